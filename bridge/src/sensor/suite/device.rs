//! What the shell opens, and who understands its bytes.

use crate::sensor::Sample;
use crate::sensor::gps::fake::Fake;
use crate::sensor::hc_sr04;
use crate::sensor::ld06::Ld06;
use crate::sensor::msp_module::MspModule;
use crate::sensor::rplidar::Rplidar;
use crate::sensor::tof_ring::TofRing;
use estimator::utm::SouthernOffset;
use vehicle::{RangerReading, Timestamp};

/// A driver of a serial line.
#[derive(Clone, Debug)]
pub enum SerialDriver {
    /// LD06 class.
    Ld06(Ld06),
    /// RPLIDAR class.
    Rplidar(Rplidar),
    /// Time-of-flight ring.
    TofRing(TofRing),
    /// MSP module.
    Msp(MspModule),
}

impl SerialDriver {
    /// The line was opened (again).
    pub fn opened(&mut self, now: Timestamp) {
        if let Self::Rplidar(lidar) = self {
            lidar.opened(now);
        }
    }

    /// What is to be said now, if anything; call every some 10 ms.
    pub fn poll(&mut self, now: Timestamp) -> Option<[u8; 2]> {
        match self {
            Self::Rplidar(lidar) => lidar.poll(now),
            Self::Ld06(_) | Self::TofRing(_) | Self::Msp(_) => None,
        }
    }

    /// Takes bytes that were read at a time; tells what is to be said in answer.
    pub fn bytes(
        &mut self,
        at: Timestamp,
        bytes: &[u8],
        out: &mut impl FnMut(Sample),
    ) -> Option<[u8; 2]> {
        let mut ranger = |r: RangerReading| out(Sample::Ranger(r));
        match self {
            Self::Ld06(lidar) => lidar.bytes(at, bytes, &mut ranger),
            Self::Rplidar(lidar) => return lidar.bytes(at, bytes, &mut ranger),
            Self::TofRing(ring) => ring.bytes(at, bytes, &mut ranger),
            Self::Msp(module) => module.bytes(at, bytes, out),
        }
        None
    }

    /// Its motor runs while DTR is low.
    #[must_use]
    pub const fn needs_dtr_low(&self) -> bool {
        matches!(self, Self::Rplidar(_))
    }
}

/// A device to open.
#[derive(Clone, Debug)]
pub enum Device {
    /// On a serial line.
    Serial {
        /// Device file.
        path: String,
        /// Baud.
        baud: u32,
        /// Who understands it.
        driver: SerialDriver,
    },
    /// Ultrasonic rangers on GPIO lines.
    Gpio {
        /// Chip, like `/dev/gpiochip0`.
        chip: String,
        /// Trigger and echo line of each sensor.
        pins: Vec<[u32; 2]>,
        /// Who fires when.
        ring: hc_sr04::Ring,
    },
    /// gpsd.
    Gpsd {
        /// host:port.
        address: String,
        /// Of southern northings.
        south: SouthernOffset,
    },
    /// A GPS log; the shell reads it.
    GpsLog {
        /// File.
        path: String,
    },
    /// Invented fixes.
    GpsFake(Fake),
}

/// A device with its name.
#[derive(Clone, Debug)]
pub struct Named {
    /// As it was written.
    pub name: String,
    /// What to open.
    pub device: Device,
}
