//! Frames of a component behind us, from its link to the stations, without a detour through the core.
//!
//! Only the plain case is decided here: the endpoint routes (`?route=on`), who speaks there may do everything, and nothing is signed
//! anywhere. Then a frame of right checksum goes to every other link as it came. Everything else, and the way back, is
//! [`Ground`](crate::autopilot::ground::Ground)'s.

use super::net::Outlet;
use crate::gcs::LinkId;
use crate::gcs::access::{self, Access, LinkPolicy, Role};
use mavlink_dialect::{Address, Decoder, FrameView};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU16, Ordering};
use std::sync::{Arc, Mutex};

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
    /// SETUP_SIGNING has given a key.
    is_signed: Arc<AtomicBool>,
    us: Arc<AtomicU16>,
    links: Arc<Mutex<BTreeMap<LinkId, Outlet>>>,
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
            is_signed: Arc::default(),
            us: Arc::new(AtomicU16::new(0)),
            links: Arc::default(),
        }
    }

    /// Our own address: what comes back from there is an echo.
    pub fn set_us(&self, us: Address) {
        let word = u16::from(us.system) << 8 | u16::from(us.component);
        self.us.store(word, Ordering::Relaxed);
    }

    /// Frames must be signed, or no longer.
    pub fn set_signed(&self, is_signed: bool) {
        self.is_signed.store(is_signed, Ordering::Relaxed);
    }

    /// True if frames of routed links are passed on here as long as nothing is signed.
    #[must_use]
    pub const fn is_plain(&self) -> bool {
        self.is_plain
    }

    /// A link came up or went.
    pub fn set(&self, link: LinkId, outlet: Option<Outlet>) {
        // Nobody panics while holding it.
        let Ok(mut links) = self.links.lock() else {
            return;
        };
        match outlet {
            Some(outlet) => drop(links.insert(link, outlet)),
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
            untold_s: 1.0,
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
    /// Since the core was told something.
    untold_s: f64,
}

impl Passing {
    /// Passes on what is whole.
    pub fn take(&mut self, bytes: &[u8]) -> Taken {
        let mut taken = Taken::default();
        if self.routes.is_signed.load(Ordering::Relaxed) {
            taken.is_served = true;
            return taken;
        }
        let us = self.routes.us.load(Ordering::Relaxed);
        let Ok(links) = self.routes.links.lock() else {
            return taken;
        };
        let link = self.link;
        self.decoder.push_views(bytes, |view: FrameView<'_>| {
            taken.is_served |= access::is_served(view.id);
            let from = u16::from(view.from.system) << 8 | u16::from(view.from.component);
            if from == us || matches!(view.id, RADIO_STATUS | SETUP_SIGNING) || view.is_signed {
                return;
            }
            for (_, outlet) in links.iter().filter(|(to, _)| **to != link) {
                taken.dropped += u64::from(!outlet.send(view.wire));
            }
        });
        taken
    }

    /// True if the core shall hear of this too; `since_s` since it was asked last. Of what no service takes a datagram a second is enough to
    /// know that somebody is there: waking the core costs more than passing a frame on.
    pub fn for_core(&mut self, since_s: f64, is_served: bool) -> bool {
        self.untold_s += since_s;
        self.tokens = (self.tokens + since_s * TO_CORE_HZ).min(BURST);
        let may = self.tokens >= 1.0 && (is_served || self.untold_s >= 1.0);
        if may {
            self.tokens -= 1.0;
            self.untold_s = 0.0;
        }
        may
    }
}

/// What became of bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Taken {
    /// Frames that found no room.
    pub dropped: u64,
    /// Some service of the core takes messages like these.
    pub is_served: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_dialect::FrameBytes;
    use mavlink_dialect::{Encoder, raw};
    use tokio::sync::mpsc::Receiver;

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
        let (to_behind, mut at_behind) = Outlet::of(16);
        let (to_station, mut at_station) = Outlet::of(4);
        routes.set(behind, Some(to_behind));
        routes.set(station, Some(to_station));
        let mut passing = routes.of(behind).unwrap();
        assert_eq!(passing.take(&beat(1, 154)).dropped, 0);
        assert_eq!(passing.take(&beat(1, 1)).dropped, 0);
        let mut broken = beat(1, 154);
        broken[11] ^= 1;
        passing.take(&broken);
        assert_eq!((count(&mut at_station), count(&mut at_behind)), (1, 0));
        let many: Vec<u8> = (0..6).flat_map(|_| beat(1, 154)).collect();
        assert_eq!(
            passing.take(&many).dropped,
            2,
            "a full queue costs what does not fit"
        );
        routes.set(station, None);
        assert_eq!(passing.take(&many).dropped, 0);
        routes.set_signed(true);
        passing.take(&many);
        assert_eq!(count(&mut at_station), 4, "signed: the core passes it on");
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
        let heard = (0..100_000)
            .filter(|_| passing.for_core(1e-5, true))
            .count();
        assert!((1_450..=1_510).contains(&heard), "{heard}");
        assert!(!passing.for_core(0.9, false) && passing.for_core(0.2, false));
    }
}
