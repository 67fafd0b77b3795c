//! TIMESYNC and PING: answers about our clock, on the link that asked.
//!
//! TIMESYNC with `tc1 = 0` is a question: the answer carries our nanoseconds since boot in `tc1` and the asker's `ts1`
//! back. With `tc1` set it is somebody's answer, and answering it would echo for ever. PING to target 0 is answered with
//! the asker as target.

#![expect(
    deprecated,
    reason = "TIMESYNC takes PING's place, stations still send it"
)]

use super::{Destination, Outbox, Peer};
use mavlink_dialect::Message;
use mavlink_dialect::standard::{MavMessage, PING_DATA, TIMESYNC_DATA};
use vehicle::Timestamp;

/// Answers a question about the clock; anything else is left alone.
pub fn handle(now: Timestamp, from: Peer, message: &Message, out: &mut Outbox) {
    let (target_system, target_component) = (from.address.system, from.address.component);
    let answer = match message {
        Message::Standard(MavMessage::TIMESYNC(m)) if m.tc1 == 0 => {
            MavMessage::TIMESYNC(TIMESYNC_DATA {
                tc1: i64::try_from(now.us().saturating_mul(1_000)).unwrap_or(i64::MAX),
                ts1: m.ts1,
                target_system,
                target_component,
            })
        }
        Message::Standard(MavMessage::PING(m))
            if m.target_system == 0 && m.target_component == 0 =>
        {
            MavMessage::PING(PING_DATA {
                time_usec: m.time_usec,
                seq: m.seq,
                target_system,
                target_component,
            })
        }
        _ => return,
    };
    out.send(Destination::Link(from.link), answer);
}
