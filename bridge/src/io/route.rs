//! Frames of a component behind us, from its link to the stations, without a detour through the core.
//!
//! Only the plain case is decided here: the endpoint routes (`?route=on`), who speaks there may do everything, and nothing is signed
//! anywhere. Then a frame of right checksum goes to every other link as it came. Everything else, and the way back, is
//! [`Ground`](crate::autopilot::ground::Ground)'s.

use crate::gcs::LinkId;
use crate::gcs::access::{Access, LinkPolicy, Role};
use mavlink_dialect::{Address, Decoder, FrameBytes, FrameView};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::{Arc, Mutex};
use tokio::sync::mpsc::Sender;

const RADIO_STATUS: u32 = 109;
const SETUP_SIGNING: u32 = 256;
/// What a component may say to the core a second, and at once; more is for the stations alone.
pub const TO_CORE_HZ: f64 = 500.0;
const BURST: f64 = 1_000.0;

/// The links there are, and where frames from each go.
#[derive(Clone, Debug)]
pub struct Routes {
    access: Arc<Access>,
    is_plain: bool,
    us: Arc<AtomicU16>,
    links: Arc<Mutex<BTreeMap<LinkId, Sender<FrameBytes>>>>,
}

impl Routes {
    /// For endpoints with these policies.
    #[must_use]
    pub fn new(policies: Vec<LinkPolicy>) -> Self {
        let is_plain =
            policies.iter().all(|p| p.key.is_none()) && policies.iter().any(|p| p.is_routed);
        Self {
            access: Arc::new(Access::new(policies)),
            is_plain,
            us: Arc::new(AtomicU16::new(0)),
            links: Arc::default(),
        }
    }

    /// Our own address: what comes back from there is an echo.
    pub fn set_us(&self, us: Address) {
        let word = u16::from(us.system) << 8 | u16::from(us.component);
        self.us.store(word, Ordering::Relaxed);
    }

    /// True if frames of routed links are passed on here.
    #[must_use]
    pub const fn is_plain(&self) -> bool {
        self.is_plain
    }

    /// A link came up or went.
    pub fn set(&self, link: LinkId, sender: Option<Sender<FrameBytes>>) {
        // Nobody panics while holding it.
        let Ok(mut links) = self.links.lock() else {
            return;
        };
        match sender {
            Some(sender) => drop(links.insert(link, sender)),
            None => drop(links.remove(&link)),
        }
    }

    /// What passes frames of a link on; none if the core does.
    #[must_use]
    pub fn of(&self, link: LinkId) -> Option<Passing> {
        let may = self.is_plain
            && self.access.is_routed(link)
            && self.access.role(link) == Role::Engineer;
        may.then(|| Passing {
            routes: self.clone(),
            link,
            decoder: Decoder::new(),
            tokens: BURST,
        })
    }
}

/// Passes frames of one link on.
#[derive(Debug)]
pub struct Passing {
    routes: Routes,
    link: LinkId,
    decoder: Decoder,
    tokens: f64,
}

impl Passing {
    /// Passes on what is whole; how many frames found no room.
    pub fn take(&mut self, bytes: &[u8]) -> u64 {
        let us = self.routes.us.load(Ordering::Relaxed);
        let Ok(links) = self.routes.links.lock() else {
            return 0;
        };
        let (link, mut dropped) = (self.link, 0);
        self.decoder.push_views(bytes, |view: FrameView<'_>| {
            let from = u16::from(view.from.system) << 8 | u16::from(view.from.component);
            if from == us || matches!(view.id, RADIO_STATUS | SETUP_SIGNING) || view.is_signed {
                return;
            }
            for (_, sender) in links.iter().filter(|(to, _)| **to != link) {
                let frame = FrameBytes::try_from(view.wire).unwrap_or_default();
                dropped += u64::from(sender.try_send(frame).is_err());
            }
        });
        dropped
    }

    /// True if the core shall hear of this too; `since_s` since it was asked last.
    pub fn for_core(&mut self, since_s: f64) -> bool {
        self.tokens = (self.tokens + since_s * TO_CORE_HZ).min(BURST);
        let may = self.tokens >= 1.0;
        if may {
            self.tokens -= 1.0;
        }
        may
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_dialect::{Encoder, raw};
    use tokio::sync::mpsc::{Receiver, channel};

    fn routes(key: bool) -> Routes {
        let routed = LinkPolicy {
            is_routed: true,
            ..LinkPolicy::default()
        };
        let open = LinkPolicy {
            key: key.then(|| mavlink_dialect::signing::SigningKey::from_passphrase("x")),
            ..LinkPolicy::default()
        };
        Routes::new(vec![open, routed])
    }

    fn beat(system: u8, component: u8) -> FrameBytes {
        let from = Address { system, component };
        Encoder::new(from).encode(&raw::HEARTBEAT_DATA::default())
    }

    fn count(receiver: &mut Receiver<FrameBytes>) -> usize {
        core::iter::from_fn(|| receiver.try_recv().ok()).count()
    }

    #[test]
    fn a_companions_frames_reach_every_other_link_and_echoes_none() {
        let routes = routes(false);
        routes.set_us(Address {
            system: 1,
            component: 1,
        });
        let (behind, station) = (LinkId::of(1, 1), LinkId::of(0, 2));
        let (to_behind, mut at_behind) = channel(16);
        let (to_station, mut at_station) = channel(4);
        routes.set(behind, Some(to_behind));
        routes.set(station, Some(to_station));
        let mut passing = routes.of(behind).unwrap();
        assert_eq!(passing.take(&beat(1, 154)), 0);
        assert_eq!(passing.take(&beat(1, 1)), 0);
        let mut broken = beat(1, 154);
        broken[11] ^= 1;
        passing.take(&broken);
        assert_eq!((count(&mut at_station), count(&mut at_behind)), (1, 0));
        let many: Vec<u8> = (0..6).flat_map(|_| beat(1, 154)).collect();
        assert_eq!(
            passing.take(&many),
            2,
            "a full queue costs what does not fit"
        );
        routes.set(station, None);
        assert_eq!(passing.take(&many), 0);
    }

    #[test]
    fn where_something_is_signed_or_nobody_routes_the_core_decides() {
        assert!(routes(true).of(LinkId::of(1, 1)).is_none());
        assert!(routes(false).of(LinkId::of(0, 1)).is_none());
        assert!(
            routes(false).of(LinkId::of(1, 1).remote()).is_none(),
            "a viewer"
        );
    }

    #[test]
    fn the_core_hears_so_much_a_second_and_no_more() {
        let mut passing = routes(false).of(LinkId::of(1, 1)).unwrap();
        let heard = (0..100_000).filter(|_| passing.for_core(1e-5)).count();
        assert!((1_450..=1_510).contains(&heard), "{heard}");
    }
}
