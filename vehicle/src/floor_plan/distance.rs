//! Exact Euclidean distance transform (Felzenszwalb and Huttenlocher 2012), two passes of lower envelopes.

use super::{Cell, FloorPlan};
use crate::{In, Map};

/// Distance to the nearest occupied cell for every cell of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct DistanceField {
    width: usize,
    height: usize,
    resolution_m: f64,
    origin: [f64; 2],
    max_m: f64,
    distances_m: Vec<f32>,
}

impl DistanceField {
    pub(super) fn new(plan: &FloorPlan, max_m: f64) -> Self {
        let (width, height) = (plan.width(), plan.height());
        let far = ((width + height) * (width + height)) as f64;
        let mut squared: Vec<f64> = plan
            .cells()
            .iter()
            .map(|c| if *c == Cell::Occupied { 0.0 } else { far })
            .collect();
        let mut pass = Envelope::new(width.max(height));
        for row in squared.chunks_exact_mut(width) {
            pass.transform(row);
        }
        let mut column = vec![0.0; height];
        for x in 0..width {
            for (y, value) in column.iter_mut().enumerate() {
                *value = squared[y * width + x];
            }
            pass.transform(&mut column);
            for (y, value) in column.iter().enumerate() {
                squared[y * width + x] = *value;
            }
        }
        let resolution_m = plan.resolution_m();
        let distances_m = squared
            .iter()
            .map(|s| (libm::sqrt(*s) * resolution_m).min(max_m) as f32)
            .collect();
        Self {
            width,
            height,
            resolution_m,
            origin: plan.origin(),
            max_m,
            distances_m,
        }
    }

    /// Distance from the cell at a point to the nearest occupied cell (centre to centre), m; 0 outside the plan.
    #[must_use]
    pub fn at(&self, p: In<Map>) -> f64 {
        let x = libm::floor((p.x() - self.origin[0]) / self.resolution_m);
        let y = libm::floor((p.y() - self.origin[1]) / self.resolution_m);
        if x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64 {
            f64::from(self.distances_m[y as usize * self.width + x as usize])
        } else {
            0.0
        }
    }

    /// Distances in rows from the bottom up, m.
    #[must_use]
    pub fn distances_m(&self) -> &[f32] {
        &self.distances_m
    }

    /// The same cut at a smaller distance, m.
    #[must_use]
    pub fn cut(&self, max_m: f64) -> Self {
        let mut cut = self.clone();
        cut.max_m = max_m.min(self.max_m);
        for d in &mut cut.distances_m {
            *d = d.min(cut.max_m as f32);
        }
        cut
    }

    /// Where distances are cut, m.
    #[must_use]
    pub const fn max_m(&self) -> f64 {
        self.max_m
    }
}

/// Work space of the one-dimensional transform.
struct Envelope {
    parabolas: Vec<usize>,
    borders: Vec<f64>,
    input: Vec<f64>,
}

impl Envelope {
    fn new(longest: usize) -> Self {
        Self {
            parabolas: vec![0; longest],
            borders: vec![0.0; longest + 1],
            input: vec![0.0; longest],
        }
    }

    /// Replaces f by min over q of (p - q)^2 + f(q).
    fn transform(&mut self, f: &mut [f64]) {
        let n = f.len();
        self.input[..n].copy_from_slice(f);
        let (v, z, g) = (&mut self.parabolas, &mut self.borders, &self.input);
        let mut k = 0usize;
        v[0] = 0;
        z[0] = f64::NEG_INFINITY;
        z[1] = f64::INFINITY;
        for q in 1..n {
            loop {
                let p = v[k];
                let (qf, pf) = (q as f64, p as f64);
                let s = ((g[q] + qf * qf) - (g[p] + pf * pf)) / (2.0 * (qf - pf));
                if s <= z[k] && k > 0 {
                    k -= 1;
                } else {
                    let at = if s <= z[k] { k } else { k + 1 };
                    k = at;
                    v[k] = q;
                    z[k] = if k == 0 { f64::NEG_INFINITY } else { s };
                    z[k + 1] = f64::INFINITY;
                    break;
                }
            }
        }
        k = 0;
        for (q, out) in f.iter_mut().enumerate() {
            while z[k + 1] < q as f64 {
                k += 1;
            }
            let d = q as f64 - v[k] as f64;
            *out = d * d + g[v[k]];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equals_the_brute_force_distance(w in 1usize..14, h in 1usize..14, seed in any::<u64>()) {
            let mut s = seed | 1;
            let mut cells: Vec<Cell> = (0..w * h).map(|_| {
                s ^= s << 13; s ^= s >> 7; s ^= s << 17;
                if s % 7 == 0 { Cell::Occupied } else { Cell::Free }
            }).collect();
            cells[seed as usize % (w * h)] = Cell::Occupied;
            let plan = FloorPlan::from_cells(w, 1.0, [0.0, 0.0], cells.clone()).unwrap();
            let field = plan.distance_field(1e9);
            prop_assert_eq!(field.cut(2.0), plan.distance_field(2.0));
            for y in 0..h { for x in 0..w {
                let best = (0..w * h).filter(|i| cells[*i] == Cell::Occupied).map(|i| {
                    let (dx, dy) = ((i % w) as f64 - x as f64, (i / w) as f64 - y as f64);
                    (dx * dx + dy * dy).sqrt()
                }).fold(f64::INFINITY, f64::min);
                let got = field.at(plan.centre_of(x as i64, y as i64));
                prop_assert!((got - best).abs() < 1e-5, "({x},{y}): {got} instead of {best}");
            }}
        }
    }
}
