//! The answering side: what a simulator or a test needs to be a flight controller.
//!
//! [`Server`] decodes requests into a bounded queue and encodes answers in the framing of the
//! request. *When* it answers is the caller's: firmware handles at most one request per run of its
//! serial task, so a faithful fake pops one per 10 ms.
//!
//! ```
//! use msp::{Server, command, message::{Attitude, Message}};
//! let mut server = Server::new();
//! server.handle(b"$M<\x00\x6c\x6c"); // bytes from the line: MSP_ATTITUDE over v1
//! let request = server.pop().expect("one request");
//! match request.command {
//!     command::ATTITUDE => server.answer(&request, &Attitude { roll_ddeg: 1, pitch_ddeg: 2, yaw_deg: 3 }),
//!     _ => server.refuse(&request),
//! }
//! assert_eq!(server.output(), b"$M>\x06\x6c\x01\x00\x02\x00\x03\x00\x6a"); // bytes to the line
//! server.clear_output();
//! ```

use crate::frame::{Accept, Counters, Decoder, Direction, Framing, Resync, encode};
use crate::message::Message;
use arrayvec::ArrayVec;
use std::collections::VecDeque;

/// Longest request payload real firmware takes.
pub const MAX_REQUEST: usize = 192;
/// Requests that wait at most; later ones are dropped and counted.
pub const MAX_PENDING: usize = 64;

/// One request of a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// Framing to answer in.
    pub framing: Framing,
    /// v2 flag byte; bit 0: no reply wanted (INAV obeys it, Betaflight does not).
    pub flag: u8,
    /// Command number.
    pub command: u16,
    /// Payload.
    pub payload: ArrayVec<u8, MAX_REQUEST>,
}

impl Request {
    /// Reads the payload as a message, whatever the command: `request.parse::<SetRawRc>()`.
    ///
    /// # Errors
    /// [`crate::ParseError`] when the payload does not fit; firmware refuses such a request.
    pub fn parse<M: Message>(&self) -> Result<M, crate::ParseError> {
        M::parse(&self.payload)
    }
}

/// The answering side of a link. Bytes in with [`Self::handle`], requests out with [`Self::pop`],
/// answers in with [`Self::answer`], [`Self::reply`] or [`Self::refuse`], bytes out with
/// [`Self::output`].
#[derive(Clone, Debug)]
pub struct Server {
    decoder: Decoder,
    pending: VecDeque<Request>,
    dropped: u64,
    payload: Vec<u8>,
    output: Vec<u8>,
}

impl Default for Server {
    fn default() -> Self {
        Self::new()
    }
}

impl Server {
    /// A server with the limits of real firmware: 192 bytes of payload, bad frames skipped.
    #[must_use]
    pub fn new() -> Self {
        Self {
            decoder: Decoder::with_limits(Accept::Requests, Resync::Skip, MAX_REQUEST),
            pending: VecDeque::with_capacity(MAX_PENDING),
            dropped: 0,
            payload: Vec::with_capacity(1024),
            output: Vec::with_capacity(4096),
        }
    }

    /// Takes bytes from the line.
    pub fn handle(&mut self, mut bytes: &[u8]) {
        while let Some(frame) = self.decoder.decode(&mut bytes) {
            if self.pending.len() == MAX_PENDING {
                self.dropped += 1;
                continue;
            }
            self.pending.push_back(Request {
                framing: frame.framing,
                flag: frame.flag,
                command: frame.command,
                payload: frame.payload.iter().copied().take(MAX_REQUEST).collect(),
            });
        }
    }

    /// The oldest request waiting.
    pub fn pop(&mut self) -> Option<Request> {
        self.pending.pop_front()
    }

    /// Answers with a message. The command is that of the request, so a `SET_` twin may be answered
    /// with its struct.
    pub fn answer(&mut self, request: &Request, message: &impl Message) {
        self.payload.clear();
        message.emit(&mut self.payload);
        self.send(request, Direction::Reply, true);
    }

    /// Answers with a payload as it stands.
    pub fn reply(&mut self, request: &Request, payload: &[u8]) {
        self.payload.clear();
        self.payload.extend_from_slice(payload);
        self.send(request, Direction::Reply, true);
    }

    /// Acknowledges a `SET_` request: an empty reply.
    pub fn acknowledge(&mut self, request: &Request) {
        self.send(request, Direction::Reply, false);
    }

    /// Answers with an error frame: unknown command, bad argument, refused.
    pub fn refuse(&mut self, request: &Request) {
        self.send(request, Direction::Error, false);
    }

    /// Bytes for the line, in order.
    #[must_use]
    pub fn output(&self) -> &[u8] {
        &self.output
    }

    /// Forgets the bytes that have been sent.
    pub fn clear_output(&mut self) {
        self.output.clear();
    }

    /// Whether the line stopped inside a frame. A `#` outside of one opens the command line of real firmware.
    #[must_use]
    pub fn has_partial(&self) -> bool {
        self.decoder.has_partial()
    }

    /// Requests that wait.
    #[must_use]
    pub fn pending(&self) -> usize {
        self.pending.len()
    }

    /// Requests dropped because too many were waiting.
    #[must_use]
    pub const fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Frame counters.
    #[must_use]
    pub const fn counters(&self) -> &Counters {
        self.decoder.counters()
    }

    fn send(&mut self, request: &Request, direction: Direction, with_payload: bool) {
        let payload: &[u8] = if with_payload { &self.payload } else { &[] };
        // The command came out of a frame of the same framing; only a payload above 65529 bytes
        // fails, and firmware has no such.
        let encoded = encode(
            request.framing,
            direction,
            request.command,
            payload,
            &mut self.output,
        );
        debug_assert!(encoded.is_ok(), "{encoded:?}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command;
    use crate::message::{Attitude, SetRawRc};

    fn request(framing: Framing, command: u16, payload: &[u8]) -> Vec<u8> {
        let mut wire = Vec::new();
        encode(framing, Direction::Request, command, payload, &mut wire).unwrap();
        wire
    }

    #[test]
    fn answers_come_in_the_framing_of_the_request() {
        for framing in [Framing::V1, Framing::V2, Framing::V2OverV1] {
            let mut server = Server::new();
            server.handle(&request(framing, command::ATTITUDE, &[]));
            let asked = server.pop().unwrap();
            let attitude = Attitude {
                roll_ddeg: -5,
                pitch_ddeg: 7,
                yaw_deg: 359,
            };
            server.answer(&asked, &attitude);
            let mut decoder = Decoder::new(Accept::Replies);
            let frame = decoder.decode(&mut server.output()).unwrap();
            assert_eq!(
                (frame.framing, frame.direction),
                (framing, Direction::Reply)
            );
            assert_eq!(Attitude::parse(frame.payload), Ok(attitude));
        }
    }

    #[test]
    fn unknown_command_is_refused_with_an_empty_error_frame() {
        let mut server = Server::new();
        server.handle(&request(Framing::V1, 199, &[]));
        let asked = server.pop().unwrap();
        server.refuse(&asked);
        assert_eq!(server.output(), [b'$', b'M', b'!', 0, 199, 199]);
    }

    #[test]
    fn requests_wait_in_order_and_a_flood_is_dropped_not_hoarded() {
        let mut server = Server::new();
        for channel in 0..100_u8 {
            server.handle(&request(Framing::V1, command::SET_RAW_RC, &[channel, 0]));
        }
        assert_eq!(
            (server.pending(), server.dropped()),
            (MAX_PENDING, 100 - MAX_PENDING as u64)
        );
        let oldest = server.pop().unwrap().parse::<SetRawRc>().unwrap();
        assert_eq!(oldest.channels_us.as_slice(), [0]);
    }

    #[test]
    fn requests_above_192_bytes_and_frames_from_a_controller_are_dropped() {
        let mut server = Server::new();
        server.handle(&request(Framing::V1, 1, &[0; 193]));
        server.handle(b"$M>\x00\x6c\x6c");
        assert_eq!(server.pop(), None);
        assert_eq!(
            (
                server.counters().oversize,
                server.counters().wrong_direction
            ),
            (1, 1)
        );
    }
}
