//! What drives the motors of a vehicle: the fake flight controller, or a program outside that is told what its sensors feel.

use crate::config::VehicleConfig;
use crate::fc::estimate::Estimate;
use crate::fc::uart::Burst;
use crate::fc::{FlightController, Radio};
use crate::firmware::Felt;
use crate::quad::Quad;
use crate::sensor::{BARO_STEP_S, Baro, Imu, MagneticField};
use std::sync::Arc;
use vehicle::{Pace, Rot, Timestamp};

/// One vehicle's flight controller.
#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "one per vehicle, for its whole life"
)]
pub(crate) enum Controller {
    /// Ours, in the same process and on virtual time.
    Fake(FlightController),
    /// Outside; whoever steps the simulation carries states and motors.
    Outside(Outside),
}

/// The board of a controller that runs outside: its sensors, and the motors as last commanded.
#[derive(Clone, Debug)]
pub(crate) struct Outside {
    imu: Imu,
    estimate: Estimate,
    baro: Baro,
    baro_task: Pace,
    felt: Felt,
    motors: [f64; 4],
}

impl Outside {
    fn new(seed: u64, vehicle: usize, quad: &Quad) -> Self {
        let mut outside = Self {
            imu: Imu::new(seed, vehicle),
            estimate: Estimate::new(seed, vehicle, quad.attitude().yaw()),
            baro: Baro::new(seed, vehicle, quad.height_m()),
            baro_task: Pace::hz(1.0 / BARO_STEP_S),
            felt: Felt {
                rates_radps: quad.rates(),
                specific_force_mps2: quad.specific_force(),
                attitude: quad.attitude(),
                altitude_m: quad.height_m(),
            },
            motors: [0.0; 4],
        };
        outside.sense(quad);
        outside
    }

    fn sense(&mut self, quad: &Quad) {
        self.imu.feel(quad.specific_force());
        self.estimate.step(&quad.attitude());
        let (specific_force_mps2, rates_radps) = self.imu.read(quad.rates(), quad.mean_speed());
        let e = &self.estimate;
        self.felt = Felt {
            rates_radps,
            specific_force_mps2,
            attitude: Rot::from_roll_pitch_yaw(e.roll(), e.pitch(), e.heading()),
            altitude_m: self.baro.felt_m(),
        };
    }
}

impl Controller {
    pub(crate) fn new(
        config: &VehicleConfig,
        seed: u64,
        vehicle: usize,
        quad: &Quad,
        field: &Arc<MagneticField>,
    ) -> Self {
        if config.outside_fc {
            Self::Outside(Outside::new(seed, vehicle, quad))
        } else {
            Self::Fake(FlightController::new(config.fc, seed, vehicle, quad, field))
        }
    }

    /// One millisecond; yields motor commands 0..=1.
    pub(crate) fn step(&mut self, now: Timestamp, quad: &Quad) -> [f64; 4] {
        match self {
            Self::Fake(fc) => fc.step(now, quad),
            Self::Outside(outside) => {
                if outside.baro_task.is_due(now) {
                    outside.baro.step(quad.height_m(), quad.mean_speed());
                }
                outside.sense(quad);
                outside.motors
            }
        }
    }

    /// Motors under way by its arming; of a program outside only its idling motors tell.
    pub(crate) fn is_armed(&self) -> bool {
        match self {
            Self::Fake(fc) => fc.is_armed(),
            Self::Outside(outside) => outside.motors.iter().any(|m| *m > 0.0),
        }
    }

    /// Too busy for its serial line, or no longer; one that is outside is what it is.
    pub(crate) fn be_busy(&mut self, is_busy: bool) {
        if let Self::Fake(fc) = self {
            fc.be_busy(is_busy);
        }
    }

    /// Tells a wrong roll from now on, or the true one again.
    pub(crate) const fn tell_askew(&mut self, is_askew: bool) {
        if let Self::Fake(fc) = self {
            fc.tell_askew(is_askew);
        }
    }

    /// The companion computer writes to the UART; one that is outside has its own line.
    pub(crate) fn write(&mut self, now: Timestamp, bytes: &[u8]) {
        if let Self::Fake(fc) = self {
            fc.write(now, bytes);
        }
    }

    /// What has arrived at the companion computer.
    pub(crate) fn deliver(&mut self, now: Timestamp) -> Option<Burst> {
        match self {
            Self::Fake(fc) => fc.deliver(now),
            Self::Outside(_) => None,
        }
    }

    /// The vehicle was carried to another heading.
    pub(crate) const fn carried(&mut self, yaw_rad: f64) {
        match self {
            Self::Fake(fc) => fc.carried(yaw_rad),
            Self::Outside(outside) => outside.estimate.carried(yaw_rad),
        }
    }

    /// The pilot's transmitter; that of a controller outside is no part of this simulation.
    pub(crate) const fn set_radio(&mut self, radio: Option<Radio>) {
        if let Self::Fake(fc) = self {
            fc.set_radio(radio);
        }
    }

    /// What the loops fly, us; zeros for a controller outside, which does not tell.
    pub(crate) const fn used_sticks_us(&self) -> [u16; 4] {
        match self {
            Self::Fake(fc) => fc.used_sticks_us(),
            Self::Outside(_) => [0; 4],
        }
    }

    /// What the sensors of a controller outside feel.
    pub(crate) const fn felt(&self) -> Option<&Felt> {
        match self {
            Self::Fake(_) => None,
            Self::Outside(outside) => Some(&outside.felt),
        }
    }

    /// Commands from a controller outside.
    pub(crate) const fn command(&mut self, motors: [f64; 4]) {
        if let Self::Outside(outside) = self {
            outside.motors = motors;
        }
    }
}
