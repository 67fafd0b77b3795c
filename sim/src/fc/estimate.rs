//! What the flight controller believes about its attitude: the truth with the faults of a filter that has no compass.
//!
//! | | Value |
//! | --- | --- |
//! | tilt error | 0.3 degrees rms, forgotten within 10 s |
//! | heading at start | anything: there is no magnetometer |
//! | heading drift | 0.3 degrees a minute (one standard deviation), plus 0.1 - 0.5 % of every turn |

use crate::noise::{Noise, Wander};
use crate::quad::STEP_S;
use vehicle::angle::wrap_pi;
use vehicle::{Frd, Ned, Rot};

/// Per axis; both together make 0.3 degrees.
const TILT_ERROR_RAD: f64 = 0.212 * core::f64::consts::PI / 180.0;
const TILT_MEMORY_S: f64 = 10.0;
/// Steps between new tilt errors.
const TILT_EVERY: u32 = 20;
const DRIFT_RADPS: f64 = 0.3 / 60.0 * core::f64::consts::PI / 180.0;
const TURN_SCALE: (f64, f64) = (0.001, 0.005);

/// Attitude as the controller has it.
#[derive(Clone, Debug)]
pub(crate) struct Estimate {
    noise: Noise,
    tilt_error: [Wander; 2],
    steps: u32,
    heading_error: f64,
    drift: f64,
    scale: f64,
    last_yaw: f64,
    roll: f64,
    pitch: f64,
    heading: f64,
}

impl Estimate {
    pub(crate) fn new(seed: u64, vehicle: usize, yaw: f64) -> Self {
        let mut noise = Noise::new(seed, vehicle, "fc attitude");
        let step_s = STEP_S * f64::from(TILT_EVERY);
        let tilt_error =
            [(); 2].map(|()| Wander::new(&mut noise, TILT_ERROR_RAD, TILT_MEMORY_S, step_s));
        let heading_error = noise.between(-core::f64::consts::PI, core::f64::consts::PI);
        let size = noise.between(TURN_SCALE.0, TURN_SCALE.1);
        Self {
            tilt_error,
            steps: 0,
            heading_error,
            drift: noise.gauss(DRIFT_RADPS),
            scale: if noise.chance(0.5) { size } else { -size },
            last_yaw: yaw,
            roll: 0.0,
            pitch: 0.0,
            heading: yaw + heading_error,
            noise,
        }
    }

    /// Every millisecond, with the true attitude.
    pub(crate) fn step(&mut self, attitude: &Rot<Frd, Ned>) {
        self.steps += 1;
        if self.steps.is_multiple_of(TILT_EVERY) {
            for error in &mut self.tilt_error {
                error.step(&mut self.noise);
            }
        }
        let (roll, pitch, yaw) = attitude.roll_pitch_yaw();
        let turned = wrap_pi(yaw - self.last_yaw);
        self.last_yaw = yaw;
        self.heading_error += self.scale * turned + self.drift * STEP_S;
        self.roll = roll + self.tilt_error[0].value();
        self.pitch = pitch + self.tilt_error[1].value();
        self.heading = yaw + self.heading_error;
    }

    /// The vehicle was carried elsewhere: a turn by hand is no turn of the gyro's making.
    pub(crate) const fn carried(&mut self, yaw: f64) {
        self.last_yaw = yaw;
    }

    /// Right side down, rad.
    pub(crate) const fn roll(&self) -> f64 {
        self.roll
    }

    /// Nose up, rad.
    pub(crate) const fn pitch(&self) -> f64 {
        self.pitch
    }

    /// Clockwise from the controller's own north, rad, -pi..=pi.
    pub(crate) fn heading(&self) -> f64 {
        wrap_pi(self.heading)
    }
}
