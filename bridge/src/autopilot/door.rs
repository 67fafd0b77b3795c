//! The door between [`Flight`](super::flight::Flight) and [`Ground`](super::ground::Ground): typed values only.
//!
//! One way go [`Asked`] requests, each with the station that asked. The other way come [`Answer`]s, [`Event`]s and a
//! [`Snapshot`] copied each tick. Nothing else passes; `Flight` formats no text, so reasons travel as values
//! ([`Refusal`], [`Notice`]) and become words in `Ground`.

mod notice;
mod refusal;
mod request;
mod snapshot;

pub use super::bench_work::{MotorTurn, Progress, Sensor};
pub use notice::*;
pub use refusal::*;
pub use request::*;
use serde::{Deserialize, Serialize};
pub use snapshot::*;

/// Matches an [`Answer`] to its [`Asked`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct RequestId(pub u32);

/// Who asked: enough to know one station from another, nothing about links.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Station {
    /// MAVLink system id.
    pub system: u8,
    /// MAVLink component id.
    pub component: u8,
}

/// A request with its sender.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Asked {
    /// Comes back in the answer.
    pub id: RequestId,
    /// Who asked.
    pub station: Station,
    /// What for.
    pub request: Request,
}
