//! What an answer, a refusal or an answered batch changes.

use super::Event;
use super::identify::{Identify, Outcome};
use super::link::{Link, MAX_OUTSTANDING, Origin, Outstanding, RESTART_US, blocks};
use super::schedule::{Members, Turns, default_schedule};
use crate::command;
use crate::frame::{Direction, Frame};
use crate::message::Reply;
use crate::message::multiple::{MAX_BATCH, Replies};
use crate::wire::ParseError;
use arrayvec::ArrayVec;

/// A loop that has stood still so long will not start by itself (seen once in about 12 starts of
/// Betaflight's simulator build).
const STILL_US: u64 = 3_000_000;
/// Replies to nothing put the link in step again at most so often.
const SYNC_PAUSE_US: u64 = 1_000_000;
/// Then a controller is so slow that RC is never answered in time, and polls must go on nevertheless.
const MAX_SYNCS: u8 = 5;

impl Link {
    pub(super) fn on_frame(&mut self, now_us: u64, frame: &Frame<'_>) {
        // What was sent after the question that puts us in step cannot be answered before it.
        let sync = self
            .outstanding
            .iter()
            .position(|waiting| waiting.origin == Origin::Sync);
        let answerable = sync.map_or(self.outstanding.len(), |index| index + 1);
        let Some(index) = self.outstanding[..answerable]
            .iter()
            .position(|waiting| waiting.command == frame.command)
        else {
            self.statistics.stale_replies += 1;
            self.heard(now_us);
            // Somebody may send RC in our name while we are held up. Such an answer says nothing that could be taken for another's.
            let is_stray_rc = frame.command == command::SET_RAW_RC;
            if now_us >= self.sync_again_us && !is_stray_rc {
                // Meant for somebody else, or we are out of step.
                self.is_syncing = true;
                self.sync_again_us = now_us + SYNC_PAUSE_US;
            }
            return;
        };
        if self.outstanding[index].origin == Origin::Sync && self.syncs_late > 0 {
            // Perhaps the reply to one that was given up. If those were lost, nothing comes any more, and
            // the next question counts none.
            self.syncs_late -= 1;
            self.sync_is_heard = true;
            self.outstanding[index].sent_us = now_us;
            self.heard(now_us);
            return;
        }
        let asked = self.outstanding.remove(index);
        if asked.origin == Origin::Sync {
            self.is_syncing = self.rc_late && self.syncs_in_row < MAX_SYNCS;
            self.syncs_in_row = if self.is_syncing {
                self.syncs_in_row + 1
            } else {
                0
            };
            self.rc_late = false;
            self.sync_is_heard = false;
            for lost in self
                .outstanding
                .drain(..index)
                .collect::<ArrayVec<_, MAX_OUTSTANDING>>()
            {
                self.on_unanswered(now_us, &lost);
            }
        }
        if blocks(asked.command) {
            self.patience_until_us = now_us;
        }
        self.heard(now_us);
        self.statistics.replies += 1;
        let max_depth = self.config.max_outstanding;
        self.averages
            .on_reply(&mut self.statistics, now_us, asked.sent_us, max_depth);
        if frame.direction == Direction::Error {
            self.statistics.refused += 1;
            self.on_refused(now_us, &asked);
        } else {
            self.on_reply(now_us, &asked, frame.payload);
        }
    }

    fn heard(&mut self, now_us: u64) {
        if self.is_lost {
            self.is_lost = false;
            let silent_us = now_us.saturating_sub(self.heard_us);
            self.emit(Event::Recovered { silent_us });
        }
        if self.is_mute {
            // What was given up may be answered yet: replies would be taken for those to newer requests, and
            // a backlog would stay in the controller for as long as its slots are filled.
            self.is_mute = false;
            self.is_syncing = true;
        }
        self.heard_us = now_us;
        self.noise_before = self.statistics.noise_bytes;
    }

    fn on_refused(&mut self, now_us: u64, asked: &Outstanding) {
        match &asked.origin {
            Origin::Probe | Origin::Sync => {}
            Origin::Refresh => self.on_refreshed(now_us),
            // Too many channels, or no MSP receiver compiled in: the pilot must know, once.
            Origin::Rc => {
                if !self.rc_is_refused {
                    self.emit(Event::Refused {
                        command: asked.command,
                    });
                }
                self.rc_is_refused = true;
            }
            Origin::Identify => self.advance(now_us, Outcome::Refused),
            Origin::OneOff => {
                self.one_offs.pop_front();
                self.emit(Event::Refused {
                    command: asked.command,
                });
            }
            Origin::Schedule(members) if asked.command == command::MULTIPLE_MSP => {
                // Does not know batches, or one of the members: ask one by one and find out which.
                self.turns.on_left_out(now_us, members);
            }
            Origin::Schedule(members) => {
                if self.turns.on_refused(now_us, members) {
                    self.emit(Event::Refused {
                        command: asked.command,
                    });
                }
            }
        }
    }

    fn on_reply(&mut self, now_us: u64, asked: &Outstanding, payload: &[u8]) {
        if let Origin::Schedule(members) = &asked.origin {
            self.turns.on_answered(members);
            if asked.command == command::MULTIPLE_MSP {
                self.on_batch(now_us, asked.sent_us, members, payload);
                return;
            }
        }
        let reply = Reply::parse(asked.command, payload);
        match &asked.origin {
            Origin::Probe | Origin::Sync => {}
            Origin::Refresh => {
                self.on_refreshed(now_us);
                match &reply {
                    Ok(reply) => self.learn(now_us, reply),
                    Err(_) => self.statistics.malformed += 1,
                }
            }
            Origin::Rc => self.rc_is_refused = false,
            Origin::Schedule(_) => self.deliver(now_us, asked.sent_us, reply),
            Origin::Identify => {
                let outcome = match &reply {
                    Ok(reply) => Outcome::Answered(reply),
                    Err(error) => {
                        self.statistics.malformed += 1;
                        self.emit(Event::Malformed(*error));
                        Outcome::Unanswered
                    }
                };
                self.advance(now_us, outcome);
            }
            Origin::OneOff => {
                self.one_offs.pop_front();
                self.deliver(now_us, asked.sent_us, reply);
                if asked.command == command::REBOOT {
                    self.restart(now_us, now_us + RESTART_US);
                }
            }
        }
    }

    fn on_batch(&mut self, now_us: u64, sent_us: u64, members: &[u16], payload: &[u8]) {
        let commands: ArrayVec<u8, MAX_BATCH> = members
            .iter()
            .filter_map(|&command| u8::try_from(command).ok())
            .collect();
        let mut replies = Replies::new(&commands, payload);
        for (command, payload) in replies.by_ref() {
            self.deliver(now_us, sent_us, Reply::parse(command, payload));
        }
        let left_out: Members = replies
            .unanswered()
            .iter()
            .copied()
            .map(u16::from)
            .collect();
        if !left_out.is_empty() {
            self.turns.on_left_out(now_us, &left_out);
        }
    }

    fn deliver(&mut self, now_us: u64, sent_us: u64, reply: Result<Reply, ParseError>) {
        match reply {
            Ok(reply) => {
                self.learn(now_us, &reply);
                self.emit(Event::Reply {
                    reply,
                    sent_us,
                    received_us: now_us,
                });
            }
            Err(error) => {
                self.statistics.malformed += 1;
                self.emit(Event::Malformed(error));
            }
        }
    }

    /// The box list and the receiver map change with the configuration: whoever asks again updates
    /// the identity.
    fn learn(&mut self, now_us: u64, reply: &Reply) {
        let Some(identity) = &mut self.identity else {
            return;
        };
        let is_new = match reply {
            Reply::BoxIds(box_ids) => {
                let is_new = identity.box_ids != *box_ids;
                identity.box_ids.clone_from(box_ids);
                is_new
            }
            Reply::RxMap(rx_map) if rx_map.is_permutation() => {
                let is_new = identity.rx_map != *rx_map;
                identity.rx_map.clone_from(rx_map);
                is_new
            }
            Reply::Status(status) => return self.watch(now_us, status.head.cycle_time_us, reply),
            Reply::StatusEx(status) => return self.watch(now_us, status.head.cycle_time_us, reply),
            Reply::InavStatus(status) => return self.watch(now_us, status.cycle_time_us, reply),
            _ => false,
        };
        if is_new {
            self.statistics.changes += 1;
            let identity = identity.clone();
            self.emit(Event::Changed(identity));
        }
    }

    /// What a status tells about the controller itself: that its loop stands still, that it has just
    /// started. A restart shorter than the silence that counts as a loss is seen only there, and after it
    /// boxes and receiver map may be others.
    fn watch(&mut self, now_us: u64, cycle_time_us: u16, status: &Reply) {
        if cycle_time_us > 0 {
            self.still_since_us = None;
            self.still_is_told = false;
        } else {
            let since_us = *self.still_since_us.get_or_insert(now_us);
            if now_us >= since_us + STILL_US && !self.still_is_told {
                self.still_is_told = true;
                self.statistics.stalls += 1;
                self.emit(Event::Stalled);
            }
        }
        let is_starting = self
            .identity
            .as_ref()
            .is_some_and(|identity| identity.is_starting(status));
        let was_starting = self.is_starting.replace(is_starting);
        if was_starting == Some(false) && is_starting && self.identify.is_none() {
            self.statistics.restarts += 1;
            self.identify = Some(Identify::new(now_us));
            self.emit(Event::Restarted);
        }
    }

    pub(super) fn advance(&mut self, now_us: u64, outcome: Outcome<'_>) {
        let Some(identity) = self
            .identify
            .as_mut()
            .and_then(|identify| identify.advance(now_us, outcome))
        else {
            return;
        };
        let schedule = self
            .config
            .schedule
            .clone()
            .unwrap_or_else(|| default_schedule(&identity));
        self.turns = Turns::new(&schedule, now_us);
        // Their turns are forgotten, so their replies would be stale.
        self.outstanding
            .retain(|waiting| !matches!(waiting.origin, Origin::Schedule(_)));
        self.identify = None;
        let before = self.identity.replace(identity.clone());
        let is_new = before.is_some_and(|before| {
            before.box_ids != identity.box_ids || before.rx_map != identity.rx_map
        });
        self.statistics.changes += u64::from(is_new);
        self.begin_watch(now_us);
        self.emit(Event::Identified(identity));
    }

    /// Forgets a controller that is starting anew and identifies it from `from_us` on.
    pub(super) fn restart(&mut self, now_us: u64, from_us: u64) {
        self.statistics.restarts += 1;
        self.is_syncing = false;
        self.identity = None;
        self.identify = Some(Identify::new(from_us));
        self.turns.reset();
        self.outstanding.clear();
        self.patience_until_us = now_us + self.config.blocking_us;
    }
}
