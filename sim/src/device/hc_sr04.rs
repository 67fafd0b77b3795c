//! HC-SR04: the echo line rises 0.46 ms after the trigger and falls with the echo, or after 38 ms.

use core::time::Duration;
use vehicle::{RangerReading, Timestamp};

/// From the trigger to the rise.
pub const RISE: Duration = Duration::from_micros(460);
/// How long the line stays up without an echo.
pub const NO_ECHO: Duration = Duration::from_millis(38);
/// Speed of sound at 20 degrees, m/s.
pub const SOUND_MPS: f64 = 343.2;

/// When the line rises and falls after a trigger, for what was measured then.
#[must_use]
pub fn edges(triggered: Timestamp, reading: &RangerReading) -> [Timestamp; 2] {
    let width = reading
        .columns_mm
        .first()
        .copied()
        .flatten()
        .map_or(NO_ECHO, |mm| {
            Duration::from_secs_f64(2e-3 * f64::from(mm) / SOUND_MPS)
        });
    [triggered + RISE, triggered + RISE + width]
}
