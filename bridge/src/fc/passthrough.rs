//! A configurator on the controller's line: its bytes pass, as long as the controller is disarmed.
//!
//! ```text
//! look: disarmed? -> pass bytes both ways, counting requests and answers -> at a pause, or when it is time, look again
//!                    command line opened with `#`: nothing is asked in between until MSP speaks again
//! armed -> the client is sent away; a motor that it turned is stopped
//! ```
//!
//! The controller answers in order, so a question of ours put in while nothing is unanswered gets the next status answer;
//! the client never sees it. A client that polls the status itself is not disturbed at all: its answers are looked at.

use msp::firmware::box_id;
use msp::message::{Reply, SetMotor};
use msp::{Accept, Decoder, Direction, Framing, Identity, Message as _, command};
use std::collections::VecDeque;
use std::time::Duration;
use vehicle::Timestamp;

/// A status older than this is asked for again.
const LOOK: Duration = Duration::from_secs(1);
/// Time for our question. A controller that restarts or saves is silent for longer, and armed it does neither.
const ANSWER: Duration = Duration::from_millis(500);
/// A request unanswered for so long is lost; half a frame of the client likewise.
const LOST: Duration = Duration::from_secs(1);

/// What the shell must do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// Write to the controller.
    ToController(Vec<u8>),
    /// Write to the client.
    ToClient(Vec<u8>),
    /// The controller is armed: send the client away.
    Armed,
}

/// The line lent to one client.
#[derive(Debug)]
pub struct Passthrough {
    identity: Identity,
    from_client: Decoder,
    from_controller: Decoder,
    steps: VecDeque<Step>,
    /// Requests of the client that are not answered yet.
    unanswered: u32,
    /// When the client sent last.
    client_spoke: Timestamp,
    /// When the controller was seen disarmed last.
    seen: Option<Timestamp>,
    /// Our question is out until then.
    looking_until: Option<Timestamp>,
    /// Not before this: the last question had no answer.
    not_before: Timestamp,
    in_command_line: bool,
    is_armed: bool,
    motors_turn: bool,
}

impl Passthrough {
    /// For a controller that has said who it is.
    #[must_use]
    pub fn new(now: Timestamp, identity: Identity) -> Self {
        let mut this = Self {
            identity,
            from_client: Decoder::new(Accept::Requests),
            from_controller: Decoder::new(Accept::Replies),
            steps: VecDeque::new(),
            unanswered: 0,
            client_spoke: now,
            seen: None,
            looking_until: None,
            not_before: now,
            in_command_line: false,
            is_armed: false,
            motors_turn: false,
        };
        this.tick(now);
        this
    }

    /// Whether bytes of the client may be taken now. While not, leave them in the socket.
    #[must_use]
    pub fn takes(&self, now: Timestamp) -> bool {
        if self.in_command_line {
            return true;
        }
        let is_fresh = self.seen.is_some_and(|seen| now.since(seen) <= LOOK);
        // Half a frame is let through to its end, else ours would fall into it.
        self.looking_until.is_none()
            && self.seen.is_some()
            && (is_fresh || self.from_client.has_partial() || now < self.not_before)
    }

    /// Bytes of the client.
    pub fn client(&mut self, now: Timestamp, bytes: &[u8]) {
        self.client_spoke = now;
        for byte in bytes {
            if self.in_command_line {
                break;
            }
            // `#` outside a frame opens the text command line.
            if *byte == b'#' && !self.from_client.has_partial() {
                self.in_command_line = true;
                self.unanswered = 0;
                break;
            }
            if let Some(frame) = self.from_client.decode(&mut core::slice::from_ref(byte)) {
                self.unanswered += 1;
                if frame.command == command::SET_MOTOR
                    && let Ok(order) = SetMotor::parse(frame.payload)
                {
                    self.motors_turn = order.motors_us.iter().any(|us| *us > 1000);
                }
            }
        }
        self.steps.push_back(Step::ToController(bytes.to_vec()));
    }

    /// Bytes of the controller.
    pub fn controller(&mut self, now: Timestamp, mut bytes: &[u8]) {
        if self.looking_until.is_none() || self.in_command_line {
            self.steps.push_back(Step::ToClient(bytes.to_vec()));
        }
        while let Some(frame) = self.from_controller.decode(&mut bytes) {
            let is_status = frame.command == self.identity.status_command();
            let is_ours = is_status && self.looking_until.is_some();
            if self.in_command_line {
                // It speaks MSP again.
                self.in_command_line = false;
                self.unanswered = 0;
                self.from_client.clear();
            } else if !is_ours {
                self.unanswered = self.unanswered.saturating_sub(1);
            }
            if is_status
                && frame.direction == Direction::Reply
                && let Ok(status) = Reply::parse(frame.command, frame.payload)
            {
                if self.identity.is_box_active(box_id::ARM, &status) == Some(true) {
                    self.is_armed = true;
                } else {
                    self.seen = Some(now);
                }
            }
            if is_ours {
                self.looking_until = None;
            } else if self.looking_until.is_some() {
                // An answer so late that it was given up: the client may still want it.
                let mut late = Vec::new();
                if frame.encode(&mut late).is_ok() {
                    self.steps.push_back(Step::ToClient(late));
                }
            }
        }
        if self.is_armed {
            self.steps.push_back(Step::Armed);
        }
        self.tick(now);
    }

    /// Time passes.
    pub fn tick(&mut self, now: Timestamp) {
        if self.in_command_line || self.is_armed {
            return;
        }
        if now.since(self.client_spoke) > LOST {
            self.unanswered = 0;
            self.from_client.clear();
            if self.looking_until.is_none() {
                self.from_controller.clear();
            }
        }
        if let Some(until) = self.looking_until {
            if now < until {
                return;
            }
            // Silent: it saves or restarts. What began is no answer any more.
            self.looking_until = None;
            self.from_controller.clear();
            self.not_before = now + LOOK;
        }
        let is_due = self.seen.is_none_or(|seen| now.since(seen) >= LOOK);
        let is_between_frames =
            !self.from_client.has_partial() && !self.from_controller.has_partial();
        let may = self.unanswered == 0 && is_between_frames && now >= self.not_before;
        if is_due && may {
            let command = self.identity.status_command();
            let framing = if command < 255 {
                Framing::V1
            } else {
                Framing::V2
            };
            let mut question = Vec::new();
            if msp::encode(framing, Direction::Request, command, &[], &mut question).is_ok() {
                self.steps.push_back(Step::ToController(question));
                self.looking_until = Some(now + ANSWER);
            }
        }
    }

    /// What to do next.
    pub fn poll(&mut self) -> Option<Step> {
        self.steps.pop_front()
    }

    /// Whether the client left a motor turning: MSP_SET_MOTOR holds for ever, so somebody must stop it.
    #[must_use]
    pub const fn motors_turn(&self) -> bool {
        self.motors_turn
    }

    /// Whether the client has the text command line open: somebody must leave it.
    #[must_use]
    pub const fn in_command_line(&self) -> bool {
        self.in_command_line
    }

    /// When [`tick`](Self::tick) has something to do at the latest.
    #[must_use]
    pub fn deadline(&self, now: Timestamp) -> Timestamp {
        let look = self.seen.map_or(now, |seen| seen + LOOK);
        let next = self.looking_until.unwrap_or(look).max(now);
        next.max(now + Duration::from_millis(5)).min(now + LOOK)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fc::conversation::Controller as _;
    use crate::fc::setup::survey::identify;
    use crate::fc::setup::test_controller::TestController;
    use proptest::prelude::*;

    const ATTITUDE_QUESTION: &[u8] = b"$M<\x00\x6c\x6c";

    fn frame(direction: Direction, command: u16, payload: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        msp::encode(Framing::V1, direction, command, payload, &mut out).unwrap();
        out
    }

    fn status(is_armed: bool) -> Vec<u8> {
        let mut controller = TestController::betaflight();
        controller.is_armed = is_armed;
        let payload = controller.ask(command::STATUS_EX, &[]).unwrap();
        frame(Direction::Reply, command::STATUS_EX, &payload)
    }

    fn begin() -> Passthrough {
        let identity = identify(&mut TestController::betaflight()).unwrap();
        Passthrough::new(Timestamp::ZERO, identity)
    }

    /// With the first look answered.
    fn open() -> Passthrough {
        let mut pass = begin();
        let question = frame(Direction::Request, command::STATUS_EX, &[]);
        assert_eq!(pass.poll(), Some(Step::ToController(question)));
        pass.controller(ms(5), &status(false));
        assert_eq!(pass.poll(), None, "the client hears nothing of it");
        pass
    }

    const fn ms(ms: u64) -> Timestamp {
        Timestamp::from_ms(ms)
    }

    #[test]
    fn nothing_of_the_client_passes_before_the_controller_was_seen_disarmed() {
        let mut pass = begin();
        assert!(!pass.takes(ms(0)));
        pass.controller(ms(5), &status(false));
        assert!(pass.takes(ms(5)));
    }

    #[test]
    fn an_armed_controller_sends_the_client_away() {
        let mut pass = begin();
        pass.poll();
        pass.controller(ms(5), &status(true));
        assert_eq!(pass.poll(), Some(Step::Armed));
        assert!(!pass.takes(ms(5)));
    }

    #[test]
    fn bytes_pass_as_they_are_both_ways() {
        let mut pass = open();
        pass.client(ms(10), ATTITUDE_QUESTION);
        assert_eq!(
            pass.poll(),
            Some(Step::ToController(ATTITUDE_QUESTION.to_vec()))
        );
        let answer = frame(Direction::Reply, command::ATTITUDE, &[0; 6]);
        for half in answer.chunks(5) {
            pass.controller(ms(12), half);
            assert_eq!(pass.poll(), Some(Step::ToClient(half.to_vec())));
        }
        assert_eq!(pass.poll(), None);
    }

    #[test]
    fn a_look_waits_until_the_client_is_answered_and_holds_its_next_request_back() {
        let mut pass = open();
        pass.client(ms(1000), ATTITUDE_QUESTION);
        pass.poll();
        pass.tick(ms(1100));
        assert_eq!(pass.poll(), None, "an answer is outstanding");
        assert!(!pass.takes(ms(1100)), "it is time to look");
        pass.controller(
            ms(1101),
            &frame(Direction::Reply, command::ATTITUDE, &[0; 6]),
        );
        assert!(matches!(pass.poll(), Some(Step::ToClient(_))));
        assert!(matches!(pass.poll(), Some(Step::ToController(_))));
        assert!(!pass.takes(ms(1101)));
        pass.controller(ms(1105), &status(false));
        assert_eq!(pass.poll(), None);
        assert!(pass.takes(ms(1105)));
    }

    #[test]
    fn a_client_that_polls_the_status_itself_is_not_disturbed_and_still_watched() {
        let mut pass = open();
        for t in (100..3000).step_by(250) {
            assert!(pass.takes(ms(t)));
            pass.client(ms(t), &frame(Direction::Request, command::STATUS_EX, &[]));
            assert!(matches!(pass.poll(), Some(Step::ToController(_))));
            pass.controller(ms(t + 5), &status(false));
            assert!(matches!(pass.poll(), Some(Step::ToClient(_))));
            assert_eq!(pass.poll(), None);
        }
        pass.client(
            ms(3100),
            &frame(Direction::Request, command::STATUS_EX, &[]),
        );
        pass.controller(ms(3105), &status(true));
        let steps: Vec<Step> = core::iter::from_fn(|| pass.poll()).collect();
        assert_eq!(steps.last(), Some(&Step::Armed));
    }

    #[test]
    fn the_command_line_is_left_alone_until_msp_speaks_again() {
        let mut pass = open();
        pass.client(ms(100), b"#\r\nstatus\r\n");
        pass.poll();
        for t in (200..20_000).step_by(500) {
            pass.tick(ms(t));
            assert_eq!(pass.poll(), None);
            assert!(pass.takes(ms(t)));
        }
        let text = b"\r\nEntering CLI Mode\r\n# ";
        pass.controller(ms(20_000), text);
        assert_eq!(pass.poll(), Some(Step::ToClient(text.to_vec())));
        pass.client(ms(21_000), b"exit\r\n");
        pass.poll();
        pass.controller(
            ms(24_000),
            &frame(Direction::Reply, command::API_VERSION, &[0, 1, 47]),
        );
        assert!(matches!(pass.poll(), Some(Step::ToClient(_))));
        assert!(
            matches!(pass.poll(), Some(Step::ToController(_))),
            "looks again"
        );
    }

    #[test]
    fn a_hash_inside_a_frame_opens_nothing() {
        let mut pass = open();
        // MSP 35 is `#`.
        pass.client(ms(10), &frame(Direction::Request, 35, b"#####"));
        pass.controller(ms(12), &frame(Direction::Reply, 35, &[]));
        while pass.poll().is_some() {}
        pass.tick(ms(1100));
        assert!(matches!(pass.poll(), Some(Step::ToController(_))));
    }

    #[test]
    fn a_controller_that_restarts_is_waited_for_with_the_client_passing() {
        let mut pass = open();
        pass.tick(ms(1100));
        pass.poll();
        pass.tick(ms(1700));
        assert_eq!(pass.poll(), None);
        assert!(pass.takes(ms(1700)), "silent is not armed");
        pass.tick(ms(2800));
        assert!(
            matches!(pass.poll(), Some(Step::ToController(_))),
            "asks again"
        );
    }

    #[test]
    fn a_motor_left_turning_is_known() {
        let mut pass = open();
        let motors = |us: u16| {
            frame(
                Direction::Request,
                command::SET_MOTOR,
                &us.to_le_bytes().repeat(8),
            )
        };
        pass.client(ms(10), &motors(1080));
        assert!(pass.motors_turn());
        pass.client(ms(20), &motors(1000));
        assert!(!pass.motors_turn());
    }

    proptest! {
        #[test]
        fn every_byte_of_the_client_passes_in_order_whatever_it_is(
            pieces in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 1..20), 1..20),
        ) {
            let mut pass = open();
            let mut passed = Vec::new();
            for piece in &pieces {
                pass.client(ms(10), piece);
                while let Some(Step::ToController(bytes)) = pass.poll() {
                    passed.extend(bytes);
                }
            }
            prop_assert_eq!(passed, pieces.concat());
        }
    }
}
