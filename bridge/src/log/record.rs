//! What is recorded of a flight, as it happens.

use crate::autopilot::door::{Answer, Event, Severity, Snapshot};
use crate::autopilot::io::{FcBytes, Input, Output};
use crate::gcs::LinkId;
use mavlink_dialect::FrameBytes;
use postcard::ser_flavors::Flavor;
use serde::{Deserialize, Serialize};
use vehicle::Timestamp;

/// A record of the flight thread: small, made without allocating.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum FlightRecord {
    /// Went into `Flight`.
    Input {
        /// When.
        at: Timestamp,
        /// What.
        input: Input,
    },
    /// Came out of it.
    Output {
        /// When.
        at: Timestamp,
        /// What.
        output: Emitted,
    },
    /// It ticked: digests of its state, in the order of [`Part::ALL`].
    Tick {
        /// When.
        at: Timestamp,
        /// One for each part.
        digests: [u64; Part::ALL.len()],
    },
    /// Records are missing here: the ring was full.
    Lost {
        /// How many.
        records: u64,
    },
}

/// An output as it is recorded: a search request is told by its number, the rest whole.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Emitted {
    /// Bytes to the flight controller.
    Fc(FcBytes),
    /// What became of a request.
    Answer(Answer),
    /// Something happened.
    Event(Event),
    /// A search was asked for.
    Job {
        /// Its number.
        id: u32,
        /// Readings it goes by.
        readings: u32,
    },
}

impl From<&Output> for Emitted {
    fn from(output: &Output) -> Self {
        match output {
            Output::Fc(bytes) => Self::Fc(bytes.clone()),
            Output::Answer(answer) => Self::Answer(*answer),
            Output::Event(event) => Self::Event(event.clone()),
            Output::Job(job) => Self::Job {
                id: job.id,
                readings: job.readings.len() as u32,
            },
        }
    }
}

impl Emitted {
    /// What it is, for people.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Fc(_) => "bytes to the flight controller",
            Self::Answer(_) => "an answer",
            Self::Event(_) => "an event",
            Self::Job { .. } => "a search request",
        }
    }
}

/// A part of the vehicle's state with a digest of its own, so that a difference has a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The estimate.
    Estimate,
    /// Mode, arming, landed state, mission, home.
    Mode,
    /// Set point and what control asks for.
    Control,
    /// Sticks and RC channels.
    Sticks,
    /// Samples of sensors and battery.
    Sensors,
    /// Link to the flight controller and timing.
    Link,
}

impl Part {
    /// All, in the order of the digests.
    pub const ALL: [Self; 6] = [
        Self::Estimate,
        Self::Mode,
        Self::Control,
        Self::Sticks,
        Self::Sensors,
        Self::Link,
    ];

    /// For people.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Estimate => "estimate",
            Self::Mode => "mode",
            Self::Control => "control",
            Self::Sticks => "sticks",
            Self::Sensors => "sensors",
            Self::Link => "link",
        }
    }

    /// Digest of this part: FNV-1a of its postcard encoding, so that one bit of one number shows.
    #[must_use]
    pub fn digest(self, s: &Snapshot) -> u64 {
        match self {
            Self::Estimate => digest(&s.nav),
            Self::Mode => digest(&(
                s.mode,
                s.is_armed,
                s.landed,
                s.is_key_mode,
                s.arm_blocked_by,
                s.mission,
                s.home,
                s.home_yaw_rad,
            )),
            Self::Control => digest(&(
                s.setpoint,
                s.attitude_target,
                s.velocity_target,
                s.thrust_target,
            )),
            Self::Sticks => digest(&(s.sticks, &s.rc_us)),
            Self::Sensors => digest(&(
                s.battery,
                s.imu,
                s.baro,
                s.down_range,
                s.flow,
                &s.scan,
                s.rangers_alive,
            )),
            Self::Link => digest(&(s.at, s.fc, s.flight_loop)),
        }
    }

    /// Digests of all parts.
    #[must_use]
    pub fn digests(s: &Snapshot) -> [u64; Self::ALL.len()] {
        Self::ALL.map(|part| part.digest(s))
    }
}

/// FNV-1a, 64 bit, fed by a serializer.
struct Fnv(u64);

impl Flavor for Fnv {
    type Output = u64;

    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3);
        Ok(())
    }

    fn finalize(self) -> postcard::Result<u64> {
        Ok(self.0)
    }
}

fn digest<T: Serialize>(value: &T) -> u64 {
    // Neither the flavor nor our types can fail; a zero would show as a difference.
    postcard::serialize_with_flavor(value, Fnv(0xCBF2_9CE4_8422_2325)).unwrap_or(0)
}

/// A record of the ground side.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "lies in a ring made at the start; a box for each frame costs more"
)]
pub enum GroundRecord {
    /// The vehicle as it is now.
    Snapshot(Box<Snapshot>),
    /// Told to the pilots.
    Text {
        /// When.
        at: Timestamp,
        /// How loud.
        severity: Severity,
        /// What.
        text: String,
    },
    /// Bytes of a link; of a datagram a frame never continues in the next one.
    Received {
        /// When.
        at: Timestamp,
        /// Which.
        link: LinkId,
        /// What.
        bytes: Vec<u8>,
        /// One datagram.
        is_datagram: bool,
    },
    /// A frame went out.
    Sent {
        /// When.
        at: Timestamp,
        /// On which link.
        link: LinkId,
        /// The frame.
        frame: FrameBytes,
    },
    /// Records are missing here.
    Lost {
        /// How many.
        records: u64,
    },
}

/// Takes records. The loop that calls it is never held up by what it does.
pub trait LogSink: Send {
    /// Of the flight thread.
    fn flight(&mut self, record: FlightRecord);
    /// Of the ground side.
    fn ground(&mut self, record: GroundRecord);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_bit_of_one_number_changes_the_digest_of_its_part_only() {
        let a = Snapshot::default();
        let mut b = a.clone();
        b.nav.height_m = f64::from_bits(1);
        let (x, y) = (Part::digests(&a), Part::digests(&b));
        let differs: Vec<Part> = Part::ALL
            .into_iter()
            .zip(x.iter().zip(&y))
            .filter(|(_, (x, y))| x != y)
            .map(|(part, _)| part)
            .collect();
        assert_eq!(differs, [Part::Estimate]);
    }

    #[test]
    fn records_survive_their_encoding() {
        let records = [
            FlightRecord::Input {
                at: Timestamp::from_ms(1),
                input: Input::FcOpened,
            },
            FlightRecord::Output {
                at: Timestamp::from_ms(2),
                output: Emitted::Fc([1, 2, 3].into_iter().collect()),
            },
            FlightRecord::Tick {
                at: Timestamp::from_ms(3),
                digests: [u64::MAX; 6],
            },
            FlightRecord::Lost { records: 7 },
        ];
        let bytes: Vec<u8> = records
            .iter()
            .flat_map(|r| postcard::to_allocvec(r).unwrap())
            .collect();
        let mut rest = bytes.as_slice();
        for record in &records {
            let (back, after) = postcard::take_from_bytes::<FlightRecord>(rest).unwrap();
            assert_eq!(&back, record);
            rest = after;
        }
        assert!(rest.is_empty());
    }
}
