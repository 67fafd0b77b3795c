//! Whose turn it is, and the frame for it.

use super::MAX_REQUEST;
use super::identify::Identify;
use super::link::{Link, Origin, Outstanding, SYNC, State, blocks};
use super::schedule::{Members, Priority, score};
use crate::command;
use crate::frame::{Direction, EncodeError, Framing, encode};
use crate::message::multiple::MAX_BATCH;
use arrayvec::ArrayVec;

/// RC frames outstanding at most, and while the controller is mute.
const MAX_RC_OUTSTANDING: [usize; 2] = [2, 1];
/// After so many RC frames in a row a request that is late by a whole interval goes first, or a
/// slow controller would serve nothing but RC.
const MAX_RC_STREAK: u8 = 2;
/// How soon a one-off request or a question of a renewed identification wants its turn.
const ONE_OFF_INTERVAL_US: u64 = 100_000;

/// Whose turn it is.
pub(super) enum Choice {
    Identify,
    OneOff,
    Probe,
    Rc,
    /// A list that changes with the configuration.
    Refresh,
    Schedule(Members),
    /// Finds out which replies belong to which requests.
    Sync,
}

impl Link {
    /// RC first, the most urgent request next. Only when RC would take every turn of a slow
    /// controller, an overdue request goes ahead of it.
    pub(super) fn choose(&self, now_us: u64) -> Option<Choice> {
        if self.state != State::Running {
            return None;
        }
        let request = if self.is_syncing && !self.is_mute {
            let is_asked = self.is_outstanding(&Origin::Sync);
            (!is_asked).then_some((Choice::Sync, true))
        } else {
            self.choose_request(now_us)
        };
        if !self.may_send_rc() {
            return request.map(|(choice, _)| choice);
        }
        match request {
            Some((choice, true)) if self.rc_streak >= MAX_RC_STREAK => Some(choice),
            _ => Some(Choice::Rc),
        }
    }

    fn may_send_rc(&self) -> bool {
        let outstanding = self
            .outstanding
            .iter()
            .filter(|waiting| waiting.origin == Origin::Rc)
            .count();
        self.rc.is_some()
            && self.identity.is_some()
            && outstanding < MAX_RC_OUTSTANDING[usize::from(self.is_mute || self.is_syncing)]
            && self.load() <= self.depth()
    }

    /// Requests to keep outstanding, RC not counted. While spare slots are not filled there is no
    /// telling how few would do.
    fn depth(&self) -> usize {
        if self.config.fill_hz == 0 || !self.is_online() {
            self.config.max_outstanding
        } else {
            self.averages.depth.now().min(self.config.max_outstanding)
        }
    }

    /// Nothing is to be sent now; if nothing is outstanding either, the controller gets a pause.
    pub(super) fn rest(&mut self) {
        if self.load() == 0 {
            self.averages.on_pause();
        }
    }

    /// Requests that wait at the controller; one that blocks it on purpose does not count.
    pub(super) fn load(&self) -> usize {
        self.outstanding
            .iter()
            .filter(|waiting| !blocks(waiting.command))
            .count()
    }

    pub(super) const fn is_online(&self) -> bool {
        self.identity.is_some() && !self.is_lost
    }

    /// Whether a request that is not RC may go out.
    pub(super) fn has_room(&self) -> bool {
        if !self.is_mute {
            // Beside RC there is always room for one, or RC alone would fill a slow controller.
            let is_rc_only = self
                .outstanding
                .iter()
                .all(|waiting| waiting.origin == Origin::Rc || blocks(waiting.command));
            return self.load() < self.depth() + usize::from(is_rc_only && self.load() > 0);
        }
        // RC is unanswered as well then; it must not keep the probes away, nor the probes RC.
        let probes = self
            .outstanding
            .iter()
            .filter(|waiting| waiting.origin != Origin::Rc && !blocks(waiting.command));
        probes.count() == 0
    }

    pub(super) fn is_outstanding(&self, origin: &Origin) -> bool {
        self.outstanding
            .iter()
            .any(|waiting| waiting.origin == *origin)
    }

    /// The most urgent request that is not RC, and whether it is overdue.
    fn choose_request(&self, now_us: u64) -> Option<(Choice, bool)> {
        if !self.has_room() {
            return None;
        }
        let identify = self
            .identify
            .as_ref()
            .filter(|_| !self.is_outstanding(&Origin::Identify));
        if !self.is_online() {
            // Nothing but the identification makes sense.
            return identify
                .filter(|identify| now_us >= identify.since_us)
                .map(|_| (Choice::Identify, true));
        }
        let front = self
            .one_offs
            .front()
            .filter(|_| !self.is_outstanding(&Origin::OneOff));
        let one_off = front.and_then(|front| {
            let since_us = front.since_us.unwrap_or(now_us);
            score(now_us, since_us, ONE_OFF_INTERVAL_US, Priority::Slow)
        });
        let identify = identify.and_then(|identify| {
            score(
                now_us,
                identify.since_us,
                ONE_OFF_INTERVAL_US,
                Priority::Normal,
            )
        });
        let turn = self.turns.next(now_us, self.batches());
        let scheduled = turn.as_ref().map(|turn| turn.score);
        let refresh = self
            .refresh_due_us()
            .filter(|_| !self.is_outstanding(&Origin::Refresh))
            .and_then(|due_us| score(now_us, due_us, ONE_OFF_INTERVAL_US, Priority::Normal));
        let all = [one_off, identify, scheduled, refresh];
        let Some(most) = all.into_iter().flatten().max() else {
            let is_quiet = self.outstanding.is_empty() && now_us >= self.probe_at_us();
            let probe = is_quiet.then_some(Choice::Probe);
            let spare = || self.fill(now_us).map(|turn| Choice::Schedule(turn.members));
            return probe.or_else(spare).map(|choice| (choice, false));
        };
        if let Some(turn) = turn.filter(|turn| turn.score == most) {
            return Some((Choice::Schedule(turn.members), turn.is_overdue));
        }
        if identify == Some(most) {
            return Some((Choice::Identify, true));
        }
        if refresh == Some(most) {
            let waited = now_us >= self.refresh_at_us + ONE_OFF_INTERVAL_US;
            return Some((Choice::Refresh, waited));
        }
        let waited = front.is_some_and(|front| {
            front
                .since_us
                .is_some_and(|since_us| now_us >= since_us + ONE_OFF_INTERVAL_US)
        });
        Some((Choice::OneOff, waited))
    }

    fn fill(&self, now_us: u64) -> Option<super::schedule::Turn> {
        let pause_us = self.fill_pause_us()?;
        self.turns.fill(now_us, pause_us, self.batches())
    }

    /// Time between two of the same fast request with spare slots, when those are used.
    pub(super) fn fill_pause_us(&self) -> Option<u64> {
        1_000_000_u64.checked_div(self.config.fill_hz.into())
    }

    pub(super) fn batches(&self) -> bool {
        self.identity
            .as_ref()
            .is_some_and(|identity| identity.has_multiple_msp)
    }

    /// Appends the frame for `choice` to `out` and remembers what was asked.
    pub(super) fn send(
        &mut self,
        now_us: u64,
        choice: Choice,
        out: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        let is_rc = matches!(choice, Choice::Rc);
        self.rc_streak = if is_rc {
            self.rc_streak.saturating_add(1)
        } else {
            0
        };
        let mut payload: ArrayVec<u8, MAX_REQUEST> = ArrayVec::new();
        let (command, origin) = match choice {
            Choice::Rc => {
                let channels_us = self.rc.take().map(|rc| rc.channels_us).unwrap_or_default();
                payload.extend(channels_us.iter().flat_map(|us| us.to_le_bytes()));
                self.statistics.rc_sent += 1;
                (command::SET_RAW_RC, Origin::Rc)
            }
            Choice::Identify => {
                let identify = self.identify.get_or_insert_with(|| Identify::new(now_us));
                identify.tries += 1;
                (identify.command(), Origin::Identify)
            }
            Choice::Probe => (command::API_VERSION, Origin::Probe),
            Choice::Refresh => (self.refresh_command, Origin::Refresh),
            Choice::Sync => (SYNC, Origin::Sync),
            Choice::OneOff => {
                let Some(front) = self.one_offs.front_mut() else {
                    return Ok(());
                };
                front.tries += 1;
                payload.clone_from(&front.payload);
                (front.command, Origin::OneOff)
            }
            Choice::Schedule(mut members) => {
                members.truncate(MAX_BATCH);
                self.turns.on_sent(now_us, &members);
                let command = match members.as_slice() {
                    [alone] => *alone,
                    batch => {
                        // Only commands below 255 go into a batch.
                        payload.extend(
                            batch
                                .iter()
                                .filter_map(|&command| u8::try_from(command).ok()),
                        );
                        command::MULTIPLE_MSP
                    }
                };
                (command, Origin::Schedule(members))
            }
        };
        let timeout_us = match &origin {
            Origin::Rc => self.config.rc_timeout_us,
            Origin::OneOff if blocks(command) => self.config.blocking_us,
            _ => self.config.timeout_us,
        };
        if blocks(command) {
            self.patience_until_us = now_us + self.config.blocking_us;
        }
        let waiting = Outstanding {
            command,
            origin,
            sent_us: now_us,
            timeout_us,
        };
        // Room is certain: at most four requests, RC above them and a blocking one.
        let queued = self.outstanding.try_push(waiting);
        debug_assert!(queued.is_ok());
        self.statistics.sent += 1;
        let framing = if command > 254 {
            Framing::V2
        } else {
            self.config.framing
        };
        encode(framing, Direction::Request, command, &payload, out)
    }
}
