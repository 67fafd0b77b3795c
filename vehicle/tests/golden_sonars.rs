//! Golden numbers of the SNSI thesis' six sonars (HC-SR04): angles, range, rate.

#![allow(clippy::unwrap_used, reason = "a test fails where it stands")]

use vehicle::{RangerKind, RingConfig};

#[test]
fn golden_sonars_of_snsi_look_to_0_53_90_127_180_degrees_and_down_from_2_to_400_cm_at_3_hz() {
    let ring = RingConfig::built_in("snsi6").unwrap();
    let level: Vec<f64> = ring
        .rangers
        .iter()
        .filter(|r| !r.looks_down())
        .map(|r| 90.0 - r.bearing_deg)
        .collect();
    assert_eq!(level.len(), 5);
    for (angle, golden) in level.iter().zip([0.0, 53.0, 90.0, 127.0, 180.0]) {
        assert!((angle - golden).abs() < 1e-9, "{angle} instead of {golden}");
    }
    assert_eq!(ring.rangers.iter().filter(|r| r.looks_down()).count(), 1);
    for r in &ring.rangers {
        assert_eq!(r.kind, RangerKind::Sonar);
        assert!((r.min_m - 0.02).abs() < 1e-9 && (r.max_m - 4.0).abs() < 1e-9);
        // Five fired one after the other take 0.3 s.
        assert!((r.rate_hz - 3.0).abs() < 0.5, "{}", r.rate_hz);
    }
}
