//! A flight flown again: recorded inputs go through the stack, what comes out is compared with what came out then, bit for bit.

use super::header::{Header, HeaderError};
use super::reader::{LogFile, ReadError};
use super::record::{Emitted, FlightRecord, Part};
use crate::autopilot::door::Snapshot;
use crate::autopilot::flight::{Flight, FlightConfig};
use crate::settings::{Origin, SettingsError};
use std::collections::VecDeque;
use std::fmt;
use vehicle::Timestamp;

/// Why a log cannot be flown again.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReplayError {
    /// Its header.
    #[error(transparent)]
    Header(#[from] HeaderError),
    /// Its stream.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A parameter of `--set`.
    #[error(transparent)]
    Setting(#[from] SettingsError),
    /// It does not begin at the beginning.
    #[error("this is part {0} of a log: replay its first part, the others follow by themselves")]
    NotFirst(String),
}

/// The first thing that came out otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// When.
    pub at: Timestamp,
    /// Tick it belongs to.
    pub tick: u64,
    /// What it is: `estimate`, `bytes to the flight controller` ...
    pub what: String,
    /// As recorded, as far as the log tells.
    pub recorded: String,
    /// As it came out now.
    pub replayed: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} differs at {:.6} s (tick {}): recorded {}, replayed {}",
            self.what,
            self.at.s(),
            self.tick,
            self.recorded,
            self.replayed
        )
    }
}

/// How a replay went.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Inputs fed.
    pub inputs: u64,
    /// Outputs compared.
    pub outputs: u64,
    /// Ticks compared.
    pub ticks: u64,
    /// Ticks whose state was another one.
    pub differing_ticks: u64,
    /// Time of the last input.
    pub end: Timestamp,
    /// The first difference, none if all was the same.
    pub difference: Option<Difference>,
    /// Records missing in the log; from the first on nothing can be compared.
    pub lost: u64,
}

impl Report {
    /// Everything that was recorded came out again.
    #[must_use]
    pub const fn is_same(&self) -> bool {
        self.difference.is_none() && self.lost == 0
    }
}

/// What comes out of a replay while it runs.
#[derive(Debug)]
pub enum Seen<'a> {
    /// An output.
    Output(&'a Emitted),
    /// It ticked.
    Tick(&'a Snapshot),
}

/// A recorded flight being flown again.
pub struct Replay {
    flight: Flight,
    records: std::vec::IntoIter<FlightRecord>,
    /// What came out since the last input and was not compared yet.
    produced: VecDeque<Produced>,
    compares: bool,
    report: Report,
}

#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "a few at a time, for as long as a tick"
)]
enum Produced {
    Output(Emitted),
    Tick([u64; Part::ALL.len()]),
}

impl Replay {
    /// From a log and the parts that follow it, with some parameters set otherwise.
    ///
    /// # Errors
    /// [`ReplayError`].
    pub fn new(parts: &[LogFile], sets: &[(&str, &str)]) -> Result<Self, ReplayError> {
        let first = parts
            .first()
            .ok_or_else(|| HeaderError::Unreadable("no file".to_owned()))?;
        let part = first.metadata.get("kestrel").and_then(|m| m.get("part"));
        if let Some(part) = part.filter(|p| *p != "1") {
            return Err(ReplayError::NotFirst(part.clone()));
        }
        let header = first.header.as_ref().map_err(Clone::clone)?;
        let mut records = Vec::new();
        for part in parts {
            records.extend(part.stream()?);
        }
        Self::of(header, records, sets)
    }

    /// From a header and its stream.
    ///
    /// # Errors
    /// [`ReplayError`].
    pub fn of(
        header: &Header,
        records: Vec<FlightRecord>,
        sets: &[(&str, &str)],
    ) -> Result<Self, ReplayError> {
        let mut config: FlightConfig = header.config()?;
        for (name, value) in sets {
            config.settings.set_text(name, value, Origin::CommandLine)?;
        }
        Ok(Self {
            flight: Flight::new(header.at, config),
            records: records.into_iter(),
            produced: VecDeque::new(),
            compares: true,
            report: Report::default(),
        })
    }

    /// How it went so far.
    #[must_use]
    pub const fn report(&self) -> &Report {
        &self.report
    }

    /// The vehicle as it is now.
    #[must_use]
    pub const fn flight(&self) -> &Flight {
        &self.flight
    }

    /// Time of the next input; none at the end.
    #[must_use]
    pub fn next_at(&self) -> Option<Timestamp> {
        self.records.as_slice().iter().find_map(|r| match r {
            FlightRecord::Input { at, .. } => Some(*at),
            _ => None,
        })
    }

    /// Takes the next record; false at the end.
    pub fn step(&mut self, mut see: impl FnMut(Seen<'_>)) -> bool {
        let Some(record) = self.records.next() else {
            // A torn log may end between an input and its outputs: what came out last is then nobody's fault.
            return false;
        };
        match record {
            FlightRecord::Input { at, input } => {
                self.nothing_is_left(at);
                self.report.inputs += 1;
                self.report.end = at;
                let ticks = self.flight.snapshot().flight_loop.ticks;
                self.flight.handle(at, input);
                while let Some(output) = self.flight.poll() {
                    let emitted = Emitted::from(&output);
                    see(Seen::Output(&emitted));
                    self.produced.push_back(Produced::Output(emitted));
                }
                let snapshot = self.flight.snapshot();
                if snapshot.flight_loop.ticks != ticks {
                    self.produced
                        .push_back(Produced::Tick(Part::digests(snapshot)));
                    see(Seen::Tick(snapshot));
                }
            }
            FlightRecord::Output { at, output } => self.compare_output(at, &output),
            FlightRecord::Tick { at, digests } => self.compare_tick(at, &digests),
            FlightRecord::Lost { records } => {
                self.report.lost += records;
                self.compares = false;
                self.produced.clear();
            }
        }
        true
    }

    /// To the end.
    pub fn run(mut self) -> Report {
        while self.step(|_| {}) {}
        self.report
    }

    fn compare_output(&mut self, at: Timestamp, recorded: &Emitted) {
        if !self.compares {
            return;
        }
        self.report.outputs += 1;
        let produced = self.produced.pop_front();
        let same = matches!(&produced, Some(Produced::Output(now)) if is_same(now, recorded));
        if !same {
            let replayed = match produced {
                Some(Produced::Output(now)) => format!("{now:?}"),
                Some(Produced::Tick(_)) | None => "nothing".to_owned(),
            };
            self.differs(at, recorded.name(), format!("{recorded:?}"), replayed);
        }
    }

    fn compare_tick(&mut self, at: Timestamp, recorded: &[u64; Part::ALL.len()]) {
        if self.report.lost > 0 {
            return;
        }
        self.report.ticks += 1;
        // Once something differed, ticks are still counted: how far apart two flights are is worth knowing.
        let Some(Produced::Tick(now)) = self.produced.pop_back() else {
            self.report.differing_ticks += 1;
            self.differs(at, "a tick", "one".to_owned(), "none".to_owned());
            return;
        };
        if let Some(Produced::Output(extra)) = self.produced.front() {
            let extra = format!("{extra:?}");
            self.differs(at, "an output", "none".to_owned(), extra);
        }
        let other = Part::ALL
            .into_iter()
            .zip(now.iter().zip(recorded))
            .find(|(_, (now, then))| now != then);
        if let Some((part, (now, then))) = other {
            self.report.differing_ticks += 1;
            self.differs(
                at,
                part.name(),
                format!("digest {then:016x}"),
                format!("digest {now:016x}"),
            );
        }
        self.produced.clear();
    }

    /// Before the next input everything that came out must have been compared.
    fn nothing_is_left(&mut self, at: Timestamp) {
        if let Some(left) = self.produced.pop_front() {
            let what = match left {
                Produced::Output(extra) => format!("{extra:?}"),
                Produced::Tick(_) => "a tick".to_owned(),
            };
            self.differs(at, "an output", "none".to_owned(), what);
            self.produced.clear();
        }
    }

    fn differs(&mut self, at: Timestamp, what: &str, recorded: String, replayed: String) {
        if self.compares {
            self.compares = false;
            self.report.difference = Some(Difference {
                at,
                tick: self.flight.snapshot().flight_loop.ticks,
                what: what.to_owned(),
                recorded,
                replayed,
            });
        }
    }
}

/// Bit for bit, so that NaN is NaN and 0 is not -0.
fn is_same(a: &Emitted, b: &Emitted) -> bool {
    match (postcard::to_allocvec(a), postcard::to_allocvec(b)) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}
