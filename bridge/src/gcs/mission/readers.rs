//! Stations that are reading, each the list it was told of: a plan that changes meanwhile must not mix with it.

use super::Stored;
use arrayvec::ArrayVec;
use core::time::Duration;
use mavlink_dialect::Address;
use mavlink_dialect::mission_item::MissionItem;
use std::sync::Arc;
use vehicle::Timestamp;

/// Stations whose download is remembered, and how long.
const MOST: usize = 8;
const TIMEOUT: Duration = Duration::from_secs(10);

#[derive(Debug)]
struct Reader {
    address: Address,
    list: Arc<Stored>,
    heard_at: Timestamp,
}

/// All of them.
#[derive(Debug, Default)]
pub(super) struct Readers(ArrayVec<Reader, MOST>);

impl Readers {
    /// A station is told of a list.
    pub(super) fn begin(&mut self, now: Timestamp, address: Address, list: &Arc<Stored>) {
        self.0.retain(|r| r.address != address);
        if self.0.is_full() {
            self.0.remove(0);
        }
        self.0.push(Reader {
            address,
            list: Arc::clone(list),
            heard_at: now,
        });
    }

    /// An item as that station was told of it; of the present list if it was told of none.
    pub(super) fn item(
        &mut self,
        now: Timestamp,
        address: Address,
        seq: u16,
        present: &Stored,
    ) -> Option<MissionItem> {
        let reader = self.0.iter_mut().find(|r| r.address == address);
        let items = match reader {
            Some(reader) => {
                reader.heard_at = now;
                &reader.list.items
            }
            None => &present.items,
        };
        items.get(usize::from(seq)).copied()
    }

    /// Forgets who is silent.
    pub(super) fn tick(&mut self, now: Timestamp) {
        self.0.retain(|r| now.since(r.heard_at) < TIMEOUT);
    }
}
