use super::*;

fn ray(x: f64, y: f64) -> Ray {
    Ray {
        from: Vector2::zeros(),
        to: Vector2::new(x, y),
        unexplained: true,
        open_m: 4.0,
        half_cone_rad: 0.049,
    }
}

#[test]
fn somebody_walking_is_followed_with_their_velocity() {
    let mut tracker = Tracker::default();
    let mut t = Timestamp::ZERO;
    for i in 0..15 {
        t = Timestamp::from_ms(67 * i);
        let x = 3.0 - 0.8 * t.s();
        // Three columns on the near side of a person.
        let rays: Rays = [ray(x, -0.15), ray(x - 0.05, 0.0), ray(x, 0.15)]
            .into_iter()
            .collect();
        tracker.observe(t, Vector2::zeros(), &rays, 0.25);
    }
    let [somebody] = tracker.tracks() else {
        panic!("{:?}", tracker.tracks())
    };
    assert!(somebody.is_moving());
    assert!(
        (somebody.velocity - Vector2::new(-0.8, 0.0)).norm() < 0.15,
        "{somebody:?}"
    );
    let later = Timestamp::from_us(t.us() + 500_000);
    let true_x = 3.2 - 0.8 * later.s();
    assert!((somebody.position_at(later) - Vector2::new(true_x, 0.0)).norm() < 0.15);
}

#[test]
fn a_chair_is_not_moving_and_a_wall_is_nobody() {
    let mut tracker = Tracker::default();
    for i in 0..30u64 {
        let wobble = if i % 2 == 0 { 0.03 } else { -0.03 };
        let mut rays: Rays = [ray(2.0 + wobble, 0.0), ray(2.0 - wobble, 0.2)]
            .into_iter()
            .collect();
        for k in 0..8 {
            rays.push(ray(-2.0, -1.0 + 0.25 * f64::from(k)));
        }
        tracker.observe(Timestamp::from_ms(67 * i), Vector2::zeros(), &rays, 0.25);
    }
    let [chair] = tracker.tracks() else {
        panic!("{:?}", tracker.tracks())
    };
    assert!(chair.is_confirmed() && !chair.is_moving());
}

#[test]
fn nobody_is_kept_where_a_ray_passes() {
    let mut tracker = Tracker::default();
    let near: Rays = [ray(1.0, 0.0)].into_iter().collect();
    let through: Rays = [Ray {
        unexplained: false,
        ..ray(3.0, 0.0)
    }]
    .into_iter()
    .collect();
    for i in 0..6 {
        tracker.observe(Timestamp::from_ms(67 * i), Vector2::zeros(), &near, 0.25);
    }
    assert_eq!(tracker.tracks().len(), 1);
    for i in 6..10 {
        tracker.observe(Timestamp::from_ms(67 * i), Vector2::zeros(), &through, 0.25);
    }
    assert!(tracker.tracks().is_empty());
}
