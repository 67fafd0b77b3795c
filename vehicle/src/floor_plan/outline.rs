//! Walls as segments: the outline of the occupied cells.

use super::{Cell, FloorPlan, Segment};

impl FloorPlan {
    /// The outline of all occupied cells, straight runs joined, plan metres.
    #[must_use]
    pub fn wall_segments(&self) -> Vec<Segment> {
        let (w, h) = (self.width() as i64, self.height() as i64);
        let [ox, oy] = self.origin();
        let r = self.resolution_m();
        let solid = |c: i64, row: i64| self.cell(c, row) == Cell::Occupied;
        let mut out = Vec::new();
        // Horizontal edges between row - 1 and row, then vertical ones between column - 1 and column. An edge belongs to
        // the outline where exactly one side is solid; a run ends where the solid side changes.
        for row in 0..=h {
            runs(
                w,
                |c| i8::from(solid(c, row)) - i8::from(solid(c, row - 1)),
                |from, to| {
                    let y = oy + row as f64 * r;
                    out.push(Segment {
                        a: [ox + from as f64 * r, y],
                        b: [ox + to as f64 * r, y],
                    });
                },
            );
        }
        for column in 0..=w {
            runs(
                h,
                |row| i8::from(solid(column, row)) - i8::from(solid(column - 1, row)),
                |from, to| {
                    let x = ox + column as f64 * r;
                    out.push(Segment {
                        a: [x, oy + from as f64 * r],
                        b: [x, oy + to as f64 * r],
                    });
                },
            );
        }
        out
    }
}

fn runs(length: i64, side: impl Fn(i64) -> i8, mut emit: impl FnMut(i64, i64)) {
    let mut start = 0;
    let mut current = 0i8;
    for i in 0..=length {
        let here = if i < length { side(i) } else { 0 };
        if here != current {
            if current != 0 {
                emit(start, i);
            }
            (start, current) = (i, here);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_two_by_one_block_has_four_walls() {
        let mut cells = vec![Cell::Free; 16];
        cells[5] = Cell::Occupied;
        cells[6] = Cell::Occupied;
        let plan = FloorPlan::from_cells(4, 1.0, [0.0, 0.0], cells).unwrap();
        let walls = plan.wall_segments();
        assert_eq!(walls.len(), 4);
        assert!(walls.contains(&Segment {
            a: [1.0, 1.0],
            b: [3.0, 1.0]
        }));
        assert!(walls.contains(&Segment {
            a: [3.0, 1.0],
            b: [3.0, 2.0]
        }));
    }
}
