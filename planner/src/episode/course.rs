//! A field of upright cylinders.

use thiserror::Error;

/// An upright cylinder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    /// Axis, m.
    pub x_m: f64,
    /// Axis, m.
    pub y_m: f64,
    /// Radius, m.
    pub radius_m: f64,
}

/// Why a course cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum CourseError {
    /// The first line is not the header.
    #[error("the first line must be `x_m,y_m,radius_m`")]
    Header,
    /// A line is not three numbers.
    #[error("line {line}: {what}")]
    Line {
        /// Line of the file, from 1.
        line: usize,
        /// What is wrong with it.
        what: &'static str,
    },
}

/// Obstacles, as they really are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    cylinders: Vec<Cylinder>,
}

/// Where a ray ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hit {
    pub(super) distance_m: f64,
    /// Cosine of the angle between ray and surface normal.
    pub(super) incidence_cos: f64,
}

impl Course {
    /// Of these obstacles.
    #[must_use]
    pub const fn new(cylinders: Vec<Cylinder>) -> Self {
        Self { cylinders }
    }

    /// From a table `x_m,y_m,radius_m` with header.
    ///
    /// # Errors
    /// [`CourseError`] names the line.
    pub fn from_csv(text: &str) -> Result<Self, CourseError> {
        let mut lines = text.lines().zip(1..);
        let header = lines
            .next()
            .map(|(l, _)| l.trim().trim_start_matches('\u{feff}'));
        if header != Some("x_m,y_m,radius_m") {
            return Err(CourseError::Header);
        }
        let mut cylinders = Vec::new();
        for (text, line) in lines.filter(|(l, _)| !l.trim().is_empty()) {
            let mut fields = text.split(',').map(|f| f.trim().parse::<f64>());
            let (Some(Ok(x_m)), Some(Ok(y_m)), Some(Ok(radius_m)), None) =
                (fields.next(), fields.next(), fields.next(), fields.next())
            else {
                return Err(CourseError::Line {
                    line,
                    what: "three numbers are needed",
                });
            };
            let usable = x_m.is_finite() && y_m.is_finite() && radius_m.is_finite();
            if !usable || radius_m <= 0.0 {
                return Err(CourseError::Line {
                    line,
                    what: "places must be finite and the radius positive",
                });
            }
            cylinders.push(Cylinder { x_m, y_m, radius_m });
        }
        Ok(Self { cylinders })
    }

    /// The obstacles.
    #[must_use]
    pub fn cylinders(&self) -> &[Cylinder] {
        &self.cylinders
    }

    /// From a point to the nearest surface, m; negative inside, infinite without obstacles.
    #[must_use]
    pub fn clearance_m(&self, [x, y]: [f64; 2]) -> f64 {
        self.cylinders.iter().fold(f64::INFINITY, |nearest, c| {
            nearest.min(libm::hypot(c.x_m - x, c.y_m - y) - c.radius_m)
        })
    }

    /// Those a ray of this length from a point can meet.
    pub(super) fn near(&self, [x, y]: [f64; 2], reach_m: f64, out: &mut Vec<Cylinder>) {
        out.clear();
        let within = |c: &&Cylinder| libm::hypot(c.x_m - x, c.y_m - y) - c.radius_m <= reach_m;
        out.extend(self.cylinders.iter().filter(within));
    }
}

/// The first surface along a ray.
pub(super) fn cast(near: &[Cylinder], [x, y]: [f64; 2], direction_rad: f64) -> Option<Hit> {
    let (dy, dx) = libm::sincos(direction_rad);
    let mut first: Option<Hit> = None;
    for c in near {
        let (ox, oy) = (c.x_m - x, c.y_m - y);
        let along = ox * dx + oy * dy;
        let aside2 = ox * ox + oy * oy - along * along;
        let depth2 = c.radius_m * c.radius_m - aside2;
        if along > 0.0 && depth2 > 0.0 {
            let half_chord = depth2.sqrt();
            let distance_m = (along - half_chord).max(0.0);
            if first.is_none_or(|f| distance_m < f.distance_m) {
                first = Some(Hit {
                    distance_m,
                    incidence_cos: half_chord / c.radius_m,
                });
            }
        }
    }
    first
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_ends_at_the_near_side_and_passes_beside() {
        let course = Course::from_csv("x_m,y_m,radius_m\n2,0,0.5\n4,0,0.5\n").unwrap();
        let hit = cast(course.cylinders(), [0.0, 0.0], 0.0).unwrap();
        assert!((hit.distance_m - 1.5).abs() < 1e-12 && (hit.incidence_cos - 1.0).abs() < 1e-12);
        assert_eq!(cast(course.cylinders(), [0.0, 0.6], 0.0), None);
        assert_eq!(cast(course.cylinders(), [0.0, 0.0], 3.0), None, "behind");
        assert!((course.clearance_m([0.0, 0.0]) - 1.5).abs() < 1e-12);
    }

    #[test]
    fn a_broken_table_names_its_line() {
        assert_eq!(Course::from_csv("1,2,3\n"), Err(CourseError::Header));
        for bad in ["1,2", "1,2,x", "1,2,3,4", "1,nan,0.1", "1,2,-0.1"] {
            let text = format!("x_m,y_m,radius_m\n0,0,0.1\n{bad}\n");
            let refused = Course::from_csv(&text).unwrap_err();
            assert!(
                matches!(refused, CourseError::Line { line: 3, .. }),
                "{bad}"
            );
        }
    }
}
