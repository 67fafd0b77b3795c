//! Who speaks and who is spoken to.

use core::fmt;

/// A MAVLink station: system and component id.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Address {
    /// System id, 1..=255.
    pub system: u8,
    /// Component id, 1..=255.
    pub component: u8,
}

impl Address {
    /// True if a message with this target is meant for `self`: 0 means everybody.
    #[must_use]
    pub const fn is_targeted_by(&self, system: u8, component: u8) -> bool {
        (system == 0 || system == self.system) && (component == 0 || component == self.component)
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.system, self.component)
    }
}
