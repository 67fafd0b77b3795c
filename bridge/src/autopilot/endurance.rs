//! How long the battery lasts, and when it is just enough for the way home.
//!
//! The capacity is learnt from what was used and what that did to the share left; until enough was used the parameter
//! `BAT1_CAPACITY` stands for it. The current is averaged over half a minute: a climb is no reason to turn round.

use super::params::AutopilotParams;
use vehicle::BatterySample;

/// Time constant of the average current, s.
const AVERAGE_S: f64 = 30.0;
/// A pause in the samples longer than this is not averaged over, s.
const PAUSE_S: f64 = 5.0;
/// Capacity is learnt once this share was used in one flight.
const LEARNT_AFTER: f64 = 0.04;
/// Less than this is a vehicle at rest, A.
const AT_REST_A: f64 = 0.05;
/// A way home with doors and people takes this much longer than its length at cruise speed.
const WAY_FACTOR: f64 = 1.3;

/// Watches the battery.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Endurance {
    last: Option<BatterySample>,
    /// The sample that learning counts from: the pack was changed, or the program began.
    first: Option<BatterySample>,
    average_a: f64,
    /// Time that is in the average, s.
    flown_s: f64,
    capacity_mah: Option<f64>,
}

impl Endurance {
    /// Takes a sample. Only what is drawn in flight counts for how long it lasts.
    pub fn sample(&mut self, b: &BatterySample, is_flying: bool) {
        let (Some(last), Some(first)) = (self.last, self.first) else {
            (self.last, self.first) = (Some(*b), Some(*b));
            return;
        };
        if b.at <= last.at {
            return;
        }
        let dt_s = b.at.seconds_since(last.at);
        let is_changed = matches!((last.remaining, b.remaining), (Some(was), Some(is)) if is > was + 0.05)
            || b.used_mah + 1.0 < last.used_mah;
        if is_changed {
            // Another pack: what was learnt of the old one does not hold.
            *self = Self {
                last: Some(*b),
                first: Some(*b),
                ..Self::default()
            };
            return;
        }
        if is_flying {
            if dt_s >= PAUSE_S {
                self.flown_s = 0.0;
            }
            // A plain mean at first: the motors' first turns are no measure.
            self.average_a += (b.current_a - self.average_a) * dt_s / (self.flown_s + dt_s);
            self.flown_s = (self.flown_s + dt_s).min(AVERAGE_S);
        }
        if let (Some(was), Some(is)) = (first.remaining, b.remaining)
            && was - is > LEARNT_AFTER
            && b.used_mah > first.used_mah
        {
            self.capacity_mah = Some((b.used_mah - first.used_mah) / (was - is));
        }
        self.last = Some(*b);
    }

    /// Time until the battery is empty at the present rate, s; none while it cannot be told.
    #[must_use]
    pub fn left_s(&self, params: &AutopilotParams) -> Option<f64> {
        let remaining = self.last?.remaining?;
        let told = (params.battery_capacity_mah > 0.0).then_some(params.battery_capacity_mah);
        let capacity_mah = self.capacity_mah.or(told)?;
        let drawn_a = self.average_a;
        (drawn_a > AT_REST_A).then(|| remaining * capacity_mah * 3.6 / drawn_a)
    }

    /// Time that the way home and the landing take, s.
    #[must_use]
    pub fn home_s(way_m: f64, height_m: f64, cruise_mps: f64, params: &AutopilotParams) -> f64 {
        let way_s = WAY_FACTOR * way_m / cruise_mps.max(0.05);
        way_s + height_m.max(0.0) / params.descent_mps.max(0.05)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle::Timestamp;

    fn sample(s: u64, remaining: f64, used_mah: f64, current_a: f64) -> BatterySample {
        BatterySample {
            at: Timestamp::from_ms(1_000 * s),
            voltage_v: 15.0,
            current_a,
            used_mah,
            cells: 4,
            remaining: Some(remaining),
        }
    }

    #[test]
    fn a_pack_of_1500_mah_at_6_amperes_lasts_a_quarter_of_an_hour() {
        let params = AutopilotParams::default();
        let mut e = Endurance::default();
        assert_eq!(e.left_s(&params), None);
        for s in 0..120 {
            let used = 6.0 * s as f64 / 3.6;
            e.sample(&sample(s, 1.0 - used / 1500.0, used, 6.0), true);
            if s == 10 {
                assert_eq!(e.left_s(&params), None, "not learnt yet");
                let told = AutopilotParams {
                    battery_capacity_mah: 1500.0,
                    ..AutopilotParams::default()
                };
                assert!((e.left_s(&told).unwrap() - 890.0).abs() < 1.0);
            }
        }
        let left_s = e.left_s(&params).unwrap();
        assert!((left_s - 781.0).abs() < 2.0, "{left_s}");
    }

    #[test]
    fn a_new_pack_is_learnt_anew_and_a_vehicle_at_rest_lasts_for_ever() {
        let params = AutopilotParams::default();
        let mut e = Endurance::default();
        for s in 0..60 {
            e.sample(
                &sample(s, 0.5 - 0.01 * s as f64, 10.0 * s as f64, 5.0),
                true,
            );
        }
        assert!(e.left_s(&params).is_some());
        e.sample(&sample(61, 1.0, 0.0, 5.0), true);
        assert_eq!(e.left_s(&params), None);
        let mut e = Endurance::default();
        for s in 0..60 {
            e.sample(&sample(s, 1.0 - 0.002 * s as f64, s as f64, 5.0), false);
        }
        assert_eq!(e.left_s(&params), None);
    }

    #[test]
    fn the_way_home_is_reckoned_with_doors_and_descent() {
        let params = AutopilotParams::default();
        let home_s = Endurance::home_s(14.0, 1.0, 0.7, &params);
        assert!((home_s - (26.0 + 2.5)).abs() < 1e-6, "{home_s}");
    }
}
