//! Messages of the mission protocol: which they are, and ours.

use super::super::{Destination, Outbox, Peer};
use mavlink_dialect::mission_item::{MissionItem, mission_result};
use mavlink_dialect::{Address, raw};
use planner::mission::PlanFault;

pub(super) const fn is_mission_message(m: &raw::MavMessage) -> bool {
    use raw::MavMessage as M;
    matches!(
        m,
        M::MISSION_COUNT(_)
            | M::MISSION_REQUEST_LIST(_)
            | M::MISSION_REQUEST_INT(_)
            | M::MISSION_REQUEST(_)
            | M::MISSION_CLEAR_ALL(_)
            | M::MISSION_ACK(_)
    )
}

/// MAV_MISSION_TYPE of a message of the mission protocol; none for any other message.
pub(super) const fn type_of(m: &raw::MavMessage) -> Option<u8> {
    use raw::MavMessage as M;
    Some(match m {
        M::MISSION_COUNT(m) => m.mission_type,
        M::MISSION_ITEM_INT(m) => m.mission_type,
        M::MISSION_ITEM(m) => m.mission_type,
        M::MISSION_REQUEST_LIST(m) => m.mission_type,
        M::MISSION_REQUEST_INT(m) => m.mission_type,
        M::MISSION_REQUEST(m) => m.mission_type,
        M::MISSION_CLEAR_ALL(m) => m.mission_type,
        M::MISSION_ACK(m) => m.mission_type,
        M::MISSION_WRITE_PARTIAL_LIST(m) => m.mission_type,
        M::MISSION_REQUEST_PARTIAL_LIST(m) => m.mission_type,
        _ => return None,
    })
}

pub(super) fn ask_for(client: Peer, seq: u16, mission_type: u8, out: &mut Outbox) {
    let Address { system, component } = client.address;
    let request = raw::MISSION_REQUEST_INT_DATA {
        seq,
        target_system: system,
        target_component: component,
        mission_type,
    };
    out.send_raw(
        Destination::All,
        raw::MavMessage::MISSION_REQUEST_INT(request),
    );
}

pub(super) fn ack(client: Peer, result: u8, mission_type: u8, id: u32, out: &mut Outbox) {
    let Address { system, component } = client.address;
    let ack = raw::MISSION_ACK_DATA {
        target_system: system,
        target_component: component,
        mavtype: result,
        mission_type,
        opaque_id: id,
    };
    out.send_raw(Destination::All, raw::MavMessage::MISSION_ACK(ack));
}

/// Code for MISSION_ACK of what the planner found.
pub(super) const fn result_of(fault: &PlanFault) -> u8 {
    match fault {
        PlanFault::Empty | PlanFault::Number(_) => mission_result::INVALID,
        PlanFault::TooLong(_) => mission_result::NO_SPACE,
        PlanFault::NoSuchItem(_) => mission_result::INVALID_PARAM1,
        PlanFault::Height { .. } => mission_result::INVALID_PARAM7,
        PlanFault::Place(_) => mission_result::INVALID_PARAM5_X,
    }
}

/// FNV-1a over the items, never 0 for a plan with items: 0 says "no plan".
pub(super) fn fingerprint(items: &[MissionItem]) -> u32 {
    if items.is_empty() {
        return 0;
    }
    let hash = items
        .iter()
        .flat_map(MissionItem::bytes)
        .fold(0x811C_9DC5_u32, |hash, byte| {
            (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
        });
    hash.max(1)
}
