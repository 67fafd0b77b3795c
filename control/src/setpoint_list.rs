//! uQuad's list of set points: 17 numbers a line, flown one after another.
//!
//! | Numbers | Meaning |
//! | --- | --- |
//! | 1-12 | wanted states: x y z, psi phi theta, vqx vqy vqz, wqx wqy wqz |
//! | 13 | path: 0 hover there, 1 straight there from the one before with the speed of vqx vqy vqz, 2 one circle through there |
//! | 14-17 | motor speeds relative to hover, rad/s |
//!
//! Reached after twenty counted samples in range; one outside takes one back. When one is reached the gains of the next are asked for, and the list goes
//! on when they are there. Entry 0 is not in the file: hover where the list begins; after the last entry it is flown again. uQuad's range of 4 m
//! (2 m in height) is one for GPS; [`Reach::default`] is for a room.

use crate::lqr::trim::Circle;
use crate::lqr::{Motion, Trim, TrimError};
use crate::proportional::STATES;
use crate::state_feedback::StateSetpoint;
use vehicle::UquadAirframe;

/// Numbers of a line.
const NUMBERS: usize = 17;
/// Samples in range that count as there.
const SAMPLES: u32 = 20;
/// Entries that are read.
pub const MAX_ENTRIES: usize = 1000;

/// How an entry is flown to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PathKind {
    /// The craft finds its way.
    Hover,
    /// Along a line at the entry's speed.
    Straight,
    /// Once around.
    Circle,
}

/// One entry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Wanted states.
    pub state: [f64; STATES],
    /// How.
    pub path: PathKind,
    /// Relative to hover, rad/s.
    pub offsets_radps: [f64; 4],
}

/// A line that is no entry.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ListError {
    /// Wrong size.
    #[error(
        "line {line}: {got} numbers, {NUMBERS} are needed (12 states, path type, 4 motor offsets)"
    )]
    Size {
        /// From 1.
        line: usize,
        /// How many.
        got: usize,
    },
    /// A word that is no finite number.
    #[error("line {line}, number {number}: `{word}` is not a number")]
    NotANumber {
        /// From 1.
        line: usize,
        /// From 1.
        number: usize,
        /// The word.
        word: String,
    },
    /// A path type that there is not.
    #[error("line {line}: path type {got}: 0 is hover, 1 straight, 2 circle")]
    Path {
        /// From 1.
        line: usize,
        /// The number.
        got: f64,
    },
    /// A straight line without speed.
    #[error("line {line}: a straight path needs a speed in vqx, vqy, vqz")]
    NoSpeed {
        /// From 1.
        line: usize,
    },
    /// No such circle.
    #[error("line {line}: {source}")]
    Circle {
        /// From 1.
        line: usize,
        /// Why.
        source: TrimError,
    },
    /// Nothing in it.
    #[error("the list is empty")]
    Empty,
    /// Too long.
    #[error("more than {MAX_ENTRIES} entries")]
    TooLong,
}

/// A list.
#[derive(Clone, Debug, PartialEq)]
pub struct SetpointList {
    entries: Vec<Entry>,
}

impl SetpointList {
    /// Reads a file; empty lines are nothing.
    ///
    /// # Errors
    /// The first line that is no entry.
    pub fn parse(text: &str, craft: &UquadAirframe) -> Result<Self, ListError> {
        let mut entries = Vec::new();
        for (index, text) in text.lines().enumerate() {
            if text.trim().is_empty() {
                continue;
            }
            if entries.len() == MAX_ENTRIES {
                return Err(ListError::TooLong);
            }
            entries.push(entry(index + 1, text, craft)?);
        }
        if entries.is_empty() {
            return Err(ListError::Empty);
        }
        Ok(Self { entries })
    }

    /// The entries of the file.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }
}

fn entry(line: usize, text: &str, craft: &UquadAirframe) -> Result<Entry, ListError> {
    let got = text.split_ascii_whitespace().count();
    if got != NUMBERS {
        return Err(ListError::Size { line, got });
    }
    let mut numbers = [0.0; NUMBERS];
    for (number, word) in text.split_ascii_whitespace().enumerate() {
        let value = word.parse().ok().filter(|v: &f64| v.is_finite());
        numbers[number] = value.ok_or_else(|| ListError::NotANumber {
            line,
            number: number + 1,
            word: word.chars().take(40).collect(),
        })?;
    }
    let mut state = [0.0; STATES];
    state.copy_from_slice(&numbers[..STATES]);
    let path = match numbers[12] {
        0.0 => PathKind::Hover,
        1.0 => PathKind::Straight,
        2.0 => PathKind::Circle,
        got => return Err(ListError::Path { line, got }),
    };
    let made = Entry {
        state,
        path,
        offsets_radps: [numbers[13], numbers[14], numbers[15], numbers[16]],
    };
    if path == PathKind::Straight && made.speed_mps() < 1e-3 {
        return Err(ListError::NoSpeed { line });
    }
    if path == PathKind::Circle {
        let motion = Motion::of(*craft);
        Trim::circle(&motion, &made.circle(), state[5])
            .map_err(|source| ListError::Circle { line, source })?;
    }
    Ok(made)
}

impl Entry {
    fn speed_mps(&self) -> f64 {
        let [vx, vy, vz] = [self.state[6], self.state[7], self.state[8]];
        libm::sqrt(vx * vx + vy * vy + vz * vz)
    }

    /// Places it passes: its own, and those of its circle.
    pub fn outline(&self) -> impl Iterator<Item = [f64; 3]> + use<> {
        let [x, y, z] = [self.state[0], self.state[1], self.state[2]];
        let (circle, theta) = (self.circle(), self.state[5]);
        let around = if self.path == PathKind::Circle { 72 } else { 1 };
        (0..around).map(move |i| {
            if i == 0 {
                return [x, y, z];
            }
            let turn = f64::from(i) * core::f64::consts::TAU / 72.0;
            let (cx, cy) = circle.centre_m(x, y, theta);
            let (s, c) = (libm::sin(turn), libm::cos(turn));
            let (rx, ry) = (x - cx, y - cy);
            [cx + c * rx - s * ry, cy + s * rx + c * ry, z]
        })
    }

    /// The circle of a circular entry.
    #[must_use]
    pub fn circle(&self) -> Circle {
        Circle {
            speed_mps: libm::hypot(self.state[6], self.state[7]),
            rate_radps: self.state[11],
            bearing_rad: libm::atan2(self.state[7], self.state[6]),
        }
    }
}

/// When an entry is reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// x and y, m.
    pub horizontal_m: f64,
    /// z, m.
    pub vertical_m: f64,
}

impl Reach {
    /// The program: for GPS.
    pub const UQUAD: Self = Self {
        horizontal_m: 4.0,
        vertical_m: 2.0,
    };
}

impl Default for Reach {
    /// A hand's length in a room.
    fn default() -> Self {
        Self {
            horizontal_m: 0.3,
            vertical_m: 0.3,
        }
    }
}

/// What the follower wants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wants {
    /// Track this.
    Fly(StateSetpoint),
    /// Track this, and make gains around the trim of the next entry; [`ListFollower::gains_made`] goes on.
    Gains(StateSetpoint, Trim),
}

/// Flies a list.
#[derive(Clone, Debug, PartialEq)]
pub struct ListFollower {
    list: SetpointList,
    craft: UquadAirframe,
    reach: Reach,
    home: [f64; STATES],
    /// 0 = entry 0, the hover where it began.
    index: usize,
    counted: u32,
    has_asked: bool,
    /// Time on the present path, s, and where it began.
    on_path_s: f64,
    from: [f64; 3],
    rounds: u32,
}

impl ListFollower {
    /// Begins with a hover at a state: entry 0. Positions of the file are relative to the origin of the state.
    #[must_use]
    pub fn new(
        list: SetpointList,
        craft: UquadAirframe,
        reach: Reach,
        home: [f64; STATES],
    ) -> Self {
        let mut hover = [0.0; STATES];
        hover[..3].copy_from_slice(&home[..3]);
        hover[5] = home[5];
        Self {
            list,
            craft,
            reach,
            from: [home[0], home[1], home[2]],
            home: hover,
            index: 0,
            counted: 0,
            has_asked: false,
            on_path_s: 0.0,
            rounds: 0,
        }
    }

    /// The entry that is flown; 0 = the hover where it began.
    #[must_use]
    pub const fn index(&self) -> usize {
        self.index
    }

    /// How often the whole list was flown.
    #[must_use]
    pub const fn rounds(&self) -> u32 {
        self.rounds
    }

    fn next_index(&self) -> usize {
        if self.index < self.list.entries.len() {
            self.index + 1
        } else {
            0
        }
    }

    fn entry(&self, index: usize) -> Option<&Entry> {
        self.list.entries.get(index.checked_sub(1)?)
    }

    fn goal(&self, index: usize) -> [f64; STATES] {
        self.entry(index).map_or(self.home, |e| e.state)
    }

    /// The gains that were asked for are in use: the next entry begins.
    pub fn gains_made(&mut self) {
        if !self.has_asked {
            return;
        }
        let here = self.goal(self.index);
        self.from = [here[0], here[1], here[2]];
        self.index = self.next_index();
        self.rounds += u32::from(self.index == 0);
        (self.counted, self.has_asked, self.on_path_s) = (0, false, 0.0);
    }

    /// One sample.
    pub fn step(&mut self, dt_s: f64, state: &[f64; STATES]) -> Wants {
        self.on_path_s += dt_s;
        let (setpoint, is_at_end) = self.setpoint();
        let goal = self.goal(self.index);
        let level = self.reach.horizontal_m;
        let is_there = is_at_end
            && (state[0] - goal[0]).abs() < level
            && (state[1] - goal[1]).abs() < level
            && (state[2] - goal[2]).abs() < self.reach.vertical_m;
        self.counted = if is_there {
            self.counted + 1
        } else {
            self.counted.saturating_sub(1)
        };
        if self.counted >= SAMPLES && !self.has_asked {
            self.has_asked = true;
            return Wants::Gains(setpoint, self.trim(self.next_index()));
        }
        Wants::Fly(setpoint)
    }

    /// What gains of an entry are made around.
    fn trim(&self, index: usize) -> Trim {
        let theta = self.goal(index)[5];
        let hover = Trim::hover(&self.craft, theta);
        match self.entry(index) {
            Some(e) if e.path == PathKind::Straight => {
                Trim::straight(&self.craft, [e.state[6], e.state[7], e.state[8]], theta)
            }
            Some(e) if e.path == PathKind::Circle => {
                let motion = Motion::of(self.craft);
                // It was found when the list was read.
                Trim::circle(&motion, &e.circle(), theta).unwrap_or(hover)
            }
            _ => hover,
        }
    }

    /// The moving set point, and whether its path is at its end.
    fn setpoint(&self) -> (StateSetpoint, bool) {
        let hover_radps = self.craft.hover_speed_radps();
        let Some(entry) = self.entry(self.index) else {
            let setpoint = StateSetpoint {
                state: self.home,
                speeds_radps: [hover_radps; 4],
            };
            return (setpoint, true);
        };
        let speeds_radps = entry.offsets_radps.map(|w| hover_radps + w);
        let mut state = entry.state;
        match entry.path {
            PathKind::Hover => {
                state[6..].fill(0.0);
                let setpoint = StateSetpoint {
                    state,
                    speeds_radps,
                };
                (setpoint, true)
            }
            PathKind::Straight => {
                let to = [state[0], state[1], state[2]];
                let off: [f64; 3] = core::array::from_fn(|i| to[i] - self.from[i]);
                let far_m = libm::sqrt(off.iter().map(|d| d * d).sum());
                let gone_m = self.on_path_s * entry.speed_mps();
                let is_at_end = gone_m >= far_m;
                let share = if is_at_end { 1.0 } else { gone_m / far_m };
                for i in 0..3 {
                    state[i] = self.from[i] + off[i] * share;
                }
                if is_at_end {
                    state[6..9].fill(0.0);
                }
                let setpoint = StateSetpoint {
                    state,
                    speeds_radps,
                };
                (setpoint, is_at_end)
            }
            PathKind::Circle => self.on_circle(entry),
        }
    }

    fn on_circle(&self, entry: &Entry) -> (StateSetpoint, bool) {
        let circle = entry.circle();
        let turned = circle.rate_radps * self.on_path_s;
        let is_round = turned.abs() >= 2.0 * core::f64::consts::PI;
        let theta0 = entry.state[5];
        let hover_radps = self.craft.hover_speed_radps();
        if is_round {
            let mut state = [0.0; STATES];
            state[..3].copy_from_slice(&entry.state[..3]);
            state[5] = theta0;
            let setpoint = StateSetpoint {
                state,
                speeds_radps: [hover_radps; 4],
            };
            return (setpoint, true);
        }
        let theta = theta0 + turned;
        let trim = Trim::circle(&Motion::of(self.craft), &circle, theta)
            .unwrap_or_else(|_| Trim::hover(&self.craft, theta));
        let (cx, cy) = circle.centre_m(entry.state[0], entry.state[1], theta0);
        let (s, c) = (libm::sin(turned), libm::cos(turned));
        let (rx, ry) = (entry.state[0] - cx, entry.state[1] - cy);
        let mut state: [f64; STATES] = trim.state.into();
        state[0] = cx + c * rx - s * ry;
        state[1] = cy + s * rx + c * ry;
        state[2] = entry.state[2];
        let inputs: [f64; 4] = trim.inputs.into();
        let setpoint = StateSetpoint {
            state,
            speeds_radps: core::array::from_fn(|m| inputs[m] + entry.offsets_radps[m]),
        };
        (setpoint, false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = "1.0 2.0 1.5 0 0 0.3 0 0 0 0 0 0 0 0 0 0 0";

    fn parse(text: &str) -> Result<SetpointList, ListError> {
        SetpointList::parse(text, &UquadAirframe::default())
    }

    #[test]
    fn lines_that_are_no_entries_are_named() {
        let said = |text: &str| parse(text).unwrap_err().to_string();
        assert_eq!(
            said("1 2 3"),
            "line 1: 3 numbers, 17 are needed (12 states, path type, 4 motor offsets)"
        );
        let second = format!("{LINE}\n{}", LINE.replacen("1.0", "inf", 1));
        assert_eq!(said(&second), "line 2, number 1: `inf` is not a number");
        let path = LINE.replacen("0 0 0 0 0 0 0 0 0 0 0", "0 0 0 0 0 0 3 0 0 0 0", 1);
        assert_eq!(
            said(&path),
            "line 1: path type 3: 0 is hover, 1 straight, 2 circle"
        );
        let circle = LINE.replacen("0 0 0 0 0 0 0 0 0 0 0", "0 0 0 0 0 0 2 0 0 0 0", 1);
        assert!(
            said(&circle).contains("a circle at 0 m/s"),
            "{}",
            said(&circle)
        );
        assert_eq!(said("\n\n"), "the list is empty");
    }

    fn follower(text: &str) -> ListFollower {
        let list = parse(text).unwrap();
        ListFollower::new(list, UquadAirframe::default(), Reach::default(), [0.0; 12])
    }

    #[test]
    fn twenty_counted_samples_and_new_gains_before_the_next_entry_and_back_to_the_first() {
        let mut f = follower(LINE);
        let there = |f: &mut ListFollower, at: [f64; 12], n: u32| {
            (0..n)
                .filter(|_| matches!(f.step(0.01, &at), Wants::Gains(..)))
                .count()
        };
        assert_eq!(there(&mut f, [0.0; 12], 19), 0);
        // One outside takes one back.
        let mut outside = [0.0; 12];
        outside[0] = 0.31;
        assert_eq!(there(&mut f, outside, 1), 0);
        assert_eq!(there(&mut f, [0.0; 12], 1), 0);
        assert_eq!(there(&mut f, [0.0; 12], 1), 1, "asks once");
        assert_eq!(there(&mut f, [0.0; 12], 50), 0);
        assert_eq!(f.index(), 0, "until the gains are there");
        f.gains_made();
        assert_eq!(f.index(), 1);
        let mut goal = [0.0; 12];
        goal[..3].copy_from_slice(&[1.0, 2.0, 1.5]);
        assert_eq!(there(&mut f, goal, 20), 1);
        f.gains_made();
        assert_eq!((f.index(), f.rounds()), (0, 1), "after the last, the first");
    }

    #[test]
    fn a_straight_path_moves_at_its_speed_and_a_circle_comes_round() {
        let straight = "2 0 0 0 0 0 0.5 0 0 0 0 0 1 0 0 0 0\n2 0 0 0 0 0 0.5 0 0 0 0 0.5 2 0 0 0 0";
        let mut f = follower(straight);
        let at = |f: &ListFollower| f.setpoint().0.state;
        for _ in 0..20 {
            f.step(0.01, &[0.0; 12]);
        }
        f.gains_made();
        for _ in 0..200 {
            f.step(0.01, &[9.0; 12]);
        }
        assert!((at(&f)[0] - 1.0).abs() < 1e-9 && (at(&f)[6] - 0.5).abs() < 1e-12);
        let mut there = [0.0; 12];
        there[0] = 2.0;
        for _ in 0..300 {
            f.step(0.01, &there);
        }
        f.gains_made();
        assert_eq!(f.index(), 2);
        // A quarter of a turn to the left with radius 1.
        for _ in 0..314 {
            f.step(0.01, &[9.0; 12]);
        }
        let p = at(&f);
        assert!(
            (p[0] - 3.0).abs() < 0.01 && (p[1] - 1.0).abs() < 0.01,
            "{p:?}"
        );
        assert!((p[5] - 1.57).abs() < 0.01);
    }
}
