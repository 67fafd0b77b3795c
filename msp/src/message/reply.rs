//! Any reply of a flight controller as one value.

use super::{
    Altitude, Analog, ApiVersion, Attitude, AttitudeQuaternion, BatteryState, BoardInfo, BoxIds,
    BoxNames, BuildInfo, CompGps, Debug, FailsafeConfig, FcVariant, FcVersion, FeatureConfig,
    Ident, InavAirSpeed, InavAnalog, InavOpticalFlow, InavStatus, Message, MixerConfig, ModeRanges,
    Motor, MotorConfig, Name, NavStatus, RawGps, RawImu, Rc, Reboot, RxConfig, RxMap, SensorConfig,
    Servo, SimulatorReply, SonarAltitude, Status, StatusEx, Uid,
};
use crate::wire::ParseError;
use arrayvec::ArrayVec;

/// A well-framed payload that this crate has no struct for.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Other {
    /// Command number.
    pub command: u16,
    /// Length of the payload on the wire.
    pub length: usize,
    /// Its first 512 bytes.
    pub payload: ArrayVec<u8, 512>,
}

impl Other {
    pub(super) fn new(command: u16, payload: &[u8]) -> Self {
        Self {
            command,
            length: payload.len(),
            payload: payload.iter().copied().take(512).collect(),
        }
    }
}

macro_rules! replies {
    ($($message:ident),* $(,)?) => {
        /// What a flight controller answered, by command. Replies to `SET_` requests are empty and
        /// arrive as [`Reply::Ack`].
        #[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
        #[serde(untagged)]
        pub enum Reply {
            $(#[doc = concat!("[`struct@", stringify!($message), "`]")] $message($message),)*
            /// Done: the empty reply to a request that sets or starts something.
            Ack {
                /// Command number.
                command: u16,
            },
            /// Anything else, payload as it came.
            Other(Other),
        }

        impl Reply {
            /// Reads the payload that came with `command`. A command unknown here is a value, not
            /// an error.
            ///
            /// # Errors
            /// [`ParseError`] when the payload does not fit the command.
            pub fn parse(command: u16, payload: &[u8]) -> Result<Self, ParseError> {
                match command {
                    $($message::COMMAND => $message::parse(payload).map(Self::$message),)*
                    _ if payload.is_empty() => Ok(Self::Ack { command }),
                    _ => Ok(Self::Other(Other::new(command, payload))),
                }
            }

            /// Command number this is the reply to.
            #[must_use]
            pub const fn command(&self) -> u16 {
                match self {
                    $(Self::$message(_) => $message::COMMAND,)*
                    Self::Ack { command } => *command,
                    Self::Other(other) => other.command,
                }
            }

            /// Appends the payload, for a side that answers.
            pub fn emit(&self, out: &mut Vec<u8>) {
                match self {
                    $(Self::$message(message) => message.emit(out),)*
                    Self::Ack { .. } => {}
                    Self::Other(other) => out.extend_from_slice(&other.payload),
                }
            }
        }

        $(impl From<$message> for Reply {
            fn from(message: $message) -> Self {
                Self::$message(message)
            }
        })*
    };
}

replies! {
    Altitude, Analog, ApiVersion, Attitude, AttitudeQuaternion, BatteryState, BoardInfo, BoxIds, BoxNames, BuildInfo, CompGps, Debug,
    FailsafeConfig, FcVariant, FcVersion, FeatureConfig, Ident, InavAirSpeed, InavAnalog, InavOpticalFlow, InavStatus, MixerConfig,
    ModeRanges, Motor, MotorConfig, Name, NavStatus, RawGps, RawImu, Rc, Reboot, RxConfig, RxMap, SensorConfig, Servo,
    SimulatorReply, SonarAltitude, Status, StatusEx, Uid,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command;

    #[test]
    fn unknown_command_is_a_value() {
        let reply = Reply::parse(32766, &[1, 2, 3]).unwrap();
        assert!(
            matches!(&reply, Reply::Other(other) if other.command == 32766 && other.payload.as_slice() == [1, 2, 3])
        );
        assert_eq!(Reply::parse(32766, &[]), Ok(Reply::Ack { command: 32766 }));
    }

    #[test]
    fn an_empty_reply_to_a_question_is_not_an_acknowledgement() {
        assert!(Reply::parse(command::ATTITUDE, &[]).is_err());
        assert_eq!(
            Reply::parse(command::SET_RAW_RC, &[]),
            Ok(Reply::Ack {
                command: command::SET_RAW_RC
            })
        );
    }
}
