//! A floor plan as a picture: walls, rooms, doors, zones, and the path of a patrol on it.

use std::fmt::Write as _;
use vehicle::{FloorPlan, In, Map};

/// Width of the picture, px.
const WIDTH_PX: f64 = 1000.0;
/// Border, px.
const MARGIN_PX: f64 = 30.0;
/// Room for the title, px.
const HEAD_PX: f64 = 44.0;

/// What is drawn.
pub(crate) struct PlanPicture<'a> {
    /// Words above it.
    pub(crate) title: &'a str,
    /// Walls, rooms, zones.
    pub(crate) plan: &'a FloorPlan,
    /// The way flown, corner by corner.
    pub(crate) path: &'a [In<Map>],
    /// Places where it stops, with what stands beside them.
    pub(crate) stops: &'a [(String, In<Map>)],
    /// Width that the path sweeps, m; 0 for none.
    pub(crate) swath_m: f64,
}

impl PlanPicture<'_> {
    /// The picture as SVG.
    pub(crate) fn svg(&self) -> String {
        let plan = self.plan;
        let size = [plan.width(), plan.height()].map(|n| n as f64 * plan.resolution_m());
        let scale = (WIDTH_PX - 2.0 * MARGIN_PX) / size[0].max(0.1);
        let height = size[1] * scale + 2.0 * MARGIN_PX + HEAD_PX;
        let at = |[x, y]: [f64; 2]| {
            (
                (x - plan.origin()[0]) * scale + MARGIN_PX,
                (plan.origin()[1] + size[1] - y) * scale + MARGIN_PX + HEAD_PX,
            )
        };
        let points = |list: &mut dyn Iterator<Item = [f64; 2]>| {
            let mut out = String::new();
            for p in list {
                let (x, y) = at(p);
                let _ = write!(out, "{x:.1},{y:.1} ");
            }
            out
        };
        let mut out = String::new();
        // Writing to a String cannot fail.
        let _ = write!(
            out,
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH_PX:.0} {height:.0}" font-family="system-ui, sans-serif">
<rect width="100%" height="100%" fill="#fbfaf7"/>
<text x="{MARGIN_PX}" y="32" font-size="19" font-weight="600" fill="#1d2733">{}</text>
"##,
            escape(self.title),
        );
        for zone in &plan.no_fly {
            let _ = writeln!(
                out,
                r##"<polygon class="no-fly" points="{}" fill="#d1242f" fill-opacity="0.15" stroke="#d1242f" stroke-dasharray="6 4"/>"##,
                points(&mut zone.iter().copied())
            );
        }
        let mut path = self.path.iter().map(|p| [p.x(), p.y()]);
        let corners = points(&mut path);
        if self.swath_m > 0.0 && !corners.is_empty() {
            let _ = writeln!(
                out,
                r##"<polyline class="swath" points="{corners}" fill="none" stroke="#54aeff" stroke-opacity="0.25" stroke-width="{:.1}" stroke-linejoin="round" stroke-linecap="round"/>"##,
                self.swath_m * scale
            );
        }
        out.push_str(
            "<g class=\"walls\" stroke=\"#2b3644\" stroke-width=\"2\" stroke-linecap=\"round\">\n",
        );
        for s in plan.wall_segments() {
            let ((x1, y1), (x2, y2)) = (at(s.a), at(s.b));
            let _ = writeln!(
                out,
                r#"<line x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}"/>"#
            );
        }
        out.push_str("</g>\n");
        for door in &plan.doors {
            let ((x1, y1), (x2, y2)) = (at(door.a), at(door.b));
            let _ = writeln!(
                out,
                r##"<line class="door" x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}" stroke="#1a7f37" stroke-width="3"><title>{}</title></line>"##,
                escape(&door.name)
            );
        }
        for room in &plan.rooms {
            let (x, y) = at([room.x, room.y]);
            let _ = writeln!(
                out,
                r##"<text x="{x:.0}" y="{:.0}" font-size="15" fill="#9aa3ad" text-anchor="middle">{}</text>"##,
                y - 12.0,
                escape(&room.name)
            );
        }
        if !corners.is_empty() {
            let _ = writeln!(
                out,
                r##"<polyline class="path" points="{corners}" fill="none" stroke="#1f77b4" stroke-width="2" stroke-linejoin="round"/>"##
            );
        }
        for (name, p) in self.stops {
            let (x, y) = at([p.x(), p.y()]);
            let _ = writeln!(
                out,
                r##"<circle cx="{x:.1}" cy="{y:.1}" r="9" fill="#8250df"/><text x="{x:.1}" y="{:.1}" font-size="11" fill="#fff" text-anchor="middle">{}</text>"##,
                y + 4.0,
                escape(name)
            );
        }
        if let Some(home) = plan.home {
            let (x, y) = at([home.x_m, home.y_m]);
            let (dx, dy) = (
                22.0 * libm::cos(home.yaw_rad),
                -22.0 * libm::sin(home.yaw_rad),
            );
            let _ = writeln!(
                out,
                r##"<g class="home" fill="none" stroke="#1a7f37" stroke-width="2.4"><circle cx="{x:.1}" cy="{y:.1}" r="11"/><path d="M{x:.1} {y:.1}l{dx:.1} {dy:.1}"/></g>"##
            );
        }
        out.push_str("</svg>\n");
        out
    }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
