//! What blocks arming: the bits of STATUS_EX (Betaflight) and INAV_STATUS (INAV), by name and with
//! what the pilot can do.

use super::Firmware;

/// One reason why the controller does not arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArmingBlocker {
    /// Bit in the flags.
    pub bit: u8,
    /// Name in the firmware.
    pub name: &'static str,
    /// What it means or what to do, for a pilot.
    pub advice: &'static str,
}

/// The blockers set in `flags`, lowest bit first. `count` is the number of bits of a Betaflight
/// version, which STATUS tells: the last one is always `ARM_SWITCH` while names move below it (26
/// bits in Betaflight 4.0, 29 in 4.6, 30 in 2026.12). INAV ignores it; its flags 0..6 and 17 are
/// states, not blockers.
pub fn arming_blockers(
    firmware: Firmware,
    count: u8,
    flags: u32,
) -> impl Iterator<Item = ArmingBlocker> {
    (0..32_u8)
        .filter(move |bit| flags & (1 << bit) != 0)
        .filter_map(move |bit| {
            let (name, advice) = match firmware {
                Firmware::Inav => inav(bit)?,
                _ if bit + 1 == count => ARM_SWITCH,
                _ => betaflight(bit),
            };
            Some(ArmingBlocker { bit, name, advice })
        })
}

type Named = (&'static str, &'static str);

const ARM_SWITCH: Named = (
    "ARM_SWITCH",
    "the arm switch was high while something else blocked: lower it, then raise it again",
);
const UNNAMED: Named = (
    "UNNAMED",
    "a reason this version of the program has no name for: see the controller's configurator",
);

/// Names as of Betaflight 4.6 (count 29) and 2026.12 (count 30).
const fn betaflight(bit: u8) -> Named {
    match bit {
        0 => ("NO_GYRO", "no gyro found"),
        1 => ("FAILSAFE", "failsafe is active: lower the arm switch"),
        2 => (
            "RX_FAILSAFE",
            "no valid receiver signal: keep RC frames coming",
        ),
        // Betaflight before 4.6 and Cleanflight 4 call it BAD_RX_RECOVERY; the cure is the same.
        3 => (
            "NOT_DISARMED",
            "the receiver came back with the arm switch high: lower it",
        ),
        4 => ("BOXFAILSAFE", "the failsafe switch is on"),
        5 => (
            "RUNAWAY_TAKEOFF",
            "runaway take-off prevention has disarmed: check motors and propellers",
        ),
        6 => (
            "CRASH_DETECTED",
            "a crash was detected: lower the arm switch",
        ),
        7 => ("THROTTLE", "throttle is not low"),
        8 => ("ANGLE", "not level enough"),
        9 => ("BOOT_GRACE_TIME", "starting, wait 5 s"),
        10 => ("NOPREARM", "the pre-arm switch is off"),
        11 => ("LOAD", "the processor is overloaded"),
        12 => ("CALIBRATING", "calibrating, keep still"),
        13 => ("CLI", "the command line is open on another port"),
        14 => ("CMS_MENU", "the on-screen menu is open"),
        15 => ("BST", "blocked over the BST bus"),
        16 => (
            "MSP",
            "blocked over MSP, usually by a configurator that was connected",
        ),
        17 => ("PARALYZE", "paralysed until restart"),
        18 => ("GPS", "waiting for a GPS fix for rescue"),
        19 => ("RESCUE_SW", "the GPS rescue switch is on"),
        20 => ("DSHOT_TELEM", "motor telemetry is missing"),
        21 => (
            "REBOOT_REQUIRED",
            "settings changed: restart the controller",
        ),
        22 => ("DSHOT_BITBANG", "bit-banged motor output failed"),
        23 => ("ACC_CALIBRATION", "the accelerometer is not calibrated"),
        24 => ("MOTOR_PROTOCOL", "no motor protocol is chosen"),
        25 => ("CRASHFLIP", "the crash-flip switch is on"),
        26 => ("ALTHOLD", "altitude hold is switched on: arm first"),
        27 => ("POSHOLD", "position hold is switched on: arm first"),
        28 => ("AUTOPILOT", "the autopilot is switched on: arm first"),
        _ => UNNAMED,
    }
}

/// Names as of INAV 9.
const fn inav(bit: u8) -> Option<Named> {
    Some(match bit {
        0..=5 | 17 | 31 => return None,
        6 => ("GEOZONE", "outside the permitted zone"),
        7 => ("FAILSAFE", "failsafe is active: keep RC frames coming"),
        8 => ("NOT_LEVEL", "not level enough"),
        9 => ("SENSORS_CALIBRATING", "calibrating, keep still"),
        10 => ("SYSTEM_OVERLOADED", "the processor is overloaded"),
        11 => (
            "NAVIGATION_UNSAFE",
            "navigation is not ready: no fix, or a navigation mode is switched on",
        ),
        12 => ("COMPASS_NOT_CALIBRATED", "the compass is not calibrated"),
        13 => (
            "ACCELEROMETER_NOT_CALIBRATED",
            "the accelerometer is not calibrated",
        ),
        14 => ARM_SWITCH,
        15 => ("HARDWARE_FAILURE", "a sensor has failed"),
        16 => ("BOXFAILSAFE", "the failsafe switch is on"),
        18 => ("RC_LINK", "no valid receiver signal: keep RC frames coming"),
        19 => ("THROTTLE", "throttle is not low"),
        20 => ("CLI", "the command line is open on another port"),
        21 => ("CMS_MENU", "the on-screen menu is open"),
        22 => ("OSD_MENU", "the on-screen menu is open"),
        23 => (
            "ROLLPITCH_NOT_CENTERED",
            "roll and pitch sticks are not centred",
        ),
        24 => ("SERVO_AUTOTRIM", "servo trim is running"),
        25 => ("OOM", "out of memory"),
        26 => (
            "INVALID_SETTING",
            "a setting is invalid: see the controller's configurator",
        ),
        27 => ("PWM_OUTPUT_ERROR", "a motor output failed to start"),
        28 => ("NO_PREARM", "the pre-arm switch is off"),
        29 => ("DSHOT_BEEPER", "the motors are beeping"),
        _ => (
            "LANDING_DETECTED",
            "landing was detected: lower the arm switch",
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(firmware: Firmware, count: u8, flags: u32) -> Vec<&'static str> {
        arming_blockers(firmware, count, flags)
            .map(|blocker| blocker.name)
            .collect()
    }

    #[test]
    fn arm_switch_is_the_last_bit_of_every_betaflight() {
        assert_eq!(names(Firmware::Betaflight, 26, 1 << 25), ["ARM_SWITCH"]);
        assert_eq!(
            names(Firmware::Betaflight, 29, 1 << 28 | 1 << 2),
            ["RX_FAILSAFE", "ARM_SWITCH"]
        );
        assert_eq!(
            names(Firmware::Betaflight, 30, 1 << 29 | 1 << 28),
            ["AUTOPILOT", "ARM_SWITCH"]
        );
    }

    #[test]
    fn states_of_inav_are_no_blockers() {
        assert_eq!(
            names(Firmware::Inav, 32, 1 << 2 | 1 << 3 | 1 << 17),
            [""; 0]
        );
        assert_eq!(
            names(Firmware::Inav, 32, 1 << 9 | 1 << 14 | 1 << 2),
            ["SENSORS_CALIBRATING", "ARM_SWITCH"]
        );
    }

    #[test]
    fn every_bit_yields_a_name_or_is_a_state() {
        assert_eq!(names(Firmware::Betaflight, 30, u32::MAX).len(), 32);
        assert_eq!(names(Firmware::Inav, 0, u32::MAX).len(), 24);
    }
}
