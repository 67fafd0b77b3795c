//! RC channels and motors, in microseconds of pulse width.
//!
//! **Two orders.** RC (what the controller sees) is Roll, Pitch, Yaw, Throttle, Aux1... SET_RAW_RC
//! (what we send) is in the order of the receiver map, by default Roll, Pitch, Throttle, Yaw,
//! Aux1... ("AETR"); [`super::RxMap::arrange`] sorts it. Roll > 1500 rolls right, **pitch > 1500
//! tilts the nose down**, yaw > 1500 turns clockwise.

use super::messages;
use arrayvec::ArrayVec;

/// Most RC channels any firmware takes (INAV 34, Betaflight and Cleanflight 18, MultiWii 8).
pub const MAX_CHANNELS: usize = 34;

messages! {
    /// RC channels as the controller sees them: Roll, Pitch, Yaw, Throttle, Aux1...
    Rc = RC {
        /// Pulse widths in microseconds.
        channels_us: ArrayVec<u16, MAX_CHANNELS>,
    }

    /// RC channels from us, in the order of the receiver map. Channels not sent become 0, which is
    /// invalid. Never send an empty one: it is acknowledged and counts as a receiver frame.
    SetRawRc = SET_RAW_RC {
        /// Pulse widths in microseconds.
        channels_us: ArrayVec<u16, MAX_CHANNELS>,
    }

    /// Motor outputs on the scale 1000..=2000 whatever the motor protocol is, 0 = no such motor.
    #[derive(Copy)]
    Motor = MOTOR {
        /// Motor 1..=8.
        motors_us: [u16; 8],
    }

    /// Servo outputs.
    Servo = SERVO {
        /// Pulse widths in microseconds.
        servos_us: ArrayVec<u16, MAX_CHANNELS>,
    }

    /// Motor test values, obeyed only while disarmed. **They persist without time-out: always end
    /// with all 1000.**
    #[derive(Copy)]
    SetMotor = SET_MOTOR {
        /// Motor 1..=8.
        motors_us: [u16; 8],
    }
}
