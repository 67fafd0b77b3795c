//! A course from above with the tracks of the methods, as SVG.

use planner::episode::standard::Standard;
use std::fmt::Write as _;

/// Pixels of a metre, and the border, m.
const SCALE: f64 = 80.0;
const BORDER_M: f64 = 0.8;
/// Room for the legend, pixels.
const LEGEND: f64 = 66.0;
/// Colours that people with any colour vision tell apart (Okabe and Ito).
const COLOURS: [&str; 4] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7"];

/// One method's first flight.
pub(super) struct Track {
    /// Of the method.
    pub(super) name: &'static str,
    /// Where it was, m.
    pub(super) points: Vec<[f64; 2]>,
    /// How it ended.
    pub(super) outcome: &'static str,
}

/// The picture.
pub(super) fn draw(standard: &Standard, tracks: &[Track]) -> String {
    let [sx, sy, _] = standard.start;
    let posts = standard.course.cylinders();
    let ends = [[sx, sy], standard.goal];
    let all = || {
        posts
            .iter()
            .map(|c| [c.x_m, c.y_m])
            .chain(ends)
            .chain(tracks.iter().flat_map(|t| t.points.iter().copied()))
    };
    let low = [0, 1].map(|i| all().map(|p| p[i]).fold(f64::INFINITY, f64::min) - BORDER_M);
    let high = [0, 1].map(|i| all().map(|p| p[i]).fold(f64::NEG_INFINITY, f64::max) + BORDER_M);
    let px = |p: [f64; 2]| [(p[0] - low[0]) * SCALE, LEGEND + (high[1] - p[1]) * SCALE];
    let (width, height) = (
        (high[0] - low[0]) * SCALE,
        LEGEND + (high[1] - low[1]) * SCALE,
    );
    let mut out = String::new();
    // Writing to a String cannot fail.
    let _ = write!(
        out,
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0} {height:.0}" font-family="system-ui, sans-serif" font-size="14" fill="#1d2733">
<rect width="100%" height="100%" fill="#fbfaf7"/>
<text x="16" y="26" font-size="18" font-weight="600">{}: {}</text>
"##,
        standard.name, standard.asks
    );
    for c in posts {
        let [x, y] = px([c.x_m, c.y_m]);
        let _ = writeln!(
            out,
            r##"<circle cx="{x:.1}" cy="{y:.1}" r="{:.1}" fill="#1d2733"/>"##,
            c.radius_m * SCALE
        );
    }
    for (i, track) in tracks.iter().enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        let mut points = String::new();
        for p in &track.points {
            let [x, y] = px(*p);
            let _ = write!(points, "{x:.1},{y:.1} ");
        }
        let _ = writeln!(
            out,
            r##"<polyline fill="none" stroke="{colour}" stroke-width="2.5" points="{}"/>"##,
            points.trim_end()
        );
        if let Some(last) = track.points.last() {
            let [x, y] = px(*last);
            let _ = writeln!(
                out,
                r##"<circle cx="{x:.1}" cy="{y:.1}" r="7" fill="none" stroke="{colour}" stroke-width="2.5"/>"##
            );
        }
        let _ = writeln!(
            out,
            r##"<text x="{:.0}" y="50" fill="{colour}" font-weight="600">{}: {}</text>"##,
            16.0 + 210.0 * i as f64,
            track.name,
            track.outcome
        );
    }
    for (p, name) in ends.into_iter().zip(["start", "goal"]) {
        let [x, y] = px(p);
        let _ = writeln!(
            out,
            r##"<path d="M{:.1} {y:.1}h12M{x:.1} {:.1}v12" stroke="#1d2733"/><text x="{:.1}" y="{:.1}">{name}</text>"##,
            x - 6.0,
            y - 6.0,
            x + 8.0,
            y + 18.0
        );
    }
    out.push_str("</svg>\n");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_track_has_its_line_and_says_how_it_ended() {
        let standard = planner::episode::standard::all().remove(0);
        let track = |name, outcome| Track {
            name,
            points: vec![[0.0, 0.0], [1.0, 0.5]],
            outcome,
        };
        let text = draw(&standard, &[track("a", "arrived"), track("b", "touched")]);
        assert_eq!(text.matches("<polyline").count(), 2);
        assert!(text.contains("a: arrived") && text.contains("b: touched"));
        assert!(!text.contains("NaN") && text.ends_with("</svg>\n"));
    }
}
