//! The way out of a link.

use super::TO_LINK;
use mavlink_dialect::FrameBytes;
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::net::UdpSocket;
use tokio::sync::mpsc::{Receiver, Sender, channel};

/// Where frames for a link are put.
#[derive(Clone, Debug)]
pub struct Outlet {
    /// Frames that wait for it.
    queue: Sender<FrameBytes>,
    /// Where they go at once while none waits.
    socket: Option<(Arc<UdpSocket>, SocketAddr)>,
}

impl Outlet {
    /// A queue, and who empties it.
    #[must_use]
    pub fn new() -> (Self, Receiver<FrameBytes>) {
        Self::of(TO_LINK)
    }

    /// The same for so many frames.
    #[must_use]
    pub fn of(frames: usize) -> (Self, Receiver<FrameBytes>) {
        let (queue, waiting) = channel(frames);
        let outlet = Self {
            queue,
            socket: None,
        };
        (outlet, waiting)
    }

    /// To a peer of a socket: a datagram a frame. What the socket has no room for waits.
    pub(super) fn udp(socket: Arc<UdpSocket>, to: SocketAddr) -> Self {
        let (outlet, mut frames) = Self::new();
        let later = Arc::clone(&socket);
        tokio::spawn(async move {
            while let Some(frame) = frames.recv().await {
                // Nobody listening yet (ECONNREFUSED) is no reason to stop.
                let _ = later.send_to(&frame, to).await;
            }
        });
        Self {
            socket: Some((socket, to)),
            ..outlet
        }
    }

    /// Puts a frame there; false if too many wait.
    #[must_use]
    pub fn send(&self, frame: &[u8]) -> bool {
        if let Some((socket, to)) = &self.socket
            && self.queue.capacity() == self.queue.max_capacity()
        {
            match socket.try_send_to(frame, *to) {
                Err(e) if e.kind() == std::io::ErrorKind::WouldBlock => {}
                // Nobody listening yet is no reason to stop.
                Ok(_) | Err(_) => return true,
            }
        }
        FrameBytes::try_from(frame).is_ok_and(|frame| self.queue.try_send(frame).is_ok())
    }
}
