//! The datagrams of Betaflight's simulator build.
//!
//! The firmware is a program that takes the state of the body as UDP datagrams and answers with motor commands. It runs on
//! the wall clock, stretched by `step of the time stamps / time between their arrivals` of the last two packets, so that every
//! jitter of arrival becomes jitter of its clock, which it takes for a lost receiver. With a **constant time stamp** the
//! stretch stays 1 and the firmware runs on the wall clock. There is no lockstep: such flights are in real time only.
//!
//! | Port | Direction | Holds |
//! | --- | --- | --- |
//! | UDP 9003 | to the firmware | state, 18 doubles ([`state_packet`]) |
//! | UDP 9002 | from it, at most one for each state | four motors as floats 0..=1 ([`motors`]) |
//! | UDP 9004 | to it | 16 RC channels ([`rc_packet`]); the first one makes UDP the receiver for good |
//! | TCP 5761 | both | MSP of UART 1, one client |
//!
//! The ports are fixed in the firmware, and it shares them silently with a second copy: one at a time on a machine.
//!
//! State packet, little-endian doubles; `w`, `f`, `q` are rate, specific force and attitude in FRD and NED:
//!
//! | Offset | Field | Betaflight 4.6 and older | Betaflight 2026.12 |
//! | --- | --- | --- | --- |
//! | 0 | time, s | constant | constant |
//! | 8 | rate, rad/s | (wx, wy, wz) | (wx, wy, -wz) |
//! | 32 | acceleration, m/s2 | (-fx, fy, fz) | (-fx, fy, fz) |
//! | 56 | quaternion w, x, y, z | q, used as it is: no estimator runs | q turned by 90 degrees about down: its compass and horizon |
//! | 88 | velocity east, north, up, m/s | for its GPS | for its GPS |
//! | 112 | longitude, latitude (deg), altitude (m) | GPS | altitude; a latitude beyond 90 = no GPS |
//! | 136 | pressure, Pa | altitude | not used |
//!
//! Measured on running firmware (Betaflight 4.6.0, MSP API 1.47; 2026.12.0-alpha, API 1.49).

use super::{Felt, pressure_pa};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use thiserror::Error;

/// UDP port on which the firmware takes states.
pub const STATE_PORT: u16 = 9003;
/// UDP port to which it sends motors.
pub const MOTOR_PORT: u16 = 9002;
/// UDP port on which it takes RC channels.
pub const RC_PORT: u16 = 9004;
/// TCP port of its UART 1.
pub const UART1_PORT: u16 = 5761;
/// Length of a state packet.
pub const STATE_LEN: usize = 144;
/// Length of a motor packet.
pub const MOTOR_LEN: usize = 16;
/// Length of an RC packet.
pub const RC_LEN: usize = 40;

/// The time stamp of every packet, s. Any number but zero would do as long as it never changes.
const CONSTANT_STAMP_S: f64 = 1.0;

/// Which edition of the packets a firmware speaks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dialect {
    /// Betaflight 4.6 and older.
    #[default]
    Betaflight46,
    /// Betaflight 2026.12.
    Betaflight2026,
}

impl Dialect {
    /// By the MSP API version: 1.47 is 4.6, 1.49 is 2026.12.
    #[must_use]
    pub const fn of_api(minor: u8) -> Self {
        if minor >= 48 {
            Self::Betaflight2026
        } else {
            Self::Betaflight46
        }
    }
}

/// A state as the firmware takes it. Indoors there is no GPS: the place is constant and the velocity zero.
#[must_use]
pub fn state_packet(dialect: Dialect, felt: &Felt) -> [u8; STATE_LEN] {
    let (w, f) = (&felt.rates_radps, &felt.specific_force_mps2);
    let (wz, latitude_deg) = match dialect {
        Dialect::Betaflight46 => (w.z(), 0.0),
        Dialect::Betaflight2026 => (-w.z(), 91.0),
    };
    let q = match dialect {
        Dialect::Betaflight46 => *felt.attitude.quaternion(),
        Dialect::Betaflight2026 => quarter_turn() * felt.attitude.quaternion(),
    };
    let mut packet = [0; STATE_LEN];
    let fields = [
        CONSTANT_STAMP_S,
        w.x(),
        w.y(),
        wz,
        -f.x(),
        f.y(),
        f.z(),
        q.w,
        q.i,
        q.j,
        q.k,
        0.0,
        0.0,
        0.0,
        0.0,
        latitude_deg,
        felt.altitude_m,
        pressure_pa(felt.altitude_m),
    ];
    for (place, field) in packet.chunks_exact_mut(8).zip(fields) {
        place.copy_from_slice(&field.to_le_bytes());
    }
    packet
}

/// 90 degrees clockwise about down.
fn quarter_turn() -> UnitQuaternion<f64> {
    let half = core::f64::consts::FRAC_1_SQRT_2;
    UnitQuaternion::from_quaternion(Quaternion::from_parts(half, Vector3::new(0.0, 0.0, half)))
}

/// Why a datagram is no motor packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum PacketError {
    /// Too short or too long.
    #[error("a motor packet has {MOTOR_LEN} bytes, this one {0}")]
    Length(usize),
    /// Not a number.
    #[error("motor {0} is no finite number")]
    NotFinite(usize),
}

/// Commands of motors 1 to 4 (numbers of Betaflight), 0..=1.
///
/// # Errors
/// [`PacketError`]: wrong length, or not numbers.
pub fn motors(dialect: Dialect, packet: &[u8]) -> Result<[f64; 4], PacketError> {
    let packet: &[u8; MOTOR_LEN] = packet
        .try_into()
        .map_err(|_| PacketError::Length(packet.len()))?;
    // Which motor is at which place.
    let order: [usize; 4] = match dialect {
        Dialect::Betaflight46 => [1, 2, 3, 0],
        Dialect::Betaflight2026 => [0, 1, 2, 3],
    };
    let mut commands = [0.0; 4];
    for (bytes, motor) in packet.as_chunks::<4>().0.iter().zip(order) {
        let command = f64::from(f32::from_le_bytes(*bytes));
        if !command.is_finite() {
            return Err(PacketError::NotFinite(motor + 1));
        }
        commands[motor] = command.clamp(0.0, 1.0);
    }
    Ok(commands)
}

/// RC channels, us, in the order aileron, elevator, throttle, rudder, Aux1...
#[must_use]
pub fn rc_packet(channels_us: &[u16; 16]) -> [u8; RC_LEN] {
    let mut packet = [0; RC_LEN];
    packet[..8].copy_from_slice(&CONSTANT_STAMP_S.to_le_bytes());
    for (place, us) in packet[8..].chunks_exact_mut(2).zip(channels_us) {
        place.copy_from_slice(&us.to_le_bytes());
    }
    packet
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "fields are copied, not computed")]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use vehicle::{In, Rot};

    fn field(packet: &[u8], index: usize) -> f64 {
        f64::from_le_bytes(packet[8 * index..8 * index + 8].try_into().unwrap())
    }

    fn felt(roll: f64, pitch: f64, yaw: f64) -> Felt {
        Felt {
            rates_radps: In::new(0.1, 0.2, 0.3),
            specific_force_mps2: In::new(1.0, 2.0, -9.81),
            attitude: Rot::from_roll_pitch_yaw(roll, pitch, yaw),
            altitude_m: 1.0,
        }
    }

    #[test]
    fn level_at_rest_is_minus_g_down_the_third_axis_in_both_dialects() {
        for dialect in [Dialect::Betaflight46, Dialect::Betaflight2026] {
            let packet = state_packet(dialect, &felt(0.0, 0.0, 0.0));
            let acceleration = [4, 5, 6].map(|i| field(&packet, i));
            assert_eq!(acceleration, [-1.0, 2.0, -9.81]);
        }
    }

    #[test]
    fn old_firmware_takes_rates_and_attitude_right_handed_about_down() {
        let packet = state_packet(Dialect::Betaflight46, &felt(0.2, 0.0, 0.0));
        assert_eq!([1, 2, 3].map(|i| field(&packet, i)), [0.1, 0.2, 0.3]);
        let q = [7, 8, 9, 10].map(|i| field(&packet, i));
        // Roll right about forward: cos 0.1, sin 0.1.
        assert!(
            (q[0] - 0.995_004).abs() < 1e-6 && (q[1] - 0.099_833).abs() < 1e-6,
            "{q:?}"
        );
        assert!(q[2].abs() < 1e-12 && q[3].abs() < 1e-12);
    }

    #[test]
    fn new_firmware_takes_yaw_rate_the_other_way_and_an_attitude_turned_by_90_degrees() {
        let packet = state_packet(Dialect::Betaflight2026, &felt(0.0, 0.0, 0.0));
        assert_eq!([1, 2, 3].map(|i| field(&packet, i)), [0.1, 0.2, -0.3]);
        let q = [7, 8, 9, 10].map(|i| field(&packet, i));
        // The reference: q body FLU to NWU is the identity; Rz(-90) q = (c, 0, 0, -s); y and z negated = (c, 0, 0, s).
        let half = core::f64::consts::FRAC_1_SQRT_2;
        assert!(
            (q[0] - half).abs() < 1e-12 && (q[3] - half).abs() < 1e-12,
            "{q:?}"
        );
        assert!(field(&packet, 15) > 90.0, "no GPS indoors");
    }

    #[test]
    fn the_stamp_never_moves_and_pressure_falls_12_pascals_a_metre() {
        let low = state_packet(Dialect::Betaflight46, &felt(0.0, 0.0, 0.0));
        let high = state_packet(
            Dialect::Betaflight46,
            &Felt {
                altitude_m: 2.0,
                ..felt(0.1, 0.2, 0.3)
            },
        );
        assert_eq!(low[..8], high[..8]);
        let fall = field(&low, 17) - field(&high, 17);
        assert!((11.9..12.1).contains(&fall), "{fall}");
    }

    #[test]
    fn motor_1_is_last_in_old_packets_and_first_in_new_ones() {
        let packet: Vec<u8> = [0.1f32, 0.2, 0.3, 0.4]
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        let near = |a: [f64; 4], b: [f64; 4]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(near(
            motors(Dialect::Betaflight46, &packet).unwrap(),
            [0.4, 0.1, 0.2, 0.3]
        ));
        assert!(near(
            motors(Dialect::Betaflight2026, &packet).unwrap(),
            [0.1, 0.2, 0.3, 0.4]
        ));
    }

    #[test]
    fn the_rc_packet_has_40_bytes_with_16_channels_after_the_stamp() {
        let mut channels = [1500; 16];
        channels[2] = 1000;
        let packet = rc_packet(&channels);
        assert_eq!(packet[12..14], 1000u16.to_le_bytes());
        assert_eq!(packet[38..], 1500u16.to_le_bytes());
    }

    proptest! {
        #[test]
        fn no_datagram_moves_a_motor_out_of_its_range(packet in proptest::collection::vec(any::<u8>(), 0..40)) {
            for dialect in [Dialect::Betaflight46, Dialect::Betaflight2026] {
                match motors(dialect, &packet) {
                    Ok(commands) => prop_assert!(packet.len() == MOTOR_LEN && commands.iter().all(|c| (0.0..=1.0).contains(c))),
                    Err(PacketError::Length(n)) => prop_assert!(n != MOTOR_LEN),
                    Err(PacketError::NotFinite(motor)) => prop_assert!((1..=4).contains(&motor)),
                }
            }
        }
    }
}
