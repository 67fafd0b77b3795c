//! Plane geometry on the plan: rays, segments, discs, convex polygons.

use vehicle::Segment;

pub(crate) type Point = [f64; 2];

/// Corner hits count: without the slack a ray could slip between two walls that share a corner.
const SLACK: f64 = 1e-9;

/// Distance along a ray to a segment. `direction` need not have length 1; the distance is in its multiples.
pub(crate) fn ray_segment(origin: Point, direction: Point, s: &Segment) -> Option<f64> {
    let along = [s.b[0] - s.a[0], s.b[1] - s.a[1]];
    let to_a = [s.a[0] - origin[0], s.a[1] - origin[1]];
    let denominator = cross(direction, along);
    if denominator.abs() < 1e-12 {
        return None;
    }
    let t = cross(to_a, along) / denominator;
    let u = cross(to_a, direction) / denominator;
    (t >= 0.0 && (-SLACK..=1.0 + SLACK).contains(&u)).then_some(t)
}

/// Distance along a ray of unit direction to a disc; 0 from inside.
pub(crate) fn ray_disc(
    origin: Point,
    direction: Point,
    centre: Point,
    radius_m: f64,
) -> Option<f64> {
    let to_centre = [centre[0] - origin[0], centre[1] - origin[1]];
    let along = dot(to_centre, direction);
    let outside2 = dot(to_centre, to_centre) - radius_m * radius_m;
    if outside2 <= 0.0 {
        return Some(0.0);
    }
    let half_chord2 = along * along - outside2;
    (along > 0.0 && half_chord2 >= 0.0).then(|| along - half_chord2.sqrt())
}

/// The point of a segment nearest to `p`.
pub(crate) fn nearest_on_segment(p: Point, s: &Segment) -> Point {
    let along = [s.b[0] - s.a[0], s.b[1] - s.a[1]];
    let length2 = dot(along, along);
    if length2 == 0.0 {
        return s.a;
    }
    let u = (dot([p[0] - s.a[0], p[1] - s.a[1]], along) / length2).clamp(0.0, 1.0);
    [s.a[0] + u * along[0], s.a[1] + u * along[1]]
}

/// True if `p` lies inside a convex polygon with corners counter-clockwise.
pub(crate) fn inside_convex(p: Point, corners: &[Point]) -> bool {
    let next = corners.iter().cycle().skip(1);
    corners
        .iter()
        .zip(next)
        .all(|(a, b)| cross([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]) >= 0.0)
}

pub(crate) fn distance(a: Point, b: Point) -> f64 {
    let (dx, dy) = (a[0] - b[0], a[1] - b[1]);
    (dx * dx + dy * dy).sqrt()
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    const WALL: Segment = Segment {
        a: [2.0, -1.0],
        b: [2.0, 1.0],
    };

    #[test]
    fn a_ray_meets_the_wall_ahead_and_not_the_one_behind() {
        assert_eq!(ray_segment([0.0, 0.0], [1.0, 0.0], &WALL), Some(2.0));
        assert_eq!(ray_segment([0.0, 0.0], [-1.0, 0.0], &WALL), None);
        assert_eq!(ray_segment([0.0, 1.1], [1.0, 0.0], &WALL), None);
        let slanted = ray_segment([0.0, 0.0], [0.8, 0.4], &WALL).unwrap();
        assert_abs_diff_eq!(slanted, 2.5, epsilon = 1e-12);
    }

    #[test]
    fn a_ray_meets_the_near_side_of_a_disc() {
        assert_eq!(
            ray_disc([0.0, 0.0], [1.0, 0.0], [3.0, 0.0], 0.25),
            Some(2.75)
        );
        assert_eq!(ray_disc([0.0, 0.0], [-1.0, 0.0], [3.0, 0.0], 0.25), None);
        assert_eq!(ray_disc([0.0, 0.0], [1.0, 0.0], [3.0, 0.3], 0.25), None);
        assert_eq!(
            ray_disc([3.1, 0.0], [1.0, 0.0], [3.0, 0.0], 0.25),
            Some(0.0)
        );
    }

    #[test]
    fn nearest_point_of_a_wall_is_its_foot_or_its_end() {
        assert_eq!(nearest_on_segment([0.0, 0.5], &WALL), [2.0, 0.5]);
        assert_eq!(nearest_on_segment([0.0, 5.0], &WALL), [2.0, 1.0]);
    }

    #[test]
    fn inside_and_outside_of_a_triangle() {
        let triangle = [[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]];
        assert!(inside_convex([0.5, 0.5], &triangle));
        assert!(!inside_convex([1.5, 1.5], &triangle));
    }
}
