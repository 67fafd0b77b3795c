//! Golden numbers of the thesis and of its program's tests.

use super::*;

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-12
}

#[test]
fn angle_table_of_the_nine_cells() {
    let table = [
        [-135.0, -90.0, -45.0],
        [180.0, 0.0, 0.0],
        [135.0, 90.0, 45.0],
    ];
    for (row, angles) in (-1..=1).zip(table) {
        for (column, angle) in (-1..=1).zip(angles) {
            assert!(close(bearing_deg(row, column), angle), "{row}, {column}");
        }
    }
}

#[test]
fn a_reading_counts_in_exactly_one_cell() {
    let mut w = Window::new(81);
    w.add(90.0, 0.52);
    w.add(90.0, 0.52);
    assert_eq!(
        w.count(10, 0),
        2,
        "ten cells down: clockwise from the columns"
    );
    assert_eq!(w.counts.iter().map(|c| u32::from(*c)).sum::<u32>(), 2);
    w.add(0.0, 9.0);
    w.add(f64::NAN, 0.5);
    assert_eq!(
        w.counts.iter().map(|c| u32::from(*c)).sum::<u32>(),
        2,
        "beyond the window"
    );
}

#[test]
fn magnitude_is_the_squared_count_times_a_less_b_d() {
    let mut w = Window::new(81);
    for _ in 0..3 {
        w.add(0.0, 0.52);
    }
    let h = w.histogram();
    assert!(close(h[0], 9.0 * (5.0 - 5.0 / 81.0 * 10.0)), "{}", h[0]);
    assert!(h[1..].iter().all(|d| *d == 0.0));
}

#[test]
fn hann_kernel_is_a_quarter_a_half_a_quarter_and_joins_the_ends() {
    let mut h = [0.0; SECTORS];
    h[0] = 1.0;
    let s = smoothed(&h, Smoothing::Hann, Ends::Joined);
    assert!(close(s[71], 0.25) && close(s[0], 0.5) && close(s[1], 0.25) && close(s[2], 0.0));
    let s = smoothed(&h, Smoothing::Hann, Ends::Open);
    assert!(close(s[71], 0.0) && close(s[0], 0.5) && close(s[1], 0.25));
}

#[test]
fn article_kernel_is_a_triangle_of_eleven() {
    let mut h = [0.0; SECTORS];
    h[36] = 11.0;
    let s = smoothed(&h, Smoothing::Article, Ends::Joined);
    let seen: Vec<f64> = s[30..43].iter().map(|v| libm::rint(*v)).collect();
    assert_eq!(seen, [0., 1., 2., 3., 4., 5., 6., 5., 4., 3., 2., 1., 0.]);
}

#[test]
fn one_reading_leaves_the_valley_from_2_to_72() {
    let mut w = Window::new(7);
    w.add(15.0, 0.077);
    let s = smoothed(&w.histogram(), Smoothing::Hann, Ends::Open);
    assert_eq!(valleys(&s, 0.0, Ends::Open).as_slice(), &[(2, 72)]);
    let s = smoothed(&w.histogram(), Smoothing::Hann, Ends::Joined);
    assert_eq!(
        valleys(&s, 0.0, Ends::Joined).as_slice(),
        &[(2, 71)],
        "joined, sector 71 feels it too"
    );
}

#[test]
fn empty_grid_turns_180_at_full_speed() {
    let target = target_deg([4.0, 2.0], [3.0, 2.0]);
    assert!(close(target, 180.0));
    let decision = decide(&[0.0; SECTORS], 0.0, target, 0.0, Ends::Open);
    assert_eq!(
        decision,
        Some(Decision {
            turn_deg: 180,
            speed_deg: 8
        })
    );
}

#[test]
fn density_of_eight_creeps() {
    assert_eq!([0.0, 4.0, 8.0, 50.0].map(speed_deg), [8, 4, 1, 1]);
}

/// Free sectors in a dense surrounding, with a lesser density on some.
fn dense_but(free: core::ops::Range<usize>) -> Polar {
    let mut h = [10.0; SECTORS];
    h[free].fill(0.0);
    h
}

#[test]
fn wide_valley_is_entered_seven_and_a_half_sectors_from_its_border() {
    // Sectors 20..50, target at 60: nearest border 49, far border 34, heading 41.5 sectors.
    let v = valleys(&dense_but(20..50), 2.0, Ends::Joined);
    assert!(close(heading_deg(&v, 300.0).unwrap(), 41.5 * 5.0));
    // From the other side the border is the lower one: 20 and 35.
    assert!(close(heading_deg(&v, 60.0).unwrap(), 27.5 * 5.0));
}

#[test]
fn narrow_valley_is_flown_through_the_middle() {
    let v = valleys(&dense_but(20..31), 2.0, Ends::Joined);
    assert!(close(heading_deg(&v, 300.0).unwrap(), 25.0 * 5.0));
}

#[test]
fn target_in_a_valley_is_approached_directly() {
    let v = valleys(&dense_but(20..50), 2.0, Ends::Joined);
    assert!(close(heading_deg(&v, 104.0).unwrap(), 104.0));
    assert_eq!(heading_deg(&[], 104.0), None);
}

#[test]
fn high_threshold_flies_close_and_low_threshold_loses_narrow_passages() {
    let mut h = [10.0; SECTORS];
    h[30..34].fill(1.5);
    h[50..60].fill(4.0);
    let found = |t: f64| valleys(&h, t, Ends::Joined).to_vec();
    assert_eq!(found(2.0), [(30, 34)], "the default keeps the passage");
    assert_eq!(found(1.0), [], "low: the passage is lost");
    assert_eq!(
        found(5.0),
        [(30, 34), (50, 60)],
        "high: flies where something is"
    );
}

#[test]
fn joined_valley_through_zero_is_one() {
    let mut h = [0.0; SECTORS];
    h[30..40].fill(10.0);
    assert_eq!(valleys(&h, 2.0, Ends::Joined).as_slice(), &[(40, 102)]);
    assert_eq!(
        valleys(&h, 2.0, Ends::Open).as_slice(),
        &[(0, 30), (40, 72)]
    );
    assert!(close(
        heading_deg(&valleys(&h, 2.0, Ends::Joined), 20.0).unwrap(),
        20.0
    ));
}
