//! MAV_CMD numbers we know, MAV_RESULT codes, and one [`Command`] for the LONG and the INT form.
//!
//! The two forms differ in parameters 5 to 7 only:
//!
//! | | COMMAND_LONG | COMMAND_INT |
//! | --- | --- | --- |
//! | 5, 6 | degrees as f32, NaN = not given | 1e-7 degrees (global frames) or 1e-4 m (local) as i32, `INT32_MAX` = not given |
//! | 7 | m as f32, above mean sea level | m as f32, meaning by `frame` |
//! | repeats | counted in `confirmation` | not marked |
//!
//! Source: MAVLink guide, "Command Protocol".
//!
//! ```
//! use mavlink_dialect::{command::{self, Command}, raw};
//! let take_off = raw::COMMAND_LONG_DATA { command: 22, param7: f32::NAN, ..Default::default() };
//! let command = Command::from_long(&take_off);
//! assert_eq!(command.number, command::cmd::NAV_TAKEOFF);
//! assert_eq!(command.point.z_m, None);
//! ```

use crate::mission_item::{Frame, Point};
use crate::raw;

macro_rules! commands {
    ($($(#[$doc:meta])+ $name:ident = $number:literal;)+) => {
        /// Numbers of MAV_CMD, without the prefix `MAV_CMD_`.
        pub mod cmd {
            $($(#[$doc])+ pub const $name: u16 = $number;)+
        }

        /// Name of a command we know, without the prefix `MAV_CMD_`.
        #[must_use]
        pub const fn name(number: u16) -> Option<&'static str> {
            match number {
                $($number => Some(stringify!($name)),)+
                _ => None,
            }
        }
    };
}

commands! {
    /// Fly to a place.
    NAV_WAYPOINT = 16;
    /// Hover there for ever.
    NAV_LOITER_UNLIM = 17;
    /// Hover there for a time.
    NAV_LOITER_TIME = 19;
    /// Fly home and land.
    NAV_RETURN_TO_LAUNCH = 20;
    /// Come down.
    NAV_LAND = 21;
    /// Climb.
    NAV_TAKEOFF = 22;
    /// Fly around a place, now.
    DO_ORBIT = 34;
    /// Fly a figure eight about a place, now.
    DO_FIGURE_EIGHT = 35;
    /// Wait.
    NAV_DELAY = 93;
    /// Wait before the next action.
    CONDITION_DELAY = 112;
    /// Turn.
    CONDITION_YAW = 115;
    /// Change the flight mode.
    DO_SET_MODE = 176;
    /// Continue the mission at another item.
    DO_JUMP = 177;
    /// Change the cruise speed.
    DO_CHANGE_SPEED = 178;
    /// Move home.
    DO_SET_HOME = 179;
    /// Stop the motors now.
    DO_FLIGHTTERMINATION = 185;
    /// Fly to a place and hover, now.
    DO_REPOSITION = 192;
    /// Pause or continue the mission.
    DO_PAUSE_CONTINUE = 193;
    /// Point at a place.
    DO_SET_ROI_LOCATION = 195;
    /// Stop pointing.
    DO_SET_ROI_NONE = 197;
    /// Point at a place, the old form.
    DO_SET_ROI = 201;
    /// Take a picture, the old form.
    DO_DIGICAM_CONTROL = 203;
    /// Turn the camera mount.
    DO_MOUNT_CONTROL = 205;
    /// Take a picture every so many metres.
    DO_SET_CAM_TRIGG_DIST = 206;
    /// Turn one motor.
    DO_MOTOR_TEST = 209;
    /// Continue the mission at an item.
    DO_SET_MISSION_CURRENT = 224;
    /// Calibrate a sensor.
    PREFLIGHT_CALIBRATION = 241;
    /// Read, write or reset stored parameters.
    PREFLIGHT_STORAGE = 245;
    /// Reboot or switch off.
    PREFLIGHT_REBOOT_SHUTDOWN = 246;
    /// Change the flight mode by its standard number.
    DO_SET_STANDARD_MODE = 262;
    /// Start the mission.
    MISSION_START = 300;
    /// Move one actuator.
    ACTUATOR_TEST = 310;
    /// Start or stop the motors.
    COMPONENT_ARM_DISARM = 400;
    /// Say whether an arm would be refused.
    RUN_PREARM_CHECKS = 401;
    /// Send HOME_POSITION.
    GET_HOME_POSITION = 410;
    /// Send MESSAGE_INTERVAL of a message.
    GET_MESSAGE_INTERVAL = 510;
    /// Send a message at an interval.
    SET_MESSAGE_INTERVAL = 511;
    /// Send a message once.
    REQUEST_MESSAGE = 512;
    /// Send CAMERA_INFORMATION, the old form.
    REQUEST_CAMERA_INFORMATION = 521;
    /// Send CAMERA_SETTINGS, the old form.
    REQUEST_CAMERA_SETTINGS = 522;
    /// Send STORAGE_INFORMATION, the old form.
    REQUEST_STORAGE_INFORMATION = 525;
    /// Format a camera's storage.
    STORAGE_FORMAT = 526;
    /// Send CAMERA_CAPTURE_STATUS, the old form.
    REQUEST_CAMERA_CAPTURE_STATUS = 527;
    /// Reset a camera's settings.
    RESET_CAMERA_SETTINGS = 529;
    /// Make something fail, in a simulator.
    INJECT_FAILURE = 420;
    /// Send PROTOCOL_VERSION, the old form.
    REQUEST_PROTOCOL_VERSION = 519;
    /// Send AUTOPILOT_VERSION, the old form.
    REQUEST_AUTOPILOT_CAPABILITIES = 520;
    /// Picture or video mode.
    SET_CAMERA_MODE = 530;
    /// Move the origin of the local frame on the globe.
    DO_SET_GLOBAL_ORIGIN = 611;
    /// Turn the gimbal.
    DO_GIMBAL_MANAGER_PITCHYAW = 1000;
    /// Take or give up control of the gimbal.
    DO_GIMBAL_MANAGER_CONFIGURE = 1001;
    /// Take pictures.
    IMAGE_START_CAPTURE = 2000;
    /// Stop taking pictures.
    IMAGE_STOP_CAPTURE = 2001;
    /// Record video.
    VIDEO_START_CAPTURE = 2500;
    /// Stop recording.
    VIDEO_STOP_CAPTURE = 2501;
    /// Start a video stream.
    VIDEO_START_STREAMING = 2502;
    /// Stop a video stream.
    VIDEO_STOP_STREAMING = 2503;
    /// Send VIDEO_STREAM_INFORMATION, the old form.
    REQUEST_VIDEO_STREAM_INFORMATION = 2504;
    /// Send VIDEO_STREAM_STATUS, the old form.
    REQUEST_VIDEO_STREAM_STATUS = 2505;
    /// Take or give back control.
    REQUEST_OPERATOR_CONTROL = 32100;
    /// Ours: parameter 1 is the ASCII code of a key of the key console.
    USER_1 = 31010;
}

/// Codes of MAV_RESULT, as COMMAND_ACK carries them.
pub mod result {
    /// Done, or begun.
    pub const ACCEPTED: u8 = 0;
    /// Not now.
    pub const TEMPORARILY_REJECTED: u8 = 1;
    /// Never like this.
    pub const DENIED: u8 = 2;
    /// Not known or not built.
    pub const UNSUPPORTED: u8 = 3;
    /// Tried and failed.
    pub const FAILED: u8 = 4;
    /// Begun; the final answer follows.
    pub const IN_PROGRESS: u8 = 5;
    /// Given up on COMMAND_CANCEL.
    pub const CANCELLED: u8 = 6;
    /// Only COMMAND_LONG carries this command.
    pub const LONG_ONLY: u8 = 7;
    /// Only COMMAND_INT carries this command.
    pub const INT_ONLY: u8 = 8;
    /// The frame does not fit this command.
    pub const UNSUPPORTED_MAV_FRAME: u8 = 9;
    /// Another station is in control.
    pub const NOT_IN_CONTROL: u8 = 10;
}

/// A command, whichever form carried it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// MAV_CMD.
    pub number: u16,
    /// Parameters 1 to 4 as sent.
    pub params: [f32; 4],
    /// Parameters 5 to 7. COMMAND_LONG has no frame: [`Frame::Global`]. None if the frame is not known to us.
    pub point: Point,
    /// 0 for the first transmission, counted up with each repeat; always 0 in COMMAND_INT.
    pub confirmation: u8,
    /// Sent as COMMAND_INT.
    pub is_int: bool,
}

impl Command {
    /// From COMMAND_LONG.
    #[must_use]
    pub fn from_long(m: &raw::COMMAND_LONG_DATA) -> Self {
        Self {
            number: m.command,
            params: [m.param1, m.param2, m.param3, m.param4],
            point: Point {
                frame: Some(Frame::Global),
                x: degrees_to_e7(m.param5),
                y: degrees_to_e7(m.param6),
                z_m: given(m.param7),
            },
            confirmation: m.confirmation,
            is_int: false,
        }
    }

    /// From COMMAND_INT.
    #[must_use]
    pub fn from_int(m: &raw::COMMAND_INT_DATA) -> Self {
        Self {
            number: m.command,
            params: [m.param1, m.param2, m.param3, m.param4],
            point: Point::from_wire(m.frame, m.x, m.y, m.z),
            confirmation: 0,
            is_int: true,
        }
    }

    /// Parameter `n` of 1..=4; none if it is NaN, which says "not given".
    #[must_use]
    pub fn param(&self, n: usize) -> Option<f32> {
        n.checked_sub(1)
            .and_then(|i| self.params.get(i))
            .copied()
            .and_then(given)
    }

    /// Parameter `n` of 1..=4 as a whole number that fits i32; none if it is not given, infinite or too large.
    #[must_use]
    pub fn whole(&self, n: usize) -> Option<i32> {
        let v = self.param(n)?.round();
        (-2.147e9..=2.147e9).contains(&v).then_some(v as i32)
    }

    /// True if both ask for the same in the same form, the repeat counter aside. Compares bits: NaN equals NaN.
    #[must_use]
    pub fn is_repeat_of(&self, other: &Self) -> bool {
        self.number == other.number
            && self.is_int == other.is_int
            && self.params.map(f32::to_bits) == other.params.map(f32::to_bits)
            && self.point.frame == other.point.frame
            && (self.point.x, self.point.y) == (other.point.x, other.point.y)
            && self.point.z_m.map(f32::to_bits) == other.point.z_m.map(f32::to_bits)
    }
}

/// The value, none if it is NaN ("not given").
#[must_use]
pub fn given(value: f32) -> Option<f32> {
    (!value.is_nan()).then_some(value)
}

/// Degrees of COMMAND_LONG and MISSION_ITEM in the unit of the INT forms. What does not fit becomes `i32::MIN`, which no
/// range check lets pass; NaN is not given.
pub(crate) fn degrees_to_e7(degrees: f32) -> Option<i32> {
    let e7 = f64::from(given(degrees)?) * 1e7;
    Some(if e7.abs() < f64::from(i32::MAX) {
        e7.round() as i32
    } else {
        i32::MIN
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn both_forms_of_a_place_read_the_same() {
        let long = raw::COMMAND_LONG_DATA {
            command: 192,
            param5: 47.25,
            param6: -8.5,
            param7: 3.0,
            ..Default::default()
        };
        let int = raw::COMMAND_INT_DATA {
            command: 192,
            x: 472_500_000,
            y: -85_000_000,
            z: 3.0,
            ..Default::default()
        };
        assert_eq!(
            Command::from_long(&long).point,
            Command::from_int(&int).point
        );
    }

    #[test]
    fn what_is_not_given_is_none_in_both_forms() {
        let nan = f32::NAN;
        let long = raw::COMMAND_LONG_DATA {
            param1: nan,
            param5: nan,
            param6: nan,
            param7: nan,
            ..Default::default()
        };
        let int = raw::COMMAND_INT_DATA {
            param1: nan,
            x: i32::MAX,
            y: i32::MAX,
            z: nan,
            ..Default::default()
        };
        for c in [Command::from_long(&long), Command::from_int(&int)] {
            assert_eq!(
                (c.param(1), c.point.x, c.point.y, c.point.z_m),
                (None, None, None, None)
            );
            assert_eq!(c.param(2), Some(0.0));
            assert_eq!(
                (c.param(0), c.param(5)),
                (None, None),
                "there are parameters 1 to 4"
            );
        }
    }

    #[test]
    fn a_repeat_is_recognised_through_nan_and_its_counter() {
        let mut m = raw::COMMAND_LONG_DATA {
            command: 22,
            param4: f32::NAN,
            ..Default::default()
        };
        let first = Command::from_long(&m);
        m.confirmation = 1;
        assert!(Command::from_long(&m).is_repeat_of(&first));
        m.param1 = 1.0;
        assert!(!Command::from_long(&m).is_repeat_of(&first));
    }

    #[test]
    fn names_are_known() {
        assert_eq!(name(cmd::DO_REPOSITION), Some("DO_REPOSITION"));
        assert_eq!(name(60_000), None);
    }

    #[test]
    fn numbers_of_the_standard_dialect_are_ours() {
        use num_traits::FromPrimitive;
        for number in 0..=u16::MAX {
            if let (Some(ours), Some(standard)) =
                (name(number), crate::standard::MavCmd::from_u16(number))
            {
                assert_eq!(format!("MAV_CMD_{ours}"), format!("{standard:?}"));
            }
        }
    }

    proptest! {
        #[test]
        fn infinite_and_huge_degrees_never_look_like_a_place(v in prop_oneof![
            Just(f32::INFINITY), Just(f32::NEG_INFINITY), Just(f32::MAX), Just(1e9f32), any::<f32>()
        ]) {
            if let Some(e7) = degrees_to_e7(v) {
                prop_assert!(e7 == i32::MIN || (f64::from(e7) * 1e-7 - f64::from(v)).abs() < 1e-6);
            }
        }
    }
}
