//! LOG_REQUEST_*: no logs are served over MAVLink yet; clients are told that the list is empty.

use super::{Destination, Outbox, Peer};
use mavlink_dialect::Message;
use mavlink_dialect::standard::{LOG_DATA_DATA, LOG_ENTRY_DATA, MavMessage};

/// Answers a log request; anything else is left alone.
pub fn handle(from: Peer, message: &Message, out: &mut Outbox) {
    let answer = match message {
        Message::Standard(MavMessage::LOG_REQUEST_LIST(_)) => {
            MavMessage::LOG_ENTRY(LOG_ENTRY_DATA::default())
        }
        // No bytes at this offset: the end of the log.
        Message::Standard(MavMessage::LOG_REQUEST_DATA(m)) => MavMessage::LOG_DATA(LOG_DATA_DATA {
            ofs: m.ofs,
            id: m.id,
            count: 0,
            data: [0; 90],
        }),
        _ => return,
    };
    out.send(Destination::Link(from.link), answer);
}
