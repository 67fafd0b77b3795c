//! What every link's task knows, and links that join from elsewhere.

use super::super::route::{Passing, Routes};
use super::{LinkEvent, Outlet};
use crate::gcs::LinkId;
use mavlink_dialect::FrameBytes;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc as std_mpsc;
use tokio::sync::mpsc;
use tokio::time::Instant;

/// What every link task knows.
#[derive(Clone, Debug)]
pub(super) struct Hub {
    pub(super) routes: Routes,
    to_core: std_mpsc::SyncSender<LinkEvent>,
    pub(super) dropped: Arc<AtomicU64>,
    next_link: Arc<AtomicU32>,
    /// Number of the endpoint, for [`LinkId::of`].
    endpoint: u8,
}

/// What passes frames on, and when the core was last told.
pub(super) type Passed = Option<(Passing, Instant)>;
/// Where a link that came up says how to reach it, and one that went that it is gone.
pub(super) type Register = mpsc::Sender<(LinkId, Option<Outlet>)>;

impl Hub {
    pub(super) fn new(
        routes: Routes,
        to_core: std_mpsc::SyncSender<LinkEvent>,
        dropped: Arc<AtomicU64>,
    ) -> Self {
        Self {
            routes,
            to_core,
            dropped,
            next_link: Arc::new(AtomicU32::new(1)),
            endpoint: 0,
        }
    }

    /// The same for another endpoint.
    pub(super) fn of(&self, endpoint: u8) -> Self {
        Self {
            endpoint,
            ..self.clone()
        }
    }

    /// A fresh link to a peer; none = a line without an address.
    pub(super) fn link(&self, peer: Option<SocketAddr>) -> LinkId {
        let link = LinkId::of(
            self.endpoint,
            self.next_link.fetch_add(1, Ordering::Relaxed),
        );
        if peer.is_some_and(|p| !p.ip().to_canonical().is_loopback()) {
            link.remote()
        } else {
            link
        }
    }

    /// Bytes of a link: passed on if it routes, and told to the core.
    pub(super) fn bytes(
        &self,
        link: LinkId,
        passing: &mut Passed,
        bytes: &[u8],
        is_datagram: bool,
    ) {
        if let Some((passing, asked)) = passing {
            let taken = passing.take(bytes);
            self.dropped.fetch_add(taken.dropped, Ordering::Relaxed);
            let now = Instant::now();
            let since = now.duration_since(*asked).as_secs_f64();
            *asked = now;
            // Of a stream nothing may be left out: a frame continues in the next piece.
            if !passing.for_core(since, taken.is_served) && is_datagram {
                return;
            }
        }
        self.tell(LinkEvent::Bytes {
            link,
            bytes: bytes.to_vec(),
            is_datagram,
        });
    }

    /// What passes frames of a link on, if it routes.
    pub(super) fn passing(&self, link: LinkId) -> Passed {
        self.routes.of(link).map(|p| (p, Instant::now()))
    }

    /// Never waits: a core that is behind loses datagrams, as a network does.
    pub(super) fn tell(&self, event: LinkEvent) {
        if self.to_core.try_send(event).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Number of the endpoint that joined links belong to.
const JOINED: u8 = u8::MAX;

/// Where a link joins that is opened elsewhere: a page of the console.
#[derive(Clone, Debug)]
pub struct Joint {
    hub: Hub,
    register: Register,
}

/// A link that joined; it must [`leave`](Joined::leave).
#[derive(Debug)]
pub struct Joined {
    /// Its number.
    pub link: LinkId,
    hub: Hub,
    register: Register,
}

impl Joint {
    pub(super) fn new(hub: &Hub, register: &Register) -> Self {
        Self {
            hub: hub.of(JOINED),
            register: register.clone(),
        }
    }

    /// A new link, and the frames that are to be sent on it; none if the links are closed.
    pub async fn join(&self) -> Option<(Joined, mpsc::Receiver<FrameBytes>)> {
        let link = self.hub.link(None);
        let (outlet, frames) = Outlet::new();
        self.register.send((link, Some(outlet))).await.ok()?;
        let joined = Joined {
            link,
            hub: self.hub.clone(),
            register: self.register.clone(),
        };
        Some((joined, frames))
    }
}

impl Joined {
    /// Whole frames came; dropped and counted if the core is behind.
    pub fn frames(&self, bytes: Vec<u8>) {
        self.hub.tell(LinkEvent::Bytes {
            link: self.link,
            bytes,
            is_datagram: true,
        });
    }

    /// The link is gone.
    pub async fn leave(self) {
        let _ = self.register.send((self.link, None)).await;
    }
}
