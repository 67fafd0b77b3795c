//! Links over datagrams: a peer each.

use super::hub::{Hub, Passed, Register};
use super::{MAKES_ROOM, MAX_PEERS, Outlet, PEER_SILENT};
use crate::gcs::LinkId;
use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::net::UdpSocket;
use tokio::time::Instant;

/// Longest datagram.
const LONGEST: usize = 65_536;
/// Datagrams taken in one go before other tasks have their turn.
const AT_ONCE: usize = 64;

fn adopt(socket: std::net::UdpSocket) -> io::Result<Arc<UdpSocket>> {
    socket.set_nonblocking(true)?;
    UdpSocket::from_std(socket).map(Arc::new)
}

/// Heartbeats go out to everybody while nobody has answered; who answers is a peer as of a server.
pub(super) async fn broadcast(
    socket: std::net::UdpSocket,
    to: SocketAddr,
    hub: Hub,
    register: Register,
) {
    let Ok(socket) = adopt(socket) else { return };
    let present = Arc::new(AtomicU64::new(0));
    let (outlet, mut frames) = Outlet::new();
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
        .send((hub.link(Some(to)), Some(outlet)))
        .await
        .is_ok()
    {
        Server::new(socket, hub, register, present).run().await;
    }
}

/// Every sender is a link.
pub(super) async fn server(socket: std::net::UdpSocket, hub: Hub, register: Register) {
    let Ok(socket) = adopt(socket) else { return };
    Server::new(socket, hub, register, Arc::default())
        .run()
        .await;
}

/// A peer of a server.
struct Peer {
    link: LinkId,
    heard: Instant,
    passing: Passed,
}

struct Server {
    socket: Arc<UdpSocket>,
    hub: Hub,
    register: Register,
    peers: BTreeMap<SocketAddr, Peer>,
    /// How many there are.
    present: Arc<AtomicU64>,
}

/// The links are closed.
struct Closed;

impl Server {
    const fn new(
        socket: Arc<UdpSocket>,
        hub: Hub,
        register: Register,
        present: Arc<AtomicU64>,
    ) -> Self {
        Self {
            socket,
            hub,
            register,
            peers: BTreeMap::new(),
            present,
        }
    }

    async fn run(mut self) {
        let mut buffer = vec![0u8; LONGEST];
        let mut sweep = tokio::time::interval(Duration::from_secs(1));
        loop {
            let done = tokio::select! {
                ready = self.socket.readable() => match ready {
                    Ok(()) => self.take(&mut buffer).await,
                    Err(_) => Ok(()),
                },
                _ = sweep.tick() => self.forget().await,
            };
            if done.is_err() {
                return;
            }
        }
    }

    /// Takes what has come.
    async fn take(&mut self, buffer: &mut [u8]) -> Result<(), Closed> {
        for _ in 0..AT_ONCE {
            match self.socket.try_recv_from(buffer) {
                Ok((n, from)) => {
                    let now = Instant::now();
                    if !self.peers.contains_key(&from) && !self.welcome(now, from).await? {
                        continue;
                    }
                    if let Some(peer) = self.peers.get_mut(&from) {
                        peer.heard = now;
                        self.hub
                            .bytes(peer.link, &mut peer.passing, &buffer[..n], true);
                    }
                }
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                // A refused datagram comes back as an error of the next receive.
                Err(_) => {}
            }
        }
        // There is more: others first.
        tokio::task::yield_now().await;
        Ok(())
    }

    /// A new peer; false if there is no place for it.
    async fn welcome(&mut self, now: Instant, from: SocketAddr) -> Result<bool, Closed> {
        if self.peers.len() >= MAX_PEERS {
            // A station beats every second: who has not spoken for three makes room for who does.
            let quiet = self.peers.iter().max_by_key(|(_, p)| p.heard.elapsed());
            let quiet = quiet.filter(|(_, p)| p.heard.elapsed() > MAKES_ROOM);
            let Some(quiet) = quiet.map(|(a, _)| *a) else {
                self.hub.dropped.fetch_add(1, Ordering::Relaxed);
                return Ok(false);
            };
            self.leave(quiet).await?;
        }
        let link = self.hub.link(Some(from));
        let outlet = Outlet::udp(Arc::clone(&self.socket), from);
        let told = self.register.send((link, Some(outlet))).await;
        told.map_err(|_| Closed)?;
        let peer = Peer {
            link,
            heard: now,
            passing: self.hub.passing(link),
        };
        self.peers.insert(from, peer);
        self.count();
        // The table announces the link before its first bytes are passed on.
        tokio::task::yield_now().await;
        Ok(true)
    }

    async fn leave(&mut self, address: SocketAddr) -> Result<(), Closed> {
        let Some(peer) = self.peers.remove(&address) else {
            return Ok(());
        };
        self.count();
        let told = self.register.send((peer.link, None)).await;
        told.map_err(|_| Closed)
    }

    /// Lets silent peers go.
    async fn forget(&mut self) -> Result<(), Closed> {
        let is_silent = |p: &Peer| p.heard.elapsed() > PEER_SILENT;
        while let Some(address) = self
            .peers
            .iter()
            .find(|(_, p)| is_silent(p))
            .map(|(a, _)| *a)
        {
            self.leave(address).await?;
        }
        Ok(())
    }

    fn count(&self) {
        self.present
            .store(self.peers.len() as u64, Ordering::Relaxed);
    }
}

/// One peer, which we call.
pub(super) async fn client(
    socket: std::net::UdpSocket,
    to: SocketAddr,
    hub: Hub,
    register: Register,
) {
    let Ok(socket) = adopt(socket) else { return };
    let link = hub.link(Some(to));
    let outlet = Outlet::udp(Arc::clone(&socket), to);
    if register.send((link, Some(outlet))).await.is_err() {
        return;
    }
    let mut passing = hub.passing(link);
    let mut buffer = vec![0u8; LONGEST];
    loop {
        match socket.recv_from(&mut buffer).await {
            Ok((n, _)) => hub.bytes(link, &mut passing, &buffer[..n], true),
            // A refused datagram comes back as an error of the next receive.
            Err(_) => tokio::time::sleep(Duration::from_millis(10)).await,
        }
    }
}
