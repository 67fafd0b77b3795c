//! A room, quadcopters in it, and what their companion computers would see: MSP bytes of a flight controller and readings of
//! range finders, optical flow and height. Everything runs on virtual time and follows from one seed.
//!
//! It is the independent witness for the rest of Kestrel. It knows nothing of the estimator, the planner or the bridge; ranges
//! come from wall segments, not from the floor plan that the bridge is given; and [`Truth`] tells what really happened.
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`simulator`] | [`Simulator`]: the steps, the outputs, the truth, faults to inject |
//! | [`config`] | what to simulate |
//! | [`room`] | bundled rooms as wall segments, the floor plan derived from them, places and doors |
//! | [`walker`] | people who walk through |
//! | `world`, `walls`, `geometry` | ray casting and nearest obstacle |
//! | `quad` | rigid body, motors, battery, contact |
//! | [`fc`] | the fake flight controller: MSP server, arming, failsafe, angle mode |
//! | [`firmware`] | packets of Betaflight's simulator build, for the real firmware in place of the fake one |
//! | [`sensor`] | one file per sensor, each with the table of faults it follows |
//! | [`camera`] | what a camera on a vehicle sees |
//! | [`imu_board`] | firmware of uQuad's inertial unit and a bench with simulated chips |
//! | [`esc_bus`] | speed controllers of uQuad's motors on a simulated I2C bus |
//! | [`motor_craft`] | uQuad's airframe, commanded in motor speeds |
//! | `craft`, `controller`, `noise` | one vehicle put together; what drives its motors; seeded streams, one per purpose |
//!
//! Positions are NED about the plan's home, whatever the start; plan coordinates are metres as drawn.
//!
//! Limits, on purpose: walls and furniture reach from floor to ceiling, the floor is flat, air moves only by a wandering force,
//! vehicles do not blow on each other, sonars do not hear each other.

pub mod camera;
pub mod config;
mod controller;
mod craft;
pub mod device;
pub mod esc_bus;
pub mod fc;
pub mod firmware;
mod geometry;
pub mod imu_board;
pub mod motor_craft;
mod noise;
mod quad;
pub mod room;
pub mod sensor;
pub mod simulator;
pub mod walker;
mod walls;
mod world;

pub use config::{INDOOR_TURBULENCE_N, SimConfig, SimError, VehicleConfig};
pub use device::{LaserConfig, LaserMount};
pub use esc_bus::{BusWrite, EscBus};
pub use fc::{Delivery, FcConfig, Manner, Radio};
pub use motor_craft::MotorCraft;
pub use room::{Door, DoorFacts, Place, Room, RoomError, RoomFacts};
pub use simulator::{Fault, STEP, SimOutput, Simulator, Truth};
pub use walker::{PERSON_HEIGHT_M, PERSON_RADIUS_M, Then, Walker};
pub use world::CEILING_M;
