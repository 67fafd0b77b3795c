//! The filter: predict with motor speeds, update with angles, specific force, rates and height (or a position fix).
//!
//! Every observation is one state, but for the accelerometer's z, which is baz plus the known specific force of the rotors. So the update is
//! sequential and scalar: no matrix is inverted, and a channel that is not believed is left out. The result is that of the batch
//! update of the thesis to rounding (the recorded run agrees to 1e-11).

use super::dynamics::{self, Equations};
use super::noise::Noise;
use super::unwrap::unwrap_theta;
use super::{ANGLES, BIAS, POSITION, RATES, STATES, Square, State, VELOCITY};
use crate::imu::{Angles, Reading, Reference};
use arrayvec::ArrayVec;
use core::fmt;
use nalgebra::Vector3;
use vehicle::angle::wrap_pi;
use vehicle::{In, Ned, UquadAirframe};

/// Which states are estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StateSet {
    /// All twelve. Without position fixes x, y, vqx, vqy drift.
    #[default]
    Full,
    /// z, psi, phi, theta, vqz, wqx, wqy, wqz; the horizontal ones stay zero. For craft without a position source.
    Reduced,
}

impl StateSet {
    const fn has(self, index: usize) -> bool {
        match self {
            Self::Full => true,
            Self::Reduced => !matches!(index, 0 | 1 | 6 | 7),
        }
    }
}

/// How the filter works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThesisConfig {
    /// The craft.
    pub craft: UquadAirframe,
    /// Corrected, or as the program has them.
    pub equations: Equations,
    /// Twelve states or eight.
    pub states: StateSet,
    /// The three accelerometer biases are estimated too.
    pub has_bias: bool,
    /// Q and R.
    pub noise: Noise,
}

impl Default for ThesisConfig {
    fn default() -> Self {
        Self {
            craft: UquadAirframe::default(),
            equations: Equations::CORRECTED,
            states: StateSet::Full,
            has_bias: true,
            noise: Noise::default(),
        }
    }
}

impl ThesisConfig {
    /// The recorded run of March 2012.
    #[must_use]
    pub fn march_2012() -> Self {
        Self {
            craft: UquadAirframe::march_2012(),
            equations: Equations::MARCH_2012,
            states: StateSet::Full,
            has_bias: false,
            noise: Noise::march_2012(),
        }
    }
}

/// Why a configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThesisError {
    /// Which number.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
}

impl fmt::Display for ThesisError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} = {} must be a positive number",
            self.name, self.value
        )
    }
}

impl core::error::Error for ThesisError {}

/// What was measured in one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ThesisInput {
    /// Specific force, m/s2, body.
    pub accel_mps2: Vector3<f64>,
    /// Angular rate, rad/s, body.
    pub gyro_radps: Vector3<f64>,
    /// From gravity and field.
    pub angles: Angles,
    /// Barometric height, m.
    pub altitude_m: f64,
    /// The specific force is gravity.
    pub accel_is_good: bool,
    /// The field is the Earth's.
    pub mag_is_good: bool,
    /// A position, m, world x y z: from GPS or from the floor plan.
    pub fix: Option<Vector3<f64>>,
}

impl From<&Reading> for ThesisInput {
    fn from(r: &Reading) -> Self {
        // What does not measure is no number to the filter: the channel is left out by name.
        let lost = Vector3::repeat(f64::NAN);
        Self {
            accel_mps2: r.measured.accel_mps2,
            gyro_radps: if r.gyro_is_good {
                r.measured.gyro_radps
            } else {
                lost
            },
            angles: r.measured.angles,
            altitude_m: if r.baro_is_good {
                r.measured.altitude_m
            } else {
                f64::NAN
            },
            accel_is_good: r.accel_is_good,
            mag_is_good: r.mag_is_good,
            fix: None,
        }
    }
}

/// An input that is left out when it is not finite or absurd.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Specific force.
    Accelerometer,
    /// Barometric height.
    Altitude,
    /// Angles.
    Angles,
    /// Position fix.
    Fix,
    /// Angular rate.
    Gyro,
}

impl fmt::Display for Channel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Accelerometer => "accelerometer",
            Self::Altitude => "altitude",
            Self::Angles => "angles",
            Self::Fix => "position fix",
            Self::Gyro => "gyro",
        })
    }
}

/// Why a step was not made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The period is not in 0..=1 s.
    Period,
    /// A motor speed is not in 0..=1000 rad/s.
    MotorSpeed,
    /// A fix cannot be used by eight states: there is no horizontal position in them.
    FixNeedsTwelveStates,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Period => "step refused: the period is not within 0-1 s",
            Self::MotorSpeed => "step refused: a motor speed is not within 0-1000 rad/s",
            Self::FixNeedsTwelveStates => {
                "step refused: a position fix needs the 12-state set, 8 states are estimated"
            }
        })
    }
}

impl core::error::Error for Refusal {}

/// Channels left out in a step.
pub type LeftOut = ArrayVec<Channel, 5>;

/// The thesis filter.
#[derive(Clone, Debug)]
pub struct ThesisFilter {
    config: ThesisConfig,
    state: State,
    covariance: Square,
}

impl ThesisFilter {
    /// At rest at the origin, P = I.
    ///
    /// # Errors
    ///
    /// The constant of the craft or of the noise that cannot be.
    pub fn new(config: ThesisConfig) -> Result<Self, ThesisError> {
        let craft = &config.craft;
        let noise = &config.noise;
        let positive = [
            ("mass", craft.mass_kg),
            ("inertia about x and y", craft.inertia_xy),
            ("inertia about z", craft.inertia_z),
            ("thrust coefficient", craft.thrust.0),
            (
                "noise of psi and phi",
                noise.without_fix.tilt.min(noise.with_fix.tilt),
            ),
            (
                "noise of theta",
                noise.without_fix.theta.min(noise.with_fix.theta),
            ),
            (
                "noise of the accelerometer",
                noise.without_fix.accel.min(noise.with_fix.accel),
            ),
            (
                "noise of the gyro",
                noise.without_fix.gyro.min(noise.with_fix.gyro),
            ),
            (
                "noise of the position",
                noise.without_fix.position.min(noise.with_fix.position),
            ),
        ];
        let process = noise.process.iter().map(|&q| ("process noise", q));
        for (name, value) in positive.into_iter().chain(process) {
            if !(value.is_finite() && value > 0.0) {
                return Err(ThesisError { name, value });
            }
        }
        let mut filter = Self {
            config,
            state: State::zeros(),
            covariance: Square::zeros(),
        };
        filter.start(State::zeros());
        Ok(filter)
    }

    /// Starts (again) with the attitude and accelerometer bias of a calibration, at a position in m.
    pub fn start_at(&mut self, reference: &Reference, position: Vector3<f64>) {
        let mut state = State::zeros();
        let angles = &reference.angles;
        state.fixed_rows_mut::<3>(POSITION).copy_from(&position);
        state[ANGLES] = angles.psi_rad;
        state[ANGLES + 1] = angles.phi_rad;
        state[ANGLES + 2] = angles.theta_rad;
        if self.config.has_bias {
            state
                .fixed_rows_mut::<3>(BIAS)
                .copy_from(&reference.accel_bias_mps2);
        }
        self.start(state);
    }

    fn start(&mut self, mut state: State) {
        self.covariance = Square::zeros();
        for i in 0..STATES {
            if self.is_estimated(i) {
                self.covariance[(i, i)] = 1.0;
            } else {
                state[i] = 0.0;
            }
        }
        self.state = state;
    }

    /// Carries the estimate to another position, m; everything else stays.
    pub fn relocate(&mut self, position_m: Vector3<f64>) {
        if position_m.iter().all(|v| v.is_finite()) {
            for i in 0..3 {
                if self.is_estimated(POSITION + i) {
                    self.state[POSITION + i] = position_m[i];
                }
            }
        }
    }

    const fn is_estimated(&self, index: usize) -> bool {
        self.config.states.has(index) && (index < BIAS || self.config.has_bias)
    }

    /// The estimate.
    #[must_use]
    pub const fn state(&self) -> &State {
        &self.state
    }

    /// Its covariance; zero rows for what is not estimated.
    #[must_use]
    pub const fn covariance(&self) -> &Square {
        &self.covariance
    }

    /// The twelve states the control law takes.
    #[must_use]
    pub fn twelve(&self) -> [f64; 12] {
        core::array::from_fn(|i| self.state[i])
    }

    /// One step of `dt_s` with the motor speeds in force during it.
    ///
    /// # Errors
    ///
    /// The reason, when nothing was changed. Channels that are no numbers, or absurd ones, are left out and named.
    pub fn step(
        &mut self,
        dt_s: f64,
        speeds_radps: &[f64; 4],
        input: &ThesisInput,
    ) -> Result<LeftOut, Refusal> {
        if !(dt_s > 0.0 && dt_s <= 1.0) {
            return Err(Refusal::Period);
        }
        if !speeds_radps.iter().all(|w| (0.0..=1000.0).contains(w)) {
            return Err(Refusal::MotorSpeed);
        }
        if input.fix.is_some() && self.config.states == StateSet::Reduced {
            return Err(Refusal::FixNeedsTwelveStates);
        }
        let lift = self.predict(dt_s, speeds_radps);
        let left_out = self.update(input, lift);
        if !self.is_sound() {
            // Never seen; better a filter that begins again than one that is dead.
            self.start(State::zeros());
        }
        Ok(left_out)
    }

    fn predict(&mut self, dt_s: f64, speeds_radps: &[f64; 4]) -> f64 {
        let (craft, equations) = (&self.config.craft, self.config.equations);
        let mut f = dynamics::jacobian(&self.state, speeds_radps, dt_s, craft, equations);
        let (mut next, lift) = dynamics::step(&self.state, speeds_radps, dt_s, craft, equations);
        for i in (0..STATES).filter(|&i| !self.is_estimated(i)) {
            next[i] = 0.0;
            f.row_mut(i).fill(0.0);
            f.column_mut(i).fill(0.0);
        }
        self.state = next;
        let p = f * self.covariance * f.transpose();
        // Rounding alone makes it lean.
        self.covariance = (p + p.transpose()) * 0.5;
        for i in 0..STATES {
            if self.is_estimated(i) {
                self.covariance[(i, i)] += self.config.noise.process[i];
            }
        }
        lift
    }

    fn update(&mut self, input: &ThesisInput, lift: f64) -> LeftOut {
        let mut left_out = LeftOut::new();
        let fix = input.fix.filter(|&f| is_within(f, 1e6));
        if input.fix.is_some() != fix.is_some() {
            left_out.push(Channel::Fix);
        }
        let r =
            self.config
                .noise
                .observation(fix.is_some(), input.accel_is_good, input.mag_is_good);

        let a = &input.angles;
        if is_within(Vector3::new(a.psi_rad, a.phi_rad, a.theta_rad), 100.0) {
            let theta = unwrap_theta(a.theta_rad, self.state[ANGLES + 2]);
            self.observe(ANGLES, a.psi_rad, r.tilt);
            self.observe(ANGLES + 1, a.phi_rad, r.tilt);
            self.observe(ANGLES + 2, theta, r.theta);
        } else {
            left_out.push(Channel::Angles);
        }
        if is_within(input.accel_mps2, 1000.0) {
            // Without bias states the thesis' rows are zero: nothing to learn from.
            if self.config.has_bias {
                for (i, known) in [0.0, 0.0, lift].into_iter().enumerate() {
                    self.observe(BIAS + i, input.accel_mps2[i] - known, r.accel);
                }
            }
        } else {
            left_out.push(Channel::Accelerometer);
        }
        if is_within(input.gyro_radps, 100.0) {
            for i in 0..3 {
                self.observe(RATES + i, input.gyro_radps[i], r.gyro);
            }
        } else {
            left_out.push(Channel::Gyro);
        }
        if let Some(fix) = fix {
            for i in 0..3 {
                self.observe(POSITION + i, fix[i], r.position);
            }
        } else if is_within(Vector3::repeat(input.altitude_m), 1e5) {
            self.observe(POSITION + 2, input.altitude_m, r.position);
        } else {
            left_out.push(Channel::Altitude);
        }
        left_out
    }

    /// A scalar observation of one state.
    fn observe(&mut self, index: usize, value: f64, variance: f64) {
        let p = &mut self.covariance;
        let s = p[(index, index)] + variance;
        let column = p.column(index).into_owned();
        let gain = column / s;
        self.state += gain * (value - self.state[index]);
        // One half is computed and mirrored, so that the covariance stays symmetric.
        for i in 0..STATES {
            for j in 0..=i {
                let reduced = p[(i, j)] - gain[i] * column[j];
                p[(i, j)] = reduced;
                p[(j, i)] = reduced;
            }
        }
    }

    fn is_sound(&self) -> bool {
        self.state.iter().all(|x| x.is_finite())
            && (0..STATES).all(|i| {
                let p = self.covariance[(i, i)];
                p.is_finite() && (p > 0.0 || !self.is_estimated(i))
            })
    }

    /// Position in NED, m: north is x, west is y.
    #[must_use]
    pub fn position_ned(&self) -> In<Ned> {
        let p = self.state.fixed_rows::<3>(POSITION);
        In::new(p[0], -p[1], -p[2])
    }

    /// Roll, pitch and yaw of aviation, rad.
    #[must_use]
    pub fn roll_pitch_yaw(&self) -> [f64; 3] {
        let s = &self.state;
        [s[ANGLES], -s[ANGLES + 1], wrap_pi(-s[ANGLES + 2])]
    }

    /// Velocity in the body, forward, right, down, m/s.
    #[must_use]
    pub fn velocity_frd(&self) -> In<vehicle::Frd> {
        let v = self.state.fixed_rows::<3>(VELOCITY);
        In::new(v[0], -v[1], -v[2])
    }

    /// Accelerometer bias, m/s2, forward, left, up.
    #[must_use]
    pub fn bias_mps2(&self) -> Vector3<f64> {
        self.state.fixed_rows::<3>(BIAS).into_owned()
    }
}

fn is_within(v: Vector3<f64>, limit: f64) -> bool {
    // False for NaN.
    v.iter().all(|x| x.abs() <= limit)
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests;
