//! Identification: which question comes next and what its answer adds to the [`Identity`].
//!
//! | step | answered | refused | not answered |
//! | --- | --- | --- | --- |
//! | API_VERSION | FC_VARIANT | IDENT | IDENT |
//! | IDENT (MultiWii) | BOXIDS | start again | start again |
//! | FC_VARIANT | FC_VERSION | FC_VERSION | start again |
//! | FC_VERSION | BOARD_INFO | BOARD_INFO | start again |
//! | BOARD_INFO | BOXIDS | BOXIDS | BOXIDS |
//! | BOXIDS | RX_MAP (MultiWii: done) | same | start again |
//! | RX_MAP | done | done with the default | start again |
//!
//! RX_MAP decides which channel is throttle, so silence there is never taken for the default.

use crate::command;
use crate::firmware::{Firmware, Identity};
use crate::message::{ApiVersion, BoxIds, FcVersion, Reply};

/// Pause before an identification starts again.
const AGAIN_US: u64 = 100_000;

/// An identification under way.
#[derive(Clone, Debug)]
pub(super) struct Identify {
    step: Step,
    found: Identity,
    /// Requests of the present step sent so far.
    pub(super) tries: u8,
    /// When the present step began, for its turn among other requests.
    pub(super) since_us: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    ApiVersion,
    Ident,
    Variant,
    Version,
    Board,
    BoxIds,
    RxMap,
    Done,
}

/// How a step ended.
#[derive(Clone, Copy, Debug)]
pub(super) enum Outcome<'a> {
    Answered(&'a Reply),
    Refused,
    /// Not answered, or with something that is no answer.
    Unanswered,
}

impl Identify {
    pub(super) fn new(now_us: u64) -> Self {
        let found = Identity {
            firmware: Firmware::MultiWii,
            api: ApiVersion::default(),
            version: FcVersion::default(),
            board: None,
            box_ids: BoxIds::default(),
            rx_map: Firmware::MultiWii.default_rx_map(),
            has_multiple_msp: false,
        };
        Self {
            step: Step::ApiVersion,
            found,
            tries: 0,
            since_us: now_us,
        }
    }

    /// The question to ask now.
    pub(super) const fn command(&self) -> u16 {
        match self.step {
            Step::ApiVersion | Step::Done => command::API_VERSION,
            Step::Ident => command::IDENT,
            Step::Variant => command::FC_VARIANT,
            Step::Version => command::FC_VERSION,
            Step::Board => command::BOARD_INFO,
            Step::BoxIds => command::BOXIDS,
            Step::RxMap => command::RX_MAP,
        }
    }

    /// Goes to the next step; the identity when there is none left.
    pub(super) fn advance(&mut self, now_us: u64, outcome: Outcome<'_>) -> Option<Identity> {
        use Outcome::{Answered, Refused, Unanswered};
        let found = &mut self.found;
        self.step = match (self.step, outcome) {
            (Step::ApiVersion, Answered(Reply::ApiVersion(api))) => {
                found.api = *api;
                Step::Variant
            }
            (Step::ApiVersion, _) => Step::Ident,
            (Step::Ident, Answered(Reply::Ident(ident))) => {
                let (major, minor) = (ident.version / 100, ident.version % 100);
                found.firmware = Firmware::MultiWii;
                found.version = FcVersion {
                    major,
                    minor,
                    ..FcVersion::default()
                };
                found.rx_map = Firmware::MultiWii.default_rx_map();
                Step::BoxIds
            }
            (Step::Variant, Answered(Reply::FcVariant(variant))) => {
                found.firmware = (*variant).into();
                Step::Version
            }
            (Step::Variant, Refused) => {
                found.firmware = Firmware::Other(*b"????");
                Step::Version
            }
            (Step::Version, Answered(Reply::FcVersion(version))) => {
                found.version.clone_from(version);
                Step::Board
            }
            (Step::Version, Refused) => Step::Board,
            (Step::Board, Answered(Reply::BoardInfo(board))) => {
                found.board = Some(board.clone());
                Step::BoxIds
            }
            (Step::Board, _) => Step::BoxIds,
            (Step::BoxIds, outcome @ (Answered(_) | Refused)) => {
                if let Answered(Reply::BoxIds(box_ids)) = outcome {
                    found.box_ids.clone_from(box_ids);
                }
                if found.firmware == Firmware::MultiWii {
                    Step::Done
                } else {
                    Step::RxMap
                }
            }
            (Step::RxMap, Answered(Reply::RxMap(rx_map))) if rx_map.is_permutation() => {
                found.rx_map.clone_from(rx_map);
                Step::Done
            }
            (Step::RxMap, Refused) => {
                found.rx_map = found.firmware.default_rx_map();
                Step::Done
            }
            (_, Answered(_) | Refused | Unanswered) => {
                *self = Self::new(now_us + AGAIN_US);
                return None;
            }
        };
        self.tries = 0;
        self.since_us = now_us;
        if self.step != Step::Done {
            return None;
        }
        self.found.has_multiple_msp = self.found.firmware.has_multiple_msp(self.found.api);
        Some(self.found.clone())
    }
}
