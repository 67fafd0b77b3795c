//! The compact telemetry: what pages are sent beside MAVLink, little-endian, a byte of topic first, then u64 us of our clock.
//!
//! | Topic | Rate | Content |
//! | --- | --- | --- |
//! | 1 [`STATE`] | 20 Hz | f32 each of [`STATE_FIELDS`], in that order (the greeting names them) |
//! | 2 [`SCAN`] | 20 Hz | per beam f32 bearing (rad clockwise from the nose), half cone (rad), distance (m, NaN: nothing), longest (m), x, y of its origin (m, forward, right) |
//! | 3 [`PARTICLES`] | 5 Hz | per particle i16 x cm, y cm, yaw mrad (plan) |
//! | 4 [`HISTOGRAM`] | 5 Hz | f32 threshold, f32 chosen direction (rad, NaN none), 72 f32 density, 72 u8 blocked |
//! | 5 [`ROUTE`] | 5 Hz | u8 1 if there is a goal, f32 goal x, y (plan m), then f32 x, y of each corner |
//! | 6 [`PEOPLE`] | 5 Hz | per person f32 x, y (plan m), velocity x, y (m/s) |
//! | 64 [`MAVLINK`] | as they come | MAVLink frames, whole ones |
//! | 65 [`ACK`] | 10 Hz and when something was refused | u32 seq, f64 t_client of the message, u8 verdict (0: passed on) |

use super::picture::Picture;
use crate::autopilot::door::{LandedState, MissionState};
use crate::autopilot::mode::{Because, Mode};
use vehicle::{In, LocalizationState, MapAnchor, Ned, Timestamp};

/// The vehicle.
pub const STATE: u8 = 1;
/// Range finders.
pub const SCAN: u8 = 2;
/// Localization.
pub const PARTICLES: u8 = 3;
/// VFH.
pub const HISTOGRAM: u8 = 4;
/// The way.
pub const ROUTE: u8 = 5;
/// People.
pub const PEOPLE: u8 = 6;
/// Frames.
pub const MAVLINK: u8 = 64;
/// Answer to a message.
pub const ACK: u8 = 65;

/// Modes by the number pages are sent.
pub const MODES: [Mode; 9] = Mode::ALL;
/// Reasons by the number pages are sent.
pub const REASONS: [Because; 13] = [
    Because::Asked,
    Because::Finished,
    Because::OffboardSilent,
    Because::ManualSilent,
    Because::GroundLost,
    Because::NotLocalized,
    Because::RangersSilent,
    Because::BatteryLow,
    Because::ShuttingDown,
    Because::EstimatorFailed,
    Because::FcSilent,
    Because::LoopHeld,
    Because::PilotTookOver,
];

macro_rules! state {
    ($($name:literal = $value:expr;)+) => {
        /// Names of the numbers in [`STATE`], in order. Metres, m/s, rad, V, A on the plan (x right, y up, yaw counter-clockwise).
        pub const STATE_FIELDS: &[&str] = &[$($name),+];

        fn push_state(out: &mut Vec<u8>, p: &Picture, anchor: &MapAnchor) {
            $(put(out, (($value) as fn(&Picture, &MapAnchor) -> f64)(p, anchor));)+
        }
    };
}

state! {
    "x" = |p, a| a.to_map(p.snapshot.nav.position).x();
    "y" = |p, a| a.to_map(p.snapshot.nav.position).y();
    "z" = |p, _| -p.snapshot.nav.position.z();
    "yaw" = |p, a| a.yaw_to_map(p.snapshot.nav.yaw_rad());
    "vx" = |p, a| a.vector_to_map(p.snapshot.nav.velocity).x();
    "vy" = |p, a| a.vector_to_map(p.snapshot.nav.velocity).y();
    "vz" = |p, _| -p.snapshot.nav.velocity.z();
    "roll" = |p, _| p.snapshot.nav.attitude.roll_pitch_yaw().0;
    "pitch" = |p, _| p.snapshot.nav.attitude.roll_pitch_yaw().1;
    "height" = |p, _| p.snapshot.nav.height_m;
    "std_n" = |p, _| p.snapshot.nav.position_std_m.x();
    "std_e" = |p, _| p.snapshot.nav.position_std_m.y();
    "std_z" = |p, _| p.snapshot.nav.position_std_m.z();
    "std_yaw" = |p, _| p.snapshot.nav.yaw_std_rad;
    "knows_position" = |p, _| flag(p.snapshot.nav.health.position);
    "knows_height" = |p, _| flag(p.snapshot.nav.health.height);
    "loc_state" = |p, _| localization(p.snapshot.nav.localization.state);
    "loc_fit" = |p, _| p.snapshot.nav.localization.fit;
    "loc_mass" = |p, _| p.snapshot.nav.localization.mass;
    "particles" = |p, _| f64::from(p.snapshot.nav.localization.particles);
    "effective" = |p, _| p.snapshot.nav.localization.effective_particles;
    "jumps" = |p, _| f64::from(p.snapshot.nav.localization.reset_counter);
    "mode" = |p, _| place(&MODES, &p.snapshot.mode.mode);
    "because" = |p, _| place(&REASONS, &p.snapshot.mode.because);
    "armed" = |p, _| flag(p.snapshot.is_armed);
    "armable" = |p, _| flag(p.snapshot.arm_blocked_by.is_none());
    "landed" = |p, _| landed(p.snapshot.landed);
    "battery" = |p, _| p.snapshot.battery.and_then(|b| b.remaining).unwrap_or(f64::NAN);
    "volts" = |p, _| p.snapshot.battery.map_or(f64::NAN, |b| b.voltage_v);
    "amps" = |p, _| p.snapshot.battery.map_or(f64::NAN, |b| b.current_a);
    "cells" = |p, _| p.snapshot.battery.map_or(0.0, |b| f64::from(b.cells));
    "fc" = |p, _| flag(p.snapshot.fc.is_connected);
    "fc_hz" = |p, _| p.snapshot.fc.service_rate_hz;
    "fc_ms" = |p, _| p.snapshot.fc.round_trip_us * 1e-3;
    "fc_load" = |p, _| p.snapshot.fc.load_percent;
    "fc_bad" = |p, _| (p.snapshot.fc.bad_frames + p.snapshot.fc.timeouts) as f64;
    "ticks" = |p, _| p.snapshot.flight_loop.ticks as f64;
    "missed" = |p, _| p.snapshot.flight_loop.missed as f64;
    "rangers" = |p, _| flag(p.snapshot.rangers_alive);
    "item" = |p, _| f64::from(p.snapshot.mission.seq);
    "items" = |p, _| f64::from(p.snapshot.mission.total);
    "mission" = |p, _| mission(p.snapshot.mission.state);
    "stick_roll" = |p, _| p.snapshot.sticks.roll;
    "stick_pitch" = |p, _| p.snapshot.sticks.pitch;
    "stick_yaw" = |p, _| p.snapshot.sticks.yaw;
    "stick_throttle" = |p, _| p.snapshot.sticks.throttle;
    "want_vx" = |p, a| a.vector_to_map(p.snapshot.velocity_target).x();
    "want_vy" = |p, a| a.vector_to_map(p.snapshot.velocity_target).y();
    "thrust" = |p, _| p.snapshot.thrust_target;
    "home_x" = |p, a| a.to_map(p.snapshot.home).x();
    "home_y" = |p, a| a.to_map(p.snapshot.home).y();
    "home_yaw" = |p, a| a.yaw_to_map(p.snapshot.home_yaw_rad);
    "flow" = |p, _| p.snapshot.flow.map_or(f64::NAN, |f| f64::from(f.quality));
    "links" = |p, _| f64::from(p.links);
    "dropped" = |p, _| p.dropped as f64;
    "owner" = |p, _| p.control.owner.map_or(0.0, |(_, system)| f64::from(system));
}

fn flag(b: bool) -> f64 {
    f64::from(u8::from(b))
}

fn place<T: PartialEq>(all: &[T], one: &T) -> f64 {
    all.iter().position(|m| m == one).map_or(-1.0, |i| i as f64)
}

const fn localization(state: LocalizationState) -> f64 {
    match state {
        LocalizationState::Off => 0.0,
        LocalizationState::Searching => 1.0,
        LocalizationState::Localized => 2.0,
        LocalizationState::Lost => 3.0,
    }
}

const fn landed(state: LandedState) -> f64 {
    match state {
        LandedState::OnGround => 0.0,
        LandedState::InAir => 1.0,
        LandedState::TakingOff => 2.0,
        LandedState::Landing => 3.0,
    }
}

const fn mission(state: MissionState) -> f64 {
    match state {
        MissionState::None => 0.0,
        MissionState::NotStarted => 1.0,
        MissionState::Active => 2.0,
        MissionState::Paused => 3.0,
        MissionState::Complete => 4.0,
    }
}

fn put(out: &mut Vec<u8>, v: f64) {
    out.extend_from_slice(&(v as f32).to_le_bytes());
}

fn put_f32(out: &mut Vec<u8>, v: f32) {
    out.extend_from_slice(&v.to_le_bytes());
}

/// A topic's first nine bytes.
#[must_use]
pub fn begin(topic: u8, at: Timestamp) -> Vec<u8> {
    let mut out = Vec::with_capacity(512);
    out.push(topic);
    out.extend_from_slice(&at.us().to_le_bytes());
    out
}

/// [`STATE`].
#[must_use]
pub fn state(p: &Picture, anchor: &MapAnchor) -> Vec<u8> {
    let mut out = begin(STATE, p.snapshot.at);
    push_state(&mut out, p, anchor);
    out
}

/// [`SCAN`]; none without a scan.
#[must_use]
pub fn scan(p: &Picture) -> Option<Vec<u8>> {
    let scan = p.snapshot.scan.as_ref()?;
    let mut out = begin(SCAN, scan.at);
    for beam in &scan.beams {
        put(&mut out, beam.bearing_rad);
        put(&mut out, beam.half_cone_rad);
        put(&mut out, beam.distance_m.unwrap_or(f64::NAN));
        put(&mut out, beam.max_m);
        put(&mut out, beam.origin.x());
        put(&mut out, beam.origin.y());
    }
    Some(out)
}

/// [`PARTICLES`].
#[must_use]
pub fn particles(p: &Picture) -> Vec<u8> {
    let mut out = begin(PARTICLES, p.snapshot.at);
    for [x, y, yaw] in &p.insight.particles {
        for v in [x * 100.0, y * 100.0, yaw * 1000.0] {
            // Saturates: a particle 300 m away is off every plan.
            out.extend_from_slice(&(v.round() as i16).to_le_bytes());
        }
    }
    out
}

/// [`HISTOGRAM`].
#[must_use]
pub fn histogram(p: &Picture) -> Vec<u8> {
    let mut out = begin(HISTOGRAM, p.snapshot.at);
    put_f32(&mut out, p.insight.threshold);
    put(&mut out, p.insight.chosen_rad.unwrap_or(f64::NAN));
    p.insight.density.iter().for_each(|d| put_f32(&mut out, *d));
    out.extend(p.insight.blocked.iter().map(|b| u8::from(*b)));
    out
}

/// [`ROUTE`].
#[must_use]
pub fn route(p: &Picture, anchor: &MapAnchor) -> Vec<u8> {
    let mut out = begin(ROUTE, p.snapshot.at);
    let corner = |out: &mut Vec<u8>, n: In<Ned>| {
        let m = anchor.to_map(n);
        put(out, m.x());
        put(out, m.y());
    };
    out.push(u8::from(p.insight.goal.is_some()));
    corner(&mut out, p.insight.goal.unwrap_or_default());
    for at in &p.insight.route {
        corner(&mut out, *at);
    }
    out
}

/// [`PEOPLE`].
#[must_use]
pub fn people(p: &Picture) -> Vec<u8> {
    let mut out = begin(PEOPLE, p.snapshot.at);
    for person in &p.insight.people {
        person.iter().for_each(|v| put_f32(&mut out, *v));
    }
    out
}

/// [`ACK`].
#[must_use]
pub fn ack(at: Timestamp, seq: u32, t_client_ms: f64, verdict: u8) -> Vec<u8> {
    let mut out = begin(ACK, at);
    out.extend_from_slice(&seq.to_le_bytes());
    out.extend_from_slice(&t_client_ms.to_le_bytes());
    out.push(verdict);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::FRAC_PI_2;

    #[test]
    fn a_state_is_one_number_per_name_on_the_plan() {
        let mut p = Picture::default();
        p.snapshot.at = Timestamp::from_ms(1_500);
        p.snapshot.nav.position = In::new(1.0, 2.0, -0.5);
        let anchor = MapAnchor::new(10.0, 20.0, FRAC_PI_2);
        let bytes = state(&p, &anchor);
        assert_eq!(bytes.len(), 9 + 4 * STATE_FIELDS.len());
        assert_eq!(bytes[..9], [1, 0x60, 0xE3, 0x16, 0, 0, 0, 0, 0]);
        let field = |name: &str| {
            let at = 9 + 4 * STATE_FIELDS.iter().position(|f| *f == name).unwrap();
            f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
        };
        // North is up on this plan: one metre north is y + 1, two east x + 2.
        assert!((field("x") - 12.0).abs() < 1e-6 && (field("y") - 21.0).abs() < 1e-6);
        assert!((field("z") - 0.5).abs() < 1e-6);
        assert!(field("battery").is_nan());
    }

    #[test]
    fn no_name_is_used_twice() {
        let mut names = STATE_FIELDS.to_vec();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), STATE_FIELDS.len());
    }

    #[test]
    fn five_hundred_particles_are_three_kilobytes() {
        let mut p = Picture::default();
        p.insight.particles = vec![[1.234, -5.678, 3.0]; 500];
        let bytes = particles(&p);
        assert_eq!(bytes.len(), 9 + 3_000);
        assert_eq!(i16::from_le_bytes([bytes[9], bytes[10]]), 123);
        assert_eq!(i16::from_le_bytes([bytes[13], bytes[14]]), 3_000);
    }
}
