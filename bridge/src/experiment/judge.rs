//! How a flight ended, by the simulator's truth.

use super::plan::{Case, Fault};
use crate::autopilot::door::Snapshot;
use crate::autopilot::failsafes::TABLE;
use crate::autopilot::mode::Because;
use crate::io::truth::Row;
use std::fmt;
use vehicle::{In, Ned};

/// Touching something more slowly is a nudge, m/s.
const NUDGE_MPS: f64 = 0.3;
/// Higher is no longer indoors, m.
const TOO_HIGH_M: f64 = 2.6;
/// Faster is out of control, m/s.
const TOO_FAST_MPS: f64 = 3.0;
/// A body this near the floor stands on it, m.
const ON_FLOOR_M: f64 = 0.12;
/// Speed is measured over this many looks.
const LOOKS: usize = 4;

/// What was wrong with a flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// It did not take off.
    NeverFlew,
    /// It touched something at this speed, m/s, where a safe way exists.
    Contact(f64),
    /// It left the room, climbed, raced, or was not down in time.
    Flyaway(&'static str),
    /// Nobody was told.
    Silent,
    /// None of the rows acted that should have.
    WrongMode(Because),
}

impl fmt::Display for Trouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NeverFlew => write!(f, "never flew"),
            Self::Contact(mps) => write!(f, "contact at {mps:.2} m/s"),
            Self::Flyaway(how) => write!(f, "flyaway: {how}"),
            Self::Silent => write!(f, "nobody was told"),
            Self::WrongMode(because) => write!(f, "ended by `{}`", because.words()),
        }
    }
}

/// How a flight ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// What was wrong.
    pub troubles: Vec<Trouble>,
    /// Fastest contact, m/s; none without any.
    pub contact_mps: Option<f64>,
    /// Reasons that the mode had.
    pub because: Vec<Because>,
    /// Rows of the table that acted or told.
    pub rows: Vec<Because>,
    /// What the pilot was told after the fault.
    pub texts: Vec<String>,
    /// Length of the flight, s.
    pub duration_s: f64,
}

impl Outcome {
    /// Nothing was wrong.
    #[must_use]
    pub const fn is_good(&self) -> bool {
        self.troubles.is_empty()
    }
}

/// Watches a flight.
#[derive(Clone, Debug, Default)]
pub(super) struct Judge {
    last: Option<Row>,
    trail: std::collections::VecDeque<[f64; 4]>,
    speed_mps: f64,
    contact_mps: Option<f64>,
    in_contact: bool,
    flyaway: Option<&'static str>,
    because: Vec<Because>,
    texts_before: usize,
}

impl Judge {
    pub(super) fn look(&mut self, row: &Row, s: &Snapshot) {
        let [x, y, z] = row.position;
        self.trail.push_back([row.t_s, x, y, z]);
        if self.trail.len() > LOOKS {
            self.trail.pop_front();
        }
        let horizontal = |a: &[f64; 4]| (x - a[1]).hypot(y - a[2]) / (row.t_s - a[0]).max(1e-3);
        // The speed it came with, from before the wall took it away.
        let speed_before = self.speed_mps;
        if let Some(first) = self.trail.front().filter(|_| self.trail.len() == LOOKS) {
            self.speed_mps = horizontal(first);
        }
        let is_flying = -z > ON_FLOOR_M;
        if row.contact && !self.in_contact && is_flying {
            let mps = self.speed_mps.max(speed_before);
            self.contact_mps = Some(self.contact_mps.unwrap_or(0.0).max(mps));
        }
        self.in_contact = row.contact;
        if -z > TOO_HIGH_M {
            self.flyaway.get_or_insert("too high");
        }
        if self.speed_mps > TOO_FAST_MPS {
            self.flyaway.get_or_insert("too fast");
        }
        if !self.because.contains(&s.mode.because) {
            self.because.push(s.mode.because);
        }
        self.last = Some(*row);
    }

    /// Where it truly is, NED about home, m.
    pub(super) fn place(&self) -> In<Ned> {
        let [x, y, z] = self.last.map_or([0.0; 3], |row| row.position);
        In::new(x, y, z)
    }

    pub(super) fn height_m(&self) -> f64 {
        self.last.map_or(0.0, |row| -row.position[2])
    }

    pub(super) fn is_on_floor(&self) -> bool {
        self.height_m() < ON_FLOOR_M
    }

    /// From now on somebody must be told.
    pub(super) const fn fault_comes(&mut self, texts: usize) {
        self.texts_before = texts;
    }

    /// A step of the place that is no motion.
    pub(super) fn was_carried(&mut self) {
        self.trail.clear();
        self.speed_mps = 0.0;
    }

    pub(super) fn never_flew(self) -> Outcome {
        Outcome {
            troubles: vec![Trouble::NeverFlew],
            contact_mps: None,
            because: self.because,
            rows: Vec::new(),
            texts: Vec::new(),
            duration_s: self.last.map_or(0.0, |row| row.t_s),
        }
    }

    pub(super) fn verdict(
        self,
        case: &Case,
        is_down: bool,
        s: &Snapshot,
        texts: &[String],
    ) -> Outcome {
        let mut troubles = Vec::new();
        if let Some(mps) = self.contact_mps
            && case.has_safe_way()
            && mps > NUDGE_MPS
        {
            troubles.push(Trouble::Contact(mps));
        }
        // Without a controller nobody here can tell when it is down; the truth can.
        let is_blind = case
            .faults()
            .any(|f| matches!(f, Fault::FcSilent | Fault::FcNoisy));
        let tumbles = case.faults().any(|f| f == Fault::MotorDead);
        if let Some(how) = self.flyaway.filter(|_| !tumbles) {
            troubles.push(Trouble::Flyaway(how));
        } else if !(is_down || is_blind && self.is_on_floor()) {
            troubles.push(Trouble::Flyaway("not down in time"));
        }
        let told = &texts[self.texts_before.min(texts.len())..];
        let texts = told.join("; ");
        let mut seen: Vec<Because> = TABLE
            .iter()
            .map(|row| row.because)
            .filter(|b| self.because.contains(b) || texts.contains(b.words()))
            .collect();
        seen.dedup();
        let rows: Vec<&Because> = case.faults().flat_map(|f| f.facts().rows).collect();
        if !rows.is_empty() {
            let acted = rows.iter().any(|b| self.because.contains(b));
            let is_told = rows.iter().any(|b| texts.contains(b.words()));
            let was_down = self.because.iter().any(|b| b.is_failsafe());
            if !is_told && !acted && !was_down {
                troubles.push(Trouble::Silent);
            } else if !acted && !is_told {
                troubles.push(Trouble::WrongMode(s.mode.because));
            }
        }
        Outcome {
            troubles,
            contact_mps: self.contact_mps,
            because: self.because,
            rows: seen,
            texts: told.to_vec(),
            duration_s: self.last.map_or(0.0, |row| row.t_s),
        }
    }
}
