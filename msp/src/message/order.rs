//! Any request to a flight controller as one value.

use super::multiple::MultipleRequest;
use super::{
    FailsafeConfig, FeatureConfig, Message, Name, Other, Reboot, RxConfig, RxMap, SensorBaro,
    SensorCompass, SensorGps, SensorOpticFlow, SensorRangefinder, SetArmingDisabled, SetModeRange,
    SetMotor, SetRawGps, SetRawRc, SetRtc, SimulatorRequest,
};
use crate::command;
use crate::wire::ParseError;

macro_rules! orders {
    ($($variant:ident($message:ident) = $command:ident,)*) => {
        /// What a client asks of a flight controller, by command.
        #[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
        #[serde(untagged)]
        #[allow(clippy::large_enum_variant, reason = "as large as the payload it holds; never kept in numbers")]
        pub enum Order {
            $(#[doc = concat!("[`command::", stringify!($command), "`]")] $variant($message),)*
            /// A question, or an action without arguments: an empty payload.
            Query {
                /// Command number.
                command: u16,
            },
            /// Anything else, payload as it came.
            Other(Other),
        }

        impl Order {
            /// Reads the payload that came with `command`. A command unknown here is a value, not an
            /// error.
            ///
            /// # Errors
            /// [`ParseError`] when the payload does not fit the command.
            pub fn parse(command: u16, payload: &[u8]) -> Result<Self, ParseError> {
                match command {
                    $(command::$command => $message::parse(payload).map(Self::$variant),)*
                    _ if payload.is_empty() => Ok(Self::Query { command }),
                    _ => Ok(Self::Other(Other::new(command, payload))),
                }
            }

            /// Command number of the request.
            #[must_use]
            pub const fn command(&self) -> u16 {
                match self {
                    $(Self::$variant(_) => command::$command,)*
                    Self::Query { command } => *command,
                    Self::Other(other) => other.command,
                }
            }

            /// Appends the payload.
            pub fn emit(&self, out: &mut Vec<u8>) {
                match self {
                    $(Self::$variant(message) => message.emit(out),)*
                    Self::Query { .. } => {}
                    Self::Other(other) => out.extend_from_slice(&other.payload),
                }
            }
        }
    };
}

orders! {
    Multiple(MultipleRequest) = MULTIPLE_MSP,
    Reboot(Reboot) = REBOOT,
    SensorBaro(SensorBaro) = SENSOR_BARO,
    SensorCompass(SensorCompass) = SENSOR_COMPASS,
    SensorGps(SensorGps) = SENSOR_GPS,
    SensorOpticFlow(SensorOpticFlow) = SENSOR_OPTIC_FLOW,
    SensorRangefinder(SensorRangefinder) = SENSOR_RANGEFINDER,
    SetArmingDisabled(SetArmingDisabled) = SET_ARMING_DISABLED,
    SetFailsafeConfig(FailsafeConfig) = SET_FAILSAFE_CONFIG,
    SetFeatureConfig(FeatureConfig) = SET_FEATURE_CONFIG,
    SetModeRange(SetModeRange) = SET_MODE_RANGE,
    SetMotor(SetMotor) = SET_MOTOR,
    SetName(Name) = SET_NAME,
    SetRawGps(SetRawGps) = SET_RAW_GPS,
    SetRawRc(SetRawRc) = SET_RAW_RC,
    SetRtc(SetRtc) = SET_RTC,
    SetRxConfig(RxConfig) = SET_RX_CONFIG,
    SetRxMap(RxMap) = SET_RX_MAP,
    Simulator(SimulatorRequest) = SIMULATOR,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_question_has_no_payload_and_an_order_has_its_own() {
        assert_eq!(
            Order::parse(command::ATTITUDE, &[]),
            Ok(Order::Query {
                command: command::ATTITUDE
            })
        );
        let order = Order::parse(command::SET_RAW_RC, &[0xdc, 5, 0xe8, 3]).unwrap();
        assert!(matches!(&order, Order::SetRawRc(rc) if rc.channels_us.as_slice() == [1500, 1000]));
        assert!(Order::parse(command::SET_MODE_RANGE, &[1]).is_err());
        // A page number, which the firmwares accept in a question.
        assert!(matches!(
            Order::parse(command::BOXIDS, &[1]),
            Ok(Order::Other(_))
        ));
    }

    #[test]
    fn the_twin_of_a_reading_message_keeps_its_own_command() {
        let order = Order::parse(command::SET_RX_MAP, &[0, 1, 3, 2]).unwrap();
        assert_eq!(order.command(), command::SET_RX_MAP);
    }
}
