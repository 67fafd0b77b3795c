//! The MAVLink we speak: framing, messages, modes, addresses. Wire units only; meaning is given in `bridge/src/gcs/convert.rs`.
//!
//! | Module | Defines |
//! | --- | --- |
//! | [`codec`] | [`Decoder`] (push, resynchronising, counting) and [`Encoder`] |
//! | [`crc`] | CRC-16/MCRF4XX, sixteen bytes a step |
//! | [`export`] | our own messages as XML for other generators |
//! | [`message`] | [`Message`]: a standard message or one of ours |
//! | [`mode`] | flight modes as PX4 `custom_mode` and as standard modes |
//! | [`command`] | MAV_CMD numbers and results |
//! | [`mission_item`] | mission items typed, or the reason why not |
//! | [`signing`] | MAVLink 2 signatures: keys, checks, time stamps |
//! | [`address`] | [`Address`]: (system, component) |
//! | [`raw`] | raw twins of messages whose enumerations a peer may exceed, generated from `kestrel.xml` |
//! | [`standard`] | the standard dialect (`development`, which contains `common`) |
//!
//! ```
//! use mavlink_dialect::{Address, Decoder, Encoder, Message, raw};
//! let mut encoder = Encoder::new(Address { system: 1, component: 1 });
//! let beat = raw::HEARTBEAT_DATA { custom_mode: 7, ..Default::default() };
//! let bytes = encoder.encode(&beat);
//! let mut decoder = Decoder::new();
//! let mut got = Vec::new();
//! decoder.push(&bytes, |frame| got.push(frame));
//! assert!(matches!(&got[0].message, Message::Raw(raw::MavMessage::HEARTBEAT(b)) if b.custom_mode == 7));
//! ```

// The generated code names the core crate, which `mavlink` re-exports whole.
extern crate mavlink as mavlink_core;

pub mod address;
pub mod codec;
pub mod command;
pub mod crc;
pub mod export;
pub mod message;
pub mod mission_item;
pub mod mode;
pub mod signing;

/// The standard dialect: `development`, which contains `common`, `standard` and `minimal`.
pub use mavlink::dialects::development as standard;

#[allow(
    missing_docs,
    unreachable_pub,
    unused_qualifications,
    non_camel_case_types,
    clippy::all,
    reason = "generated code"
)]
mod generated {
    include!(concat!(env!("OUT_DIR"), "/mod.rs"));
}
/// Raw twins of standard messages and messages of our own, generated from `message_definitions/kestrel.xml`.
pub use generated::kestrel as raw;

pub use address::Address;
pub use codec::{DecodeCounters, Decoder, Encoder, Frame, FrameBytes, FrameView};
pub use mavlink::MessageData;
pub use message::Message;
