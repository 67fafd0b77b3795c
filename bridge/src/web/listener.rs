//! Connections: one port for TLS and, from this machine to itself, for plain HTTP, which browsers trust there and which needs no
//! certificate to be accepted. The first byte tells which it is.
//!
//! A connection that says nothing in time, one too many from an address, one too many in all: closed.

use super::console::Server;
use super::gate::{Arrival, redirect};
use super::routes;
use axum::Extension;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;
use tokio_rustls::TlsAcceptor;

/// Connections of one address: a browser opens six, and one for its socket.
const PER_ADDRESS: usize = 64;
/// Connections in all.
const TOGETHER: usize = 256;
/// Time for the first byte, the handshake, the head of a request.
const PATIENCE: Duration = Duration::from_secs(5);
/// First byte of a TLS handshake.
const HANDSHAKE: u8 = 0x16;

/// Connections by address.
type Counts = Arc<Mutex<BTreeMap<IpAddr, usize>>>;

/// One connection's place.
struct Slot {
    counts: Counts,
    from: IpAddr,
}

impl Slot {
    fn take(counts: &Counts, from: IpAddr) -> Option<Self> {
        let mut table = counts.lock().unwrap_or_else(PoisonError::into_inner);
        let all: usize = table.values().sum();
        let own = table.entry(from).or_default();
        if *own >= PER_ADDRESS || all >= TOGETHER {
            return None;
        }
        *own += 1;
        Some(Self {
            counts: Arc::clone(counts),
            from,
        })
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let mut table = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(n) = table.get_mut(&self.from) {
            *n -= 1;
            if *n == 0 {
                table.remove(&self.from);
            }
        }
    }
}

/// Serves until the runtime ends.
pub(super) async fn run(socket: std::net::TcpListener, acceptor: TlsAcceptor, server: Arc<Server>) {
    let Ok(listener) = TcpListener::from_std(socket) else {
        return;
    };
    let router = routes::router(server);
    let counts = Counts::default();
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            // Out of descriptors: those that are open must end first.
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
        };
        let Some(slot) = Slot::take(&counts, peer.ip()) else {
            continue;
        };
        let (router, acceptor) = (router.clone(), acceptor.clone());
        tokio::spawn(async move {
            let _slot = slot;
            serve(stream, router, acceptor).await;
        });
    }
}

async fn serve(stream: TcpStream, router: axum::Router, acceptor: TlsAcceptor) {
    let _ = stream.set_nodelay(true);
    let (Ok(peer), Ok(local)) = (stream.peer_addr(), stream.local_addr()) else {
        return;
    };
    let mut first = [0];
    match timeout(PATIENCE, stream.peek(&mut first)).await {
        Ok(Ok(1)) => {}
        _ => return,
    }
    let mut arrival = Arrival {
        peer,
        local,
        is_tls: first[0] == HANDSHAKE,
    };
    if arrival.is_tls {
        if let Ok(Ok(stream)) = timeout(PATIENCE, acceptor.accept(stream)).await {
            speak(stream, router, arrival).await;
        }
    } else if arrival.is_local() {
        arrival.is_tls = false;
        speak(stream, router, arrival).await;
    } else {
        turn_away(stream).await;
    }
}

async fn speak<S>(stream: S, router: axum::Router, arrival: Arrival)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let service = TowerToHyperService::new(router.layer(Extension(arrival)));
    let _ = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(PATIENCE)
        .max_buf_size(64 * 1024)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades()
        .await;
}

/// Plain HTTP from another machine: told where the encrypted page is, nothing else.
async fn turn_away(stream: TcpStream) {
    let service = service_fn(|request: hyper::Request<Incoming>| async move {
        let host = request
            .headers()
            .get("host")
            .and_then(|h| h.to_str().ok())
            .unwrap_or_default()
            .to_owned();
        Ok::<_, std::convert::Infallible>(redirect(&host, request.uri().path()))
    });
    let _ = timeout(
        PATIENCE,
        http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(PATIENCE)
            .keep_alive(false)
            .serve_connection(TokioIo::new(stream), service),
    )
    .await;
}
