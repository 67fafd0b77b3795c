//! Receiving a plan over a link that loses, repeats and reorders: we ask for each item, the station only answers.
//!
//! | What happens | What we do |
//! | --- | --- |
//! | the expected item comes | ask for the next at once |
//! | nothing for 250 ms | ask again, twice |
//! | still nothing | ask one item lower each 250 ms: a station that saw a late request may have stepped back |
//! | the lower item comes | ask upwards again, one answer at a time |
//! | an item we have comes unasked | nothing, or questions and answers would multiply |
//! | nothing for 5 s | give up |
//!
//! The stepping back is what MAVSDK 4.1.0 was measured to do: it sets its place to the item last asked for, whatever came
//! before, and ignores requests above it.

use super::super::Peer;
use core::time::Duration;
use mavlink_dialect::mission_item::MissionItem;
use vehicle::Timestamp;

/// Time between two requests for an item that does not come.
pub(super) const ASK_AGAIN: Duration = Duration::from_millis(250);
/// Silence of the station after which the upload is dropped.
pub(super) const GIVE_UP: Duration = Duration::from_secs(5);
/// Times an item is asked for again before we step back.
const PATIENCE: u8 = 2;

/// A plan on its way to us.
#[derive(Clone, Debug)]
pub(super) struct Upload {
    /// Who sends it.
    pub(super) client: Peer,
    /// Items announced, at least 1.
    pub(super) count: u16,
    /// Items received, in order.
    pub(super) items: Vec<MissionItem>,
    /// Item asked for last: the next one to receive, or a lower one after stepping back.
    asked: u16,
    asked_at: Timestamp,
    /// Times left to ask for it again.
    patience: u8,
    heard_at: Timestamp,
}

/// What follows from an item or from time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// Nothing.
    Wait,
    /// Ask for this item.
    Ask(u16),
    /// All items are here.
    Complete,
    /// The station announced fewer items.
    OutOfRange,
    /// The station is silent.
    GaveUp,
}

impl Upload {
    /// Begins; ask for item 0 now.
    pub(super) fn new(now: Timestamp, client: Peer, count: u16) -> Self {
        Self {
            client,
            count,
            items: Vec::with_capacity(usize::from(count)),
            asked: 0,
            asked_at: now,
            patience: PATIENCE,
            heard_at: now,
        }
    }

    /// The item that is missing first.
    pub(super) fn expected(&self) -> u16 {
        // At most `count` items are kept.
        self.items.len() as u16
    }

    /// Takes an item of this station.
    pub(super) fn item(&mut self, now: Timestamp, item: MissionItem) -> Step {
        self.heard_at = now;
        let expected = self.expected();
        if item.seq >= self.count {
            return Step::OutOfRange;
        }
        if item.seq == expected {
            self.items.push(item);
            if self.expected() == self.count {
                return Step::Complete;
            }
            return self.ask(now, expected + 1);
        }
        let is_step_up = item.seq < expected && item.seq == self.asked;
        if is_step_up {
            self.ask(now, item.seq + 1)
        } else {
            Step::Wait
        }
    }

    /// Takes the time.
    pub(super) fn tick(&mut self, now: Timestamp) -> Step {
        if now.since(self.heard_at) >= GIVE_UP {
            return Step::GaveUp;
        }
        if now.since(self.asked_at) < ASK_AGAIN {
            return Step::Wait;
        }
        self.asked_at = now;
        if self.patience > 0 {
            self.patience -= 1;
        } else if self.asked > 0 {
            self.asked -= 1;
        } else {
            (self.asked, self.patience) = (self.expected(), PATIENCE);
        }
        Step::Ask(self.asked)
    }

    fn ask(&mut self, now: Timestamp, seq: u16) -> Step {
        (self.asked, self.asked_at, self.patience) = (seq, now, PATIENCE);
        Step::Ask(seq)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::LinkId;
    use super::*;
    use mavlink_dialect::Address;

    const CLIENT: Peer = Peer {
        link: LinkId(1),
        address: Address {
            system: 245,
            component: 190,
        },
    };

    fn item(seq: u16) -> MissionItem {
        MissionItem {
            seq,
            ..Default::default()
        }
    }

    fn ms(ms: u64) -> Timestamp {
        Timestamp::from_ms(ms)
    }

    #[test]
    fn a_silent_station_is_asked_twice_more_then_stepped_back_for_and_given_up_after_five_seconds()
    {
        let mut up = Upload::new(ms(0), CLIENT, 9);
        for seq in 0..4 {
            assert_eq!(up.item(ms(0), item(seq)), Step::Ask(seq + 1));
        }
        let asked: Vec<u16> = (1..=7)
            .map(|i| match up.tick(ms(i * 250)) {
                Step::Ask(seq) => seq,
                other => panic!("{other:?}"),
            })
            .collect();
        assert_eq!(asked, [4, 4, 3, 2, 1, 0, 4]);
        assert_eq!(up.tick(ms(4999)), Step::Ask(4));
        assert_eq!(up.tick(ms(5000)), Step::GaveUp);
    }

    #[test]
    fn once_a_lower_item_is_answered_we_walk_up_on_its_answers_only() {
        let mut up = Upload::new(ms(0), CLIENT, 9);
        for seq in 0..4 {
            up.item(ms(0), item(seq));
        }
        for i in 1..=4 {
            up.tick(ms(i * 250));
        }
        assert_eq!(
            up.item(ms(1010), item(3)),
            Step::Wait,
            "an answer to an older question"
        );
        assert_eq!(up.item(ms(1020), item(2)), Step::Ask(3));
        assert_eq!(up.item(ms(1030), item(3)), Step::Ask(4));
        assert_eq!(up.item(ms(1040), item(3)), Step::Wait, "a duplicate");
        assert_eq!(up.item(ms(1050), item(4)), Step::Ask(5));
        assert_eq!(up.items.len(), 5);
    }

    #[test]
    fn an_item_beyond_the_announced_count_is_out_of_range_and_one_ahead_is_not_taken() {
        let mut up = Upload::new(ms(0), CLIENT, 3);
        assert_eq!(up.item(ms(0), item(2)), Step::Wait);
        assert_eq!(up.expected(), 0);
        assert_eq!(up.item(ms(0), item(3)), Step::OutOfRange);
    }
}
