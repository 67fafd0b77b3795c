//! The console's thread, and what the main thread holds of it.

use super::gate::{Arrival, Refused};
use super::ledger::{Books, FILE, Ledger, LedgerError, Note};
use super::picture::Picture;
use super::role::Role;
use super::sessions::{Session, SessionId, Sessions};
use super::signal::{Desk, VIEWERS};
use super::throttle::Throttle;
use super::{listener, password, tls};
use crate::gcs::disk::Folder;
use crate::io::clock::Clock;
use crate::io::net::Joint;
use crate::settings::Settings;
use axum::http::StatusCode;
use mavlink_dialect::Address;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use subtle::ConstantTimeEq as _;
use thiserror::Error;
use tokio::sync::{Semaphore, watch};
use vehicle::param::ParamKind;
use vehicle::{FloorPlan, MapAnchor, Pace};

/// Port that is tried first.
pub const PORT: u16 = 8443;
/// Where it listens unless told otherwise.
pub const DEFAULT: &str = "127.0.0.1:8443";
/// Pictures a second.
const PICTURE_HZ: f64 = 20.0;
/// WebSockets at once.
pub(super) const SOCKETS: usize = 24;

/// What a console is made from.
#[derive(Clone, Debug)]
pub struct ConsoleConfig {
    /// Where it listens.
    pub listen: SocketAddr,
    /// That port is a default: if it is taken, the next free one is used.
    pub is_default: bool,
    /// Accounts, certificate and logs are here; none = accounts end with the program.
    pub state_dir: Option<PathBuf>,
    /// A one-time link opens the page without password, from this machine: for the simulator.
    pub has_link: bool,
    /// Names it may be called by, beside its addresses.
    pub names: Vec<String>,
    /// The vehicle's name for people.
    pub vehicle: String,
    /// Its address.
    pub us: Address,
    /// Where it flies.
    pub plan: Arc<FloorPlan>,
    /// Its parameters, for their descriptions.
    pub settings: Settings,
    /// Its camera, if it has one.
    pub camera: Option<Arc<dyn Desk>>,
}

/// Why there is no console.
#[derive(Debug, Error)]
pub enum ConsoleError {
    /// Others could reach it, and nobody needs a password.
    #[error(
        "the console opens to other machines only when somebody has a password: `kestrel passwd NAME` makes one"
    )]
    NoPassword,
    /// The port is taken or not allowed.
    #[error("the console cannot listen on {0}: {1}")]
    Listen(SocketAddr, io::Error),
    /// Accounts.
    #[error(transparent)]
    Ledger(#[from] LedgerError),
    /// The certificate.
    #[error("the console has no certificate: {0}")]
    Certificate(String),
    /// Thread, random numbers.
    #[error("the console cannot be started: {0}")]
    Io(#[from] io::Error),
}

/// How the first page is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Entry {
    /// By name and password only.
    Password,
    /// By the link on the terminal, once; then by a new one.
    Link(SessionId),
    /// By the code on the terminal, which makes the first administrator.
    Setup(SessionId),
}

/// The console as the main thread holds it; dropping it ends it.
pub struct Console {
    clock: Clock,
    feed: watch::Sender<Arc<Picture>>,
    pace: Pace,
    told: Receiver<String>,
    /// Where it listens.
    pub address: SocketAddr,
    over: Option<tokio::sync::oneshot::Sender<()>>,
}

impl Console {
    /// Starts listening. What people must know comes out of [`Console::poll_told`].
    ///
    /// # Errors
    /// [`ConsoleError`].
    pub fn start(config: ConsoleConfig, joint: Joint) -> Result<Self, ConsoleError> {
        let is_open = !config.listen.ip().is_loopback();
        let file = config.state_dir.as_ref().map(|d| d.join(FILE));
        let books = Books::open(file.as_deref())?;
        let users = books.count()?;
        if is_open && users == 0 {
            return Err(ConsoleError::NoPassword);
        }
        let socket = bind(config.listen, if config.is_default { 32 } else { 1 })
            .map_err(|e| ConsoleError::Listen(config.listen, e))?;
        socket.set_nonblocking(true)?;
        let address = socket.local_addr()?;
        let entry = match (config.has_link, users) {
            (true, _) => Entry::Link(SessionId(password::random()?)),
            (false, 0) => Entry::Setup(SessionId(password::random()?)),
            _ => Entry::Password,
        };
        let acceptor = tls::acceptor(
            config.state_dir.as_deref(),
            &config.names,
            config.listen.ip(),
        )
        .map_err(ConsoleError::Certificate)?;
        let (feed, pictures) = watch::channel(Arc::default());
        let (tell, told) = sync_channel(16);
        let anchor = config.plan.anchor();
        let server = Arc::new(Server {
            clock: Clock::start(1.0),
            joint,
            feed: pictures,
            plan_json: plan_json(&config.plan, &anchor),
            parameters_json: parameters_json(&config.settings),
            anchor,
            us: config.us,
            vehicle: config.vehicle,
            names: config.names,
            logs: config.state_dir.map(|d| d.join(Folder::Logs.name())),
            ledger: Ledger::start(books)?,
            sessions: Mutex::default(),
            throttle: Mutex::default(),
            entry: Mutex::new(Entry::Password),
            hashing: Semaphore::new(1),
            sockets: AtomicUsize::new(0),
            camera: config.camera,
            viewers: Arc::new(Semaphore::new(VIEWERS)),
            tell,
            address,
        });
        server.set_entry(entry);
        let (over, ended) = tokio::sync::oneshot::channel();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(2)
            .build()?;
        std::thread::Builder::new()
            .name("console".to_owned())
            .spawn(move || {
                runtime.block_on(async move {
                    tokio::select! {
                        () = listener::run(socket, acceptor, server) => {}
                        _ = ended => {}
                    }
                });
                // A hash under way is not waited for.
                runtime.shutdown_background();
            })?;
        Ok(Self {
            clock: Clock::start(1.0),
            feed,
            pace: Pace::hz(PICTURE_HZ),
            told,
            address,
            over: Some(over),
        })
    }

    /// True when a picture is wanted now. Nobody watching costs nothing.
    pub fn wants_picture(&mut self) -> bool {
        self.feed.receiver_count() > 1 && self.pace.is_due(self.clock.now())
    }

    /// Puts a picture down. Never waits for who looks at it.
    pub fn show(&self, picture: Picture) {
        self.feed.send_replace(Arc::new(picture));
    }

    /// The next line for the terminal.
    #[must_use]
    pub fn poll_told(&self) -> Option<String> {
        self.told.try_recv().ok()
    }
}

impl Drop for Console {
    fn drop(&mut self) {
        if let Some(over) = self.over.take() {
            let _ = over.send(());
        }
    }
}

fn bind(at: SocketAddr, tries: u16) -> io::Result<TcpListener> {
    let mut address = at;
    let mut result = TcpListener::bind(address);
    for step in 1..tries {
        match &result {
            Err(e) if e.kind() == io::ErrorKind::AddrInUse => {}
            _ => break,
        }
        address.set_port(at.port().saturating_add(step));
        result = TcpListener::bind(address);
    }
    result
}

/// What all connections share.
pub(super) struct Server {
    pub(super) clock: Clock,
    pub(super) joint: Joint,
    pub(super) feed: watch::Receiver<Arc<Picture>>,
    pub(super) plan_json: serde_json::Value,
    pub(super) parameters_json: serde_json::Value,
    pub(super) anchor: MapAnchor,
    pub(super) us: Address,
    pub(super) vehicle: String,
    pub(super) names: Vec<String>,
    pub(super) logs: Option<PathBuf>,
    pub(super) ledger: Ledger,
    sessions: Mutex<Sessions>,
    throttle: Mutex<Throttle>,
    entry: Mutex<Entry>,
    /// One password at a time: the flight loop has the other cores.
    hashing: Semaphore,
    sockets: AtomicUsize,
    pub(super) camera: Option<Arc<dyn Desk>>,
    pub(super) viewers: Arc<Semaphore>,
    tell: SyncSender<String>,
    address: SocketAddr,
}

/// A lock whose holder panicked still holds sound data here: nothing is left half changed.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
}

impl Server {
    pub(super) fn session(&self, id: SessionId) -> Option<Session> {
        locked(&self.sessions).get(self.clock.now(), id).cloned()
    }

    pub(super) fn touch(&self, id: SessionId) {
        locked(&self.sessions).touch(self.clock.now(), id);
    }

    pub(super) fn begin(&self, id: SessionId, user: &str, role: Role, stays: bool) -> Session {
        locked(&self.sessions)
            .begin(self.clock.now(), id, user, role, stays)
            .clone()
    }

    pub(super) fn end(&self, id: SessionId) {
        locked(&self.sessions).end(id);
    }

    pub(super) fn end_of(&self, user: &str) {
        locked(&self.sessions).end_of(user);
    }

    /// Who speaks with a system id.
    pub(super) fn name_of(&self, system: u8) -> Option<String> {
        locked(&self.sessions)
            .iter()
            .find(|s| s.system == system)
            .map(|s| s.user.clone())
    }

    pub(super) fn may_try(&self, from: IpAddr) -> bool {
        locked(&self.throttle).admits(self.clock.now(), from)
    }

    pub(super) fn forgive(&self, from: IpAddr) {
        locked(&self.throttle).forgive(from);
    }

    pub(super) async fn compare(
        &self,
        given: String,
        hash: Option<String>,
    ) -> Result<bool, Refused> {
        self.work(move || password::is_right(&given, hash.as_deref()))
            .await
    }

    pub(super) async fn hash(&self, given: String) -> Result<String, Refused> {
        self.work(move || password::hash(&given))
            .await?
            .map_err(|e| Refused::new(StatusCode::UNPROCESSABLE_ENTITY, &e))
    }

    /// A password's work, one at a time, beside the connections.
    async fn work<T: Send + 'static>(
        &self,
        job: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Refused> {
        let busy = || Refused::new(StatusCode::SERVICE_UNAVAILABLE, "busy: try again");
        let turn = tokio::time::timeout(Duration::from_secs(5), self.hashing.acquire())
            .await
            .map_err(|_| busy())?
            .map_err(|_| busy())?;
        let done = tokio::task::spawn_blocking(job).await.map_err(|_| busy());
        drop(turn);
        done
    }

    /// True if the key is that of the newest link; the next link is told then.
    pub(super) fn use_link(&self, key: &str) -> bool {
        let entry = *locked(&self.entry);
        let is_it = match (entry, SessionId::from_hex(key)) {
            (Entry::Link(link), Some(given)) => bool::from(link.0.ct_eq(&given.0)),
            _ => false,
        };
        if is_it && let Ok(next) = password::random() {
            self.set_entry(Entry::Link(SessionId(next)));
        }
        is_it
    }

    pub(super) fn is_setup_code(&self, code: &str) -> bool {
        match (*locked(&self.entry), SessionId::from_hex(code.trim())) {
            (Entry::Setup(kept), Some(given)) => kept.0.ct_eq(&given.0).into(),
            _ => false,
        }
    }

    /// Sets how the next page may be opened, and says so on the terminal.
    pub(super) fn set_entry(&self, entry: Entry) {
        let is_first = matches!(*locked(&self.entry), Entry::Password);
        *locked(&self.entry) = entry;
        let address = self.address;
        let line = match entry {
            Entry::Password => format!("Console: {}", self.reachable().join(" ")),
            Entry::Link(key) if is_first => {
                format!("Console: http://{address}/#enter={}", key.to_hex())
            }
            Entry::Link(key) => format!(
                "Console opened; for another browser: http://{address}/#enter={}",
                key.to_hex()
            ),
            Entry::Setup(code) => format!(
                "Console: http://{address}/#setup={} makes its first user",
                code.to_hex()
            ),
        };
        let _ = self.tell.try_send(line);
    }

    /// Where browsers find us.
    fn reachable(&self) -> Vec<String> {
        let at = |ip: IpAddr| format!("https://{}", SocketAddr::new(ip, self.address.port()));
        if self.address.ip().is_unspecified() {
            tls::own_addresses()
                .into_iter()
                .filter(|ip| !ip.is_loopback())
                .map(at)
                .collect()
        } else {
            vec![at(self.address.ip())]
        }
    }

    /// Writes an action of a user down.
    pub(super) fn action(&self, user: &str, what: String) {
        self.ledger.note(Note::Action {
            user: user.to_owned(),
            vehicle: self.us.system,
            what,
        });
    }

    /// A place for one more WebSocket, given back when it is dropped.
    pub(super) fn take_socket(self: &Arc<Self>) -> Option<SocketPlace> {
        let taken = self
            .sockets
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| {
                (n < SOCKETS).then_some(n + 1)
            });
        taken.ok().map(|_| SocketPlace(Arc::clone(self)))
    }
}

/// One of [`SOCKETS`].
pub(super) struct SocketPlace(Arc<Server>);

impl Drop for SocketPlace {
    fn drop(&mut self) {
        self.0.sockets.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Walls as lines, free cells as runs, rooms by name, home: all a page needs to draw.
fn plan_json(plan: &FloorPlan, anchor: &MapAnchor) -> serde_json::Value {
    let round = |v: f64| (v * 1e3).round() / 1e3;
    let walls: Vec<[f64; 4]> = plan
        .wall_segments()
        .iter()
        .map(|s| [s.a[0], s.a[1], s.b[0], s.b[1]].map(round))
        .collect();
    let (w, h) = (plan.width(), plan.height());
    // Per row: [kind, length] of equal cells; 0 free, 1 wall, 2 unknown.
    let mut rows = Vec::with_capacity(h);
    for row in 0..h {
        let mut runs: Vec<u32> = Vec::new();
        let mut last = None;
        for column in 0..w {
            let kind = match plan.cell(column as i64, row as i64) {
                vehicle::floor_plan::Cell::Free => 0u32,
                vehicle::floor_plan::Cell::Occupied => 1,
                vehicle::floor_plan::Cell::Unknown => 2,
            };
            match runs.last_mut() {
                Some(n) if last == Some(kind) => *n += 1,
                _ => runs.extend([kind, 1]),
            }
            last = Some(kind);
        }
        rows.push(runs);
    }
    let rooms: Vec<_> = plan
        .rooms
        .iter()
        .map(|r| serde_json::json!({ "name": r.name, "x": round(r.x), "y": round(r.y) }))
        .collect();
    let home = plan.home.unwrap_or_default();
    serde_json::json!({
        "width": w, "height": h, "cell": plan.resolution_m(),
        "origin": plan.origin(), "walls": walls, "rows": rows, "rooms": rooms,
        "home": [home.x_m, home.y_m, home.yaw_rad],
        "north": anchor.north_rad(),
    })
}

/// Every parameter with its range and words; values come by MAVLink.
fn parameters_json(settings: &Settings) -> serde_json::Value {
    let row = |r: crate::settings::Row<'_>| {
        let (range, choices) = match r.meta.kind {
            ParamKind::Float { min, max, .. } => (Some([f64::from(min), f64::from(max)]), None),
            ParamKind::Int { min, max, .. } => (Some([f64::from(min), f64::from(max)]), None),
            ParamKind::Bool { .. } => (Some([0.0, 1.0]), None),
            ParamKind::Choice { names, .. } => (None, Some(names)),
        };
        serde_json::json!({
            "name": r.meta.id, "section": r.section, "doc": r.meta.doc.trim(), "unit": r.meta.unit,
            "default": r.meta.default_value().to_string(), "range": range, "choices": choices,
        })
    };
    serde_json::Value::Array(settings.rows().map(row).collect())
}

impl Arrival {
    /// A connection from this machine itself.
    pub(super) fn is_local(self) -> bool {
        self.peer.ip().to_canonical().is_loopback() && self.local.ip().to_canonical().is_loopback()
    }
}
