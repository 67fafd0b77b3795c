//! RTP to ground stations: a station that does not listen costs a few bytes a second, no picture is coded for it.
//!
//! Nobody says by RTP that he listens, but a closed port says that he does not (ICMP, seen as an error of the socket). So a silent
//! target is knocked at once a second; if no error comes back it listens.

use crate::video::annex_b::AccessUnit;
use crate::video::rtp::Packetizer;
use crate::web::password;
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

/// Between two knocks.
const KNOCK: Duration = Duration::from_secs(1);
/// An error has come back by then.
const ECHO: Duration = Duration::from_millis(60);
/// A packet that every receiver throws away: an RTP header without payload.
const EMPTY: [u8; 12] = [0x80, 96, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Knock then.
    Closed(Instant),
    /// Knocked; the answer is known then.
    Knocked(Instant),
    /// Gets pictures; from the next key picture on.
    Open { has_begun: bool },
}

struct Station {
    socket: UdpSocket,
    state: Option<State>,
    packetizer: Packetizer,
}

/// All targets.
pub(super) struct Stations {
    all: Vec<Station>,
    wants_key: bool,
}

impl Stations {
    /// Sockets to these targets.
    pub(super) fn new(targets: &[SocketAddr]) -> io::Result<Self> {
        let all = targets
            .iter()
            .map(|target| {
                let any: SocketAddr = match target {
                    SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
                    SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
                };
                let socket = UdpSocket::bind(any)?;
                socket.connect(target)?;
                socket.set_nonblocking(true)?;
                let [a, b, c, d, e, f] = password::random()?;
                Ok(Station {
                    socket,
                    state: None,
                    packetizer: Packetizer::new(
                        u32::from_be_bytes([a, b, c, d]),
                        u16::from_be_bytes([e, f]),
                    ),
                })
            })
            .collect::<io::Result<_>>()?;
        Ok(Self {
            all,
            wants_key: false,
        })
    }

    pub(super) fn listening(&self) -> usize {
        let is_open = |s: &&Station| matches!(s.state, Some(State::Open { .. }));
        self.all.iter().filter(is_open).count()
    }

    pub(super) fn are_listening(&self) -> bool {
        self.listening() > 0
    }

    pub(super) const fn take_wants_key(&mut self) -> bool {
        std::mem::replace(&mut self.wants_key, false)
    }

    pub(super) fn deadline(&self) -> Option<Instant> {
        self.all
            .iter()
            .filter_map(|s| match s.state {
                Some(State::Closed(at) | State::Knocked(at)) => Some(at),
                _ => None,
            })
            .min()
    }

    /// Knocks, and listens to what comes back.
    pub(super) fn pass(&mut self, now: Instant) {
        for s in &mut self.all {
            match s.state.unwrap_or(State::Closed(now)) {
                State::Closed(at) if at <= now => {
                    let _ = s.socket.take_error();
                    s.state = Some(if s.socket.send(&EMPTY).is_ok() {
                        State::Knocked(now + ECHO)
                    } else {
                        State::Closed(now + KNOCK)
                    });
                }
                State::Knocked(at) if at <= now => {
                    let is_refused = !matches!(s.socket.take_error(), Ok(None));
                    s.state = Some(if is_refused {
                        State::Closed(now + KNOCK)
                    } else {
                        self.wants_key = true;
                        State::Open { has_begun: false }
                    });
                }
                state => s.state = Some(state),
            }
        }
    }

    /// A picture for all that listen.
    pub(super) fn send(&mut self, now: Instant, time: u32, unit: &AccessUnit) {
        for s in &mut self.all {
            let Some(State::Open { has_begun }) = s.state else {
                continue;
            };
            if !has_begun && !unit.is_key {
                continue;
            }
            let mut error = None;
            let socket = &s.socket;
            s.packetizer.packets(unit, time, &mut |packet| {
                if error.is_none()
                    && let Err(e) = socket.send(packet)
                    // A full buffer of the system is no refusal.
                    && e.kind() != io::ErrorKind::WouldBlock
                {
                    error = Some(e);
                }
            });
            s.state = Some(match error {
                Some(_) => State::Closed(now + KNOCK),
                None => State::Open { has_begun: true },
            });
        }
    }
}
