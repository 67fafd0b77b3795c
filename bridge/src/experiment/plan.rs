//! What is flown: a campaign, and the case that each of its seeds is.

use crate::autopilot::mode::Because;
use serde::Deserialize;

/// A campaign, as its TOML file says.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Campaign {
    /// Bundled rooms.
    pub rooms: Vec<String>,
    /// Modes flown when the fault comes.
    pub modes: Vec<FlownMode>,
    /// Faults.
    pub faults: Vec<Fault>,
    /// Flights.
    pub seeds: u64,
    /// Parameters of the vehicle.
    pub params: std::collections::BTreeMap<String, toml::Value>,
}

impl Default for Campaign {
    fn default() -> Self {
        Self {
            rooms: sim::Room::BUNDLED.map(str::to_owned).to_vec(),
            modes: FlownMode::ALL.to_vec(),
            faults: Fault::ALL.to_vec(),
            seeds: 100,
            params: std::collections::BTreeMap::new(),
        }
    }
}

/// Why a campaign cannot be flown.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CampaignError {
    /// Not TOML, or a key, mode or fault is not known.
    #[error("{0}")]
    Toml(String),
    /// A list is empty, or no fault goes with any of the modes.
    #[error("{0}")]
    Empty(&'static str),
}

/// A mode as the script flies it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FlownMode {
    /// Hover.
    Hold,
    /// Velocity sticks.
    Position,
    /// A plan through the rooms.
    Mission,
    /// A stream of velocities.
    Offboard,
}

impl FlownMode {
    /// All.
    pub const ALL: [Self; 4] = [Self::Hold, Self::Position, Self::Mission, Self::Offboard];

    /// Its name in files and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Hold => "hold",
            Self::Position => "position",
            Self::Mission => "mission",
            Self::Offboard => "offboard",
        }
    }
}

/// A fault of the generator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "the table below says what each is")]
pub enum Fault {
    None,
    GroundSilent,
    SticksStop,
    StreamStops,
    FcSilent,
    FcNoisy,
    FcSlow,
    FcLossy,
    AttitudeAskew,
    LoopHeld,
    LoopSlow,
    RangersSilent,
    OneRangerSilent,
    RangerStuck,
    FlowSilent,
    DownSilent,
    MotorDead,
    BatteryLow,
    BatteryCritical,
    BatterySags,
    BatteryReserve,
    WayBlocked,
    SearchFails,
    PlaceJumps,
    Kidnapped,
    Hot,
    DiskFull,
    ClockJump,
    Throttled,
    Overload,
    CtrlC,
    Stop,
}

/// What is known of a fault before it is flown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaultFacts {
    /// Its name in files and reports.
    pub name: &'static str,
    /// There is a way to end without touching anything.
    pub has_safe_way: bool,
    /// Rows of which one must act or tell; none: nothing need happen.
    pub rows: &'static [Because],
    /// Modes it can happen in; none: all.
    pub modes: &'static [FlownMode],
    /// Its row needs so long that a second fault would come before it.
    pub is_alone: bool,
}

impl Fault {
    /// All.
    pub const ALL: [Self; 32] = [
        Self::None,
        Self::GroundSilent,
        Self::SticksStop,
        Self::StreamStops,
        Self::FcSilent,
        Self::FcNoisy,
        Self::FcSlow,
        Self::FcLossy,
        Self::AttitudeAskew,
        Self::LoopHeld,
        Self::LoopSlow,
        Self::RangersSilent,
        Self::OneRangerSilent,
        Self::RangerStuck,
        Self::FlowSilent,
        Self::DownSilent,
        Self::MotorDead,
        Self::BatteryLow,
        Self::BatteryCritical,
        Self::BatterySags,
        Self::BatteryReserve,
        Self::WayBlocked,
        Self::SearchFails,
        Self::PlaceJumps,
        Self::Kidnapped,
        Self::Hot,
        Self::DiskFull,
        Self::ClockJump,
        Self::Throttled,
        Self::Overload,
        Self::CtrlC,
        Self::Stop,
    ];

    /// What is known of it beforehand.
    #[must_use]
    pub const fn facts(self) -> FaultFacts {
        const fn row(
            name: &'static str,
            has_safe_way: bool,
            rows: &'static [Because],
        ) -> FaultFacts {
            FaultFacts {
                name,
                has_safe_way,
                rows,
                modes: &[],
                is_alone: false,
            }
        }
        match self {
            Self::None => row("none", true, &[]),
            Self::GroundSilent => row("ground-silent", true, &[Because::GroundLost]),
            Self::SticksStop => FaultFacts {
                modes: &[FlownMode::Position],
                ..row("sticks-stop", true, &[Because::ManualSilent])
            },
            Self::StreamStops => FaultFacts {
                modes: &[FlownMode::Offboard],
                ..row("stream-stops", true, &[Because::OffboardSilent])
            },
            // The controller holds its last sticks and then stops the motors: it falls.
            Self::FcSilent => row("fc-silent", false, &[Because::FcSilent]),
            Self::FcNoisy => row("fc-noisy", false, BAD_LINE),
            // It carries out 40 messages a second, where 60 are asked for.
            Self::FcSlow => row("fc-slow", true, &[Because::FcSlow]),
            // Half of its bytes are lost: whether answers are too few or none for a moment is the moment's.
            Self::FcLossy => row("fc-lossy", true, BAD_LINE),
            // It says that it leans, and does not: sooner or later the estimate believes it.
            Self::AttitudeAskew => row("attitude-askew", false, &[Because::Inconsistent]),
            Self::LoopHeld => row("loop-held", true, &[Because::LoopHeld]),
            // Whether beats are missed or replies are late first is the moment's.
            Self::LoopSlow => row(
                "loop-slow",
                true,
                &[
                    Because::LoopOverrun,
                    Because::FcSlow,
                    Because::EstimatorFailed,
                ],
            ),
            Self::RangersSilent => row("rangers-silent", true, &[Because::RangersSilent]),
            Self::OneRangerSilent => row("one-ranger-silent", true, &[]),
            // What it hides is not seen; walls of the plan are known without it.
            Self::RangerStuck => row("ranger-stuck", true, &[]),
            Self::FlowSilent => row("flow-silent", true, &[]),
            Self::DownSilent => row("down-silent", true, &[]),
            Self::MotorDead => row(
                "motor-dead",
                false,
                &[Because::Toppled, Because::Tilted, Because::Inconsistent],
            ),
            Self::BatteryLow => row("battery-low", true, &[Because::BatteryLow]),
            Self::BatteryCritical => row(
                "battery-critical",
                true,
                &[Because::BatteryCritical, Because::BatterySags],
            ),
            // An old pack: full enough, and its voltage breaks down under load.
            Self::BatterySags => row("battery-sags", true, &[Because::BatterySags]),
            // The way home became longer than the battery: told by the reserve that is asked for.
            Self::BatteryReserve => row("battery-reserve", true, &[Because::BatteryReserve]),
            // Walls that rise around it and are not on the plan: it cannot pass, or what it sees is nowhere on the plan.
            Self::WayBlocked => FaultFacts {
                modes: &[FlownMode::Mission],
                is_alone: true,
                ..row(
                    "way-blocked",
                    true,
                    &[Because::NoProgress, Because::NotLocalized],
                )
            },
            // It starts anywhere, among walls that the plan does not show: the search flight finds nothing.
            Self::SearchFails => FaultFacts {
                modes: &[FlownMode::Hold],
                is_alone: true,
                ..row("search-fails", true, &[Because::NotLocalized])
            },
            // Carried away where one jump is one too many.
            Self::PlaceJumps => row(
                "place-jumps",
                false,
                &[Because::PlaceJumps, Because::NotLocalized],
            ),
            // Until it has found its new place it may steer by the old one.
            Self::Kidnapped => row("kidnapped", false, &[]),
            Self::Hot => row("hot", true, &[Because::Hot]),
            Self::DiskFull => row("disk-full", true, &[Because::DiskFails]),
            Self::ClockJump => row("clock-jump", true, &[Because::ClockJumped]),
            Self::Throttled => row("throttled", true, &[Because::Throttled]),
            Self::Overload => row("overload", true, &[Because::Overloaded]),
            Self::CtrlC => row("ctrl-c", true, &[Because::ShuttingDown]),
            Self::Stop => row("stop", true, &[]),
        }
    }

    fn can_happen_in(self, mode: FlownMode) -> bool {
        let modes = self.facts().modes;
        modes.is_empty() || modes.contains(&mode)
    }
}

/// What a line says that loses its bytes: too few answers, none, no attitude that is fresh, or one that does not fit.
const BAD_LINE: &[Because] = &[
    Because::FcSlow,
    Because::FcSilent,
    Because::EstimatorFailed,
    Because::Inconsistent,
];

/// One flight of a campaign.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Case {
    /// Seed of everything in it.
    pub seed: u64,
    /// Room.
    pub room: String,
    /// Mode when the fault comes.
    pub mode: FlownMode,
    /// The fault.
    pub fault: Fault,
    /// A second one, 0.5 s to 4 s later.
    pub second: Option<Fault>,
}

impl Campaign {
    /// From a file's text.
    ///
    /// # Errors
    /// [`CampaignError`] names the line or the list.
    pub fn parse(text: &str) -> Result<Self, CampaignError> {
        let campaign: Self =
            toml::from_str(text).map_err(|e| CampaignError::Toml(e.to_string()))?;
        if campaign.rooms.is_empty() || campaign.modes.is_empty() || campaign.faults.is_empty() {
            return Err(CampaignError::Empty(
                "rooms, modes and faults need an entry",
            ));
        }
        let goes = |fault: &Fault| campaign.modes.iter().any(|mode| fault.can_happen_in(*mode));
        if !campaign.faults.iter().all(goes) {
            return Err(CampaignError::Empty(
                "a fault goes with none of the modes (sticks-stop: position, stream-stops: offboard)",
            ));
        }
        Ok(campaign)
    }

    /// The flight that a seed is. Faults follow each other, so that each is flown equally often; the rest is drawn.
    #[must_use]
    pub fn case(&self, seed: u64) -> Case {
        let mut dice = Dice(seed);
        let at = |dice: &mut Dice, n: usize| dice.roll(n.max(1) as u64) as usize;
        let fault = self.faults[(seed % self.faults.len() as u64) as usize];
        let modes: Vec<FlownMode> = self
            .modes
            .iter()
            .copied()
            .filter(|mode| fault.can_happen_in(*mode))
            .collect();
        let mode = modes[at(&mut dice, modes.len())];
        let room = self.rooms[at(&mut dice, self.rooms.len())].clone();
        let others: Vec<Fault> = self
            .faults
            .iter()
            .copied()
            .filter(|f| {
                *f != fault && *f != Fault::None && !f.facts().is_alone && f.can_happen_in(mode)
            })
            .collect();
        let has_second = fault != Fault::None
            && !fault.facts().is_alone
            && !others.is_empty()
            && dice.roll(4) == 0;
        let second = has_second.then(|| others[at(&mut dice, others.len())]);
        Case {
            seed,
            room,
            mode,
            fault,
            second,
        }
    }
}

impl Case {
    /// Both faults.
    pub fn faults(&self) -> impl Iterator<Item = Fault> + use<> {
        [Some(self.fault), self.second].into_iter().flatten()
    }

    /// There is a way to end without touching anything.
    #[must_use]
    pub fn has_safe_way(&self) -> bool {
        self.faults().all(|fault| fault.facts().has_safe_way)
    }
}

/// Numbers that follow from a seed (splitmix64).
#[derive(Clone, Debug)]
pub(super) struct Dice(pub(super) u64);

impl Dice {
    /// A number below `sides`.
    pub(super) const fn roll(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % sides
    }

    /// A number of a range.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.roll(1 << 20) as f64 / f64::from(1 << 20)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_is_flown_equally_often_and_a_seed_is_a_case() {
        let campaign = Campaign::default();
        let n = Fault::ALL.len() as u64;
        for fault in Fault::ALL {
            let flown = (0..10 * n)
                .filter(|seed| campaign.case(*seed).fault == fault)
                .count();
            assert_eq!(flown, 10, "{fault:?}");
        }
        for seed in 0..200 {
            let case = campaign.case(seed);
            assert_eq!(case, campaign.case(seed));
            assert!(
                case.faults().all(|f| f.can_happen_in(case.mode)),
                "{case:?}"
            );
        }
    }

    #[test]
    fn a_campaign_is_read_and_a_wrong_one_refused_in_words() {
        let c =
            Campaign::parse("rooms = [\"maze\"]\nfaults = [\"stop\", \"loop-held\"]\n").unwrap();
        assert_eq!((c.rooms.len(), c.faults.len(), c.seeds), (1, 2, 100));
        for wrong in [
            "rooms = []",
            "faults = [\"no-such\"]",
            "typo = 1",
            "modes = [\"hold\"]\nfaults = [\"sticks-stop\"]",
        ] {
            assert!(!Campaign::parse(wrong).unwrap_err().to_string().is_empty());
        }
    }

    #[test]
    fn names_of_faults_are_those_of_the_file() {
        for fault in Fault::ALL {
            let text = format!("faults = [\"{}\"]", fault.facts().name);
            assert_eq!(Campaign::parse(&text).unwrap().faults, [fault]);
        }
    }
}
