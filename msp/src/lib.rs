//! MultiWii Serial Protocol (MSP) without I/O: frames, messages in wire units, and both ends of the
//! conversation as plain state machines driven from outside. It speaks to Betaflight, INAV,
//! Cleanflight and MultiWii.
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`frame`] | delimiters, lengths, checksums: push [`Decoder`] and [`encode`] for v1, v1 jumbo, v2 and v2 over v1 |
//! | [`command`] | command numbers and their names |
//! | [`message`] | one typed struct per payload, in **wire units** (`_ddeg`, `_cm`, `_dv`...): [`Message::parse`] and [`Message::emit`] |
//! | [`pattern`] | payloads by a pattern like `"3h"`, without a struct |
//! | [`firmware`] | who answers, and what differs: scales, channel order, mode boxes, arming blockers |
//! | [`client`] | the asking side: identification, poll schedule, RC output, time-outs, link health |
//! | [`server`] | the answering side, for simulators and tests |
//!
//! Nothing here reads a clock, opens a port or converts to SI. Nothing allocates after construction
//! and no byte from a line can make it panic.
//!
//! # Example
//!
//! ```
//! use msp::frame::{Accept, Decoder, Direction, Framing, encode};
//! use msp::message::{Attitude, Message};
//! use msp::command;
//!
//! // A flight controller answers: 10 degrees right, 2 degrees nose up, heading west.
//! let attitude = Attitude { roll_ddeg: 100, pitch_ddeg: -20, yaw_deg: 270 };
//! let (mut payload, mut wire) = (Vec::new(), Vec::new());
//! attitude.emit(&mut payload);
//! encode(Framing::V1, Direction::Reply, command::ATTITUDE, &payload, &mut wire)?;
//!
//! let mut decoder = Decoder::new(Accept::Replies);
//! let mut input = wire.as_slice();
//! let frame = decoder.decode(&mut input).expect("one whole frame went in");
//! assert_eq!(frame.command, command::ATTITUDE);
//! assert_eq!(Attitude::parse(frame.payload)?, attitude);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # References
//!
//! - MultiWii wiki, "MultiWii Serial Protocol" (v1 and the original messages).
//! - INAV wiki, "MSP V2" (v2 frames, CRC-8/DVB-S2, encapsulation in v1).
//! - The `msp_protocol*.h` headers of Betaflight and INAV (command numbers).

pub mod client;
pub mod command;
pub mod firmware;
pub mod frame;
pub mod message;
pub mod pattern;
pub mod server;
mod wire;

pub use client::Client;
pub use firmware::{Firmware, Identity};
pub use frame::{Accept, Decoder, Direction, Frame, Framing, encode};
pub use message::{Message, Order, Reply};
pub use server::Server;
pub use wire::{LongText, ParseError, ShortText};
