//! Sensors: frames of the inertial unit into filter and navigation, rangers into the ring.

use super::UquadFlight;
use super::io::UquadOutput;
use crate::autopilot::door::{Event, ImuFlags, Notice};
use crate::autopilot::modes::Air;
use crate::sensor::ring::Measured;
use crate::uquad::reference::Reference;
use crate::uquad::{Said, Step};
use arrayvec::ArrayVec;
use estimator::imu::ImuEvent;
use nalgebra::Vector3;
use vehicle::{
    AttitudeSample, BaroSample, DownRange, ImuSample, In, NavHealth, NavState, Ned, RangerReading,
    Rot, Timestamp,
};

/// Frames between two turns of modes and planner.
const PLAN_EVERY: u32 = 2;
/// Frames between two positions from localization to the filter.
const FIX_EVERY: u32 = 10;

pub(super) fn notice_of(said: &Said) -> Option<Notice> {
    match said {
        Said::Imu(ImuEvent::Calibrated(_)) => Some(Notice::ImuCalibrated),
        Said::Imu(ImuEvent::Disturbed(_)) => Some(Notice::ImuDisturbed),
        Said::Period(fault) => {
            use estimator::imu::period::PeriodFault;
            let (PeriodFault::OutOfRange { measured_s, errors }
            | PeriodFault::Gap { measured_s, errors }) = *fault;
            Some(Notice::ImuPeriod {
                ms: measured_s * 1e3,
                errors,
            })
        }
        _ => None,
    }
}

impl UquadFlight {
    pub(super) fn imu(&mut self, now: Timestamp, bytes: &[u8]) {
        let mut said = ArrayVec::<Said, 8>::new();
        let step = self.aircraft.bytes(now, bytes, &mut |s| {
            let _ = said.try_push(s);
        });
        for s in said {
            if let Some(notice) = notice_of(&s) {
                self.emit(UquadOutput::Event(Event::Notice(notice)));
            }
        }
        let Some(step) = step else { return };
        self.heard_at = Some(now);
        self.step = Some(step);
        self.frames = self.frames.wrapping_add(1);
        self.feed_estimator(&step);
        self.estimate(now, &step);
        if self.frames.is_multiple_of(PLAN_EVERY) {
            self.turn(now);
        }
        self.guide(&step);
    }

    /// The thesis's filter in place of a flight controller's: attitude, inertial sample, height.
    pub(super) fn feed_estimator(&mut self, step: &Step) {
        let filter = self.aircraft.filter();
        let [roll_rad, pitch_rad, yaw_rad] = filter.roll_pitch_yaw();
        let at = step.reading.at;
        let attitude = AttitudeSample {
            at,
            roll_rad,
            pitch_rad,
            heading_rad: yaw_rad,
        };
        let frd = |v: Vector3<f64>| In::new(v.x, -v.y, -v.z);
        let velocity: In<Ned> =
            Rot::from_roll_pitch_yaw(roll_rad, pitch_rad, yaw_rad) * filter.velocity_frd();
        let measured = &step.reading.measured;
        let imu = ImuSample {
            at,
            accel_mps2: frd(measured.accel_mps2),
            gyro_radps: frd(measured.gyro_radps),
            mag: Some(frd(measured.mag)),
        };
        let baro = BaroSample {
            at,
            altitude_m: measured.altitude_m,
            climb_mps: -velocity.z(),
        };
        self.estimator.attitude(&attitude);
        self.estimator.imu(&imu);
        if step.reading.baro_is_good {
            self.estimator.baro(&baro);
            self.snapshot.baro = Some(baro);
        }
        self.snapshot.imu = Some(imu);
        self.snapshot.imu_flags = Some(ImuFlags {
            accel_is_gravity: step.reading.accel_is_good,
            mag_is_earth: step.reading.mag_is_good,
        });
    }

    /// Navigation for modes and planner, and the position for the filter.
    pub(super) fn estimate(&mut self, now: Timestamp, step: &Step) {
        if self.ring.is_none() {
            self.nav = self.own_state(now, step);
            return;
        }
        self.estimator.set_landed(self.air == Air::Ground);
        self.estimator.update(now);
        if let Some(job) = self.estimator.poll_job() {
            self.emit(UquadOutput::Job(job));
        }
        let nav = *self.estimator.state();
        let here = Vector3::new(nav.position.x(), -nav.position.y(), self.up_m(&nav));
        if nav.localization.reset_counter != self.reset_counter {
            self.reset_counter = nav.localization.reset_counter;
            let was_lost = !self.nav.health.position;
            self.aircraft.uquad().relocate(here);
            self.reference = Reference::at(&self.aircraft.filter().twelve());
            self.arbiter.relocalized(was_lost);
        }
        if nav.health.position {
            if self.frames.is_multiple_of(FIX_EVERY) {
                self.aircraft.fix(here);
            }
            self.localized_at = Some(now);
        }
        self.nav = nav;
    }

    /// Height of the craft over where it stood, m: the law's z.
    pub(super) fn up_m(&self, nav: &NavState) -> f64 {
        -nav.position.z() - self.airframe.landed_height_m
    }

    /// The thesis's estimate alone: no place.
    pub(super) fn own_state(&self, now: Timestamp, step: &Step) -> NavState {
        let filter = self.aircraft.filter();
        let [roll, pitch, yaw] = filter.roll_pitch_yaw();
        let attitude = Rot::from_roll_pitch_yaw(roll, pitch, yaw);
        let p = filter.position_ned();
        let frd = |v: Vector3<f64>| In::new(v.x, -v.y, -v.z);
        let down_m = p.z() - self.airframe.landed_height_m;
        NavState {
            at: now,
            position: p.with_z(down_m),
            velocity: attitude * filter.velocity_frd(),
            attitude,
            rates_radps: frd(step.reading.measured.gyro_radps),
            accel_mps2: frd(step.reading.measured.accel_mps2),
            height_m: -down_m,
            health: NavHealth {
                attitude: true,
                height: true,
                velocity: false,
                position: false,
            },
            ..NavState::default()
        }
    }

    pub(super) fn range(&mut self, reading: &RangerReading) {
        let Some(ring) = &mut self.ring else { return };
        if ring.looks_around(reading) {
            self.watch.ranger(reading, self.nav.position);
        }
        let mut measured = ArrayVec::<Measured, 2>::new();
        ring.read(reading, |m| {
            let _ = measured.try_push(m);
        });
        for m in measured {
            match m {
                Measured::Scan(scan) => {
                    self.estimator.scan(&scan);
                    self.navigator.observe(&scan, &self.nav);
                }
                Measured::Down(sample) => self.down_range(&sample),
            }
        }
    }

    pub(super) fn down_range(&mut self, sample: &DownRange) {
        self.estimator.down_range(sample);
        self.snapshot.down_range = Some(*sample);
    }
}
