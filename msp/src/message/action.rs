//! Requests that make the controller do something. `EEPROM_WRITE` and `ACC_CALIBRATION` have empty
//! payloads and need no struct: the first is refused while armed, the second wants a level vehicle
//! at rest and is ignored while armed.

use super::messages;

messages! {
    /// Restart. The controller answers with the mode, then resets.
    #[derive(Copy)]
    Reboot = REBOOT {
        /// 0 (or absent in a request) = into the firmware; other values start boot loaders.
        mode: Option<u8>,
    }

    /// Blocks arming from this link; configurators leave it blocked.
    #[derive(Copy)]
    SetArmingDisabled = SET_ARMING_DISABLED {
        /// 1 = block arming and disarm, 0 = allow.
        disable: u8,
        /// Betaflight: 1 = disable runaway take-off prevention too.
        disable_runaway_takeoff: Option<u8>,
    }

    /// Sets the clock of the controller, which stamps its logs.
    #[derive(Copy)]
    SetRtc = SET_RTC {
        /// Seconds since 1970, UTC.
        seconds: u32,
        /// Milliseconds of the second.
        milliseconds: u16,
    }
}
