//! How a flight was: gathered from snapshots while armed, told after landing.

use crate::autopilot::door::Snapshot;
use crate::autopilot::latency::LatencySummary;
use crate::autopilot::mode::Because;
use std::fmt;
use vehicle::{In, Ned, Timestamp};

/// Faster than anything indoors: a step like this is a correction of the place, no way flown, m/s.
const JUMP_MPS: f64 = 10.0;

/// How one flight was, from arming to disarming.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FlightSummary {
    /// Time armed, s.
    pub duration_s: f64,
    /// Way over ground by the estimate while localized, m.
    pub distance_m: f64,
    /// Largest height, m.
    pub highest_m: f64,
    /// Jumps of the published place.
    pub resets: u32,
    /// Age of the attitude at each RC frame.
    pub sample_to_command: LatencySummary,
    /// Our own share of it.
    pub reply_to_command: LatencySummary,
    /// Beats missed.
    pub missed: u64,
    /// Failsafes that acted, in order, each named once.
    pub faults: Vec<&'static str>,
    localized_s: f64,
    battery: Option<(f64, f64)>,
}

impl FlightSummary {
    /// Share of the flight with a known place, 0..=1.
    #[must_use]
    pub fn localized_share(&self) -> f64 {
        if self.duration_s > 0.0 {
            (self.localized_s / self.duration_s).min(1.0)
        } else {
            0.0
        }
    }

    /// Charge used, 0..=1, if the controller tells.
    #[must_use]
    pub fn battery_used(&self) -> Option<f64> {
        self.battery.map(|(first, last)| first - last)
    }
}

/// `Flight 85 s, 23.4 m, up to 1.0 m, localized 99 %, p99 12.8 ms, 0 beats missed, no faults`.
impl fmt::Display for FlightSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "Flight {:.0} s, {:.1} m, up to {:.1} m, localized {:.0} %, p99 {:.1} ms, {} beats missed, ",
            self.duration_s,
            self.distance_m,
            self.highest_m,
            100.0 * self.localized_share(),
            self.sample_to_command.p99_us as f64 * 1e-3,
            self.missed,
        )?;
        if self.faults.is_empty() {
            f.write_str("no faults")
        } else {
            write!(f, "faults: {}", self.faults.join(", "))
        }
    }
}

/// Gathers a flight.
#[derive(Clone, Debug, Default)]
pub struct FlightBook {
    open: Option<Page>,
}

#[derive(Clone, Debug)]
struct Page {
    summary: FlightSummary,
    began: Timestamp,
    last: Timestamp,
    place: In<Ned>,
    resets: u8,
    missed: u64,
    because: Because,
}

impl FlightBook {
    /// Takes the vehicle as it is now; gives the summary when a flight is over.
    pub fn look(&mut self, s: &Snapshot) -> Option<FlightSummary> {
        match (&mut self.open, s.is_armed) {
            (None, false) => None,
            (None, true) => {
                self.open = Some(Page {
                    summary: FlightSummary::default(),
                    began: s.at,
                    last: s.at,
                    place: s.nav.position,
                    resets: s.nav.localization.reset_counter,
                    missed: s.flight_loop.missed,
                    because: s.mode.because,
                });
                None
            }
            (Some(page), true) => {
                page.look(s);
                None
            }
            (Some(page), false) => {
                page.note(s.mode.because);
                self.open.take().map(|page| page.summary)
            }
        }
    }
}

impl Page {
    fn look(&mut self, s: &Snapshot) {
        let dt_s = s.at.since(self.last).as_secs_f64();
        self.last = s.at;
        let sum = &mut self.summary;
        sum.duration_s = s.at.since(self.began).as_secs_f64();
        sum.highest_m = sum.highest_m.max(-s.nav.position.z());
        sum.sample_to_command = s.flight_loop.sample_to_command;
        sum.reply_to_command = s.flight_loop.reply_to_command;
        sum.missed = s.flight_loop.missed - self.missed;
        sum.resets += u32::from(s.nav.localization.reset_counter.wrapping_sub(self.resets));
        self.resets = s.nav.localization.reset_counter;
        if s.nav.health.position {
            sum.localized_s += dt_s;
            let step_m = (s.nav.position - self.place).norm_xy();
            if step_m <= JUMP_MPS * dt_s {
                sum.distance_m += step_m;
            }
        }
        self.place = s.nav.position;
        if let Some(left) = s.battery.and_then(|b| b.remaining) {
            sum.battery = Some((sum.battery.map_or(left, |(first, _)| first), left));
        }
        self.note(s.mode.because);
    }

    fn note(&mut self, because: Because) {
        let is_new = because != self.because;
        self.because = because;
        if is_new && because.is_failsafe() && !self.summary.faults.contains(&because.words()) {
            self.summary.faults.push(because.words());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flight_is_summed_up_when_it_is_over() {
        let mut book = FlightBook::default();
        let mut s = Snapshot::default();
        assert_eq!(book.look(&s), None);
        s.is_armed = true;
        s.nav.health.position = true;
        for i in 0..=100 {
            s.at = Timestamp::from_ms(1_000 + i * 100);
            s.nav.position = In::new(0.05 * i as f64, 0.0, -1.0);
            s.nav.health.position = i < 50;
            if i == 80 {
                s.mode.because = Because::BatteryLow;
            }
            assert_eq!(book.look(&s), None);
        }
        s.is_armed = false;
        let sum = book.look(&s).unwrap();
        assert!((sum.duration_s - 10.0).abs() < 1e-9);
        assert!((sum.distance_m - 2.45).abs() < 1e-9, "{}", sum.distance_m);
        assert!((sum.localized_share() - 0.49).abs() < 1e-9);
        assert_eq!(sum.faults, ["battery low"]);
        assert_eq!(
            sum.to_string(),
            "Flight 10 s, 2.5 m, up to 1.0 m, localized 49 %, p99 0.0 ms, 0 beats missed, faults: battery low"
        );
        assert_eq!(book.look(&s), None);
    }

    #[test]
    fn a_correction_of_the_place_is_no_way_flown() {
        let mut book = FlightBook::default();
        let mut s = Snapshot {
            is_armed: true,
            ..Snapshot::default()
        };
        s.nav.health.position = true;
        book.look(&s);
        s.at = Timestamp::from_ms(25);
        s.nav.position = In::new(5.0, 0.0, 0.0);
        book.look(&s);
        s.is_armed = false;
        assert!(book.look(&s).unwrap().distance_m < 1e-9);
    }
}
