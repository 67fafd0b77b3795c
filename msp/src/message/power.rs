//! Battery: voltage, current, consumption.

use super::messages;

messages! {
    /// Voltage, consumption, RSSI and current.
    #[derive(Copy)]
    Analog = ANALOG {
        /// Voltage in 0.1 V.
        vbat_dv: u8,
        /// Consumption in mAh.
        drawn_mah: u16,
        /// Radio signal strength 0..=1023.
        rssi: u16,
        /// Current in 0.01 A (Cleanflight has an option for 0.001 A).
        current_ca: i16,
        /// Betaflight: voltage in 0.01 V.
        vbat_cv: Option<u16>,
    }

    /// Battery as the controller judges it.
    #[derive(Copy)]
    BatteryState = BATTERY_STATE {
        /// Cells in series, 0 = no battery detected.
        cells: u8,
        /// Capacity in mAh.
        capacity_mah: u16,
        /// Voltage in 0.1 V.
        vbat_dv: u8,
        /// Consumption in mAh.
        drawn_mah: u16,
        /// Current in 0.01 A.
        current_ca: i16,
        /// 0 ok, 1 warning, 2 critical, 3 not present, 4 initialising.
        state: Option<u8>,
        /// Voltage in 0.01 V.
        vbat_cv: Option<u16>,
    }

    /// Battery and power as INAV sees them.
    #[derive(Copy)]
    InavAnalog = INAV_ANALOG {
        /// Bit 0 full when plugged in, bit 1 uses capacity thresholds, bits 2-3 state, bits 4-7
        /// cells.
        flags: u8,
        /// Voltage in 0.01 V.
        vbat_cv: u16,
        /// Current in 0.01 A.
        current_ca: i16,
        /// Power in 0.01 W.
        power_cw: u32,
        /// Consumption in mAh.
        drawn_mah: u32,
        /// Consumption in mWh.
        drawn_mwh: u32,
        /// Remaining capacity, mAh or mWh as configured.
        remaining: u32,
        /// Remaining charge in percent.
        percentage: u8,
        /// Radio signal strength 0..=1023.
        rssi: u16,
    }
}

impl InavAnalog {
    /// Cells in series, 0 = no battery detected.
    #[must_use]
    pub const fn cells(&self) -> u8 {
        self.flags >> 4
    }

    /// 0 ok, 1 warning, 2 critical, 3 not present: as [`BatteryState::state`].
    #[must_use]
    pub const fn state(&self) -> u8 {
        (self.flags >> 2) & 0b11
    }
}
