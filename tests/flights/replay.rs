//! The same seed is the same flight, to the bit.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use flight_tests::Scenario;

#[test]
fn the_same_seed_gives_the_same_flight() {
    let fly = |seed| {
        let mut f = Scenario::office().seed(seed).start();
        f.take_off(1.0);
        f.wait_s(10.0);
        (f.rows.clone(), f.snapshot().clone())
    };
    let (a, b, c) = (fly(7), fly(7), fly(8));
    assert!(a == b, "two flights with one seed differ");
    assert!(a.0 != c.0, "two seeds give one flight");
}
