//! Payloads as typed structs in **wire units**: what the number on the wire means is in the field's
//! suffix (`_ddeg` tenth of a degree, `_cm`, `_cms` cm/s, `_dv` 0.1 V, `_cv` 0.01 V, `_ca` 0.01 A,
//! `_us`, `_e7`), conversion to SI is the caller's.
//!
//! | Module | Messages |
//! | --- | --- |
//! | [`identity`] | who is there |
//! | [`status`] | cycle time, modes, arming blockers |
//! | [`sensor`] | IMU, attitude, altitude, rangefinder, optical flow, GPS |
//! | [`power`] | battery |
//! | [`rc`] | RC channels, motors |
//! | [`config`] | mode ranges, receiver, features, failsafe |
//! | [`action`] | reboot, arming lock, clock |
//! | [`navigation`] | what the controller's own navigation does |
//! | [`simulator`] | INAV with sensors from outside |
//! | [`multiple`] | several questions in one frame |
//!
//! [`Reply`] is any reply and [`Order`] any request as one value. All of them are
//! [`serde::Serialize`], for programs that print them.
//!
//! Rules that hold for every message:
//! - integers are little endian;
//! - fields that newer firmware appends are `Option` and in order: one is present only when all
//!   before it are;
//! - bytes after the last field known here are ignored, since firmware appends freely;
//! - a struct with every `Option` in order survives `emit` then `parse` unchanged.

pub mod action;
pub mod config;
pub mod identity;
pub mod multiple;
pub mod navigation;
mod order;
pub mod power;
pub mod rc;
mod reply;
pub mod sensor;
pub mod simulator;
pub mod status;

pub use action::{Reboot, SetArmingDisabled, SetRtc};
pub use config::{
    BoxIds, BoxNames, FailsafeConfig, FeatureConfig, MixerConfig, ModeRange, ModeRanges,
    MotorConfig, RxConfig, RxMap, SensorConfig, SetModeRange,
};
pub use identity::{ApiVersion, BoardInfo, BuildInfo, FcVariant, FcVersion, Ident, Name, Uid};
pub use navigation::{CompGps, NavStatus};
pub use order::Order;
pub use power::{Analog, BatteryState, InavAnalog};
pub use rc::{Motor, Rc, Servo, SetMotor, SetRawRc};
pub use reply::{Other, Reply};
pub use sensor::{
    Altitude, Attitude, AttitudeQuaternion, InavAirSpeed, InavOpticalFlow, RawGps, RawImu,
    SensorBaro, SensorCompass, SensorGps, SensorOpticFlow, SensorRangefinder, SetRawGps,
    SonarAltitude,
};
pub use simulator::{SimulatorReply, SimulatorRequest};
pub use status::{
    BatteryProfiles, Debug, InavStatus, Status, StatusEx, StatusExTail, StatusHead, StatusTail,
};

use crate::wire::ParseError;

/// A payload with its command number.
pub trait Message: Sized {
    /// Command number of the frame that carries this payload (for configuration messages the
    /// reading one; the `SET_` twin has the same layout).
    const COMMAND: u16;

    /// Reads a payload.
    ///
    /// # Errors
    /// [`ParseError`] when the payload ends inside a field or holds more elements than the struct.
    fn parse(payload: &[u8]) -> Result<Self, ParseError>;

    /// Appends the payload to `out`.
    fn emit(&self, out: &mut Vec<u8>);
}

/// Declares messages as tables of fields, in wire order.
macro_rules! messages {
    ($($(#[$meta:meta])* $name:ident = $command:ident { $($(#[$field_meta:meta])* $field:ident: $type:ty,)* })*) => {$(
        $(#[$meta])*
        #[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
        pub struct $name {
            $($(#[$field_meta])* pub $field: $type,)*
        }

        impl crate::wire::Wire for $name {
            fn read(reader: &mut crate::wire::Reader<'_>) -> Result<Self, crate::wire::ParseError> {
                Ok(Self { $($field: crate::wire::Wire::read(reader)?,)* })
            }
            fn write(&self, out: &mut Vec<u8>) {
                $(crate::wire::Wire::write(&self.$field, out);)*
            }
        }

        impl crate::message::Message for $name {
            const COMMAND: u16 = crate::command::$command;

            fn parse(payload: &[u8]) -> Result<Self, crate::wire::ParseError> {
                let mut reader = crate::wire::Reader::new(crate::command::$command, payload);
                crate::wire::Wire::read(&mut reader)
            }

            fn emit(&self, out: &mut Vec<u8>) {
                crate::wire::Wire::write(self, out);
            }
        }
    )*};
}
pub(crate) use messages;
