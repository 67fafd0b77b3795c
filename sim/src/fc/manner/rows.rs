//! The rows of the table of manners.

use super::{
    AngleCurve, ArmingRules, Batch, Board, Identity, Override, ReceiverChoice, ReceiverRules,
    StatusKind, StickRules, Table, WireRules, YawCurve,
};
use crate::fc::arming::cause;
use crate::fc::receiver::{AETR, RPYT};
use core::time::Duration;
use msp::command as c;
use msp::firmware::box_id;

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

// ---- Betaflight -----------------------------------------------------------------------------------------------------

/// Questions that every Betaflight answers.
const BETAFLIGHT_QUESTIONS: [u16; 27] = [
    c::API_VERSION,
    c::FC_VARIANT,
    c::FC_VERSION,
    c::BOARD_INFO,
    c::BUILD_INFO,
    c::NAME,
    c::MODE_RANGES,
    c::FEATURE_CONFIG,
    c::MIXER_CONFIG,
    c::RX_CONFIG,
    c::SONAR_ALTITUDE,
    c::RX_MAP,
    c::FAILSAFE_CONFIG,
    RXFAIL_CONFIG,
    c::STATUS,
    c::RAW_IMU,
    c::MOTOR,
    c::RC,
    c::ATTITUDE,
    c::ALTITUDE,
    c::ANALOG,
    c::BOXNAMES,
    c::BOXIDS,
    c::BATTERY_STATE,
    c::MOTOR_CONFIG,
    c::STATUS_EX,
    c::UID,
];
const BETAFLIGHT_NEW_QUESTIONS: [u16; 28] = {
    let mut all = [c::ATTITUDE_QUATERNION; 28];
    let mut i = 0;
    while i < BETAFLIGHT_QUESTIONS.len() {
        all[i] = BETAFLIGHT_QUESTIONS[i];
        i += 1;
    }
    all
};
const BETAFLIGHT_ORDERS: &[u16] = &[
    c::SET_NAME,
    c::SET_MODE_RANGE,
    c::SET_FEATURE_CONFIG,
    c::SET_RX_CONFIG,
    c::SET_RX_MAP,
    c::SET_FAILSAFE_CONFIG,
    SET_RXFAIL_CONFIG,
    c::SET_ARMING_DISABLED,
    c::SET_RAW_RC,
    c::SET_MOTOR,
    c::ACC_CALIBRATION,
    c::EEPROM_WRITE,
    c::REBOOT,
];
/// In the order of the mode flags. Not the order of their ids: HEADFREE is 6, HEADADJ 7.
const BETAFLIGHT_BOXES: &[(u8, &str)] = &[
    (box_id::ARM, "ARM"),
    (box_id::ANGLE, "ANGLE"),
    (box_id::HORIZON, "HORIZON"),
    (6, "HEADFREE"),
    (box_id::FAILSAFE, "FAILSAFE"),
    (7, "HEADADJ"),
    (box_id::BEEPER, "BEEPER"),
    (box_id::MSP_OVERRIDE, "MSP OVERRIDE"),
];
const BETAFLIGHT_NEW_BOXES: &[(u8, &str)] = &[
    (box_id::ARM, "ARM"),
    (box_id::ANGLE, "ANGLE"),
    (box_id::HORIZON, "HORIZON"),
    (box_id::HEADING_HOLD, "MAG"),
    (box_id::ALTITUDE_HOLD, "ALTHOLD"),
    (6, "HEADFREE"),
    (box_id::FAILSAFE, "FAILSAFE"),
    (box_id::POSITION_HOLD, "POS HOLD"),
    (box_id::BETAFLIGHT_AUTOPILOT, "AUTOPILOT"),
    (7, "HEADADJ"),
    (box_id::BEEPER, "BEEPER"),
    (box_id::MSP_OVERRIDE, "MSP OVERRIDE"),
];
const BETAFLIGHT_WIRE: WireRules = WireRules {
    acc_counts_per_g: 2048.0,
    gyro_counts_per_dps: 16.4,
    told_channels: 18,
    most_channels: 18,
    rx_map_len: 8,
    rc_order: AETR,
    altitude_has_baro: false,
    analog_has_centivolts: true,
    heading_is_signed: false,
};
/// Measured on 4.6.
const BETAFLIGHT_RECEIVER: ReceiverRules = ReceiverRules {
    flag_after: ms(150),
    hold: ms(300),
    recovery: ms(500),
    stage_two_extra: ms(0),
    min_check_us: 1050,
    failsafe: (15, 60, 1000, 1),
    rest: [27, 0],
    chosen_by: ReceiverChoice::Feature,
};
const BETAFLIGHT_STICKS: StickRules = StickRules {
    angle: AngleCurve::Actual { limit_deg: 60.0 },
    yaw: YawCurve::Actual,
    motors: [crate::fc::stabilizer::IDLE, 1.0],
};

const fn betaflight_bits(count: u8) -> [(u32, u32); 11] {
    [
        (cause::FAILSAFE, 1 << 1),
        (cause::RX_LOST, 1 << 2),
        (cause::NOT_DISARMED, 1 << 3),
        (cause::THROTTLE, 1 << 7),
        (cause::TILT, 1 << 8),
        (cause::SETTLING, 1 << 9),
        (cause::CALIBRATING, 1 << 12),
        (cause::CLI, 1 << 13),
        (cause::MSP, 1 << 16),
        (cause::REBOOT, 1 << 21),
        (cause::ARM_SWITCH, 1 << (count - 1)),
    ]
}
const BITS_26: [(u32, u32); 11] = betaflight_bits(26);
const BITS_29: [(u32, u32); 11] = betaflight_bits(29);
const BITS_30: [(u32, u32); 11] = betaflight_bits(30);

pub(super) const BETAFLIGHT_46: Table = Table {
    identity: Identity {
        variant: Some(*b"BTFL"),
        api: (1, 47),
        version: (4, 6, 0),
        version_text: None,
        board: Board::Full,
    },
    questions: &BETAFLIGHT_QUESTIONS,
    orders: BETAFLIGHT_ORDERS,
    boxes: BETAFLIGHT_BOXES,
    mode_slots: 20,
    wire: BETAFLIGHT_WIRE,
    status: StatusKind::Betaflight {
        has_temperature: true,
        has_battery_profiles: false,
    },
    batch: Batch::EndsEarly,
    arming: ArmingRules {
        settle: ms(5000),
        throttle_latches: true,
        told: &BITS_29,
        count: 29,
        armed_bit: 0,
        was_armed_bit: 0,
        blocking_boxes: &[],
    },
    receiver: BETAFLIGHT_RECEIVER,
    // No freshness test: the last value stays while the box is on.
    beside_radio: Override::ByBox {
        fresh_for: None,
        keeps_switch: false,
    },
    sticks: BETAFLIGHT_STICKS,
};

pub(super) const BETAFLIGHT_OLD: Table = Table {
    identity: Identity {
        variant: Some(*b"BTFL"),
        api: (1, 45),
        version: (4, 4, 3),
        version_text: None,
        board: Board::Full,
    },
    status: StatusKind::Betaflight {
        has_temperature: false,
        has_battery_profiles: false,
    },
    arming: ArmingRules {
        told: &BITS_26,
        count: 26,
        ..BETAFLIGHT_46.arming
    },
    ..BETAFLIGHT_46
};

pub(super) const BETAFLIGHT_NEW: Table = Table {
    identity: Identity {
        variant: Some(*b"BTFL"),
        api: (1, 49),
        version: (26, 12, 0),
        version_text: Some("2026.12.0"),
        board: Board::Full,
    },
    questions: &BETAFLIGHT_NEW_QUESTIONS,
    boxes: BETAFLIGHT_NEW_BOXES,
    status: StatusKind::Betaflight {
        has_temperature: true,
        has_battery_profiles: true,
    },
    batch: Batch::Refused,
    arming: ArmingRules {
        told: &BITS_30,
        count: 30,
        blocking_boxes: &[
            (box_id::ALTITUDE_HOLD, 1 << 26),
            (box_id::POSITION_HOLD, 1 << 27),
            (box_id::BETAFLIGHT_AUTOPILOT, 1 << 28),
        ],
        ..BETAFLIGHT_46.arming
    },
    // Measured 0.299 s.
    beside_radio: Override::ByBox {
        fresh_for: Some(ms(300)),
        keeps_switch: false,
    },
    ..BETAFLIGHT_46
};

// ---- INAV -----------------------------------------------------------------------------------------------------------

pub(super) const INAV: Table = Table {
    identity: Identity {
        variant: Some(*b"INAV"),
        api: (2, 5),
        version: (9, 0, 0),
        version_text: None,
        board: Board::Target,
    },
    questions: &[
        c::API_VERSION,
        c::FC_VARIANT,
        c::FC_VERSION,
        c::BOARD_INFO,
        c::BUILD_INFO,
        c::NAME,
        c::MODE_RANGES,
        c::FEATURE_CONFIG,
        c::MIXER_CONFIG,
        c::RX_CONFIG,
        c::SONAR_ALTITUDE,
        c::RX_MAP,
        c::FAILSAFE_CONFIG,
        c::STATUS,
        c::RAW_IMU,
        c::MOTOR,
        c::RC,
        c::ATTITUDE,
        c::ALTITUDE,
        c::ANALOG,
        c::BOXNAMES,
        c::BOXIDS,
        c::BATTERY_STATE,
        c::STATUS_EX,
        c::UID,
        c::INAV_STATUS,
        c::INAV_ANALOG,
    ],
    orders: &[
        c::SET_NAME,
        c::SET_MODE_RANGE,
        c::SET_FEATURE_CONFIG,
        c::SET_RX_CONFIG,
        c::SET_RX_MAP,
        c::SET_FAILSAFE_CONFIG,
        c::SET_RAW_RC,
        c::SET_MOTOR,
        c::ACC_CALIBRATION,
        c::EEPROM_WRITE,
        c::REBOOT,
    ],
    boxes: &[
        (box_id::ARM, "ARM"),
        (box_id::INAV_PREARM, "PREARM"),
        (box_id::ANGLE, "ANGLE"),
        (box_id::HORIZON, "HORIZON"),
        (box_id::HEADING_HOLD, "HEADING HOLD"),
        (6, "HEADFREE"),
        (7, "HEADADJ"),
        // The number that means GPS rescue to Betaflight.
        (46, "MC BRAKING"),
        (box_id::ALTITUDE_HOLD, "NAV ALTHOLD"),
        (box_id::POSITION_HOLD, "NAV POSHOLD"),
        (box_id::BEEPER, "BEEPER"),
        (box_id::FAILSAFE, "FAILSAFE"),
        (box_id::MSP_OVERRIDE, "MSP RC OVERRIDE"),
    ],
    mode_slots: 40,
    wire: WireRules {
        acc_counts_per_g: 512.0,
        gyro_counts_per_dps: 1.0,
        told_channels: 34,
        most_channels: 34,
        rx_map_len: 4,
        rc_order: AETR,
        altitude_has_baro: true,
        analog_has_centivolts: false,
        heading_is_signed: false,
    },
    status: StatusKind::Inav,
    batch: Batch::Unknown,
    arming: ArmingRules {
        // Calibration of the gyro.
        settle: ms(2500),
        throttle_latches: true,
        told: &[
            (cause::FAILSAFE, 1 << 7),
            (cause::TILT, 1 << 8),
            (cause::SETTLING, 1 << 9),
            (cause::CALIBRATING, 1 << 9),
            (cause::ARM_SWITCH, 1 << 14),
            (cause::NOT_DISARMED, 1 << 14),
            (cause::RX_LOST, 1 << 18),
            (cause::THROTTLE, 1 << 19),
            (cause::CLI, 1 << 20),
        ],
        count: 32,
        armed_bit: 1 << 2,
        was_armed_bit: 1 << 3,
        blocking_boxes: &[(box_id::POSITION_HOLD, 1 << 11)],
    },
    receiver: ReceiverRules {
        flag_after: ms(200),
        hold: ms(800),
        recovery: ms(500),
        // 0.8 s measured with a delay of 0.5 s.
        stage_two_extra: ms(300),
        min_check_us: 1100,
        failsafe: (5, 200, 1000, 0),
        rest: [12, 12],
        chosen_by: ReceiverChoice::ReceiverType,
    },
    beside_radio: Override::ByBox {
        fresh_for: Some(ms(700)),
        keeps_switch: true,
    },
    sticks: StickRules {
        // 2.3 degrees measured at 1600 us with the limit at 30.
        angle: AngleCurve::Expo {
            gain_deg: 30.0,
            expo: 0.64,
            limit_deg: 30.0,
        },
        // 30 degrees measured in a second at 1600 us.
        yaw: YawCurve::Expo {
            full_dps: 200.0,
            expo: 0.26,
        },
        motors: [0.08, 1.0],
    },
};

// ---- Cleanflight and MultiWii ---------------------------------------------------------------------------------------

/// Both share MultiWii's stick curves: rate 0.90, expo 0.65, two tenths of a degree a step, yaw rate 0.
const MULTIWII_STICKS: StickRules = StickRules {
    angle: AngleCurve::Expo {
        gain_deg: 90.0,
        expo: 0.65,
        limit_deg: 50.0,
    },
    yaw: YawCurve::Expo {
        full_dps: 114.0,
        expo: 0.0,
    },
    // min_throttle 1150, max_throttle 1850.
    motors: [0.15, 0.85],
};

pub(super) const CLEANFLIGHT: Table = Table {
    identity: Identity {
        variant: Some(*b"CLFL"),
        api: (1, 19),
        version: (1, 13, 0),
        version_text: None,
        board: Board::Short,
    },
    questions: &[
        c::API_VERSION,
        c::FC_VARIANT,
        c::FC_VERSION,
        c::BOARD_INFO,
        c::BUILD_INFO,
        c::MODE_RANGES,
        c::FEATURE_CONFIG,
        c::MIXER_CONFIG,
        c::RX_CONFIG,
        c::SONAR_ALTITUDE,
        c::RX_MAP,
        c::FAILSAFE_CONFIG,
        c::IDENT,
        c::STATUS,
        c::RAW_IMU,
        c::MOTOR,
        c::RC,
        c::ATTITUDE,
        c::ALTITUDE,
        c::ANALOG,
        c::BOXNAMES,
        c::BOXIDS,
        c::STATUS_EX,
        c::UID,
    ],
    orders: &[
        c::SET_MODE_RANGE,
        c::SET_FEATURE_CONFIG,
        c::SET_RX_CONFIG,
        c::SET_RX_MAP,
        c::SET_FAILSAFE_CONFIG,
        c::SET_RAW_RC,
        c::SET_MOTOR,
        c::ACC_CALIBRATION,
        c::EEPROM_WRITE,
        c::REBOOT,
    ],
    boxes: &[
        (box_id::ARM, "ARM"),
        (box_id::ANGLE, "ANGLE"),
        (box_id::HORIZON, "HORIZON"),
        (box_id::ALTITUDE_HOLD, "BARO"),
        (box_id::HEADING_HOLD, "MAG"),
        (6, "HEADFREE"),
        (7, "HEADADJ"),
        (box_id::BEEPER, "BEEPER"),
        (box_id::FAILSAFE, "FAILSAFE"),
    ],
    mode_slots: 20,
    wire: WireRules {
        acc_counts_per_g: 512.0,
        analog_has_centivolts: false,
        ..BETAFLIGHT_WIRE
    },
    status: StatusKind::Cleanflight,
    batch: Batch::Unknown,
    arming: ArmingRules {
        // Gyro calibration, a guess.
        settle: ms(2000),
        throttle_latches: false,
        told: &[],
        count: 0,
        armed_bit: 0,
        was_armed_bit: 0,
        blocking_boxes: &[],
    },
    receiver: ReceiverRules {
        // 10 Hz at least, a guess.
        flag_after: ms(100),
        hold: ms(300),
        recovery: ms(500),
        stage_two_extra: ms(0),
        min_check_us: 1100,
        failsafe: (10, 200, 1000, 0),
        rest: [0, 0],
        chosen_by: ReceiverChoice::Feature,
    },
    beside_radio: Override::Never,
    sticks: MULTIWII_STICKS,
};

pub(super) const MULTIWII: Table = Table {
    identity: Identity {
        variant: None,
        api: (0, 0),
        version: (2, 40, 0),
        version_text: None,
        board: Board::Short,
    },
    questions: &[
        c::IDENT,
        c::STATUS,
        c::RAW_IMU,
        c::MOTOR,
        c::RC,
        c::ATTITUDE,
        c::ALTITUDE,
        c::ANALOG,
        MULTIWII_BOX,
        c::BOXNAMES,
        c::BOXIDS,
    ],
    orders: &[
        c::SET_RAW_RC,
        MULTIWII_SET_BOX,
        c::ACC_CALIBRATION,
        c::SET_MOTOR,
        c::EEPROM_WRITE,
    ],
    boxes: &[
        (box_id::ARM, "ARM"),
        (box_id::ANGLE, "ANGLE"),
        (box_id::HORIZON, "HORIZON"),
        (box_id::ALTITUDE_HOLD, "BARO"),
        (box_id::HEADING_HOLD, "MAG"),
        (6, "HEADFREE"),
        (7, "HEADADJ"),
    ],
    mode_slots: 20,
    wire: WireRules {
        acc_counts_per_g: 512.0,
        // Raw counts divided by four, a guess.
        gyro_counts_per_dps: 4.1,
        told_channels: 8,
        most_channels: 8,
        rx_map_len: 0,
        rc_order: RPYT,
        altitude_has_baro: false,
        analog_has_centivolts: false,
        heading_is_signed: true,
    },
    status: StatusKind::MultiWii,
    batch: Batch::Unknown,
    arming: ArmingRules {
        settle: ms(1500),
        ..CLEANFLIGHT.arming
    },
    receiver: ReceiverRules {
        flag_after: ms(1000),
        hold: ms(1000),
        recovery: ms(0),
        stage_two_extra: ms(0),
        min_check_us: 1100,
        failsafe: (10, 200, 1000, 1),
        rest: [0, 0],
        chosen_by: ReceiverChoice::None,
    },
    // 50 rounds of its loop for each channel.
    beside_radio: Override::Always {
        fresh_for: ms(1000),
    },
    sticks: MULTIWII_STICKS,
};

/// MSP_BOX of MultiWii: three bits (low, middle, high) for each of Aux1 to Aux4, a word for each box.
pub(in crate::fc) const MULTIWII_BOX: u16 = 113;
/// MSP_SET_BOX.
pub(in crate::fc) const MULTIWII_SET_BOX: u16 = 203;
/// MSP_RXFAIL_CONFIG of Betaflight: mode u8 (0 auto, 1 hold, 2 set) and value u16 for each channel.
pub(in crate::fc) const RXFAIL_CONFIG: u16 = 77;
/// MSP_SET_RXFAIL_CONFIG: channel u8, mode u8, value u16.
pub(in crate::fc) const SET_RXFAIL_CONFIG: u16 = 78;
