//! What can be said to the board: one character and a newline.

/// A command. The board needs 350 ms after the port is opened (it resets) before it listens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImuCommand {
    /// `!`: default mode, run.
    RunDefault,
    /// `#`: leave the menu, run.
    LeaveMenu,
    /// `$`: stop and show the menu.
    Stop,
    /// `2`: in the menu, accelerometer on or off.
    ToggleAccel,
    /// `3`: in the menu, gyro on or off.
    ToggleGyro,
    /// `4`: in the menu, compass on or off.
    ToggleCompass,
    /// `5`: in the menu, temperature on or off.
    ToggleTemperature,
    /// `6`: in the menu, pressure on or off.
    TogglePressure,
    /// `7`: in the menu, show the barometer's calibration.
    ShowBarometer,
}

/// Time the board needs after its port was opened, ms.
pub const RESET_MS: u64 = 350;

impl ImuCommand {
    /// The two bytes on the wire.
    #[must_use]
    pub const fn bytes(self) -> [u8; 2] {
        let character = match self {
            Self::RunDefault => b'!',
            Self::LeaveMenu => b'#',
            Self::Stop => b'$',
            Self::ToggleAccel => b'2',
            Self::ToggleGyro => b'3',
            Self::ToggleCompass => b'4',
            Self::ToggleTemperature => b'5',
            Self::TogglePressure => b'6',
            Self::ShowBarometer => b'7',
        };
        [character, b'\n']
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_ends_with_a_newline() {
        assert_eq!(ImuCommand::RunDefault.bytes(), *b"!\n");
        assert_eq!(ImuCommand::LeaveMenu.bytes(), *b"#\n");
        assert_eq!(ImuCommand::Stop.bytes(), *b"$\n");
        assert_eq!(ImuCommand::ShowBarometer.bytes(), *b"7\n");
    }
}
