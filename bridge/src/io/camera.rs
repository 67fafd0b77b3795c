//! The thread `camera`: takes pictures from their source, codes them once, and sends them to whoever watches.
//!
//! It runs at a low priority and never touches the flight: the main thread puts a [`Shot`] down (simulator) and goes on, or knows
//! nothing of it at all. Nobody watching, nothing is drawn or coded.
//!
//! ```text
//! main thread --Shot (newest only)--+
//! feeder thread --access units------+--> camera --datagrams--> browsers, ground stations
//! console --words-------------------+        \---words------> console
//! ```

use super::camera_feed;
use super::camera_rtp::Stations;
use super::clock::{self, Clock};
use crate::video::CameraSource;
use crate::video::annex_b::{AccessUnit, kind};
use crate::video::encode::{EncodeError, Encoder, EncoderSettings};
use crate::video::signalling::{self, Said, Stream};
use crate::video::sps;
use crate::video::viewers::{Caller, Out, Viewers};
use crate::web::password;
use crate::web::signal::{Desk, Reply};
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::fd::OwnedFd;
use sim::camera::{Camera, Picture, Scenery, Shot, stamp};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use thiserror::Error;
use vehicle::Pace;

/// Port of WebRTC that is tried first.
pub const PORT: u16 = 8444;
/// Pixels of the simulated camera.
pub const SIZE: [usize; 2] = [640, 480];
/// Words and coded pictures that wait for the thread at most.
const WAITING: usize = 256;
/// Callers of the signalling at most.
const CALLERS: usize = 32;
/// Datagrams taken in a round: a flood does not keep pictures waiting.
const ROUND: usize = 64;
/// How much lower than the rest this thread ranks.
const NICE: i32 = 10;
/// Key pictures are not further apart for ground stations, which cannot ask.
const KEY_EVERY: Duration = Duration::from_secs(2);
/// And never closer than this, whoever asks.
const KEY_GAP: Duration = Duration::from_millis(250);

/// What a camera is made from.
#[derive(Clone, Debug)]
pub struct CameraConfig {
    /// Where pictures come from.
    pub source: CameraSource,
    /// The room, for the simulator's.
    pub scenery: Option<Scenery>,
    /// Where WebRTC listens; none = no console.
    pub listen: Option<IpAddr>,
    /// Ground stations that get RTP.
    pub stations: Vec<SocketAddr>,
    /// For the simulator's.
    pub encoder: EncoderSettings,
}

/// Why there is no camera.
#[derive(Debug, Error)]
pub enum CameraError {
    /// No port, no thread.
    #[error("the camera cannot be started: {0}")]
    Io(#[from] io::Error),
    /// No encoder.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// No room to see.
    #[error("only the simulator has a simulated camera: name another source")]
    NoScenery,
}

/// What it has done so far.
#[derive(Debug, Default)]
pub struct CameraCounts {
    /// Coded pictures.
    pub pictures: AtomicU64,
    /// Their bytes.
    pub bytes: AtomicU64,
    /// Sessions of browsers now.
    pub viewers: AtomicUsize,
    /// Datagrams on WebRTC's socket that belonged to no session.
    pub strangers: AtomicU64,
    /// Words or pictures dropped at a full queue.
    pub dropped: AtomicU64,
}

/// What the threads share.
#[derive(Debug)]
pub(super) struct Shared {
    slot: Mutex<Option<(Shot, u64)>>,
    /// How many watch, browsers and stations.
    watching: AtomicUsize,
    pub(super) is_over: AtomicBool,
    wake: OwnedFd,
    pub(super) counts: Arc<CameraCounts>,
}

impl Shared {
    pub(super) fn is_watched(&self) -> bool {
        self.watching.load(Ordering::Relaxed) > 0
    }

    fn ring(&self) {
        let _ = rustix::io::write(&self.wake, &1_u64.to_ne_bytes());
    }
}

/// What comes in beside shots and datagrams.
pub(super) enum Inbox {
    Open(Caller, IpAddr, Reply),
    Said(Caller, String),
    Closed(Caller),
    /// Coded by somebody else, and when it came, us on CLOCK_MONOTONIC.
    Unit(AccessUnit, u64),
}

/// Where feeders put things.
#[derive(Clone, Debug)]
pub(super) struct Slip {
    pub(super) shared: Arc<Shared>,
    inbox: SyncSender<Inbox>,
}

impl Slip {
    /// False if it was dropped.
    pub(super) fn put(&self, what: Inbox) -> bool {
        let is_in = match self.inbox.try_send(what) {
            Ok(()) => true,
            Err(TrySendError::Full(_)) => {
                self.shared.counts.dropped.fetch_add(1, Ordering::Relaxed);
                false
            }
            Err(TrySendError::Disconnected(_)) => false,
        };
        self.shared.ring();
        is_in
    }
}

/// The camera as the main thread holds it; dropping it ends it.
#[derive(Debug)]
pub struct CameraThread {
    slip: Slip,
    clock: Clock,
    pace: Pace,
    told: Receiver<String>,
    /// Where WebRTC listens.
    pub address: Option<SocketAddr>,
}

impl CameraThread {
    /// Starts it.
    ///
    /// # Errors
    /// [`CameraError`].
    pub fn start(config: CameraConfig) -> Result<Self, CameraError> {
        let socket = config.listen.map(bind).transpose()?;
        let address = socket.as_ref().map(UdpSocket::local_addr).transpose()?;
        let drawn = match (&config.source, config.scenery) {
            (CameraSource::Simulator, Some(scenery)) => Some(Drawn {
                camera: Camera::new(scenery),
                picture: Picture::new(SIZE[0], SIZE[1]),
                encoder: Encoder::new(config.encoder)?,
            }),
            (CameraSource::Simulator, None) => return Err(CameraError::NoScenery),
            _ => None,
        };
        str0m::crypto::from_feature_flags().install_process_default();
        let shared = Arc::new(Shared {
            slot: Mutex::default(),
            watching: AtomicUsize::new(0),
            is_over: AtomicBool::new(false),
            wake: eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)
                .map_err(io::Error::from)?,
            counts: Arc::default(),
        });
        let (inbox, waiting) = sync_channel(WAITING);
        let slip = Slip {
            shared: Arc::clone(&shared),
            inbox,
        };
        let (tell, told) = sync_channel(16);
        let feeder = camera_feed::start(&config.source, slip.clone(), tell.clone())?;
        let stream = Stream {
            id: signalling::uuid(password::random()?),
            name: config.source.describe().to_owned(),
            size: if drawn.is_some() {
                SIZE.map(|v| v as u32)
            } else {
                [0, 0]
            },
            fps: config.encoder.fps,
            source: config.source.describe().to_owned(),
        };
        let studio = Studio {
            shared,
            waiting,
            feeder,
            drawn,
            tell,
            media: address,
            stations: Stations::new(&config.stations)?,
            viewers: Viewers::default(),
            callers: BTreeMap::new(),
            gone: BTreeSet::new(),
            stream,
            key_wanted: true,
            key_at: None,
            clock: Clock::start(1.0),
        };
        std::thread::Builder::new()
            .name("camera".to_owned())
            .spawn(move || studio.run(socket))?;
        Ok(Self {
            slip,
            clock: Clock::start(1.0),
            pace: Pace::hz(config.encoder.fps),
            told,
            address,
        })
    }

    /// How the console reaches it.
    #[must_use]
    pub fn desk(&self) -> Arc<dyn Desk> {
        Arc::new(Counter {
            slip: self.slip.clone(),
            next: AtomicU64::new(1),
        })
    }

    /// What it has done so far.
    #[must_use]
    pub fn counts(&self) -> &CameraCounts {
        &self.slip.shared.counts
    }

    /// True when a shot is wanted now. Nobody watching costs nothing.
    pub fn wants_shot(&mut self) -> bool {
        self.slip.shared.is_watched() && self.pace.is_due(self.clock.now())
    }

    /// Puts a shot down, in place of one that was not drawn yet.
    pub fn show(&self, shot: Shot) {
        let taken = (shot, clock::utc_us());
        *self
            .slip
            .shared
            .slot
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Some(taken);
        self.slip.shared.ring();
    }

    /// The next line for the terminal.
    #[must_use]
    pub fn poll_told(&self) -> Option<String> {
        self.told.try_recv().ok()
    }
}

impl Drop for CameraThread {
    fn drop(&mut self) {
        self.slip.shared.is_over.store(true, Ordering::Relaxed);
        self.slip.shared.ring();
    }
}

/// The camera's end of the console's WebSockets.
#[derive(Debug)]
struct Counter {
    slip: Slip,
    next: AtomicU64,
}

impl Desk for Counter {
    fn open(&self, local: IpAddr, reply: Reply) -> Option<u64> {
        let caller = self.next.fetch_add(1, Ordering::Relaxed);
        self.slip
            .put(Inbox::Open(caller, local, reply))
            .then_some(caller)
    }

    fn say(&self, caller: u64, text: String) -> bool {
        self.slip.put(Inbox::Said(caller, text))
    }

    fn close(&self, caller: u64) {
        self.slip.put(Inbox::Closed(caller));
    }
}

fn bind(ip: IpAddr) -> io::Result<UdpSocket> {
    let mut result = UdpSocket::bind((ip, PORT));
    for step in 1..64 {
        match &result {
            Err(e) if e.kind() == io::ErrorKind::AddrInUse => {}
            _ => break,
        }
        result = UdpSocket::bind((ip, PORT + step));
    }
    let socket = result?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

/// The simulator's camera.
struct Drawn {
    camera: Camera,
    picture: Picture,
    encoder: Encoder,
}

/// Somebody on the signalling.
struct Seat {
    consumer: String,
    local: IpAddr,
    reply: Reply,
}

/// Everything the thread holds.
struct Studio {
    shared: Arc<Shared>,
    waiting: Receiver<Inbox>,
    feeder: Option<std::thread::Thread>,
    drawn: Option<Drawn>,
    tell: SyncSender<String>,
    media: Option<SocketAddr>,
    stations: Stations,
    viewers: Viewers,
    callers: BTreeMap<Caller, Seat>,
    gone: BTreeSet<Caller>,
    stream: Stream,
    key_wanted: bool,
    key_at: Option<Instant>,
    clock: Clock,
}

/// What leaves the thread.
struct Wire<'a> {
    socket: Option<&'a UdpSocket>,
    callers: &'a BTreeMap<Caller, Seat>,
    gone: &'a mut BTreeSet<Caller>,
}

impl Out for Wire<'_> {
    fn transmit(&mut self, to: SocketAddr, bytes: &[u8]) {
        // A full buffer of the system: RTP repairs what is lost.
        if let Some(socket) = self.socket {
            let _ = socket.send_to(bytes, to);
        }
    }

    fn tell(&mut self, caller: Caller, text: String) {
        if let Some(seat) = self.callers.get(&caller)
            && !(seat.reply)(text)
        {
            self.gone.insert(caller);
        }
    }
}

/// Borrows what a [`Wire`] needs beside the viewers.
macro_rules! wire {
    ($self:ident, $socket:expr) => {
        Wire {
            socket: $socket,
            callers: &$self.callers,
            gone: &mut $self.gone,
        }
    };
}

impl Studio {
    fn run(mut self, socket: Option<UdpSocket>) {
        let _ = rustix::process::nice(NICE);
        let socket = socket.as_ref();
        let mut datagram = [0; 2048];
        while !self.shared.is_over.load(Ordering::Relaxed) {
            self.wait(socket);
            let _ = rustix::io::read(&self.shared.wake, &mut [0_u8; 8]);
            let now = clock::instant();
            for _ in 0..ROUND {
                let Ok(what) = self.waiting.try_recv() else {
                    break;
                };
                self.take(now, what, socket);
            }
            if let Some(socket) = socket {
                for _ in 0..ROUND {
                    let Ok((n, from)) = socket.recv_from(&mut datagram) else {
                        break;
                    };
                    let out = &mut wire!(self, Some(socket));
                    self.viewers.receive(now, from, &datagram[..n], out);
                }
            }
            let shot = self
                .shared
                .slot
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .take();
            if let Some((shot, taken_us)) = shot {
                self.draw(&shot, taken_us, socket);
            }
            let now = clock::instant();
            self.viewers.pass(now, &mut wire!(self, socket));
            self.stations.pass(now);
            while let Some(caller) = self.gone.pop_first() {
                self.callers.remove(&caller);
                self.viewers.end(caller, &mut wire!(self, socket));
            }
            self.key_wanted |= self.viewers.take_wants_key() | self.stations.take_wants_key();
            self.count();
        }
        for caller in self.callers.keys().copied().collect::<Vec<_>>() {
            self.viewers.end(caller, &mut wire!(self, socket));
        }
        if let Some(feeder) = &self.feeder {
            feeder.unpark();
        }
    }

    /// Until something comes or a session's time has come.
    fn wait(&self, socket: Option<&UdpSocket>) {
        let now = clock::instant();
        let until = [self.viewers.deadline(), self.stations.deadline()]
            .into_iter()
            .flatten()
            .min()
            .map_or(Duration::from_secs(1), |at| {
                at.saturating_duration_since(now)
            });
        // A session that wants to be called at once, again and again, must not take the processor.
        let until = until.clamp(Duration::from_micros(500), Duration::from_secs(1));
        let timeout = Timespec {
            tv_sec: until.as_secs() as i64,
            tv_nsec: i64::from(until.subsec_nanos()),
        };
        let mut fds = vec![PollFd::new(&self.shared.wake, PollFlags::IN)];
        fds.extend(socket.map(|s| PollFd::new(s, PollFlags::IN)));
        let _ = poll(&mut fds, Some(&timeout));
    }

    fn take(&mut self, now: Instant, what: Inbox, socket: Option<&UdpSocket>) {
        match what {
            Inbox::Open(caller, local, reply) => {
                if self.callers.len() < CALLERS
                    && let Ok(bytes) = password::random()
                {
                    let seat = Seat {
                        consumer: signalling::uuid(bytes),
                        local,
                        reply,
                    };
                    self.callers.insert(caller, seat);
                }
            }
            Inbox::Closed(caller) => {
                self.gone.insert(caller);
            }
            Inbox::Said(caller, text) => {
                if let Some(said) = signalling::read(&text) {
                    self.answer(now, caller, &said, socket);
                }
            }
            Inbox::Unit(unit, at_us) => self.publish(&unit, at_us, socket),
        }
    }

    fn answer(&mut self, now: Instant, caller: Caller, said: &Said, socket: Option<&UdpSocket>) {
        let Some(seat) = self.callers.get(&caller) else {
            return;
        };
        let out = &mut wire!(self, socket);
        match said {
            Said::PeerId => out.tell(caller, signalling::peer_id(&seat.consumer)),
            Said::AvailableStreams => {
                let all = std::slice::from_ref(&self.stream);
                out.tell(caller, signalling::available_streams(all));
            }
            Said::StartSession { producer } if *producer == self.stream.id => {
                let (Some(media), Ok(ids)) = (self.media, password::random()) else {
                    return;
                };
                let local = SocketAddr::new(seat.local, media.port());
                let who = (caller, seat.consumer.as_str());
                self.viewers.begin(now, who, &self.stream, local, ids, out);
            }
            other => self.viewers.said(now, caller, other, out),
        }
    }

    fn draw(&mut self, shot: &Shot, taken_us: u64, socket: Option<&UdpSocket>) {
        let wants_key = self.is_key_due();
        let Some(drawn) = &mut self.drawn else { return };
        drawn.camera.render(shot, &mut drawn.picture);
        stamp(&mut drawn.picture, taken_us / 1000);
        let at_us = self.clock.now().us();
        match drawn
            .encoder
            .encode(&drawn.picture, at_us / 1000, wants_key)
        {
            Ok(Some(unit)) => self.publish(&unit, at_us, socket),
            // Left out for the rate.
            Ok(None) => {}
            Err(e) => {
                let _ = self.tell.try_send(e.to_string());
            }
        }
    }

    fn is_key_due(&self) -> bool {
        let Some(last) = self.key_at else { return true };
        let age = clock::instant().saturating_duration_since(last);
        age >= KEY_GAP && (self.key_wanted || (age >= KEY_EVERY && self.stations.are_listening()))
    }

    fn publish(&mut self, unit: &AccessUnit, at_us: u64, socket: Option<&UdpSocket>) {
        let now = clock::instant();
        if unit.is_key {
            (self.key_wanted, self.key_at) = (false, Some(now));
            if let Some(facts) = unit.nals().find(|n| kind(n) == 7).and_then(sps::read) {
                self.stream.size = [facts.width, facts.height];
                self.stream.fps = facts.fps.unwrap_or(self.stream.fps);
            }
        }
        let counts = &self.shared.counts;
        counts.pictures.fetch_add(1, Ordering::Relaxed);
        counts
            .bytes
            .fetch_add(unit.annex_b.len() as u64, Ordering::Relaxed);
        // 90 kHz.
        let time = at_us * 9 / 100;
        self.viewers.show(now, time, unit, &mut wire!(self, socket));
        self.stations.send(now, time as u32, unit);
    }

    fn count(&self) {
        let viewers = self.viewers.count();
        let watching = viewers + self.stations.listening();
        let counts = &self.shared.counts;
        counts.viewers.store(viewers, Ordering::Relaxed);
        counts
            .strangers
            .store(self.viewers.strangers, Ordering::Relaxed);
        let before = self.shared.watching.swap(watching, Ordering::Relaxed);
        if before == 0
            && watching > 0
            && let Some(feeder) = &self.feeder
        {
            feeder.unpark();
        }
    }
}
