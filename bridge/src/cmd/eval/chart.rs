//! Lines over time as SVG, one panel under the other.

use std::fmt::Write as _;

const WIDTH: f64 = 960.0;
const LEFT: f64 = 76.0;
const RIGHT: f64 = 130.0;
const HEAD: f64 = 48.0;
const PANEL: f64 = 150.0;
const GAP: f64 = 34.0;
/// Colours that people with any colour vision tell apart (Okabe and Ito).
const COLOURS: [&str; 6] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9",
];

/// One panel.
pub(crate) struct Panel<'a> {
    /// Title with unit.
    pub(crate) title: &'a str,
    /// Names and values, one value for each time.
    pub(crate) lines: Vec<(&'a str, Vec<f64>)>,
}

/// The picture; `x` is the common abscissa, named `x_title`.
pub(crate) fn svg(title: &str, x_title: &str, x: &[f64], panels: &[Panel<'_>]) -> String {
    let height = HEAD + panels.len() as f64 * (PANEL + GAP) + 24.0;
    let mut out = String::new();
    // Writing to a String cannot fail.
    let _ = write!(
        out,
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="system-ui, sans-serif" font-size="12" fill="#1d2733">
<rect width="100%" height="100%" fill="#fbfaf7"/>
<text x="24" y="28" font-size="18" font-weight="600">{}</text>
"##,
        escape(title)
    );
    let across = Scale::over(x.iter().copied(), LEFT, WIDTH - RIGHT);
    for (i, panel) in panels.iter().enumerate() {
        let top = HEAD + i as f64 * (PANEL + GAP);
        panel.draw(&mut out, top, x, &across);
    }
    let _ = write!(
        out,
        r##"<text x="{:.1}" y="{:.1}" text-anchor="middle">{}</text>
</svg>
"##,
        (LEFT + WIDTH - RIGHT) / 2.0,
        height - 10.0,
        escape(x_title)
    );
    out
}

/// Values to pixels.
struct Scale {
    low: f64,
    high: f64,
    from_px: f64,
    to_px: f64,
}

impl Scale {
    fn over(values: impl Iterator<Item = f64>, from_px: f64, to_px: f64) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for v in values.filter(|v| v.is_finite()) {
            low = low.min(v);
            high = high.max(v);
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        // A constant line lies in the middle.
        let margin = (0.05 * (high - low)).max(1e-9 * high.abs()).max(1e-12);
        Self {
            low: low - margin,
            high: high + margin,
            from_px,
            to_px,
        }
    }

    fn px(&self, v: f64) -> f64 {
        self.from_px + (v - self.low) / (self.high - self.low) * (self.to_px - self.from_px)
    }
}

impl Panel<'_> {
    fn draw(&self, out: &mut String, top: f64, x: &[f64], across: &Scale) {
        let bottom = top + PANEL;
        let up = Scale::over(
            self.lines.iter().flat_map(|(_, v)| v.iter().copied()),
            bottom,
            top,
        );
        let _ = writeln!(
            out,
            r##"<text x="{LEFT}" y="{:.1}" font-weight="600">{}</text>
<rect x="{LEFT}" y="{top:.1}" width="{:.1}" height="{PANEL}" fill="none" stroke="#9aa3ad"/>"##,
            top - 5.0,
            escape(self.title),
            WIDTH - LEFT - RIGHT,
        );
        for share in [0.0, 0.5, 1.0] {
            let value = up.low + share * (up.high - up.low);
            let y = up.px(value);
            let _ = writeln!(
                out,
                r##"<text x="{:.1}" y="{:.1}" text-anchor="end">{value:.4}</text><path d="M{LEFT} {y:.1}h-4" stroke="#9aa3ad"/>"##,
                LEFT - 7.0,
                y + 4.0,
            );
            let value = across.low + share * (across.high - across.low);
            let _ = writeln!(
                out,
                r##"<text x="{:.1}" y="{:.1}" text-anchor="middle">{value:.2}</text>"##,
                across.px(value),
                bottom + 15.0,
            );
        }
        for (i, (name, values)) in self.lines.iter().enumerate() {
            let colour = COLOURS[i % COLOURS.len()];
            let mut points = String::new();
            for (&x, &v) in x.iter().zip(values).filter(|(_, v)| v.is_finite()) {
                let _ = write!(points, "{:.1},{:.1} ", across.px(x), up.px(v));
            }
            let _ = writeln!(
                out,
                r##"<polyline fill="none" stroke="{colour}" stroke-width="1.4" points="{}"/>
<text x="{:.1}" y="{:.1}" fill="{colour}" font-weight="600">{}</text>"##,
                points.trim_end(),
                WIDTH - RIGHT + 10.0,
                top + 16.0 + 17.0 * i as f64,
                escape(name),
            );
        }
    }
}

/// As text of XML.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_has_its_points_and_what_is_no_number_has_none() {
        let panel = Panel {
            title: "a < b",
            lines: vec![("up", vec![0.0, 1.0, f64::NAN]), ("flat", vec![2.0; 3])],
        };
        let text = svg("t", "s", &[0.0, 1.0, 2.0], &[panel]);
        assert!(text.contains("a &lt; b") && text.ends_with("</svg>\n"));
        let points: Vec<usize> = text
            .lines()
            .filter(|l| l.starts_with("<polyline"))
            .map(|l| l.matches(',').count())
            .collect();
        assert_eq!(points, [2, 3]);
        assert!(!text.contains("NaN") && !text.contains("inf"));
    }

    #[test]
    fn nothing_to_draw_is_an_empty_frame() {
        let panel = Panel {
            title: "none",
            lines: vec![("x", vec![])],
        };
        let text = svg("t", "s", &[], &[panel]);
        assert!(!text.contains("NaN") && !text.contains("inf"));
    }
}
