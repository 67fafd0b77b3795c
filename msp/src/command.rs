//! Command numbers (the `MSP_` and `MSP2_` names of the firmware headers) and their names for
//! messages to people.
//!
//! Numbers below 255 travel in any framing, the others need v2 ([`crate::frame::Framing`]).

macro_rules! commands {
    ($($(#[$meta:meta])* $name:ident = $number:literal, $text:literal;)*) => {
        $($(#[$meta])* pub const $name: u16 = $number;)*

        /// The firmware's name of a command, `"MSP command"` when this crate does not know it.
        #[must_use]
        pub const fn name(command: u16) -> &'static str {
            match command {
                $($name => $text,)*
                _ => "MSP command",
            }
        }
    };
}

commands! {
    /// Protocol and API version, the first question to ask.
    API_VERSION = 1, "MSP_API_VERSION";
    /// Four letters naming the firmware.
    FC_VARIANT = 2, "MSP_FC_VARIANT";
    /// Version of the firmware.
    FC_VERSION = 3, "MSP_FC_VERSION";
    /// Board and target names.
    BOARD_INFO = 4, "MSP_BOARD_INFO";
    /// Date, time and revision of the build.
    BUILD_INFO = 5, "MSP_BUILD_INFO";
    /// Craft name.
    NAME = 10, "MSP_NAME";
    /// Sets the craft name.
    SET_NAME = 11, "MSP_SET_NAME";
    /// Slots that map RC switch positions to modes.
    MODE_RANGES = 34, "MSP_MODE_RANGES";
    /// Sets one slot of the mode ranges.
    SET_MODE_RANGE = 35, "MSP_SET_MODE_RANGE";
    /// Feature bits.
    FEATURE_CONFIG = 36, "MSP_FEATURE_CONFIG";
    /// Sets the feature bits.
    SET_FEATURE_CONFIG = 37, "MSP_SET_FEATURE_CONFIG";
    /// Mixer and motor direction.
    MIXER_CONFIG = 42, "MSP_MIXER_CONFIG";
    /// Receiver thresholds and provider.
    RX_CONFIG = 44, "MSP_RX_CONFIG";
    /// Sets the receiver thresholds and provider.
    SET_RX_CONFIG = 45, "MSP_SET_RX_CONFIG";
    /// Height above ground by the controller's own rangefinder.
    SONAR_ALTITUDE = 58, "MSP_SONAR_ALTITUDE";
    /// Arming limits.
    ARMING_CONFIG = 61, "MSP_ARMING_CONFIG";
    /// Order of the sticks in `SET_RAW_RC`.
    RX_MAP = 64, "MSP_RX_MAP";
    /// Sets the order of the sticks.
    SET_RX_MAP = 65, "MSP_SET_RX_MAP";
    /// Restarts the controller.
    REBOOT = 68, "MSP_REBOOT";
    /// What the controller does when RC stops.
    FAILSAFE_CONFIG = 75, "MSP_FAILSAFE_CONFIG";
    /// Sets what the controller does when RC stops.
    SET_FAILSAFE_CONFIG = 76, "MSP_SET_FAILSAFE_CONFIG";
    /// Sensor hardware chosen.
    SENSOR_CONFIG = 96, "MSP_SENSOR_CONFIG";
    /// Blocks or allows arming from this link.
    SET_ARMING_DISABLED = 99, "MSP_SET_ARMING_DISABLED";
    /// Identity of MultiWii and old Cleanflight.
    IDENT = 100, "MSP_IDENT";
    /// Cycle time, sensors, active modes.
    STATUS = 101, "MSP_STATUS";
    /// Accelerometer, gyro and magnetometer in sensor counts.
    RAW_IMU = 102, "MSP_RAW_IMU";
    /// Servo outputs.
    SERVO = 103, "MSP_SERVO";
    /// Motor outputs.
    MOTOR = 104, "MSP_MOTOR";
    /// RC channels as the controller sees them.
    RC = 105, "MSP_RC";
    /// GPS position.
    RAW_GPS = 106, "MSP_RAW_GPS";
    /// Way home by GPS.
    COMP_GPS = 107, "MSP_COMP_GPS";
    /// Attitude by the controller's estimator.
    ATTITUDE = 108, "MSP_ATTITUDE";
    /// Altitude and climb rate by the controller's estimator.
    ALTITUDE = 109, "MSP_ALTITUDE";
    /// Voltage, current, consumption, RSSI.
    ANALOG = 110, "MSP_ANALOG";
    /// Names of the mode boxes.
    BOXNAMES = 116, "MSP_BOXNAMES";
    /// Permanent ids of the mode boxes.
    BOXIDS = 119, "MSP_BOXIDS";
    /// Navigation of INAV.
    NAV_STATUS = 121, "MSP_NAV_STATUS";
    /// Battery by the controller.
    BATTERY_STATE = 130, "MSP_BATTERY_STATE";
    /// Throttle limits.
    MOTOR_CONFIG = 131, "MSP_MOTOR_CONFIG";
    /// Status with arming blockers.
    STATUS_EX = 150, "MSP_STATUS_EX";
    /// Serial number of the processor.
    UID = 160, "MSP_UID";
    /// Attitude as a quaternion (Betaflight API 1.49).
    ATTITUDE_QUATERNION = 167, "MSP_ATTITUDE_QUATERNION";
    /// RC channels from us.
    SET_RAW_RC = 200, "MSP_SET_RAW_RC";
    /// GPS position from us.
    SET_RAW_GPS = 201, "MSP_SET_RAW_GPS";
    /// Starts the accelerometer calibration.
    ACC_CALIBRATION = 205, "MSP_ACC_CALIBRATION";
    /// Motor test values, disarmed only.
    SET_MOTOR = 214, "MSP_SET_MOTOR";
    /// Several questions in one frame.
    MULTIPLE_MSP = 230, "MSP_MULTIPLE_MSP";
    /// Trim of the level.
    ACC_TRIM = 240, "MSP_ACC_TRIM";
    /// Sets the clock.
    SET_RTC = 246, "MSP_SET_RTC";
    /// The clock.
    RTC = 247, "MSP_RTC";
    /// Saves the configuration.
    EEPROM_WRITE = 250, "MSP_EEPROM_WRITE";
    /// Values for developers of the firmware.
    DEBUG = 254, "MSP_DEBUG";
    /// Mixer rows of the motors (INAV).
    COMMON_MOTOR_MIXER = 0x1005, "MSP2_COMMON_MOTOR_MIXER";
    /// Rangefinder sample from us.
    SENSOR_RANGEFINDER = 0x1F01, "MSP2_SENSOR_RANGEFINDER";
    /// Optical flow sample from us.
    SENSOR_OPTIC_FLOW = 0x1F02, "MSP2_SENSOR_OPTIC_FLOW";
    /// GPS solution from us.
    SENSOR_GPS = 0x1F03, "MSP2_SENSOR_GPS";
    /// Magnetometer sample from us.
    SENSOR_COMPASS = 0x1F04, "MSP2_SENSOR_COMPASS";
    /// Barometer sample from us.
    SENSOR_BARO = 0x1F05, "MSP2_SENSOR_BAROMETER";
    /// Status of INAV, with 64 mode flags.
    INAV_STATUS = 0x2000, "MSP2_INAV_STATUS";
    /// Optical flow as INAV sees it.
    INAV_OPTICAL_FLOW = 0x2001, "MSP2_INAV_OPTICAL_FLOW";
    /// Battery and power as INAV sees them.
    INAV_ANALOG = 0x2002, "MSP2_INAV_ANALOG";
    /// Air speed as INAV sees it.
    INAV_AIR_SPEED = 0x2009, "MSP2_INAV_AIR_SPEED";
    /// Sensors from a simulator (INAV).
    SIMULATOR = 0x201F, "MSP_SIMULATOR";
    /// Texts by type: craft name, pilot name (Betaflight).
    GET_TEXT = 0x3006, "MSP2_GET_TEXT";
    /// Reads a setting by name (Betaflight from 2026).
    GET_SETTING = 0x3010, "MSP2_GET_SETTING";
    /// Writes a setting by name (Betaflight from 2026).
    SET_SETTING = 0x3011, "MSP2_SET_SETTING";
    /// One line of the text console over MSP (Betaflight from 2026).
    CLI_COMMAND = 0x3012, "MSP2_CLI_COMMAND";
}
