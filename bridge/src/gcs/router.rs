//! Which frames are for us, from whom, and how many on the way were lost.
//!
//! | Frame | Verdict |
//! | --- | --- |
//! | from our own address (an echo of a hub or a loop) | counted, dropped |
//! | from system 0 | counted, dropped: nobody can be answered |
//! | targeted at another system or component | counted, dropped: nothing is forwarded |
//! | more than a station can mean (token bucket per peer) | counted, dropped |
//! | else | for us |
//!
//! A HEARTBEAT of type MAV_TYPE_GCS from any system is a ground station's presence.

use super::{LinkId, Peer};
use core::time::Duration;
use mavlink_dialect::{Address, Message, raw};
use vehicle::Timestamp;

/// Most peers remembered; the one that was silent longest makes room.
pub const MAX_PEERS: usize = 64;
/// Messages a peer may send at once, beyond its rate.
const BURST: f64 = 1_000.0;
/// Messages a second a peer may send for long.
const RATE_HZ: f64 = 500.0;
/// MAV_TYPE_GCS.
const TYPE_GCS: u8 = 6;
/// A presence is passed on at most this often.
const PRESENCE_PERIOD: Duration = Duration::from_millis(500);
/// A larger step of the sequence is a peer that began anew.
const MAX_GAP: u8 = 128;
/// A step this far or farther is a step back: a frame seen before, or one that was overtaken.
const STEP_BACK: u8 = 224;

/// What to do with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Give it to the services.
    ForUs,
    /// For our camera alone.
    ForCamera,
    /// From our own address.
    Echo,
    /// Too many from this peer.
    Flood,
    /// For somebody else, or from nobody.
    NotForUs,
}

/// What was seen of one peer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeerStats {
    /// Who, on which link.
    pub peer: Peer,
    /// Frames received.
    pub received: u64,
    /// Frames missing by their sequence numbers.
    pub lost: u64,
    /// Frames dropped because there were too many.
    pub flooded: u64,
    /// True if it said that it is a ground station.
    pub is_ground_station: bool,
    /// Last frame.
    pub last: Timestamp,
}

#[derive(Debug)]
struct PeerState {
    stats: PeerStats,
    sequence: u8,
    tokens: f64,
    refilled: Timestamp,
}

/// Counters over all links.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RouterCounters {
    /// Frames for us.
    pub for_us: u64,
    /// Own echoes.
    pub echoes: u64,
    /// Frames for others.
    pub not_for_us: u64,
    /// Frames beyond a peer's rate.
    pub flooded: u64,
}

/// Judges frames and keeps count of peers.
#[derive(Debug)]
pub struct Router {
    us: Address,
    /// Another component of ours.
    camera: Option<u8>,
    peers: Vec<PeerState>,
    counters: RouterCounters,
    presence: Option<Timestamp>,
}

impl Router {
    /// A router for our address.
    #[must_use]
    pub fn new(us: Address) -> Self {
        Self {
            us,
            camera: None,
            peers: Vec::with_capacity(MAX_PEERS),
            counters: RouterCounters::default(),
            presence: None,
        }
    }

    /// There is a camera behind us, with this component id, or none.
    pub const fn set_camera(&mut self, component: Option<u8>) {
        self.camera = component;
    }

    /// Says what to do with a frame, and counts it.
    pub fn judge(
        &mut self,
        now: Timestamp,
        from: Peer,
        sequence: u8,
        message: &Message,
    ) -> Verdict {
        let is_own = |component| {
            from.address
                == Address {
                    component,
                    ..self.us
                }
        };
        if from.address == self.us || self.camera.is_some_and(is_own) {
            self.counters.echoes += 1;
            return Verdict::Echo;
        }
        if from.address.system == 0 {
            self.counters.not_for_us += 1;
            return Verdict::NotForUs;
        }
        let has_token = self.note(now, from, sequence, message);
        let (system, component) = message.target();
        let is_for_camera = component != 0
            && self.camera == Some(component)
            && (system == 0 || system == self.us.system);
        if is_for_camera && has_token {
            self.counters.for_us += 1;
            Verdict::ForCamera
        } else if !self.us.is_targeted_by(system, component) {
            self.counters.not_for_us += 1;
            Verdict::NotForUs
        } else if !has_token {
            self.counters.flooded += 1;
            Verdict::Flood
        } else {
            self.counters.for_us += 1;
            Verdict::ForUs
        }
    }

    /// True if the message is a ground station's heartbeat and the last presence was passed on a while ago.
    pub fn is_news_of_ground_station(&mut self, now: Timestamp, message: &Message) -> bool {
        let is_news = is_ground_heartbeat(message)
            && self
                .presence
                .is_none_or(|last| now.since(last) >= PRESENCE_PERIOD);
        if is_news {
            self.presence = Some(now);
        }
        is_news
    }

    /// Counters over all links.
    #[must_use]
    pub const fn counters(&self) -> &RouterCounters {
        &self.counters
    }

    /// What was seen of each peer.
    pub fn peers(&self) -> impl Iterator<Item = &PeerStats> {
        self.peers.iter().map(|p| &p.stats)
    }

    /// True if a target may be on a link: everybody is everywhere, and who was heard there is.
    #[must_use]
    pub fn is_there(&self, link: LinkId, (system, component): (u8, u8)) -> bool {
        system == 0
            || self.peers.iter().any(|p| {
                p.stats.peer.link == link && p.stats.peer.address.is_targeted_by(system, component)
            })
    }

    /// Forgets the peers of a link.
    pub fn link_down(&mut self, link: LinkId) {
        self.peers.retain(|p| p.stats.peer.link != link);
    }

    /// Counts a frame of a peer; false if it has used up its rate.
    fn note(&mut self, now: Timestamp, peer: Peer, sequence: u8, message: &Message) -> bool {
        let at = match self.peers.iter().position(|p| p.stats.peer == peer) {
            Some(at) => at,
            None => self.add(now, peer, sequence),
        };
        let p = &mut self.peers[at];
        // The number this frame should have had; the first one has it by definition.
        let gap = sequence.wrapping_sub(p.sequence.wrapping_add(1));
        if gap < MAX_GAP {
            p.stats.lost += u64::from(gap);
            p.sequence = sequence;
        } else if gap < STEP_BACK {
            p.sequence = sequence;
        }
        p.stats.received += 1;
        p.stats.last = now;
        p.stats.is_ground_station |= is_ground_heartbeat(message);
        p.tokens = (p.tokens + now.since(p.refilled).as_secs_f64() * RATE_HZ).min(BURST);
        p.refilled = now;
        if p.tokens >= 1.0 {
            p.tokens -= 1.0;
            true
        } else {
            p.stats.flooded += 1;
            false
        }
    }

    fn add(&mut self, now: Timestamp, peer: Peer, sequence: u8) -> usize {
        let state = PeerState {
            stats: PeerStats {
                peer,
                received: 0,
                lost: 0,
                flooded: 0,
                is_ground_station: false,
                last: now,
            },
            sequence: sequence.wrapping_sub(1),
            tokens: BURST,
            refilled: now,
        };
        if self.peers.len() >= MAX_PEERS
            && let Some(at) = self
                .peers
                .iter()
                .enumerate()
                .min_by_key(|(_, p)| p.stats.last)
                .map(|(at, _)| at)
        {
            self.peers[at] = state;
            return at;
        }
        self.peers.push(state);
        self.peers.len() - 1
    }
}

fn is_ground_heartbeat(message: &Message) -> bool {
    matches!(message, Message::Raw(raw::MavMessage::HEARTBEAT(beat)) if beat.mavtype == TYPE_GCS)
}

#[cfg(test)]
mod tests {
    use super::*;

    const US: Address = Address {
        system: 1,
        component: 1,
    };
    const GCS: Address = Address {
        system: 255,
        component: 190,
    };
    const LINK: LinkId = LinkId(7);

    fn judge(
        router: &mut Router,
        now: Timestamp,
        address: Address,
        sequence: u8,
        target: (u8, u8),
    ) -> Verdict {
        let command = raw::COMMAND_LONG_DATA {
            target_system: target.0,
            target_component: target.1,
            ..Default::default()
        };
        let message = raw::MavMessage::COMMAND_LONG(command).into();
        let from = Peer {
            link: LINK,
            address,
        };
        router.judge(now, from, sequence, &message)
    }

    #[test]
    fn only_our_address_and_everybody_is_for_us() {
        let mut router = Router::new(US);
        let mut judge = |from, target| judge(&mut router, Timestamp::ZERO, from, 0, target);
        assert_eq!(judge(GCS, (1, 1)), Verdict::ForUs);
        assert_eq!(judge(GCS, (0, 0)), Verdict::ForUs);
        assert_eq!(judge(GCS, (1, 0)), Verdict::ForUs);
        assert_eq!(judge(GCS, (2, 1)), Verdict::NotForUs);
        assert_eq!(judge(GCS, (1, 100)), Verdict::NotForUs);
        assert_eq!(judge(US, (1, 1)), Verdict::Echo);
        assert_eq!(
            judge(
                Address {
                    system: 0,
                    component: 0
                },
                (1, 1)
            ),
            Verdict::NotForUs
        );
    }

    #[test]
    fn gaps_of_the_sequence_are_losses_and_wrapping_is_none() {
        let mut router = Router::new(US);
        for sequence in [254, 255, 0, 1, 4, 4, 3, 5] {
            judge(&mut router, Timestamp::ZERO, GCS, sequence, (1, 1));
        }
        let stats = router.peers().next().copied().unwrap();
        assert_eq!((stats.received, stats.lost), (8, 2));
    }

    #[test]
    fn a_flood_of_one_peer_leaves_the_others_alone() {
        let mut router = Router::new(US);
        let other = Address {
            system: 254,
            component: 1,
        };
        let mut passed = 0;
        for i in 0..10_000u32 {
            let now = Timestamp::from_us(u64::from(i) * 100);
            let verdict = judge(&mut router, now, GCS, i as u8, (1, 1));
            passed += u32::from(verdict == Verdict::ForUs);
        }
        // One second: the burst and one second's rate.
        assert!((1_450..=1_510).contains(&passed), "{passed}");
        assert_eq!(
            judge(&mut router, Timestamp::from_ms(1_000), other, 0, (1, 1)),
            Verdict::ForUs
        );
        assert_eq!(router.counters().flooded, 10_000 - u64::from(passed));
    }

    #[test]
    fn strangers_do_not_fill_the_memory() {
        let mut router = Router::new(US);
        for i in 0..1_000u32 {
            let from = Address {
                system: (i % 200 + 2) as u8,
                component: (i / 200) as u8,
            };
            let now = Timestamp::from_ms(u64::from(i));
            judge(&mut router, now, from, 0, (1, 1));
        }
        assert_eq!(router.peers().count(), MAX_PEERS);
    }
}
