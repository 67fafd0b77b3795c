//! A flight as a picture: plan, true path, estimated path, set points.

use bridge::io::truth::Row;
use sim::Room;
use std::fmt::Write as _;
use vehicle::{In, MapAnchor, Ned, Setpoint};

/// Pixels per metre.
const SCALE: f64 = 80.0;
/// Border, m.
const MARGIN_M: f64 = 0.6;
/// Room for title and legend above the plan, px.
const HEAD_PX: f64 = 64.0;

/// One point of the track.
#[derive(Clone, Debug)]
pub(crate) struct TrackPoint {
    /// Truth and estimate.
    pub(crate) row: Row,
    /// What was followed.
    pub(crate) target: Option<Setpoint>,
}

/// What is drawn.
pub(crate) struct Picture<'a> {
    /// Words above it.
    pub(crate) title: &'a str,
    /// Walls, rooms.
    pub(crate) room: &'a Room,
    /// Plan in the world.
    pub(crate) anchor: MapAnchor,
    /// The flight.
    pub(crate) track: &'a [TrackPoint],
}

impl Picture<'_> {
    /// The picture as SVG.
    pub(crate) fn svg(&self) -> String {
        let walls = self.room.segments();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in walls.iter().flat_map(|s| [s.a, s.b]) {
            for axis in 0..2 {
                low[axis] = low[axis].min(p[axis]);
                high[axis] = high[axis].max(p[axis]);
            }
        }
        let width = (high[0] - low[0] + 2.0 * MARGIN_M) * SCALE;
        let height = (high[1] - low[1] + 2.0 * MARGIN_M) * SCALE + HEAD_PX;
        let at = |x: f64, y: f64| {
            (
                (x - low[0] + MARGIN_M) * SCALE,
                (high[1] - y + MARGIN_M) * SCALE + HEAD_PX,
            )
        };
        let ned = |p: [f64; 3]| {
            let m = self.anchor.to_map(In::<Ned>::from(p));
            at(m.x(), m.y())
        };

        let mut out = String::new();
        // Writing to a String cannot fail.
        let _ = write!(
            out,
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0} {height:.0}" font-family="system-ui, sans-serif">
<rect width="100%" height="100%" fill="#fbfaf7"/>
<text x="24" y="30" font-size="19" font-weight="600" fill="#1d2733">Kestrel: {}</text>
"##,
            escape(self.title),
        );
        self.legend(&mut out);

        out.push_str(
            "<g id=\"plan\" stroke=\"#2b3644\" stroke-width=\"2.4\" stroke-linecap=\"round\">\n",
        );
        for s in walls {
            let ((x1, y1), (x2, y2)) = (at(s.a[0], s.a[1]), at(s.b[0], s.b[1]));
            let _ = writeln!(
                out,
                r#"<line x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}"/>"#
            );
        }
        out.push_str(
            "</g>\n<g id=\"rooms\" font-size=\"15\" fill=\"#9aa3ad\" text-anchor=\"middle\">\n",
        );
        for room in &self.room.floor_plan().rooms {
            let (x, y) = at(room.x, room.y);
            let _ = writeln!(
                out,
                r#"<text x="{x:.0}" y="{:.0}">{}</text>"#,
                y - 12.0,
                escape(&room.name)
            );
        }
        out.push_str("</g>\n");

        self.targets(&mut out, &ned);
        let path = |f: fn(&Row) -> [f64; 3]| {
            let mut d = String::new();
            for t in self.track.iter().filter(|t| t.row.position[2] < -0.1) {
                let (x, y) = ned(f(&t.row));
                let _ = write!(d, "{x:.1},{y:.1} ");
            }
            d
        };
        let _ = writeln!(
            out,
            r##"<polyline id="true-path" fill="none" stroke="#1f77b4" stroke-width="3.2" stroke-linejoin="round" points="{}"/>
<polyline id="estimated-path" fill="none" stroke="#e8710a" stroke-width="1.6" stroke-dasharray="6 4" points="{}"/>"##,
            path(|r| r.position),
            path(|r| r.est_position),
        );
        let (hx, hy) = ned([0.0; 3]);
        let _ = writeln!(
            out,
            r##"<g id="home" fill="none" stroke="#1a7f37" stroke-width="2.4"><circle cx="{hx:.1}" cy="{hy:.1}" r="11"/><path d="M{:.1} {hy:.1}h22M{hx:.1} {:.1}v22"/></g>"##,
            hx - 11.0,
            hy - 11.0,
        );
        for t in self.track.iter().filter(|t| t.row.contact) {
            let (x, y) = ned(t.row.position);
            let _ = writeln!(
                out,
                r##"<circle cx="{x:.1}" cy="{y:.1}" r="7" fill="#d1242f"/>"##
            );
        }
        out.push_str("</svg>\n");
        out
    }

    fn legend(&self, out: &mut String) {
        let entries = [
            ("#1f77b4", 3, "", "true path"),
            ("#e8710a", 2, "6 4", "estimated path"),
            ("#8250df", 8, "0.1 16", "set points"),
        ];
        for (i, (colour, width, dash, words)) in entries.iter().enumerate() {
            let x = 24.0 + 170.0 * i as f64;
            let _ = writeln!(
                out,
                r##"<line x1="{x}" y1="50" x2="{}" y2="50" stroke="{colour}" stroke-width="{width}" stroke-linecap="round" stroke-dasharray="{dash}"/><text x="{}" y="55" font-size="14" fill="#1d2733">{words}</text>"##,
                x + 34.0,
                x + 42.0,
            );
        }
        let x = 24.0 + 170.0 * entries.len() as f64;
        let _ = writeln!(
            out,
            r##"<line x1="{x}" y1="50" x2="{}" y2="50" stroke="#1d2733" stroke-width="3"/><text x="{}" y="55" font-size="14" fill="#1d2733">1 m</text>"##,
            x + SCALE,
            x + SCALE + 8.0,
        );
    }

    /// Hover set points as dots, once each.
    fn targets(&self, out: &mut String, ned: &impl Fn([f64; 3]) -> (f64, f64)) {
        out.push_str("<g id=\"set-points\" fill=\"#8250df\">\n");
        let mut last: Option<In<Ned>> = None;
        for t in self.track {
            let Some(Setpoint::Hover { position, .. } | Setpoint::Land { position, .. }) = t.target
            else {
                continue;
            };
            if last.is_some_and(|l| (l - position).norm_xy() < 0.05) {
                continue;
            }
            last = Some(position);
            let (x, y) = ned(position.into());
            let _ = writeln!(out, r#"<circle cx="{x:.1}" cy="{y:.1}" r="4"/>"#);
        }
        out.push_str("</g>\n");
    }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
