//! A ring of HC-SR04 on GPIO lines: who fires when, and what the edges of the echo lines say.
//!
//! A trigger pulse of 10 us makes a sensor send eight periods of 40 kHz; some 0.45 ms later its echo line rises, and falls when the
//! echo is heard: `distance = 343 m/s * width / 2`. Without an echo the line stays up for 38 ms (some copies: 200 ms).
//!
//! **Cross-talk.** Every sensor hears every other one's ping. So only one slot of sensors that look away from each other
//! fires at a time (rangers of equal `phase` of the ring table), a slot is long enough for the sound to die away (60 ms: 10 m to
//! and fro), only the sensors of the slot are listened to, and slots vary in length by some milliseconds, so that a ping of
//! another vehicle or an echo of an echo never lies at the same place twice.
//!
//! | What the line does | What it means |
//! | --- | --- |
//! | rises 0.1 - 5 ms after the trigger, falls within 30 ms | a distance |
//! | rises, falls later or not at all | nothing within reach: a reading without a distance |
//! | does not rise | no sensor there: no reading, and a ring of such is silent |
//! | is still up when the sensor should fire | it is not fired; counted |
//!
//! Pure: [`Ring::poll`] says whom to trigger, [`Ring::fired`] and [`Ring::edge`] take what the kernel stamped.

use arrayvec::ArrayVec;
use core::time::Duration;
use vehicle::{RangerReading, RingConfig, Timestamp};

/// Sensors at most.
pub const MAX_SENSORS: usize = 16;
/// Length of a slot if nothing else is said: SNSI measured 60 ms a reading.
pub const SLOT: Duration = Duration::from_millis(60);
/// The shortest slot: the longest echo and the time a sensor needs to listen again.
pub const SHORTEST_SLOT: Duration = Duration::from_millis(40);
/// From the trigger to the rise of the line.
const RISES: core::ops::RangeInclusive<u128> = 100..=5_000;
/// A longer echo is none, us: 5 m and more.
const LONGEST_ECHO_US: u128 = 30_000;
/// Slots vary by up to this, us.
const VARIATION_US: u64 = 4_000;

/// Speed of sound in dry air at a temperature, m/s.
#[must_use]
pub fn sound_mps(celsius: f64) -> f64 {
    331.3 * libm::sqrt(1.0 + celsius / 273.15)
}

/// What was seen on the lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Pings that gave a distance.
    pub echoes: u64,
    /// Pings without an echo within reach.
    pub open: u64,
    /// Pings that no line rose to.
    pub dead: u64,
    /// Pings left out because the line was still up.
    pub busy: u64,
    /// Edges of sensors whose turn it was not.
    pub stray: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ping {
    Idle,
    Fired(Timestamp),
    Rose { fired: Timestamp, at: Timestamp },
}

/// The ring's schedule and its sensors.
#[derive(Clone, Debug)]
pub struct Ring {
    slots: ArrayVec<ArrayVec<u8, MAX_SENSORS>, MAX_SENSORS>,
    length: Duration,
    first_ranger: u8,
    mps: f64,
    slot: usize,
    /// When the next slot begins.
    next: Timestamp,
    fired: u64,
    pings: [Ping; MAX_SENSORS],
    is_up: [bool; MAX_SENSORS],
    /// Of the present slot.
    firing: ArrayVec<u8, MAX_SENSORS>,
    counters: Counters,
}

impl Ring {
    /// For the sensors of a ring table: those of equal phase share a slot, slots follow by phase.
    #[must_use]
    pub fn new(config: &RingConfig, first_ranger: u8, length: Duration, celsius: f64) -> Self {
        let mut order: Vec<(f64, u8)> = (0u8..)
            .zip(&config.rangers)
            .take(MAX_SENSORS)
            .map(|(i, r)| (r.phase, i))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut slots: ArrayVec<ArrayVec<u8, MAX_SENSORS>, MAX_SENSORS> = ArrayVec::new();
        let mut last = None;
        for (phase, sensor) in order {
            if last.is_none_or(|last: f64| (phase - last).abs() > 1e-6) {
                slots.push(ArrayVec::new());
            }
            last = Some(phase);
            if let Some(slot) = slots.last_mut() {
                slot.push(sensor);
            }
        }
        Self {
            slots,
            length: length.max(SHORTEST_SLOT),
            first_ranger,
            mps: sound_mps(celsius),
            slot: 0,
            next: Timestamp::ZERO,
            fired: 0,
            pings: [Ping::Idle; MAX_SENSORS],
            is_up: [false; MAX_SENSORS],
            firing: ArrayVec::new(),
            counters: Counters::default(),
        }
    }

    /// How often each sensor fires, Hz.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        let slot_s = self.length.as_secs_f64() + 0.5e-6 * VARIATION_US as f64;
        1.0 / (slot_s * self.slots.len().max(1) as f64)
    }

    /// What was seen on the lines.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// When to call [`Self::poll`] next.
    #[must_use]
    pub const fn deadline(&self) -> Timestamp {
        self.next
    }

    /// At its time: closes the slot and names the sensors to trigger now. Answer with [`Self::fired`].
    pub fn poll(&mut self, now: Timestamp, out: &mut impl FnMut(RangerReading)) -> Option<&[u8]> {
        if now < self.next || self.slots.is_empty() {
            return None;
        }
        for i in core::mem::take(&mut self.firing) {
            match core::mem::replace(&mut self.pings[usize::from(i)], Ping::Idle) {
                Ping::Idle => {}
                Ping::Fired(_) => self.counters.dead += 1,
                Ping::Rose { fired, .. } => self.open(i, fired, out),
            }
        }
        let is_up = &self.is_up;
        self.firing = self.slots[self.slot]
            .iter()
            .copied()
            .filter(|i| !is_up[usize::from(*i)])
            .collect();
        let all = self.slots[self.slot].len();
        self.counters.busy += (all - self.firing.len()) as u64;
        self.slot = (self.slot + 1) % self.slots.len();
        self.fired += 1;
        self.next = now + self.length + Duration::from_micros(scatter(self.fired) % VARIATION_US);
        for i in &self.firing {
            self.pings[usize::from(*i)] = Ping::Fired(now);
        }
        Some(&self.firing)
    }

    /// The trigger pulse of a sensor began at this time.
    pub fn fired(&mut self, sensor: u8, at: Timestamp) {
        if let Some(ping @ Ping::Fired(_)) = self.pings.get_mut(usize::from(sensor)) {
            *ping = Ping::Fired(at);
        }
    }

    /// The echo line of a sensor changed, stamped by the kernel.
    pub fn edge(
        &mut self,
        at: Timestamp,
        sensor: u8,
        is_rising: bool,
        out: &mut impl FnMut(RangerReading),
    ) {
        let index = usize::from(sensor);
        let Some(ping) = self.pings.get(index).copied() else {
            return;
        };
        self.is_up[index] = is_rising;
        match (ping, is_rising) {
            (Ping::Fired(fired), true) if RISES.contains(&at.since(fired).as_micros()) => {
                self.pings[index] = Ping::Rose { fired, at };
            }
            (Ping::Rose { fired, at: rose }, false) => {
                self.pings[index] = Ping::Idle;
                let width = at.since(rose);
                if width.as_micros() > LONGEST_ECHO_US {
                    self.open(sensor, fired, out);
                    return;
                }
                let mm = 0.5e3 * self.mps * width.as_secs_f64();
                self.counters.echoes += 1;
                out(RangerReading {
                    // The sound was at the wall in the middle.
                    at: rose + width / 2,
                    ranger: self.first_ranger + sensor,
                    columns_mm: core::iter::once(Some(libm::round(mm) as u16)).collect(),
                });
            }
            _ => self.counters.stray += 1,
        }
    }

    fn open(&mut self, sensor: u8, fired: Timestamp, out: &mut impl FnMut(RangerReading)) {
        self.counters.open += 1;
        out(RangerReading {
            at: fired,
            ranger: self.first_ranger + sensor,
            columns_mm: core::iter::once(None).collect(),
        });
    }
}

/// Numbers that look like chance and are the same in every flight (splitmix64).
const fn scatter(n: u64) -> u64 {
    let mut z = n.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ring(name: &str) -> Ring {
        Ring::new(&RingConfig::built_in(name).unwrap(), 0, SLOT, 20.0)
    }

    /// Runs one slot; every fired sensor answers with an echo after `mm`, none = it never falls.
    fn slot(ring: &mut Ring, answer: impl Fn(u8) -> Option<f64>) -> (Vec<u8>, Vec<RangerReading>) {
        let mut out = Vec::new();
        let now = ring.deadline();
        let fired: Vec<u8> = ring.poll(now, &mut |r| out.push(r)).unwrap().to_vec();
        let mut edges: Vec<(Timestamp, u8, bool)> = Vec::new();
        for i in &fired {
            ring.fired(*i, now + Duration::from_micros(12));
            let rise = now + Duration::from_micros(470);
            edges.push((rise, *i, true));
            if let Some(mm) = answer(*i) {
                edges.push((
                    rise + Duration::from_secs_f64(2.0 * mm * 1e-3 / sound_mps(20.0)),
                    *i,
                    false,
                ));
            }
        }
        edges.sort();
        for (at, i, is_rising) in edges {
            ring.edge(at, i, is_rising, &mut |r| out.push(r));
        }
        (fired, out)
    }

    #[test]
    fn eight_sonars_fire_two_by_two_opposite_ones_together_in_four_slots() {
        let mut r = ring("sonar8");
        let slots: Vec<_> = (0..5).map(|_| slot(&mut r, |_| Some(1000.0)).0).collect();
        assert_eq!(
            slots,
            [vec![0, 4], vec![1, 5], vec![2, 6], vec![3, 7], vec![0, 4]]
        );
        assert!((r.rate_hz() - 4.0).abs() < 0.2, "{}", r.rate_hz());
    }

    #[test]
    fn the_ring_of_the_thesis_fires_one_after_the_other() {
        let mut r = ring("snsi6");
        let slots: Vec<_> = (0..6).map(|_| slot(&mut r, |_| Some(1000.0)).0).collect();
        assert_eq!(
            slots,
            [vec![0], vec![1], vec![2], vec![3], vec![4], vec![5]]
        );
    }

    #[test]
    fn a_golden_echo_of_5831_us_is_a_metre() {
        let mut r = ring("snsi6");
        r.poll(Timestamp::ZERO, &mut |_| {}).unwrap();
        let mut out = Vec::new();
        let us = Timestamp::from_us;
        r.edge(us(460), 0, true, &mut |r| out.push(r));
        r.edge(us(460 + 5824), 0, false, &mut |r| out.push(r));
        // 343.2 m/s at 20 degrees.
        assert_eq!(out[0].columns_mm[..], [Some(999)]);
        assert_eq!(out[0].at, us(460 + 2912));
        assert!((sound_mps(20.0) - 343.2).abs() < 0.1 && (sound_mps(0.0) - 331.3).abs() < 1e-9);
    }

    #[test]
    fn no_echo_is_open_space_and_no_rise_is_no_sensor() {
        let mut r = ring("snsi6");
        let (_, none) = slot(&mut r, |_| Some(7000.0));
        assert_eq!(none[0].columns_mm[..], [None]);
        // Sensor 1 never falls: told when its slot closes; it is up and left out the next time round.
        let mut out = slot(&mut r, |_| None).1;
        for _ in 0..5 {
            out.extend(slot(&mut r, |_| Some(500.0)).1);
        }
        assert!(
            out.iter()
                .any(|r| r.ranger == 1 && r.columns_mm[0].is_none())
        );
        let (fired, _) = slot(&mut r, |_| Some(500.0));
        assert_eq!((fired, r.counters().busy), (vec![], 1));
        // Nobody there at all.
        let mut dead = ring("snsi6");
        for _ in 0..30 {
            let now = dead.deadline();
            dead.poll(now, &mut |_| panic!("a reading from nowhere"));
        }
        assert_eq!(dead.counters().dead, 29);
    }

    #[test]
    fn a_neighbour_that_hears_the_ping_is_not_listened_to() {
        let mut r = ring("snsi6");
        r.poll(Timestamp::ZERO, &mut |_| {}).unwrap();
        let us = Timestamp::from_us;
        r.edge(us(500), 1, true, &mut |_| panic!("cross-talk"));
        r.edge(us(3000), 1, false, &mut |_| panic!("cross-talk"));
        assert_eq!(r.counters().stray, 2);
    }

    #[test]
    fn slots_vary_so_that_nothing_else_keeps_step() {
        let mut r = ring("snsi6");
        let mut lengths = std::collections::BTreeSet::new();
        for _ in 0..50 {
            let before = r.deadline();
            r.poll(before, &mut |_| {});
            lengths.insert(r.deadline().since(before).as_micros());
        }
        assert!(lengths.len() > 40 && lengths.iter().all(|us| (60_000..64_000).contains(us)));
    }

    proptest! {
        #[test]
        fn any_edges_give_one_reading_per_ping_at_most(
            edges in proptest::collection::vec((0u64..40_000, 0u8..20, any::<bool>()), 0..300)
        ) {
            let mut r = ring("sonar8");
            let mut now = Timestamp::ZERO;
            let (mut readings, mut pings) = (0u64, 0u64);
            for (us, sensor, is_rising) in edges {
                now += Duration::from_micros(us);
                pings += r.poll(now, &mut |_| readings += 1).map_or(0, |s| s.len() as u64);
                r.edge(now, sensor, is_rising, &mut |_| readings += 1);
                prop_assert!(readings <= pings);
            }
        }
    }
}
