//! MAV_CMD_INJECT_FAILURE in the simulator: what a station breaks and mends.
//!
//! | Unit (FAILURE_UNIT) | Kinds (FAILURE_TYPE) | Instance |
//! | --- | --- | --- |
//! | 5 optical flow | 1 off | - |
//! | 7 distance sensor | 1 off, 2 stuck | 0 the whole ring, 1.. one ranger of it, 26 the down-ranger (its DISTANCE_SENSOR.id and one) |
//! | 100 battery | 1 off: 4 % left; 4 wrong: 12 % left | - |
//! | 101 motor | 1 off | 0 all, 1.. one |
//! | 102 servo, the stand-in for the flight controller, which MAVLink does not name | 1 off: silent; 7 intermittent: a noisy line | - |
//!
//! Kind 0 (OK) mends. A full battery is put in.

use crate::autopilot::door::{Failure, FailureKind, FailureUnit, Outcome, Refusal};
use sim::{Fault, Simulator};

/// Motors of a quadcopter.
const MOTORS: u8 = 4;
/// Instance of the down-ranger.
pub const DOWN: u8 = 26;

/// Breaks or mends something of the first vehicle, whose ring has so many rangers.
pub(super) fn inject(simulator: &mut Simulator, rangers: usize, failure: Failure) -> Outcome {
    use FailureKind as Kind;
    let Failure {
        unit,
        kind,
        instance,
    } = failure;
    let rangers = u8::try_from(rangers).unwrap_or(u8::MAX);
    let is_broken = kind != Kind::Ok;
    let mut set = |fault| simulator.set_fault(0, fault, is_broken && kind == kind_of(fault));
    let one_of = |all: u8| match instance {
        0 => Some(0..all),
        one if one <= all => Some(one - 1..one),
        _ => None,
    };
    match (unit, kind) {
        (FailureUnit::Flow, Kind::Ok | Kind::Off) => set(Fault::FlowSilent),
        (FailureUnit::Distance, Kind::Ok | Kind::Off) if instance == DOWN => set(Fault::DownSilent),
        (FailureUnit::Distance, Kind::Ok | Kind::Off | Kind::Stuck) => {
            let Some(those) = one_of(rangers) else {
                return Outcome::Refused(Refusal::BadNumber);
            };
            for ranger in those {
                set(Fault::RangerSilent(ranger));
                set(Fault::RangerStuck(ranger));
            }
        }
        (FailureUnit::Motor, Kind::Ok | Kind::Off) => {
            let Some(those) = one_of(MOTORS) else {
                return Outcome::Refused(Refusal::BadNumber);
            };
            for motor in those {
                set(Fault::MotorDead(motor));
            }
        }
        (FailureUnit::Controller, Kind::Ok | Kind::Off | Kind::Intermittent) => {
            set(Fault::FcSilent);
            set(Fault::FcNoisy);
        }
        (FailureUnit::Battery, Kind::Ok) => simulator.set_charge(0, 1.0),
        (FailureUnit::Battery, Kind::Off) => simulator.set_charge(0, 0.04),
        (FailureUnit::Battery, Kind::Wrong) => simulator.set_charge(0, 0.12),
        _ => return Outcome::Refused(Refusal::Unsupported),
    }
    Outcome::Accepted
}

/// The kind of failure that a fault is.
const fn kind_of(fault: Fault) -> FailureKind {
    match fault {
        Fault::RangerStuck(_) => FailureKind::Stuck,
        Fault::FcNoisy => FailureKind::Intermittent,
        _ => FailureKind::Off,
    }
}
