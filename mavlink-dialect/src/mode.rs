//! Flight modes on the wire: PX4's packing of `custom_mode` and MAVLink's standard modes.
//!
//! `custom_mode = main << 16 | sub << 24` (PX4 `px4_custom_mode.h`).

/// A mode as PX4 numbers it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Px4Mode {
    /// Main mode.
    pub main: u8,
    /// Sub mode, 0 if the main mode has none.
    pub sub: u8,
}

impl Px4Mode {
    /// As HEARTBEAT.custom_mode carries it.
    #[must_use]
    pub const fn custom_mode(self) -> u32 {
        (self.main as u32) << 16 | (self.sub as u32) << 24
    }

    /// From HEARTBEAT.custom_mode.
    #[must_use]
    pub const fn from_custom_mode(custom_mode: u32) -> Self {
        Self {
            main: (custom_mode >> 16) as u8,
            sub: (custom_mode >> 24) as u8,
        }
    }
}

/// MAV_MODE_FLAG_CUSTOM_MODE_ENABLED.
pub const FLAG_CUSTOM: u8 = 1;
/// MAV_MODE_FLAG_AUTO_ENABLED.
pub const FLAG_AUTO: u8 = 4;
/// MAV_MODE_FLAG_GUIDED_ENABLED.
pub const FLAG_GUIDED: u8 = 8;
/// MAV_MODE_FLAG_STABILIZE_ENABLED.
pub const FLAG_STABILIZE: u8 = 16;
/// MAV_MODE_FLAG_MANUAL_INPUT_ENABLED.
pub const FLAG_MANUAL: u8 = 64;
/// MAV_MODE_FLAG_SAFETY_ARMED.
pub const FLAG_ARMED: u8 = 128;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loiter_is_50593792() {
        assert_eq!(Px4Mode { main: 4, sub: 3 }.custom_mode(), 50_593_792);
        assert_eq!(
            Px4Mode::from_custom_mode(50_593_792),
            Px4Mode { main: 4, sub: 3 }
        );
    }
}
