//! Poses on the plan as a picture.

use estimator::mcl::replay::Placed;
use estimator::mcl::replay::score::CLAIM_MASS;
use std::fmt::Write as _;
use vehicle::{FloorPlan, MapPose};

/// Longer side of the picture, px.
const SIDE_PX: f64 = 1000.0;
/// Room for the title, px.
const HEAD_PX: f64 = 60.0;
const MARGIN_M: f64 = 0.3;

/// What is drawn.
pub(super) struct Picture<'a> {
    pub(super) title: &'a str,
    pub(super) plan: &'a FloorPlan,
    pub(super) placed: &'a [Placed],
    pub(super) truth: Option<&'a [(u32, MapPose)]>,
}

impl Picture<'_> {
    /// The picture as SVG.
    pub(super) fn svg(&self) -> String {
        let [ox, oy] = self.plan.origin();
        let r = self.plan.resolution_m();
        let size = [
            self.plan.width() as f64 * r + 2.0 * MARGIN_M,
            self.plan.height() as f64 * r + 2.0 * MARGIN_M,
        ];
        let scale = SIDE_PX / size[0].max(size[1]);
        let top = oy + self.plan.height() as f64 * r + MARGIN_M;
        let at = |x: f64, y: f64| ((x - ox + MARGIN_M) * scale, (top - y) * scale + HEAD_PX);
        let (width, height) = (size[0] * scale, size[1] * scale + HEAD_PX);
        let title: String = self
            .title
            .chars()
            .map(|c| if "<>&\"".contains(c) { '_' } else { c })
            .collect();
        // Writing to a String cannot fail.
        let mut out = format!(
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0} {height:.0}" font-family="system-ui, sans-serif">
<rect width="100%" height="100%" fill="#fbfaf7"/>
<text x="16" y="26" font-size="18" font-weight="600" fill="#1d2733">{title}</text>
<g font-size="14" fill="#1d2733"><circle cx="22" cy="46" r="5" fill="#e8710a"/><text x="34" y="51">pose, claimed</text><circle cx="152" cy="46" r="5" fill="none" stroke="#e8710a"/><text x="164" y="51">pose, not sure</text><circle cx="292" cy="46" r="5" fill="#1f77b4"/><text x="304" y="51">truth</text></g>
<g stroke="#2b3644" stroke-width="1.2" stroke-linecap="round">
"##
        );
        for s in self.plan.wall_segments() {
            let ((x1, y1), (x2, y2)) = (at(s.a[0], s.a[1]), at(s.b[0], s.b[1]));
            let _ = writeln!(
                out,
                r#"<line x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}"/>"#
            );
        }
        out.push_str("</g>\n");
        for (_, t) in self.truth.unwrap_or_default() {
            let (x, y) = at(t.x_m, t.y_m);
            let _ = writeln!(
                out,
                r##"<circle cx="{x:.1}" cy="{y:.1}" r="5" fill="#1f77b4"/>"##
            );
        }
        for p in self.placed {
            let (x, y) = at(p.pose.x_m, p.pose.y_m);
            let (s, c) = p.pose.yaw_rad.sin_cos();
            let fill = if p.mass > CLAIM_MASS {
                "#e8710a"
            } else {
                "none"
            };
            let _ = writeln!(
                out,
                r##"<g fill="{fill}" stroke="#e8710a"><circle cx="{x:.1}" cy="{y:.1}" r="4"/><path d="M{x:.1} {y:.1}l{:.1} {:.1}"/></g>"##,
                14.0 * c,
                -14.0 * s
            );
        }
        out.push_str("</svg>\n");
        out
    }
}
