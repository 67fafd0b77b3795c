//! The groups of REQUEST_DATA_STREAM, MAV_DATA_STREAM, as ArduPilot fills them: MAVProxy and dronekit ask so.
//!
//! Messages that are on request only stay so, except where their group is asked for by name.

use super::table::TABLE;

const ALL: u8 = 0;

/// Group and what belongs to it.
const GROUPS: [(u8, &[u32]); 7] = [
    (1, &[26, 27, 105]),
    (2, &[1, 24, 42, 147]),
    (3, &[65]),
    (6, &[32, 33, 331]),
    (10, &[30, 31]),
    (11, &[74, 141]),
    (12, &[2, 132, 230, 330]),
];

/// Ids of a group; nothing for one we have nothing for.
pub(super) fn members(group: u8) -> impl Iterator<Item = u32> {
    let named = GROUPS
        .iter()
        .filter(move |(g, _)| *g == group)
        .flat_map(|(_, ids)| ids.iter().copied());
    let on_by_default = TABLE
        .iter()
        .filter(move |row| group == ALL && row.period_us > 0)
        .map(|row| row.id)
        .filter(|id| GROUPS.iter().any(|(_, ids)| ids.contains(id)));
    named.chain(on_by_default)
}

#[cfg(test)]
mod tests {
    use super::super::table::index_of;
    use super::*;

    #[test]
    fn every_member_is_a_message_we_send() {
        for (_, ids) in GROUPS {
            assert!(ids.iter().all(|id| index_of(*id).is_some()), "{ids:?}");
        }
        assert!(members(ALL).count() > 10);
        assert_eq!(members(10).collect::<Vec<_>>(), [30, 31]);
        assert_eq!(members(99).count(), 0);
    }
}
