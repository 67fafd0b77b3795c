//! One ranger of the ring: when it fires, where it looks, what it reports.

use super::{View, laser::Laser, sonar::Sonar, tof::Tof};
use core::time::Duration;
use vehicle::{Frd, In, RangerConfig, RangerKind, RangerReading, Timestamp};

/// A mounted ranger with its schedule.
#[derive(Clone, Debug)]
pub(crate) struct Ranger {
    index: u8,
    rate_hz: f64,
    phase: f64,
    firings: u64,
    next: Timestamp,
    origin: In<Frd>,
    device: Device,
}

#[derive(Clone, Debug)]
enum Device {
    Laser(Laser),
    Tof(Tof),
    Sonar(Sonar),
}

impl Ranger {
    /// Number `index` of the ring of vehicle `vehicle`.
    pub(crate) fn new(config: &RangerConfig, index: u8, seed: u64, vehicle: usize) -> Self {
        let device = match config.kind {
            RangerKind::Laser => Device::Laser(Laser::new(config, index, seed, vehicle)),
            RangerKind::Tof => Device::Tof(Tof::new(config, index, seed, vehicle)),
            RangerKind::Sonar => Device::Sonar(Sonar::new(config, index, seed, vehicle)),
        };
        let mut ranger = Self {
            index,
            rate_hz: config.rate_hz,
            phase: config.phase,
            firings: 0,
            next: Timestamp::ZERO,
            origin: In::from(config.offset_m),
            device,
        };
        ranger.schedule();
        ranger
    }

    fn schedule(&mut self) {
        // From the count, not by adding periods: 15 Hz is no whole number of microseconds.
        let at_us = (self.firings as f64 + self.phase) / self.rate_hz * 1e6;
        self.next = Timestamp::from_us(libm::round(at_us) as u64);
        self.firings += 1;
    }

    /// True once per firing.
    pub(crate) fn is_due(&mut self, now: Timestamp) -> bool {
        let due = now >= self.next;
        if due {
            self.schedule();
        }
        due
    }

    /// Fires: the reading and how long it takes to be delivered.
    pub(crate) fn fire(&mut self, now: Timestamp, view: &View<'_>) -> (RangerReading, Duration) {
        let origin = view.point(self.origin);
        let (columns_mm, latency) = match &mut self.device {
            Device::Laser(laser) => laser.measure(view, origin),
            Device::Tof(tof) => tof.measure(view, origin),
            Device::Sonar(sonar) => sonar.measure(view, origin),
        };
        let reading = RangerReading {
            at: now,
            ranger: self.index,
            columns_mm,
        };
        (reading, latency)
    }
}

/// Axis of a ranger and the two directions across it (to its right, upwards), body frame.
pub(super) fn frame(config: &RangerConfig) -> [In<Frd>; 3] {
    let (sb, cb) = libm::sincos(config.bearing_deg.to_radians());
    let (se, ce) = libm::sincos(config.elevation_deg.to_radians());
    [
        In::new(cb * ce, sb * ce, -se),
        In::new(-sb, cb, 0.0),
        In::new(-cb * se, -sb * se, -ce),
    ]
}

/// Millimetres, if within what the ranger can measure.
pub(super) fn millimetres(distance_m: f64, config: &RangerConfig) -> Option<u16> {
    let within = (config.min_m..=config.max_m).contains(&distance_m);
    within.then(|| libm::round(distance_m * 1000.0) as u16)
}
