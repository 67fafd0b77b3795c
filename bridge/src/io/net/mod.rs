//! MAVLink links on a thread of their own: bytes in, bytes out, through bounded queues.
//!
//! Every UDP peer, TCP connection and serial port is a link. Datagrams of a peer that was not heard before make a link;
//! after [`PEER_SILENT`] without one the link is gone. The thread ends when the [`Links`] handle is dropped.

//!
//! | File | Has |
//! | --- | --- |
//! | `open.rs` | endpoints bound before the thread starts, so that errors reach the user at once |
//! | `hub.rs` | what every link's task knows; links that join from elsewhere |
//! | `outlet.rs` | the way out of a link: its queue, or straight into its socket |
//! | `udp.rs`, `stream.rs` | datagrams; TCP connections and serial ports |

mod hub;
mod open;
mod outlet;
mod stream;
mod udp;

pub use self::hub::{Joined, Joint};
pub use self::open::{OpenError, Wanted};
pub use self::outlet::Outlet;

use self::hub::{Hub, Register};
use self::open::Bound;
use super::lockstep::our_address;
use super::route::Routes;
use crate::autopilot::ground::Ground;
use crate::gcs::signing::KEY_DOCUMENT;
use crate::gcs::{Document, LinkId};
use mavlink_dialect::FrameBytes;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc as std_mpsc;
use std::time::Duration;
use tokio::sync::mpsc;

/// A UDP peer silent for this long is forgotten.
pub const PEER_SILENT: Duration = Duration::from_secs(20);
/// A peer silent for this long goes when all places are taken and somebody new speaks.
pub const MAKES_ROOM: Duration = Duration::from_secs(3);
/// Peers of one UDP socket at most: a flood of invented addresses costs them, not us.
const MAX_PEERS: usize = 16;
/// Messages that wait for the core at most; more are dropped and counted.
const TO_CORE: usize = 1024;
/// Frames that wait for one link at most; more are dropped (telemetry is sent again anyway).
const TO_LINK: usize = 1024;
/// Pause before a lost TCP or serial peer is tried again.
const RETRY: Duration = Duration::from_secs(1);

/// What the links tell the core.
#[derive(Clone, Debug)]
pub enum LinkEvent {
    /// A link is there.
    Up(LinkId),
    /// A link is gone.
    Down(LinkId),
    /// Bytes came.
    Bytes {
        /// From which link.
        link: LinkId,
        /// What.
        bytes: Vec<u8>,
        /// One datagram, complete in itself.
        is_datagram: bool,
    },
}

/// A set of open links; dropping it closes them.
#[derive(Debug)]
pub struct Links {
    events: std_mpsc::Receiver<LinkEvent>,
    outgoing: mpsc::Sender<(LinkId, FrameBytes)>,
    dropped: Arc<AtomicU64>,
    joint: Joint,
    routes: Routes,
    /// What was opened, for people.
    pub described: Vec<String>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Links {
    /// Opens all endpoints.
    ///
    /// # Errors
    /// [`OpenError`] names the endpoint and what to do.
    pub fn open(wanted: &[Wanted]) -> Result<Self, OpenError> {
        let mut bound = Vec::new();
        let mut described = Vec::new();
        for w in wanted {
            let (b, text) = open::bind(w)?;
            bound.push(b);
            described.push(text);
        }
        let (to_core, events) = std_mpsc::sync_channel(TO_CORE);
        let (outgoing, mut from_core) = mpsc::channel::<(LinkId, FrameBytes)>(4 * TO_LINK);
        let dropped = Arc::new(AtomicU64::new(0));
        let routes = Routes::new(wanted.iter().map(|w| w.policy.clone()).collect());
        let hub = Hub::new(routes.clone(), to_core, Arc::clone(&dropped));
        let (register, mut registered) = mpsc::channel(64);
        let joint = Joint::new(&hub, &register);
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(OpenError::Thread)?;
        let thread = std::thread::Builder::new()
            .name("links".to_owned())
            .spawn(move || {
                runtime.block_on(async move {
                    for (b, endpoint) in bound.into_iter().zip(0..) {
                        serve(b, &hub.of(endpoint), &register);
                    }
                    // Keeps the table of links; ends when the handle is dropped.
                    let mut outlets: BTreeMap<LinkId, Outlet> = BTreeMap::new();
                    loop {
                        tokio::select! {
                            new = registered.recv() => match new {
                                Some((id, Some(outlet))) => {
                                    hub.routes.set(id, Some(outlet.clone()));
                                    outlets.insert(id, outlet);
                                    hub.tell(LinkEvent::Up(id));
                                }
                                Some((id, None)) => {
                                    hub.routes.set(id, None);
                                    outlets.remove(&id);
                                    hub.tell(LinkEvent::Down(id));
                                }
                                None => break,
                            },
                            out = from_core.recv() => match out {
                                Some((id, frame)) => {
                                    if let Some(outlet) = outlets.get(&id)
                                        && !outlet.send(&frame) {
                                        hub.dropped.fetch_add(1, Ordering::Relaxed);
                                    }
                                }
                                None => break,
                            },
                        }
                    }
                    // Let what was just queued reach the sockets.
                    drop(outlets);
                    tokio::time::sleep(Duration::from_millis(20)).await;
                });
            })
            .map_err(OpenError::Thread)?;
        Ok(Self {
            events,
            outgoing,
            dropped,
            joint,
            routes,
            described,
            thread: Some(thread),
        })
    }

    /// Agrees with the core on who passes frames of components behind us on.
    pub fn route_for(&self, ground: &mut Ground) {
        self.routes.set_us(our_address(ground.settings()));
        self.routes.set_signed(ground.has_given_key());
        ground.set_shell_routes(self.routes.is_plain());
    }

    /// A document is kept. If it is a key by SETUP_SIGNING, frames are passed on by the core from now on, which can sign.
    pub fn note(&self, document: &Document) {
        if document.name == KEY_DOCUMENT {
            self.routes.set_signed(!document.bytes.is_empty());
        }
    }

    /// The next thing that happened, without waiting.
    #[must_use]
    pub fn poll(&self) -> Option<LinkEvent> {
        self.events.try_recv().ok()
    }

    /// The next thing that happens within a time.
    #[must_use]
    pub fn wait(&self, at_most: Duration) -> Option<LinkEvent> {
        self.events.recv_timeout(at_most).ok()
    }

    /// Sends a frame; dropped and counted if the network thread is behind.
    pub fn send(&self, link: LinkId, frame: FrameBytes) {
        if self.outgoing.try_send((link, frame)).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Where other parts of the shell join links of their own.
    #[must_use]
    pub fn joint(&self) -> Joint {
        self.joint.clone()
    }

    /// Frames and datagrams dropped because a queue was full.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

impl Drop for Links {
    fn drop(&mut self) {
        // Closing the channel ends the thread's loop.
        let (closed, _) = mpsc::channel(1);
        self.outgoing = closed;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Starts the task of an endpoint.
fn serve(bound: Bound, hub: &Hub, register: &Register) {
    let (hub, register) = (hub.clone(), register.clone());
    match bound {
        Bound::UdpServer(socket) => tokio::spawn(udp::server(socket, hub, register)),
        Bound::UdpBroadcast(socket, to) => tokio::spawn(udp::broadcast(socket, to, hub, register)),
        Bound::UdpClient(socket, to) => tokio::spawn(udp::client(socket, to, hub, register)),
        Bound::TcpServer(listener) => tokio::spawn(stream::tcp_server(listener, hub, register)),
        Bound::TcpClient(to) => tokio::spawn(stream::tcp_client(to, hub, register)),
        Bound::Serial { device, baud } => tokio::spawn(stream::serial(device, baud, hub, register)),
    };
}
