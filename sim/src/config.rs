//! What to simulate, and why it may not be possible.

use crate::device::LaserConfig;
use crate::fc::FcConfig;
use crate::room::Room;
use crate::walker::Walker;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use vehicle::floor_plan::Cell;
use vehicle::{Airframe, In, MapPose, RingConfig, RingError, UquadAirframe};

/// Turbulence of still indoor air with the vehicle's own wash, N (one standard deviation of the force).
pub const INDOOR_TURBULENCE_N: f64 = 0.03;

/// What to simulate.
#[derive(Clone, Debug)]
pub struct SimConfig {
    /// Where.
    pub room: Room,
    /// Every random number follows from it.
    pub seed: u64,
    /// What the vehicles are.
    pub airframe: Airframe,
    /// The vehicles.
    pub vehicles: Vec<VehicleConfig>,
    /// People in the room.
    pub people: Vec<Walker>,
    /// Standard deviation of the wandering force of the air, N; 0 for still air.
    pub turbulence_n: f64,
}

/// One vehicle: where it starts and what it carries.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleConfig {
    /// Where it stands at first, on the plan.
    pub start: MapPose,
    /// Its rangers.
    pub ring: RingConfig,
    /// Whether it has an optical flow sensor.
    pub flow: bool,
    /// Whether it has a down-looking ranger of its own, besides those of the ring.
    pub down_range: bool,
    /// Charge of the battery at the start, 0..=1.
    pub charge: f64,
    /// Its flight controller.
    pub fc: FcConfig,
    /// Its flight controller is a program outside ([`crate::firmware`]) instead: whoever steps the simulation carries
    /// [`felt`](crate::Simulator::felt) to it and [`motors`](crate::Simulator::command_motors) back.
    #[serde(default)]
    pub outside_fc: bool,
    /// It has no flight controller at all: a body commanded in motor speeds ([`turn_motors`](crate::Simulator::turn_motors)).
    #[serde(skip)]
    pub motor_craft: Option<UquadAirframe>,
    /// Lidars with a line of their own, besides the ring: their bytes come out ([`SimOutput::Laser`](crate::SimOutput::Laser)).
    #[serde(default)]
    pub lasers: Vec<LaserConfig>,
    /// The rangers of the ring fire only when they are triggered ([`trigger`](crate::Simulator::trigger)), as sonars on GPIO lines do.
    #[serde(default)]
    pub ring_waits: bool,
}

impl VehicleConfig {
    /// A vehicle with flow and down-ranger, full battery and Betaflight defaults.
    #[must_use]
    pub fn new(start: MapPose, ring: RingConfig) -> Self {
        Self {
            start,
            ring,
            flow: true,
            down_range: true,
            charge: 1.0,
            fc: FcConfig::default(),
            outside_fc: false,
            motor_craft: None,
            lasers: Vec::new(),
            ring_waits: false,
        }
    }
}

impl SimConfig {
    /// One vehicle at home in still indoor air, nobody else there.
    #[must_use]
    pub fn new(room: Room, ring: RingConfig, seed: u64) -> Self {
        let vehicle = VehicleConfig::new(room.home(), ring);
        Self {
            room,
            seed,
            airframe: Airframe::default(),
            vehicles: vec![vehicle],
            people: Vec::new(),
            turbulence_n: INDOOR_TURBULENCE_N,
        }
    }
}

/// Why a simulation cannot start.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SimError {
    /// The airframe cannot fly.
    #[error("airframe: {what} must be positive and finite")]
    Airframe {
        /// Name of the value.
        what: &'static str,
    },
    /// Nothing to simulate.
    #[error("no vehicle")]
    NoVehicle,
    /// A person cannot walk.
    #[error(
        "person {person}: needs at least one way point, finite numbers, and a speed that is not negative"
    )]
    Person {
        /// Index of the person.
        person: usize,
    },
    /// A ring is wrong.
    #[error("vehicle {vehicle}: {error}")]
    Ring {
        /// Index of the vehicle.
        vehicle: usize,
        /// What is wrong.
        error: RingError,
    },
    /// A vehicle would start inside something.
    #[error(
        "vehicle {vehicle} starts at ({x_m:.2}, {y_m:.2}) on the plan, {clear_m:.2} m from a wall; its radius is {radius_m:.2} m"
    )]
    StartBlocked {
        /// Index of the vehicle.
        vehicle: usize,
        /// Where, m.
        x_m: f64,
        /// Where, m.
        y_m: f64,
        /// Free distance, m.
        clear_m: f64,
        /// Radius of the vehicle, m.
        radius_m: f64,
    },
}

/// Everything that can be wrong with a configuration.
pub(crate) fn check(config: &SimConfig) -> Result<(), SimError> {
    let frame = &config.airframe;
    for (what, value) in [
        ("mass_kg", frame.mass_kg),
        ("max_thrust_n", frame.max_thrust_n),
        ("radius_m", frame.radius_m),
        ("arm_m", frame.arm_m),
        ("landed_height_m", frame.landed_height_m),
    ] {
        if !(value.is_finite() && value > 0.0) {
            return Err(SimError::Airframe { what });
        }
    }
    if config.vehicles.is_empty() {
        return Err(SimError::NoVehicle);
    }
    if let Some(person) = config.people.iter().position(|p| !p.is_valid()) {
        return Err(SimError::Person { person });
    }
    for (vehicle, v) in config.vehicles.iter().enumerate() {
        let ring = v.ring.check();
        ring.map_err(|error| SimError::Ring { vehicle, error })?;
        let MapPose { x_m, y_m, .. } = v.start;
        let radius_m = frame.radius_m;
        let wall = config.room.walls().nearest([x_m, y_m], radius_m);
        // In the middle of something large no outline is near.
        let inside = config.room.floor_plan().at(In::new(x_m, y_m, 0.0)) == Cell::Occupied;
        let blocked_m = if inside {
            Some(0.0)
        } else {
            wall.map(|(m, _)| m)
        };
        if let Some(clear_m) = blocked_m {
            return Err(SimError::StartBlocked {
                vehicle,
                x_m,
                y_m,
                clear_m,
                radius_m,
            });
        }
    }
    Ok(())
}
