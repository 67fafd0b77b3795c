//! MAVLink links on a thread of their own: bytes in, bytes out, through bounded queues.
//!
//! Every UDP peer, TCP connection and serial port is a link. Datagrams of a peer that was not heard before make a link;
//! after [`PEER_SILENT`] without one the link is gone. The thread ends when the [`Links`] handle is dropped.

use super::endpoint::Endpoint;
use super::route::{Passing, Routes};
use crate::gcs::LinkId;
use crate::gcs::access::LinkPolicy;
use mavlink_dialect::{Address, FrameBytes};
use std::collections::BTreeMap;
use std::io;
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc as std_mpsc;
use std::time::Duration;
use thiserror::Error;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_serial::SerialPortBuilderExt as _;

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

/// Why a link could not be opened.
#[derive(Debug, Error)]
pub enum OpenError {
    /// Address not known.
    #[error("{endpoint}: cannot find that address: {reason}")]
    Address {
        /// Asked for.
        endpoint: Endpoint,
        /// Reason.
        reason: io::Error,
    },
    /// Port taken or not allowed.
    #[error("{endpoint}: {reason}{}", if reason.kind() == io::ErrorKind::AddrInUse { ": stop the other program or name another port" } else { "" })]
    Bind {
        /// Asked for.
        endpoint: Endpoint,
        /// Reason.
        reason: io::Error,
    },
    /// The network thread could not be started.
    #[error("cannot start the network thread: {0}")]
    Thread(io::Error),
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

/// One endpoint to open.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Where.
    pub endpoint: Endpoint,
    /// A default: if its port is taken, the next free one is used.
    pub is_default: bool,
    /// What its links may do.
    pub policy: LinkPolicy,
}

/// A socket bound before the thread starts, so that errors reach the user at once.
enum Bound {
    UdpServer(std::net::UdpSocket),
    UdpClient(std::net::UdpSocket, SocketAddr),
    UdpBroadcast(std::net::UdpSocket, SocketAddr),
    TcpServer(std::net::TcpListener),
    TcpClient(String),
    Serial { device: String, baud: u32 },
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
            let (b, text) = bind(w)?;
            bound.push(b);
            described.push(text + &told(&w.policy));
        }
        let (to_core, events) = std_mpsc::sync_channel(TO_CORE);
        let (outgoing, mut from_core) = mpsc::channel::<(LinkId, FrameBytes)>(4 * TO_LINK);
        let dropped = Arc::new(AtomicU64::new(0));
        let routes = Routes::new(wanted.iter().map(|w| w.policy.clone()).collect());
        let hub = Hub {
            routes: routes.clone(),
            to_core,
            dropped: Arc::clone(&dropped),
            next_link: Arc::new(AtomicU32::new(1)),
            endpoint: 0,
        };
        let (register, mut registered) = mpsc::channel(64);
        let joint = Joint {
            hub: Hub {
                endpoint: JOINED,
                ..hub.clone()
            },
            register: register.clone(),
        };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(OpenError::Thread)?;
        let thread = std::thread::Builder::new()
            .name("links".to_owned())
            .spawn(move || {
                runtime.block_on(async move {
                    for (b, endpoint) in bound.into_iter().zip(0..) {
                        let hub = Hub {
                            endpoint,
                            ..hub.clone()
                        };
                        serve(b, &hub, &register);
                    }
                    // Keeps the table of links; ends when the handle is dropped.
                    let mut senders: BTreeMap<LinkId, mpsc::Sender<FrameBytes>> = BTreeMap::new();
                    loop {
                        tokio::select! {
                            new = registered.recv() => match new {
                                Some((id, Some(sender))) => {
                                    hub.routes.set(id, Some(sender.clone()));
                                    senders.insert(id, sender);
                                    hub.tell(LinkEvent::Up(id));
                                }
                                Some((id, None)) => {
                                    hub.routes.set(id, None);
                                    senders.remove(&id);
                                    hub.tell(LinkEvent::Down(id));
                                }
                                None => break,
                            },
                            out = from_core.recv() => match out {
                                Some((id, frame)) => {
                                    if let Some(sender) = senders.get(&id)
                                        && sender.try_send(frame).is_err() {
                                        hub.dropped.fetch_add(1, Ordering::Relaxed);
                                    }
                                }
                                None => break,
                            },
                        }
                    }
                    // Let what was just queued reach the sockets.
                    drop(senders);
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

    /// Tells our own address; true if frames of components behind us are passed on here and not by the core.
    #[must_use]
    pub fn routes_as(&self, us: Address) -> bool {
        self.routes.set_us(us);
        self.routes.is_plain()
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
    /// A new link, and the frames that are to be sent on it; none if the links are closed.
    pub async fn join(&self) -> Option<(Joined, mpsc::Receiver<FrameBytes>)> {
        let link = self.hub.link(None);
        let (sender, frames) = mpsc::channel(TO_LINK);
        self.register.send((link, Some(sender))).await.ok()?;
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

/// What was said about an endpoint, for people.
fn told(policy: &LinkPolicy) -> String {
    let mut words = Vec::new();
    if policy.key.is_some() {
        words.push("signed".to_owned());
    }
    if let Some(role) = policy.role {
        words.push(format!("role {role}"));
    }
    if let Some(rate) = policy.rate_bytes_per_s {
        words.push(format!("{rate:.0} B/s"));
    }
    if policy.is_routed {
        words.push("routed".to_owned());
    }
    if words.is_empty() {
        String::new()
    } else {
        format!(" ({})", words.join(", "))
    }
}

fn bind(w: &Wanted) -> Result<(Bound, String), OpenError> {
    let endpoint = &w.endpoint;
    let resolve = |text: &str| -> Result<SocketAddr, OpenError> {
        let address = |reason| OpenError::Address {
            endpoint: endpoint.clone(),
            reason,
        };
        let mut found = text.to_socket_addrs().map_err(address)?;
        found
            .next()
            .ok_or_else(|| address(io::Error::from(io::ErrorKind::NotFound)))
    };
    let failed = |reason| OpenError::Bind {
        endpoint: endpoint.clone(),
        reason,
    };
    // A default port in use gives the next free one; a named one is an error.
    let tries = if w.is_default { 32 } else { 1 };
    match endpoint {
        Endpoint::UdpServer(a) => {
            let (socket, at) =
                next_free(resolve(a)?, tries, std::net::UdpSocket::bind).map_err(failed)?;
            Ok((
                Bound::UdpServer(socket),
                format!("udpserver://{at}{}", instead_of(endpoint, at)),
            ))
        }
        Endpoint::TcpServer(a) => {
            let (socket, at) =
                next_free(resolve(a)?, tries, std::net::TcpListener::bind).map_err(failed)?;
            Ok((
                Bound::TcpServer(socket),
                format!("tcpserver://{at}{}", instead_of(endpoint, at)),
            ))
        }
        Endpoint::UdpClient(a) => {
            let to = resolve(a)?;
            let any: SocketAddr = if to.is_ipv4() {
                ([0, 0, 0, 0], 0).into()
            } else {
                ([0u16; 8], 0).into()
            };
            let socket = std::net::UdpSocket::bind(any).map_err(failed)?;
            Ok((Bound::UdpClient(socket, to), format!("udpclient://{to}")))
        }
        Endpoint::UdpBroadcast(a) => {
            let to = resolve(a)?;
            let socket = std::net::UdpSocket::bind((std::net::Ipv4Addr::UNSPECIFIED, 0))
                .and_then(|s| s.set_broadcast(true).map(|()| s))
                .map_err(failed)?;
            Ok((
                Bound::UdpBroadcast(socket, to),
                format!("udpbroadcast://{to}"),
            ))
        }
        Endpoint::TcpClient(a) => Ok((Bound::TcpClient(a.clone()), endpoint.to_string())),
        Endpoint::Serial { device, baud } => {
            // Opened once here so that a wrong name is told at once; the thread opens it for good.
            tokio_serial::new(device, *baud).open().map_err(|e| {
                failed(io::Error::other(format!(
                    "{}: check the name and the cable",
                    e.description
                )))
            })?;
            Ok((
                Bound::Serial {
                    device: device.clone(),
                    baud: *baud,
                },
                endpoint.to_string(),
            ))
        }
    }
}

/// Words for a default port that was taken.
fn instead_of(wanted: &Endpoint, got: SocketAddr) -> String {
    let wanted = wanted.to_string();
    if wanted.ends_with(&format!(":{}", got.port())) {
        String::new()
    } else {
        let port = wanted.rsplit(':').next().unwrap_or_default();
        format!(" (port {port} is in use)")
    }
}

fn next_free<S>(
    at: SocketAddr,
    tries: u16,
    bind: impl Fn(SocketAddr) -> io::Result<S>,
) -> io::Result<(S, SocketAddr)> {
    let mut address = at;
    let mut result = bind(address);
    for step in 1..tries {
        match &result {
            Err(e) if e.kind() == io::ErrorKind::AddrInUse => {}
            _ => break,
        }
        address.set_port(at.port().saturating_add(step));
        result = bind(address);
    }
    result.map(|socket| (socket, address))
}

/// What every link task knows.
#[derive(Clone, Debug)]
struct Hub {
    routes: Routes,
    to_core: std_mpsc::SyncSender<LinkEvent>,
    dropped: Arc<AtomicU64>,
    next_link: Arc<AtomicU32>,
    /// Number of the endpoint, for [`LinkId::of`].
    endpoint: u8,
}

/// What passes frames on, and when the core was last told.
type Passed = Option<(Passing, Instant)>;
type Register = mpsc::Sender<(LinkId, Option<mpsc::Sender<FrameBytes>>)>;

impl Hub {
    /// A fresh link to a peer; none = a line without an address.
    fn link(&self, peer: Option<SocketAddr>) -> LinkId {
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
    fn bytes(&self, link: LinkId, passing: &mut Passed, bytes: &[u8], is_datagram: bool) {
        if let Some((passing, asked)) = passing {
            let lost = passing.take(bytes);
            self.dropped.fetch_add(lost, Ordering::Relaxed);
            let now = Instant::now();
            let since = now.duration_since(*asked).as_secs_f64();
            *asked = now;
            // Of a stream nothing may be left out: a frame continues in the next piece.
            if !passing.for_core(since) && is_datagram {
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
    fn passing(&self, link: LinkId) -> Passed {
        self.routes.of(link).map(|p| (p, Instant::now()))
    }

    /// Never waits: a core that is behind loses datagrams, as a network does.
    fn tell(&self, event: LinkEvent) {
        if self.to_core.try_send(event).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

fn serve(bound: Bound, hub: &Hub, register: &Register) {
    let (hub, register) = (hub.clone(), register.clone());
    match bound {
        Bound::UdpServer(socket) => {
            tokio::spawn(async move {
                if let Ok(socket) = adopt_udp(socket) {
                    udp_server(socket, hub, register, &AtomicU64::new(0)).await;
                }
            });
        }
        Bound::UdpBroadcast(socket, to) => {
            tokio::spawn(async move {
                if let Ok(socket) = adopt_udp(socket) {
                    udp_broadcast(socket, to, hub, register).await;
                }
            });
        }
        Bound::UdpClient(socket, to) => {
            tokio::spawn(async move {
                if let Ok(socket) = adopt_udp(socket) {
                    udp_client(socket, to, hub, register).await;
                }
            });
        }
        Bound::TcpServer(listener) => {
            tokio::spawn(async move {
                let listener = listener
                    .set_nonblocking(true)
                    .and_then(|()| TcpListener::from_std(listener));
                let Ok(listener) = listener else { return };
                while let Ok((stream, peer)) = listener.accept().await {
                    let _ = stream.set_nodelay(true);
                    tokio::spawn(stream_link(
                        stream,
                        Some(peer),
                        hub.clone(),
                        register.clone(),
                    ));
                }
            });
        }
        Bound::TcpClient(to) => {
            tokio::spawn(async move {
                loop {
                    if let Ok(stream) = TcpStream::connect(&to).await {
                        let _ = stream.set_nodelay(true);
                        let peer = stream.peer_addr().ok();
                        stream_link(stream, peer, hub.clone(), register.clone()).await;
                    }
                    tokio::time::sleep(RETRY).await;
                }
            });
        }
        Bound::Serial { device, baud } => {
            tokio::spawn(async move {
                loop {
                    if let Ok(port) = tokio_serial::new(&device, baud).open_native_async() {
                        stream_link(port, None, hub.clone(), register.clone()).await;
                    }
                    tokio::time::sleep(RETRY).await;
                }
            });
        }
    }
}

fn adopt_udp(socket: std::net::UdpSocket) -> io::Result<Arc<UdpSocket>> {
    socket.set_nonblocking(true)?;
    UdpSocket::from_std(socket).map(Arc::new)
}

/// Sends a link's frames as datagrams until its queue is closed.
fn udp_sender(socket: Arc<UdpSocket>, to: SocketAddr) -> mpsc::Sender<FrameBytes> {
    let (sender, mut frames) = mpsc::channel::<FrameBytes>(TO_LINK);
    tokio::spawn(async move {
        while let Some(frame) = frames.recv().await {
            // Nobody listening yet (ECONNREFUSED) is no reason to stop.
            let _ = socket.send_to(&frame, to).await;
        }
    });
    sender
}

/// Heartbeats go out to everybody while nobody has answered; who answers is a peer as of a server.
async fn udp_broadcast(socket: Arc<UdpSocket>, to: SocketAddr, hub: Hub, register: Register) {
    let present = Arc::new(AtomicU64::new(0));
    let (sender, mut frames) = mpsc::channel::<FrameBytes>(TO_LINK);
    let (out, answered) = (Arc::clone(&socket), Arc::clone(&present));
    tokio::spawn(async move {
        while let Some(frame) = frames.recv().await {
            // Of version 2, as every frame of ours: the id is in bytes 7 to 9.
            let is_heartbeat = frame.get(7..10) == Some(&[0, 0, 0]);
            if is_heartbeat && answered.load(Ordering::Relaxed) == 0 {
                // No network yet is no reason to stop.
                let _ = out.send_to(&frame, to).await;
            }
        }
    });
    if register
        .send((hub.link(Some(to)), Some(sender)))
        .await
        .is_ok()
    {
        udp_server(socket, hub, register, &present).await;
    }
}

async fn udp_server(socket: Arc<UdpSocket>, hub: Hub, register: Register, present: &AtomicU64) {
    let mut peers: BTreeMap<SocketAddr, (LinkId, Instant, Passed)> = BTreeMap::new();
    let mut buffer = vec![0u8; 65_536];
    let mut sweep = tokio::time::interval(Duration::from_secs(1));
    loop {
        tokio::select! {
            got = socket.recv_from(&mut buffer) => {
                let Ok((n, from)) = got else { continue };
                let now = Instant::now();
                if !peers.contains_key(&from) {
                    if peers.len() >= MAX_PEERS {
                        // A station beats every second: who has not spoken for three makes room for who does.
                        let quiet = peers.iter().max_by_key(|(_, (_, at, _))| at.elapsed());
                        let quiet = quiet.filter(|(_, (_, at, _))| at.elapsed() > MAKES_ROOM).map(|(a, _)| *a);
                        let Some((link, ..)) = quiet.and_then(|a| peers.remove(&a)) else {
                            hub.dropped.fetch_add(1, Ordering::Relaxed);
                            continue;
                        };
                        if register.send((link, None)).await.is_err() {
                            return;
                        }
                    }
                    let link = hub.link(Some(from));
                    if register.send((link, Some(udp_sender(Arc::clone(&socket), from)))).await.is_err() {
                        return;
                    }
                    peers.insert(from, (link, now, hub.passing(link)));
                    present.store(peers.len() as u64, Ordering::Relaxed);
                    // The table announces the link before its first bytes are passed on.
                    tokio::task::yield_now().await;
                }
                if let Some((link, heard, passing)) = peers.get_mut(&from) {
                    *heard = now;
                    hub.bytes(*link, passing, &buffer[..n], true);
                }
            }
            _ = sweep.tick() => {
                let silent: Vec<SocketAddr> =
                    peers.iter().filter(|(_, (_, at, _))| at.elapsed() > PEER_SILENT).map(|(a, _)| *a).collect();
                for address in silent {
                    present.store(peers.len() as u64 - 1, Ordering::Relaxed);
                    if let Some((link, ..)) = peers.remove(&address)
                        && register.send((link, None)).await.is_err() {
                        return;
                    }
                }
            }
        }
    }
}

async fn udp_client(socket: Arc<UdpSocket>, to: SocketAddr, hub: Hub, register: Register) {
    let link = hub.link(Some(to));
    if register
        .send((link, Some(udp_sender(Arc::clone(&socket), to))))
        .await
        .is_err()
    {
        return;
    }
    let mut passing = hub.passing(link);
    let mut buffer = vec![0u8; 65_536];
    loop {
        match socket.recv_from(&mut buffer).await {
            Ok((n, _)) => hub.bytes(link, &mut passing, &buffer[..n], true),
            // A refused datagram comes back as an error of the next receive.
            Err(_) => tokio::time::sleep(Duration::from_millis(10)).await,
        }
    }
}

/// One byte stream from open to close.
async fn stream_link<S: AsyncRead + AsyncWrite + Send + 'static>(
    stream: S,
    peer: Option<SocketAddr>,
    hub: Hub,
    register: Register,
) {
    let link = hub.link(peer);
    let (mut read, mut write) = tokio::io::split(stream);
    let (sender, mut frames) = mpsc::channel::<FrameBytes>(TO_LINK);
    if register.send((link, Some(sender))).await.is_err() {
        return;
    }
    let writer = tokio::spawn(async move {
        while let Some(frame) = frames.recv().await {
            if write.write_all(&frame).await.is_err() {
                return;
            }
        }
    });
    let mut passing = hub.passing(link);
    let mut buffer = vec![0u8; 4096];
    while let Ok(n) = read.read(&mut buffer).await {
        if n == 0 {
            break;
        }
        hub.bytes(link, &mut passing, &buffer[..n], false);
    }
    writer.abort();
    let _ = register.send((link, None)).await;
}
