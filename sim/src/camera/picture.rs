//! A picture as video encoders take it.

/// I420: a plane of brightness, and two planes of colour at half the resolution. BT.601, 16 (black) ..= 235 (white), colour about 128.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Pixels per row; even.
    pub width: usize,
    /// Rows; even.
    pub height: usize,
    /// Brightness, row by row.
    pub y: Vec<u8>,
    /// Blue difference, one per block of 2 x 2.
    pub u: Vec<u8>,
    /// Red difference, likewise.
    pub v: Vec<u8>,
}

impl Picture {
    /// A black one. Odd sizes are rounded down to even ones.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        let (width, height) = (width & !1, height & !1);
        Self {
            width,
            height,
            y: vec![16; width * height],
            u: vec![128; width * height / 4],
            v: vec![128; width * height / 4],
        }
    }

    /// A rectangle of one brightness without colour, cut at the borders.
    pub(super) fn fill(&mut self, left: usize, top: usize, size: [usize; 2], y: u8) {
        let right = (left + size[0]).min(self.width);
        let bottom = (top + size[1]).min(self.height);
        for row in top..bottom {
            if left < right {
                self.y[row * self.width + left..row * self.width + right].fill(y);
            }
        }
        for row in top / 2..bottom.div_ceil(2) {
            let start = row * self.width / 2;
            if left < right {
                self.u[start + left / 2..start + right.div_ceil(2)].fill(128);
                self.v[start + left / 2..start + right.div_ceil(2)].fill(128);
            }
        }
    }

    /// Red, green and blue, three bytes a pixel: for looking at it.
    #[must_use]
    pub fn to_rgb(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(3 * self.y.len());
        for (i, y) in self.y.iter().enumerate() {
            let (row, column) = (i / self.width, i % self.width);
            let c = row / 2 * (self.width / 2) + column / 2;
            let luma = 1.164 * (f32::from(*y) - 16.0);
            let (u, v) = (f32::from(self.u[c]) - 128.0, f32::from(self.v[c]) - 128.0);
            let rgb = [
                luma + 1.596 * v,
                luma - 0.392 * u - 0.813 * v,
                luma + 2.017 * u,
            ];
            out.extend(rgb.map(|x| x.clamp(0.0, 255.0) as u8));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rectangle_ends_at_the_border() {
        let mut p = Picture::new(16, 8);
        p.fill(12, 6, [100, 100], 200);
        assert_eq!(p.y.iter().filter(|y| **y == 200).count(), 8);
        p.fill(40, 40, [2, 2], 99);
        assert!(!p.y.contains(&99));
    }

    #[test]
    fn black_and_white_are_grey_levels_of_rgb() {
        let mut p = Picture::new(2, 2);
        assert_eq!(p.to_rgb(), vec![0; 12]);
        p.y.fill(235);
        assert!(p.to_rgb().iter().all(|c| *c > 250));
    }
}
