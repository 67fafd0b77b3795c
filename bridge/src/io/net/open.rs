//! Endpoints bound before the thread starts.

use super::super::endpoint::Endpoint;
use crate::gcs::access::LinkPolicy;
use rustix::net::sockopt::set_socket_recv_buffer_size;
use std::io;
use std::net::{SocketAddr, ToSocketAddrs as _};
use thiserror::Error;

/// Receive buffer asked for, bytes; the kernel gives what it allows (net.core.rmem_max). Its default holds less than 5 ms of a fast
/// companion, and this thread may have to wait longer for the processor.
const RECEIVE_BUFFER: usize = 4 << 20;

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

/// A socket.
pub(super) enum Bound {
    UdpServer(std::net::UdpSocket),
    UdpClient(std::net::UdpSocket, SocketAddr),
    UdpBroadcast(std::net::UdpSocket, SocketAddr),
    TcpServer(std::net::TcpListener),
    TcpClient(String),
    Serial { device: String, baud: u32 },
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

/// A socket for an endpoint, and what to tell people of it.
pub(super) fn bind(w: &Wanted) -> Result<(Bound, String), OpenError> {
    let (bound, text) = bind_to(w)?;
    if let Bound::UdpServer(socket) | Bound::UdpClient(socket, _) | Bound::UdpBroadcast(socket, _) =
        &bound
    {
        // A smaller one works too.
        let _ = set_socket_recv_buffer_size(socket, RECEIVE_BUFFER);
    }
    Ok((bound, text + &told(&w.policy)))
}

fn bind_to(w: &Wanted) -> Result<(Bound, String), OpenError> {
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
