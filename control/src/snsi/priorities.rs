//! Controllers with priorities: each cycle starts from neutral, and the highest available priority wins each channel.
//!
//! | Controller as shipped | Priority | Channels |
//! | --- | --- | --- |
//! | remote control | 10 | all five |
//! | take-off, height | 9 | throttle, arm |
//! | avoidance, yaw | 10 in its code, the same as remote: the later one replaced it, with a warning | rudder (its code says 4, which is arm) |
//! | inclination | 11 | elevator |
//!
//! Channels are in the order throttle, roll, pitch, yaw, arm. Availability is asked for each cycle: who is silent loses his channels at once.

use arrayvec::ArrayVec;

/// Channels: throttle, roll, pitch, yaw, arm.
pub const CHANNELS: usize = 5;
/// What nobody writes, us.
pub const NEUTRAL_US: [f64; CHANNELS] = [1000.0, 1500.0, 1500.0, 1500.0, 1000.0];
/// Controllers at most.
pub const MAX_CONTROLLERS: usize = 16;
/// Neutral for so long at the start, s: the controller calibrates and sees arm low.
pub const NEUTRAL_S: f64 = 5.0;

/// Who wants to write what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Claim {
    /// Name for the pilot.
    pub name: &'static str,
    /// Higher wins.
    pub priority: u8,
    /// Which channels.
    pub channels: [bool; CHANNELS],
}

/// Something is not as it should be; flying goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Warning {
    /// Two with one priority: the later one replaces the earlier.
    Replaced {
        /// Who is gone.
        gone: &'static str,
        /// Who stands in its place.
        by: &'static str,
        /// Their priority.
        priority: u8,
    },
    /// No room.
    Full {
        /// Who is left out.
        left_out: &'static str,
    },
}

impl core::fmt::Display for Warning {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Replaced { gone, by, priority } => write!(
                f,
                "priority {priority} belongs to {gone}: {by} replaces it; give it another"
            ),
            Self::Full { left_out } => write!(f, "no room for {left_out}"),
        }
    }
}

/// The table.
#[derive(Clone, Debug, Default)]
pub struct Priorities {
    claims: ArrayVec<Claim, MAX_CONTROLLERS>,
}

impl Priorities {
    /// Adds a controller.
    ///
    /// # Errors
    /// The warning: it replaced another, or was left out.
    pub fn add(&mut self, claim: Claim) -> Result<(), Warning> {
        if let Some(same) = self
            .claims
            .iter_mut()
            .find(|c| c.priority == claim.priority)
        {
            let gone = same.name;
            *same = claim;
            return Err(Warning::Replaced {
                gone,
                by: claim.name,
                priority: claim.priority,
            });
        }
        let at = self.claims.partition_point(|c| c.priority < claim.priority);
        self.claims
            .try_insert(at, claim)
            .map_err(|_| Warning::Full {
                left_out: claim.name,
            })
    }

    /// One cycle: `values` answers what a controller (by name) writes now, none when it is not available.
    pub fn cycle(
        &self,
        mut values: impl FnMut(&'static str) -> Option<[f64; CHANNELS]>,
    ) -> [f64; CHANNELS] {
        let mut out = NEUTRAL_US;
        for claim in &self.claims {
            let Some(wanted) = values(claim.name) else {
                continue;
            };
            for (i, us) in wanted.into_iter().enumerate() {
                if claim.channels[i] && us.is_finite() {
                    out[i] = us;
                }
            }
        }
        out
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;

    const REMOTE: Claim = Claim {
        name: "remote",
        priority: 12,
        channels: [true; CHANNELS],
    };
    const HEIGHT: Claim = Claim {
        name: "height",
        priority: 9,
        channels: [true, false, false, false, true],
    };
    const YAW: Claim = Claim {
        name: "yaw",
        priority: 10,
        channels: [false, false, false, true, false],
    };

    fn table() -> Priorities {
        let mut p = Priorities::default();
        // In any order: it is the priority that counts.
        for claim in [REMOTE, YAW, HEIGHT] {
            p.add(claim).unwrap();
        }
        p
    }

    #[test]
    fn the_highest_that_is_available_wins_each_channel_and_live() {
        let p = table();
        let mut remote_speaks = true;
        let values = |name: &'static str, remote_speaks: bool| match name {
            "remote" if remote_speaks => Some([1200.0, 1510.0, 1520.0, 1530.0, 2000.0]),
            "height" => Some([1600.0, 0.0, 0.0, 0.0, 2000.0]),
            "yaw" => Some([0.0, 0.0, 0.0, 1450.0, 0.0]),
            _ => None,
        };
        let out = p.cycle(|name| values(name, remote_speaks));
        assert_eq!(out, [1200.0, 1510.0, 1520.0, 1530.0, 2000.0]);
        remote_speaks = false;
        let out = p.cycle(|name| values(name, remote_speaks));
        assert_eq!(out, [1600.0, 1500.0, 1500.0, 1450.0, 2000.0]);
        assert_eq!(
            p.cycle(|_| None),
            NEUTRAL_US,
            "nobody speaks: neutral, disarmed"
        );
    }

    #[test]
    fn the_same_priority_replaces_with_a_warning() {
        let mut p = table();
        let warning = p
            .add(Claim {
                name: "avoidance",
                ..YAW
            })
            .unwrap_err();
        assert_eq!(
            warning.to_string(),
            "priority 10 belongs to yaw: avoidance replaces it; give it another"
        );
        let out = p.cycle(|name| (name == "avoidance").then_some([1.0, 1.0, 1.0, 1444.0, 1.0]));
        assert_eq!(out, [1000.0, 1500.0, 1500.0, 1444.0, 1000.0]);
    }

    #[test]
    fn what_is_no_number_writes_nothing() {
        let out = table().cycle(|name| (name == "yaw").then_some([f64::NAN; CHANNELS]));
        assert_eq!(out, NEUTRAL_US);
    }
}
