//! Rays against wall segments, as SNSI computed predicted distances: orientation test, then line intersection.

use vehicle::floor_plan::Segment;

/// Twice the signed area of a triangle: positive if the corners run counter-clockwise.
#[must_use]
pub fn orientation(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Distance of two points.
#[must_use]
pub fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    libm::hypot(b[0] - a[0], b[1] - a[1])
}

/// Where the segment from `a` to `b` crosses a wall, if it does: the ends of each lie on different sides of the other.
#[must_use]
pub fn crossing(a: [f64; 2], b: [f64; 2], wall: &Segment) -> Option<[f64; 2]> {
    let (p, q) = (wall.a, wall.b);
    let (da, db) = (orientation(p, q, a), orientation(p, q, b));
    let (dp, dq) = (orientation(a, b, p), orientation(a, b, q));
    if da * db > 0.0 || dp * dq > 0.0 {
        return None;
    }
    let span = da - db;
    if span == 0.0 {
        // Parallel: along the wall there is no single point.
        return None;
    }
    let t = da / span;
    Some([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])])
}

/// End of a ray of a sensor. SNSI counts sensor angles counter-clockwise from the right-hand side: 90 degrees is ahead.
#[must_use]
pub fn ray_end(origin: [f64; 2], heading_rad: f64, sensor_rad: f64, length: f64) -> [f64; 2] {
    let direction = heading_rad - core::f64::consts::FRAC_PI_2 + sensor_rad;
    [
        origin[0] + length * libm::cos(direction),
        origin[1] + length * libm::sin(direction),
    ]
}

/// The nearest wall on the way from `a` to `b`: index and point.
#[must_use]
pub fn nearest(a: [f64; 2], b: [f64; 2], walls: &[Segment]) -> Option<(usize, [f64; 2])> {
    let mut best: Option<(usize, [f64; 2])> = None;
    let mut least = f64::INFINITY;
    for (i, wall) in walls.iter().enumerate() {
        if let Some(hit) = crossing(a, b, wall) {
            let d = distance(a, hit);
            if d < least {
                least = d;
                best = Some((i, hit));
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::{FRAC_PI_2, PI};

    fn walls() -> [Segment; 3] {
        let s = |a, b| Segment { a, b };
        [
            s([6.0, 9.0], [8.0, 3.0]),
            s([3.0, 6.0], [6.0, 7.0]),
            s([2.0, 5.0], [5.0, 3.0]),
        ]
    }

    fn near(a: [f64; 2], b: [f64; 2]) -> bool {
        distance(a, b) < 1e-12
    }

    #[test]
    fn golden_ray_ends_from_5_4_heading_90_at_0_and_180_degrees_with_length_3() {
        assert!(near(ray_end([5.0, 4.0], FRAC_PI_2, 0.0, 3.0), [8.0, 4.0]));
        assert!(near(ray_end([5.0, 4.0], FRAC_PI_2, PI, 3.0), [2.0, 4.0]));
    }

    #[test]
    fn golden_hits_are_at_7_6667_4_on_the_first_wall_and_at_3_5_4_on_the_third() {
        let origin = [5.0, 4.0];
        let (wall, hit) = nearest(origin, ray_end(origin, FRAC_PI_2, 0.0, 3.0), &walls()).unwrap();
        assert!(wall == 0 && near(hit, [23.0 / 3.0, 4.0]), "{wall} {hit:?}");
        let (wall, hit) = nearest(origin, ray_end(origin, FRAC_PI_2, PI, 3.0), &walls()).unwrap();
        assert!(wall == 2 && near(hit, [3.5, 4.0]), "{wall} {hit:?}");
    }

    #[test]
    fn golden_origin_5_0_meets_no_wall() {
        let origin = [5.0, 0.0];
        for angle in [0.0, PI] {
            let end = ray_end(origin, FRAC_PI_2, angle, 3.0);
            assert_eq!(nearest(origin, end, &walls()), None);
        }
    }

    #[test]
    fn golden_distance_of_0_0_and_1_1_is_1_41421356() {
        let golden: f64 = "1.41421356".parse().unwrap();
        assert!((distance([0.0, 0.0], [1.0, 1.0]) - golden).abs() < 1e-8);
    }

    #[test]
    fn a_ray_along_a_wall_meets_nothing_and_the_nearest_of_two_walls_is_taken() {
        let s = |a, b| Segment { a, b };
        let along = [s([0.0, 0.0], [4.0, 0.0])];
        assert_eq!(nearest([1.0, 0.0], [3.0, 0.0], &along), None);
        let two = [s([3.0, -1.0], [3.0, 1.0]), s([2.0, -1.0], [2.0, 1.0])];
        let (wall, hit) = nearest([0.0, 0.0], [9.0, 0.0], &two).unwrap();
        assert!(wall == 1 && near(hit, [2.0, 0.0]));
    }
}
