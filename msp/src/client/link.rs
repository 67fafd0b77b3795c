//! State of the link, commands to it, and what time does to it. What is sent is in [`super::turn`],
//! what an answer changes in [`super::answer`].

use super::identify::{Identify, Outcome};
use super::schedule::{Members, Schedule, Turns};
use super::statistics::{Averages, Statistics, blend};
use super::{Config, Event, MAX_ONE_OFFS, MAX_REQUEST, RequestError};
use crate::command;
use crate::firmware::{Firmware, Identity};
use crate::frame::Counters;
use crate::message::rc::MAX_CHANNELS;
use arrayvec::ArrayVec;
use std::collections::VecDeque;

/// Events that wait at most.
const MAX_EVENTS: usize = 64;
/// Outstanding requests at most: 4, RC above them, and one that blocks the controller.
pub(super) const MAX_OUTSTANDING: usize = 8;
/// How long a controller is left alone after it has acknowledged a restart.
pub(super) const RESTART_US: u64 = 1_000_000;

/// Everything about the link but its bytes.
#[derive(Clone, Debug)]
pub(super) struct Link {
    pub(super) config: Config,
    pub(super) state: State,
    pub(super) identity: Option<Identity>,
    pub(super) identify: Option<Identify>,
    pub(super) turns: Turns,
    pub(super) one_offs: VecDeque<OneOff>,
    pub(super) outstanding: ArrayVec<Outstanding, MAX_OUTSTANDING>,
    pub(super) rc: Option<RcFrame>,
    /// RC frames in a row.
    pub(super) rc_streak: u8,
    /// The last answer, or the start of the link.
    pub(super) heard_us: u64,
    /// Silence is expected until then.
    pub(super) patience_until_us: u64,
    /// Noise bytes counted at the last answer.
    pub(super) noise_before: u64,
    /// The last RC frame was refused, and that has been told.
    pub(super) rc_is_refused: bool,
    pub(super) is_lost: bool,
    /// Replies may be those to older requests: nothing but RC is sent until the reply to [`SYNC`] tells
    /// that all of them are through.
    pub(super) is_syncing: bool,
    /// Such questions given up, whose replies may come yet.
    pub(super) syncs_late: u8,
    /// One of those replies came while the present one waited.
    pub(super) sync_is_heard: bool,
    /// RC frames given up since such a question was sent: their replies come after its own.
    pub(super) rc_late: bool,
    /// Such questions in a row.
    pub(super) syncs_in_row: u8,
    /// When a reply to nothing may start that again.
    pub(super) sync_again_us: u64,
    /// Which list is read again next, and when.
    pub(super) refresh_command: u16,
    pub(super) refresh_at_us: u64,
    /// The last status said that the controller has just started.
    pub(super) is_starting: Option<bool>,
    /// Since when the cycle time is 0, and whether that has been told.
    pub(super) still_since_us: Option<u64>,
    pub(super) still_is_told: bool,
    /// Time between two RC frames of the caller, moving average; 0 = not known.
    pub(super) rc_period_us: f64,
    pub(super) rc_set_us: u64,
    /// When it is judged whether the controller is slow; `None` = told already.
    pub(super) judge_at_us: Option<u64>,
    /// A request has timed out since the last answer: do not pile up more than one.
    pub(super) is_mute: bool,
    pub(super) events: VecDeque<Event>,
    pub(super) statistics: Statistics,
    pub(super) averages: Averages,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    Idle,
    /// Throws bytes away until then.
    Draining {
        until_us: u64,
    },
    Running,
}

#[derive(Clone, Debug)]
pub(super) struct OneOff {
    pub(super) command: u16,
    pub(super) payload: ArrayVec<u8, MAX_REQUEST>,
    /// When it became the first in the queue.
    pub(super) since_us: Option<u64>,
    pub(super) tries: u8,
}

#[derive(Clone, Debug)]
pub(super) struct RcFrame {
    pub(super) channels_us: ArrayVec<u16, MAX_CHANNELS>,
    pub(super) since_us: u64,
}

/// A request the controller has not answered yet.
#[derive(Clone, Debug)]
pub(super) struct Outstanding {
    pub(super) command: u16,
    pub(super) origin: Origin,
    pub(super) sent_us: u64,
    pub(super) timeout_us: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Origin {
    Identify,
    OneOff,
    /// Asked only to hear whether anybody is there.
    Probe,
    Rc,
    Refresh,
    Schedule(Members),
    Sync,
}

/// The question by which the client finds out where it stands. Replies have no number, but they come in
/// the order of the requests: when this one is answered, everything sent before it has been answered or is
/// lost. Nothing else asks it, every firmware knows it or refuses it, its reply is short.
pub(super) const SYNC: u16 = command::DEBUG;

/// When a controller is judged after its identification, and again while it is fast enough.
const JUDGE_US: u64 = 3_000_000;
/// Betaflight serves 100 requests a second unless told otherwise. Fewer than this are too few when one
/// line of its command line gives ten times as many.
const SLOW_HZ: f64 = 150.0;
/// Part of the wanted rate that nobody notices to be missing.
const ENOUGH: f64 = 0.9;

impl Link {
    pub(super) fn new(config: Config) -> Self {
        Self {
            config,
            state: State::Idle,
            identity: None,
            identify: None,
            turns: Turns::default(),
            one_offs: VecDeque::with_capacity(MAX_ONE_OFFS),
            outstanding: ArrayVec::new(),
            rc: None,
            rc_streak: 0,
            heard_us: 0,
            patience_until_us: 0,
            noise_before: 0,
            rc_is_refused: false,
            is_lost: false,
            is_syncing: false,
            syncs_late: 0,
            sync_is_heard: false,
            rc_late: false,
            syncs_in_row: 0,
            sync_again_us: 0,
            refresh_command: command::BOXIDS,
            refresh_at_us: 0,
            is_starting: None,
            still_since_us: None,
            still_is_told: false,
            rc_period_us: 0.0,
            rc_set_us: 0,
            judge_at_us: None,
            is_mute: false,
            events: VecDeque::with_capacity(MAX_EVENTS),
            statistics: Statistics::default(),
            averages: Averages::default(),
        }
    }

    // ---- commands ----

    pub(super) fn connect(&mut self, now_us: u64) {
        let until_us = now_us + self.config.drain_us;
        self.state = State::Draining { until_us };
        self.identity = None;
        self.identify = Some(Identify::new(until_us));
        self.turns = Turns::default();
        self.one_offs.clear();
        self.outstanding.clear();
        self.rc = None;
        self.rc_streak = 0;
        self.rc_is_refused = false;
        self.heard_us = until_us;
        self.patience_until_us = 0;
        self.noise_before = self.statistics.noise_bytes;
        self.is_lost = false;
        self.is_mute = false;
        self.is_syncing = false;
        self.syncs_late = 0;
        self.is_starting = None;
        self.still_since_us = None;
        self.judge_at_us = None;
        self.averages.on_pause();
    }

    pub(super) fn set_rc(&mut self, now_us: u64, channels_us: &[u16]) {
        // An empty SET_RAW_RC is acknowledged and counts as a receiver frame.
        if channels_us.is_empty() {
            return;
        }
        let channels_us = channels_us.iter().copied().take(MAX_CHANNELS).collect();
        let since_us = now_us;
        let period_us = now_us.saturating_sub(self.rc_set_us);
        if (1..JUDGE_US).contains(&period_us) {
            self.rc_period_us = blend(self.rc_period_us, period_us as f64, 1.0 / 16.0);
        }
        self.rc_set_us = now_us;
        let unsent = self.rc.replace(RcFrame {
            channels_us,
            since_us,
        });
        self.statistics.rc_replaced += u64::from(unsent.is_some());
    }

    pub(super) fn request(&mut self, command: u16, payload: &[u8]) -> Result<(), RequestError> {
        let length = payload.len();
        let payload = ArrayVec::try_from(payload)
            .map_err(|_| RequestError::PayloadTooLong { command, length })?;
        if self.one_offs.len() == MAX_ONE_OFFS {
            return Err(RequestError::QueueFull { command });
        }
        self.one_offs.push_back(OneOff {
            command,
            payload,
            since_us: None,
            tries: 0,
        });
        Ok(())
    }

    pub(super) fn set_schedule(&mut self, now_us: u64, schedule: &Schedule) {
        self.config.schedule = Some(schedule.clone());
        if self.identity.is_some() {
            self.turns = Turns::new(schedule, now_us);
        }
    }

    /// Takes over the counters of the decoder.
    pub(super) fn count(&mut self, counters: &Counters) {
        self.statistics.line = *counters;
        self.statistics.bad_frames = counters.bad_frames();
        self.statistics.noise_bytes = counters.noise_bytes;
    }

    // ---- time ----

    pub(super) fn tick(&mut self, now_us: u64) {
        match self.state {
            State::Idle => return,
            State::Draining { until_us } if now_us < until_us => return,
            State::Draining { .. } => {
                self.state = State::Running;
                self.heard_us = now_us;
            }
            State::Running => {}
        }
        self.averages.tick(&mut self.statistics, now_us);
        let is_late = |waiting: &Outstanding| now_us >= waiting.deadline_us();
        while let Some(index) = self.outstanding.iter().position(is_late) {
            let late = self.outstanding.remove(index);
            self.on_timeout(now_us, &late);
        }
        if let Some(front) = self.one_offs.front_mut() {
            front.since_us.get_or_insert(now_us);
        }
        if let Some(rc) = &self.rc
            && now_us > rc.since_us + self.config.rc_max_age_us
        {
            self.rc = None;
            self.statistics.rc_expired += 1;
        }
        if self.judge_at_us.is_some_and(|at_us| now_us >= at_us) {
            self.judge(now_us);
        }
        if self
            .lost_at_us()
            .is_some_and(|lost_at_us| now_us >= lost_at_us)
        {
            self.on_lost(now_us);
        }
    }

    /// Whether the controller serves what flight wants.
    fn judge(&mut self, now_us: u64) {
        self.judge_at_us = Some(now_us + JUDGE_US);
        let service_rate_hz = self.statistics.service_rate_hz;
        let may_judge = self.is_online() && service_rate_hz > 0.0;
        let Some(identity) = self.identity.as_ref().filter(|_| may_judge) else {
            return;
        };
        let is_rc_live = self.rc_period_us > 0.0 && now_us < self.rc_set_us + JUDGE_US;
        let rc_hz = if is_rc_live {
            1e6 / self.rc_period_us
        } else {
            0.0
        };
        let wanted_hz = self.turns.demand_hz(self.batches()) + rc_hz;
        let cli_line = identity.firmware.faster_cli_line();
        let too_few = service_rate_hz < ENOUGH * wanted_hz;
        if too_few || (cli_line.is_some() && service_rate_hz < SLOW_HZ) {
            self.judge_at_us = None;
            self.emit(Event::Slow {
                service_rate_hz,
                wanted_hz,
                cli_line,
            });
        }
    }

    /// Called when the controller has been identified.
    pub(super) fn begin_watch(&mut self, now_us: u64) {
        self.statistics.identifications += 1;
        self.judge_at_us = Some(now_us + JUDGE_US);
        self.refresh_at_us = now_us + self.config.refresh_us / 2;
        self.is_starting = None;
    }

    /// When a list is to be read again.
    pub(super) fn refresh_due_us(&self) -> Option<u64> {
        (self.config.refresh_us > 0 && self.identify.is_none()).then_some(self.refresh_at_us)
    }

    /// The list was read, or the controller has none: now the other one.
    pub(super) fn on_refreshed(&mut self, now_us: u64) {
        // Now and then without a reason: a second client may have put us out of step unnoticed.
        self.is_syncing = true;
        let has_map = self
            .identity
            .as_ref()
            .is_some_and(|identity| identity.firmware != Firmware::MultiWii);
        self.refresh_command = match self.refresh_command {
            command::BOXIDS if has_map => command::RX_MAP,
            _ => command::BOXIDS,
        };
        self.refresh_at_us = now_us + self.config.refresh_us / 2;
    }

    /// When silence becomes a loss. Only if a request has gone unanswered: a program that was
    /// itself held up has no right to complain.
    fn lost_at_us(&self) -> Option<u64> {
        let silent_from_us = self.heard_us.max(self.patience_until_us);
        (self.is_mute && !self.is_lost).then_some(silent_from_us + self.config.silence_us)
    }

    /// When somebody has to be asked something, whatever the schedule says, to know whether he is
    /// still there.
    pub(super) fn probe_at_us(&self) -> u64 {
        self.heard_us.max(self.patience_until_us) + self.config.silence_us / 3
    }

    fn on_timeout(&mut self, now_us: u64, late: &Outstanding) {
        self.averages.on_pause();
        self.is_mute = true;
        self.on_unanswered(now_us, late);
    }

    pub(super) fn on_unanswered(&mut self, now_us: u64, late: &Outstanding) {
        self.statistics.timeouts += 1;
        match &late.origin {
            Origin::Rc => self.rc_late |= self.is_syncing,
            Origin::Probe | Origin::Refresh => {}
            Origin::Sync if self.sync_is_heard => {
                // Those given up are lost: what came was the reply to this one.
                (self.syncs_late, self.sync_is_heard) = (0, false);
            }
            Origin::Sync => self.syncs_late = self.syncs_late.saturating_add(1),
            Origin::Schedule(members) => self.turns.on_timeout(now_us, members),
            Origin::Identify => {
                if self
                    .identify
                    .as_ref()
                    .is_some_and(|identify| identify.tries >= self.config.tries)
                {
                    self.advance(now_us, Outcome::Unanswered);
                }
            }
            Origin::OneOff => {
                let is_final = self
                    .one_offs
                    .front()
                    .is_some_and(|front| front.tries >= self.config.tries);
                if is_final || blocks(late.command) {
                    self.one_offs.pop_front();
                    self.emit(Event::Unanswered {
                        command: late.command,
                    });
                }
                if late.command == command::REBOOT {
                    // It may well have restarted and only the answer was lost.
                    self.restart(now_us, now_us);
                }
            }
        }
    }

    fn on_lost(&mut self, now_us: u64) {
        self.is_lost = true;
        self.statistics.losses += 1;
        self.turns.reset();
        self.outstanding
            .retain(|waiting| !matches!(waiting.origin, Origin::Schedule(_) | Origin::Identify));
        self.identify = Some(Identify::new(now_us));
        self.emit(Event::Lost {
            silent_us: now_us.saturating_sub(self.heard_us),
            noise_bytes: self.statistics.noise_bytes - self.noise_before,
        });
    }

    pub(super) fn deadline_us(&self) -> Option<u64> {
        match self.state {
            State::Idle => return None,
            State::Draining { until_us } => return Some(until_us),
            State::Running => {}
        }
        let timeouts = self.outstanding.iter().map(Outstanding::deadline_us).min();
        let silence = self.lost_at_us();
        // While it gets in step only the reply or its time-out matters.
        let has_room = self.has_room() && (self.is_mute || !self.is_syncing);
        let may_ask = self.is_online() && has_room;
        let due = may_ask.then(|| self.turns.next_due_us()).flatten();
        let fill = self
            .fill_pause_us()
            .filter(|_| may_ask)
            .and_then(|pause_us| self.turns.next_fill_us(pause_us));
        let refresh = self
            .refresh_due_us()
            .filter(|_| may_ask && !self.is_outstanding(&Origin::Refresh));
        let judge = self.judge_at_us;
        let identify = self
            .identify
            .as_ref()
            .filter(|_| has_room && !self.is_outstanding(&Origin::Identify))
            .map(|identify| identify.since_us);
        let rc = self
            .rc
            .as_ref()
            .map(|rc| rc.since_us + self.config.rc_max_age_us + 1);
        let probe = (self.is_online() && self.outstanding.is_empty()).then(|| self.probe_at_us());
        [
            timeouts, silence, due, fill, refresh, judge, identify, rc, probe,
        ]
        .into_iter()
        .flatten()
        .min()
    }

    pub(super) fn emit(&mut self, event: Event) {
        if self.events.len() == MAX_EVENTS {
            self.events.pop_front();
            self.statistics.events_dropped += 1;
        }
        self.events.push_back(event);
    }
}

impl Outstanding {
    const fn deadline_us(&self) -> u64 {
        self.sent_us + self.timeout_us
    }
}

/// Commands after which a controller may be silent for seconds.
pub(super) const fn blocks(command: u16) -> bool {
    matches!(command, command::EEPROM_WRITE | command::REBOOT)
}
