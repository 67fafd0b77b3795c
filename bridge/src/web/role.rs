//! Roles of users, and what each may do with the vehicle.

use crate::gcs::intent::Intent;
use std::fmt;
use std::str::FromStr;

/// What a user may do; each role may do what those before it may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Sees everything, may stop: the guard.
    Viewer,
    /// Takes control, arms, flies, writes missions.
    Pilot,
    /// Sets parameters, reads logs.
    Engineer,
    /// Makes users.
    Admin,
}

impl Role {
    /// All of them, least first.
    pub const ALL: [Self; 4] = [Self::Viewer, Self::Pilot, Self::Engineer, Self::Admin];

    /// Its name in accounts and on the page.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Pilot => "pilot",
            Self::Engineer => "engineer",
            Self::Admin => "admin",
        }
    }

    /// True if messages of this intent are passed on for it.
    #[must_use]
    pub fn may(self, intent: Intent) -> bool {
        match intent {
            Intent::Watch | Intent::Stop => true,
            Intent::Fly => self >= Self::Pilot,
            Intent::Configure => self >= Self::Engineer,
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Role {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|r| r.name() == s)
            .ok_or_else(|| format!("no role `{s}`: viewer, pilot, engineer or admin"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_viewer_stops_and_watches_and_no_more() {
        let may = |r: Role| {
            [Intent::Watch, Intent::Stop, Intent::Fly, Intent::Configure].map(|i| r.may(i))
        };
        assert_eq!(may(Role::Viewer), [true, true, false, false]);
        assert_eq!(may(Role::Pilot), [true, true, true, false]);
        assert_eq!(may(Role::Engineer), [true; 4]);
        assert_eq!(may(Role::Admin), [true; 4]);
    }

    #[test]
    fn names_are_read_back() {
        for role in Role::ALL {
            assert_eq!(role.name().parse(), Ok(role));
        }
        assert!("root".parse::<Role>().is_err());
    }
}
