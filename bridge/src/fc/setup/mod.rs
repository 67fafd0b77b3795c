//! Making a controller fit to be flown by MSP, and putting it back.
//!
//! ```text
//! survey (what is there) -> findings (what must be) -> provision: save, write, verify, keep, restart, verify again
//!                                                      restore:   write what was saved, the same way
//! ```
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`survey`] | [`Survey`]: identity and every setting that may be touched, byte for byte |
//! | [`findings`](mod@findings) | the table of what flight by MSP needs, with what is there |
//! | [`beside_radio`] | the same for flight beside a pilot's radio |
//! | [`backup`] | a survey as a file |
//! | [`apply`](mod@apply) | writing, verifying, saving, restarting |
//!
//! Touched are: the kind of receiver, the slots of the mode switches, and what the throttle does in the first moments
//! without a receiver. Never touched: PID, rates, motors, ESC, calibration.

pub mod apply;
pub mod backup;
pub mod beside_radio;
pub mod findings;
pub mod survey;

pub use apply::{ApplyError, Write, apply};
pub use backup::{Backup, BackupError};
pub use beside_radio::findings_beside_radio;
pub use findings::{Finding, Verdict, findings};
pub use survey::Survey;

#[cfg(test)]
pub(crate) mod test_controller;
#[cfg(test)]
mod tests;
