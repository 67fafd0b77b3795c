//! uQuad's whole loop on one page: frame, reading, filter, law, motor speeds.
//!
//! A craft that flies by motor speeds, or a recording of one. Sans-IO: frames with their time go in, one [`Step`] per reading comes out, and what a pilot should
//! hear. `kestrel eval uquad` drives it.

use crate::motor::SpeedRange;
use control::integral::IntegralAction;
use control::lqr::Design;
use control::proportional::{ErrorLimits, Gains};
use control::state_feedback::{StateFeedback, StateSetpoint};
use core::fmt;
use estimator::imu::angles::URUGUAY_DECLINATION_RAD;
use estimator::imu::period::{PeriodFault, SamplingPeriod};
use estimator::imu::{
    Build, Calibration, ChainConfig, ConfigError, ImuChain, ImuEvent, RawFrame, Reading, Reference,
    Smoothing,
};
use estimator::thesis::{
    Channel, LeftOut, Refusal, StateSet, ThesisConfig, ThesisError, ThesisFilter, ThesisInput,
};
use nalgebra::Vector3;
use vehicle::Timestamp;

/// How the loop works.
#[derive(Clone, Debug)]
pub struct UquadConfig {
    /// The inertial unit.
    pub imu: ChainConfig,
    /// The filter.
    pub filter: ThesisConfig,
    /// Proportional gains.
    pub gains: Gains,
    /// Integral action, if any.
    pub integral: Option<IntegralAction>,
    /// Speeds that hover, rad/s.
    pub hover_radps: f64,
    /// Speeds the filter believes in its first step, rad/s.
    pub first_speeds_radps: f64,
    /// Speeds that are commanded, rad/s.
    pub speed_range_radps: (f64, f64),
    /// Where a motor would leave that range the differences between the motors give way
    /// ([`within`](control::state_feedback::within)); else each is cut off by itself, as uQuad's program does.
    pub keeps_lift: bool,
    /// Steps of the filter for each action of the law; speeds stand in between.
    pub steps_per_action: u32,
    /// When the loop begins.
    pub start: Start,
}

/// When the loop begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// With the first reading after the start-up calibration, at its attitude and accelerometer bias.
    Calibrated,
    /// With a given frame, all states zero and height zero at a given pressure, without calibration.
    AtFrame {
        /// Frames before.
        frame: u32,
        /// Pressure of height zero, Pa.
        reference_pa: f64,
    },
}

impl UquadConfig {
    /// The final program with corrected equations: hover at the place of the start, gains `K_prop_pptz`.
    #[must_use]
    pub fn corrected() -> Self {
        let filter = ThesisConfig::default();
        let hover = filter.craft.hover_speed_radps();
        Self {
            imu: ChainConfig::default(),
            filter,
            gains: Gains::from_pattern(&Gains::K_PROP_PPTZ),
            integral: None,
            hover_radps: hover,
            first_speeds_radps: hover,
            speed_range_radps: speed_range(hover),
            keeps_lift: false,
            steps_per_action: 1,
            start: Start::Calibrated,
        }
    }

    /// The run recorded on 23 March 2012: its misprints, its 8-frame mean, its law, and the idle speed that was 50 I2C units but given as rad/s.
    #[must_use]
    pub fn march_2012() -> Self {
        Self {
            imu: ChainConfig {
                smoothing: Smoothing::MeanOfConverted(8),
                declination_rad: URUGUAY_DECLINATION_RAD,
                build: Build::March2012,
                ..ChainConfig::default()
            },
            filter: ThesisConfig::march_2012(),
            gains: Gains::from_pattern(&Gains::MARCH_2012),
            integral: None,
            hover_radps: 334.28,
            first_speeds_radps: 50.0,
            speed_range_radps: (0.0, 1000.0),
            keeps_lift: false,
            steps_per_action: 1,
            start: Start::AtFrame {
                frame: 200,
                reference_pa: 101_205.0,
            },
        }
    }
}

/// Slowest and fastest commanded speed around a hover speed, rad/s: as far below it as the fastest motor is above.
#[must_use]
pub fn speed_range(hover_radps: f64) -> (f64, f64) {
    let range = SpeedRange::around(hover_radps);
    (range.slowest_radps, range.fastest_radps)
}

/// Speed that hovers with a mass, rad/s, never above what a motor may turn at.
fn laws_hover(craft: &vehicle::UquadAirframe, mass_kg: f64) -> f64 {
    vehicle::UquadAirframe { mass_kg, ..*craft }
        .hover_speed_radps()
        .min(vehicle::uquad::MAX_SPEED_RADPS)
}

/// Why a configuration is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UquadError {
    /// The inertial unit.
    #[error(transparent)]
    Imu(#[from] ConfigError),
    /// The filter.
    #[error(transparent)]
    Filter(#[from] ThesisError),
    /// The reduced set with gains for what it does not estimate.
    #[error("states = 8 and gains for x, y, vqx or vqy: these gains need states = 12")]
    GainsNeedTwelveStates,
    /// A law that never acts.
    #[error("steps per action = 0: the law acts every step (1) or every so many")]
    StepsPerAction,
    /// Speeds that no motor turns at.
    #[error("motor speeds {0}..{1} rad/s: the slower comes first, both within 0-1000")]
    SpeedRange(f64, f64),
}

/// One turn of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Number of the newest frame, from 0.
    pub frame: u32,
    /// Period by the board's clock, us.
    pub elapsed_us: u64,
    /// What was measured.
    pub reading: Reading,
    /// The estimate: 12 states and 3 biases.
    pub state: [f64; 15],
    /// Motor speeds commanded, rad/s.
    pub speeds_radps: [f64; 4],
    /// The same as the law asked for them, not limited, rad/s.
    pub asked_radps: [f64; 4],
    /// What the law has integrated, in the order of its columns; zero without integral action.
    pub integrals: [f64; 4],
}

/// What a pilot should hear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Said {
    /// The inertial unit.
    Imu(ImuEvent),
    /// An input of the filter was left out.
    LeftOut(Channel),
    /// The sampling period.
    Period(PeriodFault),
    /// The filter refused a step.
    Refused(Refusal),
    /// Ten timing errors: the loop ends.
    Stopped,
}

impl fmt::Display for Said {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Imu(e) => e.fmt(f),
            Self::LeftOut(c) => write!(f, "the filter leaves the {c} out"),
            Self::Period(p) => p.fmt(f),
            Self::Refused(r) => r.fmt(f),
            Self::Stopped => f.write_str("stopped: ten timing errors"),
        }
    }
}

/// The loop.
#[derive(Clone, Debug)]
pub struct Uquad {
    imu: ImuChain,
    filter: ThesisFilter,
    law: StateFeedback,
    setpoint: StateSetpoint,
    speed_range_radps: (f64, f64),
    keeps_lift: bool,
    speeds_radps: [f64; 4],
    asked_radps: [f64; 4],
    period: SamplingPeriod,
    left_out: LeftOut,
    steps_per_action: u32,
    /// Steps and time since the law acted, s.
    since_action: (u32, f64),
    start: Start,
    fix: Option<Vector3<f64>>,
    start_m: Vector3<f64>,
    frames: u32,
    is_running: bool,
    is_stopped: bool,
}

impl Uquad {
    /// A loop that waits for its start.
    ///
    /// # Errors
    /// The setting that cannot be, with the rule.
    pub fn new(calibration: Calibration, config: UquadConfig) -> Result<Self, UquadError> {
        let horizontal = [0, 1, 6, 7].map(|i| config.gains.matrix.column(i).amax());
        if config.filter.states == StateSet::Reduced && horizontal.iter().any(|&g| g > 0.0) {
            return Err(UquadError::GainsNeedTwelveStates);
        }
        let filter = ThesisFilter::new(config.filter)?;
        let (slowest, fastest) = config.speed_range_radps;
        // False for NaN.
        if !(0.0 <= slowest && slowest <= fastest && fastest <= 1000.0) {
            return Err(UquadError::SpeedRange(slowest, fastest));
        }
        if config.steps_per_action == 0 {
            return Err(UquadError::StepsPerAction);
        }
        let mut imu = ImuChain::new(calibration, config.imu)?;
        if let Start::AtFrame { reference_pa, .. } = config.start {
            imu.set_reference(Reference {
                reference_pa,
                // No calibration, no field to compare with: a flag that only the dynamic covariance would use.
                mag_norm: 1.0,
                ..Reference::default()
            });
        }
        Ok(Self {
            imu,
            filter,
            law: StateFeedback {
                gains: config.gains,
                limits: ErrorLimits::default(),
                integral: config.integral,
            },
            setpoint: StateSetpoint {
                state: [0.0; 12],
                speeds_radps: [config.hover_radps; 4],
            },
            speed_range_radps: config.speed_range_radps,
            keeps_lift: config.keeps_lift,
            speeds_radps: [config.first_speeds_radps; 4],
            asked_radps: [config.first_speeds_radps; 4],
            period: SamplingPeriod::default(),
            left_out: LeftOut::new(),
            steps_per_action: config.steps_per_action,
            since_action: (0, 0.0),
            start: config.start,
            fix: None,
            start_m: Vector3::zeros(),
            frames: 0,
            is_running: false,
            is_stopped: false,
        })
    }

    /// Takes one frame; answers when it made a step. What there is to say goes to `say`.
    pub fn frame(
        &mut self,
        now: Timestamp,
        frame: RawFrame,
        say: &mut dyn FnMut(Said),
    ) -> Option<Step> {
        let number = self.frames;
        self.frames = self.frames.saturating_add(1);
        self.imu.frame(now, frame);
        self.turn(number, say)
    }

    /// Takes bytes of the inertial unit's line; answers when they made a step. Frames that queue up make one step: never fall behind.
    pub fn bytes(
        &mut self,
        now: Timestamp,
        bytes: &[u8],
        say: &mut dyn FnMut(Said),
    ) -> Option<Step> {
        self.imu.bytes(now, bytes);
        let number = self.frames;
        let step = self.turn(number, say);
        self.frames = self.frames.saturating_add(u32::from(step.is_some()));
        step
    }

    fn turn(&mut self, number: u32, say: &mut dyn FnMut(Said)) -> Option<Step> {
        while let Some(event) = self.imu.poll() {
            say(Said::Imu(event));
        }
        let reading = self.imu.take()?;
        if self.is_stopped || !self.has_begun(number) {
            return None;
        }
        let judged = self.period.judge(reading.elapsed_us as f64 * 1e-6);
        if let Some(fault) = judged.fault.filter(|_| judged.is_worth_saying) {
            say(Said::Period(fault));
        }
        if self.period.must_stop() {
            self.is_stopped = true;
            say(Said::Stopped);
            return None;
        }
        let mut input = ThesisInput::from(&reading);
        input.fix = self.fix.take();
        match self.filter.step(judged.used_s, &self.speeds_radps, &input) {
            Ok(left_out) => {
                // Said when it begins, not with every frame.
                let is_new = |c: &Channel| !self.left_out.contains(c);
                let fresh = left_out.iter().copied().filter(is_new);
                fresh.for_each(|c| say(Said::LeftOut(c)));
                self.left_out = left_out;
            }
            Err(refusal) => {
                say(Said::Refused(refusal));
                return None;
            }
        }
        let (steps, time_s) = self.since_action;
        self.since_action = (steps + 1, time_s + judged.used_s);
        if steps + 1 >= self.steps_per_action {
            let (state, dt_s) = (self.filter.twelve(), self.since_action.1);
            let range = self.speed_range_radps;
            (self.asked_radps, self.speeds_radps) = if self.keeps_lift {
                self.law.act_within(&self.setpoint, &state, dt_s, range)
            } else {
                let asked = self.law.act(&self.setpoint, &state, dt_s);
                (asked, asked.map(|w| w.clamp(range.0, range.1)))
            };
            self.since_action = (0, 0.0);
        }
        Some(Step {
            frame: number,
            elapsed_us: reading.elapsed_us,
            reading,
            state: (*self.filter.state()).into(),
            speeds_radps: self.speeds_radps,
            asked_radps: self.asked_radps,
            integrals: self
                .law
                .integral
                .as_ref()
                .map_or([0.0; 4], IntegralAction::values),
        })
    }

    fn has_begun(&mut self, number: u32) -> bool {
        if self.is_running {
            return true;
        }
        match self.start {
            Start::AtFrame { frame, .. } => self.is_running = number >= frame,
            Start::Calibrated => {
                let Some(reference) = self.imu.reference() else {
                    return false;
                };
                self.filter.start_at(reference, self.start_m);
                // Hover where it stands, facing where it faces.
                self.setpoint.state[..3].copy_from_slice(self.start_m.as_slice());
                self.setpoint.state[5] = reference.angles.theta_rad;
                self.is_running = true;
            }
        }
        self.is_running
    }

    /// Where it shall be, from the next step on.
    pub const fn aim(&mut self, setpoint: StateSetpoint) {
        self.setpoint = setpoint;
    }

    /// Where it shall be.
    #[must_use]
    pub const fn setpoint(&self) -> &StateSetpoint {
        &self.setpoint
    }

    /// A position (x y z, m) for the next step: GPS, or the floor plan indoors.
    pub const fn fix(&mut self, position_m: Vector3<f64>) {
        self.fix = Some(position_m);
    }

    /// What the motors really turn at when it is not what the law asked for, rad/s: the filter's next step believes it.
    pub const fn believe(&mut self, speeds_radps: [f64; 4]) {
        self.speeds_radps = speeds_radps;
    }

    /// Other gains from the next step on; what is integrated stays where the columns are the same.
    pub fn set_gains(&mut self, design: &Design) {
        self.law.gains = design.gains;
        if let (Some(action), Some((gains, _))) = (&mut self.law.integral, design.integral) {
            action.set_gains(gains);
        }
    }

    /// The estimate is carried to another position, m: localization found itself elsewhere.
    pub fn relocate(&mut self, position_m: Vector3<f64>) {
        self.filter.relocate(position_m);
    }

    /// The estimate.
    #[must_use]
    pub const fn filter(&self) -> &ThesisFilter {
        &self.filter
    }

    /// Where x and y are zero: the place of the start, m.
    pub const fn start_from(&mut self, position_m: Vector3<f64>) {
        self.start_m = position_m;
    }

    /// Other limits of the commanded speeds, rad/s: the weight was changed.
    pub const fn set_speed_range(&mut self, speed_range_radps: (f64, f64)) {
        self.speed_range_radps = speed_range_radps;
    }

    /// Forgets the integrals: before take-off they have summed up the floor.
    pub fn reset_integrals(&mut self) {
        if let Some(integral) = &mut self.law.integral {
            integral.reset();
        }
    }

    /// True after ten timing errors.
    #[must_use]
    pub const fn is_stopped(&self) -> bool {
        self.is_stopped
    }

    /// The inertial unit.
    #[must_use]
    pub const fn imu(&self) -> &ImuChain {
        &self.imu
    }
}

pub mod aircraft;
pub mod board_words;
pub mod flight;
pub mod laws;
pub mod reference;

#[cfg(test)]
mod tests;
