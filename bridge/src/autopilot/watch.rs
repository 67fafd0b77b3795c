//! How long things have been wrong: clocks and counters behind the rows of the [`supervisor`](super::supervisor).

use super::door::HostReport;
use super::failsafes::Facts;
use super::params::AutopilotParams;
use arrayvec::ArrayVec;
use core::time::Duration;
use vehicle::sample::MAX_COLUMNS;
use vehicle::{BatterySample, In, NavState, Ned, RangerReading, Setpoint, Timestamp};

/// Most rangers that are watched for being stuck.
const RANGERS: usize = 16;
/// A vehicle that moved this far since a ranger began to say the same has moved, m.
const MOVED_M: f64 = 0.3;
/// The same for a single beam, which along a wall may well say the same, m.
const MOVED_SINGLE_M: f64 = 1.0;
/// A stuck ranger says the same at least this often.
const SAME_READINGS: u32 = 15;
/// Jumps of the place are counted over this time.
const JUMP_WINDOW: Duration = Duration::from_secs(10);
/// Missed beats are counted over this time, s.
const MISS_WINDOW_S: f64 = 2.0;
/// A vehicle on its way that stays within this circle makes no progress, m: one that is walled in may wander that far.
const PROGRESS_M: f64 = 1.0;
/// Who hovers this near to where it shall is there, m.
const THERE_M: f64 = 0.2;
/// Faster than anything indoors, m/s: an estimate that says so is none.
const ABSURD_MPS: f64 = 6.0;

/// What a tick shows.
#[derive(Clone, Copy, Debug)]
pub struct Look<'a> {
    /// Now.
    pub now: Timestamp,
    /// Since the last tick, s.
    pub dt_s: f64,
    /// The estimate.
    pub nav: &'a NavState,
    /// Off the ground.
    pub is_flying: bool,
    /// Time that the filter has refused roll or pitch, s.
    pub tilt_refused_s: f64,
    /// The set point being followed.
    pub setpoint: Option<Setpoint>,
    /// The place that is flown to.
    pub goal: Option<In<Ned>>,
    /// Battery.
    pub battery: Option<BatterySample>,
    /// Replies a second of a controller that answers.
    pub fc_rate_hz: Option<f64>,
    /// Ticks and missed beats so far.
    pub beats: (u64, u64),
    /// Parameters.
    pub params: &'a AutopilotParams,
}

/// Clocks and counters; all zero while nothing is wrong.
#[derive(Clone, Debug, Default)]
pub struct Watch {
    /// Tilted beyond KST_CRASH_TILT, s.
    pub toppled_s: f64,
    /// Tilted beyond KST_TILT_MAX, s.
    pub tilted_s: f64,
    /// The estimate is no number, absurd, or refuses the controller's attitude, s.
    pub inconsistent_s: f64,
    /// The estimate is no number or absurd, s.
    absurd_s: f64,
    /// Cells below BAT_V_SAG, s.
    pub sag_s: f64,
    /// Replies below KST_FC_MIN_HZ, s.
    pub slow_s: f64,
    /// On the way without getting anywhere, s.
    pub no_progress_s: f64,
    /// Share of beats missed lately, 0..=1.
    pub missed_share: f64,
    /// What the computer says of itself.
    pub host: HostReport,
    jumps: ArrayVec<Timestamp, 8>,
    resets: u8,
    circle: Option<In<Ned>>,
    goal: Option<In<Ned>>,
    window: (f64, u64, u64),
    rangers: [Same; RANGERS],
}

/// A ranger's reading and since when it is the same.
#[derive(Clone, Debug, Default)]
struct Same {
    columns_mm: ArrayVec<Option<u16>, MAX_COLUMNS>,
    place: In<Ned>,
    since: Timestamp,
    last: Timestamp,
    count: u32,
}

impl Watch {
    /// One tick.
    pub fn look(&mut self, l: &Look<'_>) {
        let nav = l.nav;
        let tilt_rad = if nav.health.attitude {
            nav.attitude.tilt()
        } else {
            0.0
        };
        let p = l.params;
        let while_so = |s: f64, is_so: bool| if is_so { s + l.dt_s } else { 0.0 };
        self.toppled_s = while_so(self.toppled_s, tilt_rad > p.crash_tilt_deg.to_radians());
        self.tilted_s = while_so(self.tilted_s, tilt_rad > p.tilt_max_deg.to_radians());
        let is_absurd = !nav.position.is_finite()
            || !nav.velocity.is_finite()
            || nav.velocity.norm() > ABSURD_MPS;
        self.absurd_s = while_so(self.absurd_s, l.is_flying && is_absurd);
        let refused_s = if l.is_flying { l.tilt_refused_s } else { 0.0 };
        self.inconsistent_s = self.absurd_s.max(refused_s);
        let sags = l.battery.is_some_and(|b| {
            b.cells > 0 && b.voltage_v > 1.0 && b.voltage_v / f64::from(b.cells) < p.battery_sag_v
        });
        self.sag_s = while_so(self.sag_s, sags);
        let is_slow = l.fc_rate_hz.is_some_and(|hz| hz < p.fc_min_hz);
        self.slow_s = while_so(self.slow_s, is_slow);
        self.follow_place(l);
        self.follow_way(l);
        self.count_beats(l);
    }

    fn follow_place(&mut self, l: &Look<'_>) {
        let resets = l.nav.localization.reset_counter;
        if resets != self.resets && l.is_flying {
            if self.jumps.is_full() {
                self.jumps.remove(0);
            }
            self.jumps.push(l.now);
        }
        self.resets = resets;
        self.jumps.retain(|at| l.now.since(*at) < JUMP_WINDOW);
    }

    /// Jumps of the place within the last ten seconds.
    #[must_use]
    pub fn jumps(&self) -> u32 {
        self.jumps.len() as u32
    }

    /// What the rows look at, as far as it is known here; the rest is as in a vehicle that stands and is well.
    #[must_use]
    pub fn facts<'a>(
        &self,
        now: Timestamp,
        here: In<Ned>,
        params: &'a AutopilotParams,
    ) -> Facts<'a> {
        Facts {
            toppled_s: self.toppled_s,
            tilted_s: self.tilted_s,
            inconsistent_s: self.inconsistent_s,
            jumps: self.jumps(),
            stuck_s: self.stuck_s(now, here),
            sag_s: self.sag_s,
            no_progress_s: self.no_progress_s,
            missed_share: self.missed_share,
            fc_slow_s: self.slow_s,
            host: self.host,
            ..Facts::quiet(params)
        }
    }

    fn follow_way(&mut self, l: &Look<'_>) {
        let here = l.nav.position;
        // The last piece to a place is hovered to: what stands in front of it keeps the vehicle as well.
        let is_under_way = match l.setpoint {
            // A stream of speeds leads nowhere in particular: it may go to and fro.
            Some(Setpoint::Velocity { .. }) => l.goal.is_some(),
            Some(Setpoint::Hover { position, .. }) => (position - here).norm_xy() > THERE_M,
            _ => false,
        };
        let is_on_its_way = l.is_flying && is_under_way;
        let is_inside = self
            .circle
            .is_some_and(|c| (here - c).norm_xy() < PROGRESS_M);
        // Another place to go to is progress.
        let is_same = core::mem::replace(&mut self.goal, l.goal) == l.goal;
        if is_on_its_way && is_inside && is_same {
            self.no_progress_s += l.dt_s;
        } else {
            self.circle = is_on_its_way.then_some(here);
            self.no_progress_s = 0.0;
        }
    }

    fn count_beats(&mut self, l: &Look<'_>) {
        let (ticks, missed) = l.beats;
        let (since_s, ticks_then, missed_then) = &mut self.window;
        *since_s += l.dt_s;
        if *since_s >= MISS_WINDOW_S {
            let missed_now = missed.saturating_sub(*missed_then) as f64;
            let all = missed_now + ticks.saturating_sub(*ticks_then) as f64;
            self.missed_share = missed_now / all.max(1.0);
            self.window = (0.0, ticks, missed);
        }
    }

    /// A ranger spoke.
    pub fn ranger(&mut self, reading: &RangerReading, here: In<Ned>) {
        let Some(same) = self.rangers.get_mut(usize::from(reading.ranger)) else {
            return;
        };
        // Out of range everywhere is the same everywhere.
        let says_something = reading.columns_mm.iter().any(Option::is_some);
        if says_something && same.columns_mm == reading.columns_mm {
            same.count += 1;
        } else {
            same.columns_mm.clone_from(&reading.columns_mm);
            same.place = here;
            same.since = reading.at;
            same.count = 0;
        }
        same.last = reading.at;
    }

    /// Longest time that a ranger has said the same while the vehicle moved, s.
    #[must_use]
    pub fn stuck_s(&self, now: Timestamp, here: In<Ned>) -> f64 {
        self.rangers
            .iter()
            .filter(|r| {
                let moved_m = match r.columns_mm.len() {
                    1 => MOVED_SINGLE_M,
                    _ => MOVED_M,
                };
                r.count >= SAME_READINGS
                    && now.since(r.last) < Duration::from_secs(1)
                    && (here - r.place).norm_xy() > moved_m
            })
            .map(|r| now.since(r.since).as_secs_f64())
            .fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn look<'a>(ms: u64, nav: &'a NavState, params: &'a AutopilotParams) -> Look<'a> {
        Look {
            now: Timestamp::from_ms(ms),
            dt_s: 0.025,
            nav,
            is_flying: true,
            tilt_refused_s: 0.0,
            setpoint: None,
            goal: None,
            battery: None,
            fc_rate_hz: Some(60.0),
            beats: (ms / 25, 0),
            params,
        }
    }

    #[test]
    fn a_clock_runs_while_something_is_wrong_and_starts_anew() {
        let params = AutopilotParams::default();
        let level = NavState {
            health: vehicle::NavHealth {
                attitude: true,
                ..Default::default()
            },
            ..NavState::default()
        };
        let tilted = NavState {
            attitude: vehicle::Rot::from_roll_pitch_yaw(0.9, 0.0, 0.0),
            ..level
        };
        let mut w = Watch::default();
        for i in 0..8 {
            w.look(&look(25 * i, &tilted, &params));
        }
        assert!((w.tilted_s - 0.2).abs() < 1e-9 && w.toppled_s == 0.0);
        w.look(&look(200, &level, &params));
        assert!(w.tilted_s == 0.0);
    }

    #[test]
    fn a_ranger_that_says_the_same_on_the_move_is_stuck_and_in_a_hover_it_is_not() {
        let mut w = Watch::default();
        let reading = |ms: u64, mm: Option<u16>| RangerReading {
            at: Timestamp::from_ms(ms),
            ranger: 2,
            columns_mm: [mm; 4].into_iter().collect(),
        };
        for i in 0..60u64 {
            w.ranger(&reading(66 * i, Some(800)), In::zero());
        }
        let now = Timestamp::from_ms(66 * 60);
        assert!(w.stuck_s(now, In::zero()) == 0.0);
        let moved = In::new(0.5, 0.0, 0.0);
        assert!(w.stuck_s(now, moved) > 3.5);
        w.ranger(&reading(66 * 60, Some(801)), moved);
        assert!(w.stuck_s(now, moved) == 0.0);
        for i in 61..99u64 {
            w.ranger(&reading(66 * i, None), In::zero());
        }
        assert!(w.stuck_s(Timestamp::from_ms(66 * 99), moved) == 0.0);
    }

    #[test]
    fn standing_where_one_should_travel_is_no_progress() {
        let params = AutopilotParams::default();
        let nav = NavState::default();
        let travelling = Setpoint::Velocity {
            velocity: In::zero(),
            down_m: None,
            heading: vehicle::Heading::Rate(0.0),
        };
        let mut w = Watch::default();
        let mut stand = |goal| {
            for i in 0..=400 {
                w.look(&Look {
                    setpoint: Some(travelling),
                    goal,
                    ..look(25 * i, &nav, &params)
                });
            }
            w.no_progress_s
        };
        assert!(stand(None) == 0.0, "speeds by a stream lead to no place");
        let stood_s = stand(Some(In::new(3.0, 0.0, 0.0)));
        assert!((stood_s - 10.0).abs() < 0.05, "{stood_s}");
        w.look(&look(10_025, &nav, &params));
        assert!(w.no_progress_s == 0.0);
    }

    #[test]
    fn a_hover_away_from_its_place_is_no_progress_and_one_at_it_is_none_needed() {
        let params = AutopilotParams::default();
        let nav = NavState::default();
        let stood_s = |off_m: f64| {
            let hover = Setpoint::Hover {
                position: In::new(0.0, off_m, 0.0),
                heading: vehicle::Heading::Rate(0.0),
            };
            let mut w = Watch::default();
            for i in 0..=400 {
                w.look(&Look {
                    setpoint: Some(hover),
                    ..look(25 * i, &nav, &params)
                });
            }
            w.no_progress_s
        };
        assert!(stood_s(0.35) > 9.9 && stood_s(0.1) == 0.0);
        // From place to place on one spot: each is a step of the plan done.
        let mut w = Watch::default();
        for i in 0..=400u64 {
            let place = In::new(0.0, 0.4, -0.01 * (i / 80) as f64);
            w.look(&Look {
                setpoint: Some(Setpoint::Hover {
                    position: place,
                    heading: vehicle::Heading::Rate(0.0),
                }),
                goal: Some(place),
                ..look(25 * i, &nav, &params)
            });
            assert!(w.no_progress_s < 2.1);
        }
    }

    #[test]
    fn an_attitude_that_is_refused_is_an_inconsistent_estimate_before_the_filter_gives_in() {
        let params = AutopilotParams::default();
        let nav = NavState::default();
        let mut w = Watch::default();
        w.look(&Look {
            tilt_refused_s: 0.95,
            ..look(0, &nav, &params)
        });
        assert!(w.inconsistent_s > params.inconsistent_s);
        w.look(&look(25, &nav, &params));
        assert!(w.inconsistent_s == 0.0);
    }

    #[test]
    fn missed_beats_are_a_share_of_the_last_two_seconds() {
        let params = AutopilotParams::default();
        let nav = NavState::default();
        let mut w = Watch::default();
        for i in 0..200u64 {
            w.look(&Look {
                beats: (i, i),
                ..look(25 * i, &nav, &params)
            });
        }
        assert!((w.missed_share - 0.5).abs() < 0.05, "{}", w.missed_share);
    }
}
