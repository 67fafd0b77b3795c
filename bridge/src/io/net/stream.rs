//! Links of one byte stream each: TCP connections and serial ports.

use super::hub::{Hub, Register};
use super::{Outlet, RETRY};
use std::net::SocketAddr;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio_serial::SerialPortBuilderExt as _;

/// Every connection is a link.
pub(super) async fn tcp_server(listener: std::net::TcpListener, hub: Hub, register: Register) {
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
}

/// Connects, and again when the connection is lost.
pub(super) async fn tcp_client(to: String, hub: Hub, register: Register) {
    loop {
        if let Ok(stream) = TcpStream::connect(&to).await {
            let _ = stream.set_nodelay(true);
            let peer = stream.peer_addr().ok();
            stream_link(stream, peer, hub.clone(), register.clone()).await;
        }
        tokio::time::sleep(RETRY).await;
    }
}

/// Opens a port, and again when it is unplugged.
pub(super) async fn serial(device: String, baud: u32, hub: Hub, register: Register) {
    loop {
        if let Ok(port) = tokio_serial::new(&device, baud).open_native_async() {
            stream_link(port, None, hub.clone(), register.clone()).await;
        }
        tokio::time::sleep(RETRY).await;
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
    let (outlet, mut frames) = Outlet::new();
    if register.send((link, Some(outlet))).await.is_err() {
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
