//! The magnetic field in the level frame of the tilt filter: where north is, what sticks to the sensor, how late it reads.
//!
//! State: earth's field (0..3, level frame), hard iron (3..6, sensor frame), delay of the magnetometer (6, s). Fields are shares
//! of the first field's strength. The measurement `m = E + R b + delay * (w x E)` is linear but for the small product
//! of delay and field.

use super::AttitudeParams;
use super::tilt::Tilt;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

const STATES: usize = 7;
const EARTH: usize = 0;
const HARD_IRON: usize = 3;
const DELAY: usize = 6;

/// First reading as earth's field, share: it will be corrected by the next ones.
const FIRST_STD: f64 = 0.11;
/// Heading doubted more than this is not known at all, rad.
const MAX_DOUBT_RAD: f64 = 2.0;
/// Heading that may be lost unseen per second beyond the gyro's range, rad.
const CLIPPED_RATE_RADPS: f64 = 10.0;
/// A reading this many times stronger than the first is no field: magnetometers clip there, share.
const MAX_SHARE: f64 = 10.0;

/// Sums over a block of readings.
#[derive(Clone, Copy, Debug)]
struct Block {
    mag: Vector3<f64>,
    imu_to_level: Matrix3<f64>,
    rate: Vector3<f64>,
    speed: f64,
    readings: u32,
    span_s: f64,
}

impl Block {
    const EMPTY: Self = Self {
        mag: Vector3::new(0.0, 0.0, 0.0),
        imu_to_level: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        rate: Vector3::new(0.0, 0.0, 0.0),
        speed: 0.0,
        readings: 0,
        span_s: 0.0,
    };
}

/// The field filter.
#[derive(Clone, Debug)]
pub(super) struct Field {
    /// State and covariance, once a field was seen.
    filter: Option<(SVector<f64, STATES>, SMatrix<f64, STATES, STATES>)>,
    /// Strength of the first field, unit of the magnetometer.
    unit: f64,
    block: Block,
    /// Squared misfit of strength and dip, remembered for a while, share squared.
    misfit: f64,
    heading_rad: f64,
}

impl Field {
    pub(super) const fn new() -> Self {
        Self {
            filter: None,
            unit: 1.0,
            block: Block::EMPTY,
            misfit: 0.0,
            heading_rad: 0.0,
        }
    }

    /// Turn about up from the level frame to east, north, up, rad.
    pub(super) const fn heading_rad(&self) -> f64 {
        self.heading_rad
    }

    pub(super) fn heading_std_rad(&self) -> Option<f64> {
        let (x, p) = self.filter.as_ref()?;
        let level2 = x[0] * x[0] + x[1] * x[1];
        let across = Vector3::new(-x[1], x[0], 0.0);
        let variance = (across.transpose() * p.fixed_view::<3, 3>(EARTH, EARTH) * across).x;
        let std = variance.max(0.0).sqrt() / level2.max(1e-9);
        Some(std.min(core::f64::consts::PI))
    }

    pub(super) fn hard_iron(&self) -> Vector3<f64> {
        self.filter.as_ref().map_or_else(Vector3::zeros, |(x, _)| {
            x.fixed_rows::<3>(HARD_IRON) * self.unit
        })
    }

    pub(super) fn delay_s(&self) -> f64 {
        self.filter.as_ref().map_or(0.0, |(x, _)| x[DELAY])
    }

    pub(super) fn is_disturbed(&self, p: &AttitudeParams) -> bool {
        self.misfit > p.disturbance_threshold * p.disturbance_threshold
    }

    /// Gathers a reading; a full block is used.
    pub(super) fn observe(
        &mut self,
        tilt: &Tilt,
        mag: Option<&Vector3<f64>>,
        dt: f64,
        p: &AttitudeParams,
    ) {
        let b = &mut self.block;
        b.span_s += dt;
        b.speed += tilt.rate_radps().norm() * dt;
        let limit = MAX_SHARE
            * if self.filter.is_some() {
                self.unit
            } else {
                1e6
            };
        if let Some(mag) = mag.filter(|m| m.iter().all(|c| c.abs() < limit)) {
            let q = tilt.imu_to_level();
            b.mag += q * mag;
            b.imu_to_level += q.to_rotation_matrix().matrix();
            b.rate += q * tilt.rate_radps();
            b.readings += 1;
        }
        if b.span_s < p.field_block_s {
            return;
        }
        let block = core::mem::replace(b, Block::EMPTY);
        if block.readings == 0 {
            // Heading drifts on although nobody looks.
            if let Some((x, covariance)) = &mut self.filter {
                drift(x, covariance, &block, p);
            }
            return;
        }
        let n = f64::from(block.readings);
        let mag = block.mag / n;
        if self.filter.is_none() {
            self.begin(&mag, p);
        }
        self.correct(&(mag / self.unit), &block, n, p);
    }

    fn begin(&mut self, mag: &Vector3<f64>, p: &AttitudeParams) {
        let strength = mag.norm();
        if strength < 1e-9 {
            return;
        }
        self.unit = strength;
        let mut x = SVector::<f64, STATES>::zeros();
        x.fixed_rows_mut::<3>(EARTH).copy_from(&(mag / strength));
        x[DELAY] = p.mag_delay_s;
        let mut covariance = SMatrix::<f64, STATES, STATES>::zeros();
        for i in 0..3 {
            covariance[(EARTH + i, EARTH + i)] = FIRST_STD * FIRST_STD;
            covariance[(HARD_IRON + i, HARD_IRON + i)] = p.hard_iron_std * p.hard_iron_std;
        }
        covariance[(DELAY, DELAY)] = p.mag_delay_std_s * p.mag_delay_std_s;
        self.filter = Some((x, covariance));
    }

    fn correct(&mut self, mag: &Vector3<f64>, block: &Block, n: f64, p: &AttitudeParams) {
        let Some((x, covariance)) = &mut self.filter else {
            return;
        };
        drift(x, covariance, block, p);
        let r = block.imu_to_level / n;
        let earth: Vector3<f64> = x.fixed_rows::<3>(EARTH).into_owned();
        let late = (block.rate / n).cross(&earth);
        let hard_iron: Vector3<f64> = r * x.fixed_rows::<3>(HARD_IRON);
        let seen = mag - hard_iron - late * x[DELAY];

        // Strength along the ground and upwards do not depend on heading: they tell whether this is earth's field at all.
        let level = |v: &Vector3<f64>| libm::hypot(v.x, v.y);
        let (along, up) = (level(&seen) - level(&earth), seen.z - earth.z);
        let fresh = along * along + up * up;
        self.misfit = (self.misfit * libm::exp(-block.span_s / p.disturbance_memory_s)).max(fresh);
        let threshold = p.disturbance_threshold * p.disturbance_threshold;
        let opening = p.disturbance_to_hard_iron_per_s * (self.misfit - threshold).max(0.0);
        for i in HARD_IRON..HARD_IRON + 3 {
            covariance[(i, i)] += opening * block.span_s;
        }

        // What does not fit in two directions is as wrong in the third, heading.
        let sharing = (p.field_correlation_s / block.span_s).max(1.0);
        let noise = (p.field_std * p.field_std + self.misfit) * sharing;
        for axis in 0..3 {
            let mut row = SVector::<f64, STATES>::zeros();
            row[EARTH + axis] = 1.0;
            for j in 0..3 {
                row[HARD_IRON + j] = r[(axis, j)];
            }
            row[DELAY] = late[axis];
            let ph = *covariance * row;
            let gain = ph / (row.dot(&ph) + noise);
            let innovation = mag[axis] - row.dot(x);
            *covariance -= gain * ph.transpose();
            *x += gain * innovation;
        }
        *covariance = (*covariance + covariance.transpose()) * 0.5;
        for i in 0..STATES {
            covariance[(i, i)] = covariance[(i, i)].max(1e-14);
        }
        if x.iter().chain(covariance.iter()).all(|c| c.is_finite()) {
            self.heading_rad = libm::atan2(x[0], x[1]);
        } else {
            // Heading is held until a new field begins.
            self.filter = None;
        }
    }

    /// Without samples heading may have turned this far, rad.
    pub(super) fn coast(&mut self, turn_rad: f64) {
        self.block = Block::EMPTY;
        self.lose_heading(turn_rad);
    }

    /// A clipped gyro hides as much again as it shows.
    pub(super) fn doubt_saturated(&mut self, dt: f64) {
        self.lose_heading(CLIPPED_RATE_RADPS * dt);
    }

    fn lose_heading(&mut self, turn_rad: f64) {
        if let Some((x, covariance)) = &mut self.filter {
            let turn = turn_rad.min(MAX_DOUBT_RAD);
            turn_earth(x, covariance, turn * turn);
        }
    }
}

/// Time passes: heading drifts with the turning, the field changes from place to place, hard iron ages.
fn drift(
    x: &SVector<f64, STATES>,
    covariance: &mut SMatrix<f64, STATES, STATES>,
    block: &Block,
    p: &AttitudeParams,
) {
    let dt = block.span_s;
    if dt <= 0.0 {
        return;
    }
    let share = p.heading_walk_share * block.speed / dt;
    turn_earth(
        x,
        covariance,
        (p.gyro_noise * p.gyro_noise + share * share) * dt,
    );
    for i in 0..3 {
        covariance[(EARTH + i, EARTH + i)] += p.field_walk * p.field_walk * dt;
        covariance[(HARD_IRON + i, HARD_IRON + i)] += p.hard_iron_walk * p.hard_iron_walk * dt;
    }
}

/// Adds a variance of heading (rad2): the field in the level frame turns about up.
fn turn_earth(
    x: &SVector<f64, STATES>,
    covariance: &mut SMatrix<f64, STATES, STATES>,
    variance: f64,
) {
    let across = Vector3::new(-x[1], x[0], 0.0);
    let mut earth = covariance.fixed_view_mut::<3, 3>(EARTH, EARTH);
    earth += across * across.transpose() * variance;
}
