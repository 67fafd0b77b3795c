//! The console's thread, and what the main thread holds of it.

use super::aboard::Aboard;
use super::fleet::Fleet;
use super::gate::{Arrival, Refused};
use super::ledger::{Books, FILE, Ledger, LedgerError, Note};
use super::picture::Picture;
use super::place::Place;
use super::sessions::{Entrant, Session, SessionId, Sessions};
use super::signal::{Desk, VIEWERS};
use super::throttle::Throttle;
use super::{listener, password, tls};
use crate::io::clock::Clock;
use crate::io::net::Joint;
use crate::settings::Settings;
use axum::http::StatusCode;
use mavlink_dialect::Address;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use subtle::ConstantTimeEq as _;
use thiserror::Error;
use tokio::sync::{Semaphore, watch};
use vehicle::{FloorPlan, Pace};

/// Port that is tried first.
pub const PORT: u16 = 8443;
/// Where it listens unless told otherwise.
pub const DEFAULT: &str = "127.0.0.1:8443";
/// How often accounts are looked at: another program may change them.
const LOOK: Duration = Duration::from_secs(1);
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

/// What a console off the drone is made from, for several vehicles.
#[derive(Clone, Debug)]
pub struct FleetConfig {
    /// Where it listens.
    pub listen: SocketAddr,
    /// That port is a default: if it is taken, the next free one is used.
    pub is_default: bool,
    /// Accounts, vehicles, certificate; none = they end with the program.
    pub state_dir: Option<PathBuf>,
    /// Names it may be called by, beside its addresses.
    pub names: Vec<String>,
    /// Vehicles to add to those that are known: name (none: what it calls itself) and address.
    pub vehicles: Vec<(Option<String>, Place)>,
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
        let (feed, pictures) = watch::channel(Arc::default());
        let base = Base {
            listen: config.listen,
            is_default: config.is_default,
            state_dir: config.state_dir.clone(),
            has_link: config.has_link,
            names: config.names.clone(),
        };
        let aboard = Aboard::new(config, joint, pictures);
        Self::open(base, feed, |_, _| Ok((Some(Arc::new(aboard)), None)))
    }

    /// Starts a console off the drone, for several vehicles.
    ///
    /// # Errors
    /// [`ConsoleError`].
    pub fn start_fleet(config: FleetConfig) -> Result<Self, ConsoleError> {
        let (feed, _) = watch::channel(Arc::default());
        let base = Base {
            listen: config.listen,
            is_default: config.is_default,
            state_dir: config.state_dir,
            has_link: false,
            names: config.names,
        };
        Self::open(base, feed, |books, tell| {
            let roster = books.roster()?;
            Ok((None, Some(Fleet::new(roster, config.vehicles, tell))))
        })
    }

    fn open(
        base: Base,
        feed: watch::Sender<Arc<Picture>>,
        serves: impl FnOnce(&Books, SyncSender<String>) -> Result<Serves, ConsoleError>,
    ) -> Result<Self, ConsoleError> {
        let is_open = !base.listen.ip().is_loopback();
        let file = base.state_dir.as_ref().map(|d| d.join(FILE));
        let books = Books::open(file.as_deref())?;
        let users = books.count()?;
        if is_open && users == 0 {
            return Err(ConsoleError::NoPassword);
        }
        let socket = bind(base.listen, if base.is_default { 32 } else { 1 })
            .map_err(|e| ConsoleError::Listen(base.listen, e))?;
        socket.set_nonblocking(true)?;
        let address = socket.local_addr()?;
        let entry = match (base.has_link, users) {
            (true, _) => Entry::Link(SessionId(password::random()?)),
            (false, 0) => Entry::Setup(SessionId(password::random()?)),
            _ => Entry::Password,
        };
        let (acceptor, pin) =
            tls::acceptor(base.state_dir.as_deref(), &base.names, base.listen.ip())
                .map_err(ConsoleError::Certificate)?;
        let (tell, told) = sync_channel(16);
        let (aboard, fleet) = serves(&books, tell.clone())?;
        let server = Arc::new(Server {
            clock: Clock::start(1.0),
            aboard,
            fleet,
            pin,
            names: base.names,
            ledger: Ledger::start(books)?,
            sessions: Mutex::default(),
            throttle: Mutex::default(),
            entry: Mutex::new(Entry::Password),
            hashing: Semaphore::new(1),
            sockets: AtomicUsize::new(0),
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
                        () = listener::run(socket, acceptor, Arc::clone(&server)) => {}
                        () = look_at_accounts(&server) => {}
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

    /// The next line for the terminal, waited for; none if the time is over, an error if the console has ended.
    ///
    /// # Errors
    /// [`RecvTimeoutError::Disconnected`] only.
    pub fn wait_told(&self, at_most: Duration) -> Result<Option<String>, RecvTimeoutError> {
        match self.told.recv_timeout(at_most) {
            Ok(line) => Ok(Some(line)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(gone) => Err(gone),
        }
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

/// What both kinds of console are opened with.
struct Base {
    listen: SocketAddr,
    is_default: bool,
    state_dir: Option<PathBuf>,
    has_link: bool,
    names: Vec<String>,
}

/// One of the two is there: the vehicle we are aboard of, or those that are elsewhere.
type Serves = (Option<Arc<Aboard>>, Option<Fleet>);

/// What another program did to the accounts comes into force: sessions end, vehicles come and go.
async fn look_at_accounts(server: &Arc<Server>) {
    let mut look = tokio::time::interval(LOOK);
    look.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    if let Some(fleet) = &server.fleet {
        fleet.add_wanted(server).await;
    }
    loop {
        look.tick().await;
        if !locked(&server.sessions).is_empty()
            && let Ok(stamps) = server.ledger.ask(|books| books.stamps()).await
        {
            locked(&server.sessions).keep_only(&stamps);
        }
        if let Some(fleet) = &server.fleet {
            fleet.reload(server).await;
        }
    }
}

/// What all connections share.
pub(super) struct Server {
    pub(super) clock: Clock,
    /// Aboard a vehicle: that one.
    pub(super) aboard: Option<Arc<Aboard>>,
    /// Off the drone: those of the roster.
    pub(super) fleet: Option<Fleet>,
    /// SHA-256 of our certificate.
    pub(super) pin: [u8; 32],
    pub(super) names: Vec<String>,
    pub(super) ledger: Ledger,
    sessions: Mutex<Sessions>,
    throttle: Mutex<Throttle>,
    entry: Mutex<Entry>,
    /// One password at a time: the flight loop has the other cores.
    hashing: Semaphore,
    sockets: AtomicUsize,
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

    pub(super) fn begin(&self, id: SessionId, who: Entrant) -> Session {
        locked(&self.sessions)
            .begin(self.clock.now(), id, who)
            .clone()
    }

    pub(super) fn end(&self, id: SessionId) {
        locked(&self.sessions).end(id);
    }

    pub(super) fn end_of(&self, account: &str) {
        locked(&self.sessions).end_of(account);
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
        self.say(line);
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
    pub(super) fn action(&self, user: &str, vehicle: &str, what: String) {
        self.ledger.note(Note::Action {
            user: user.to_owned(),
            vehicle: vehicle.to_owned(),
            what,
        });
    }

    /// Writes down what an administrator did here.
    pub(super) fn administered(&self, user: &str, what: String) {
        self.action(user, "console", what);
    }

    /// Tells the terminal.
    pub(super) fn say(&self, line: String) {
        let _ = self.tell.try_send(line);
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

impl Arrival {
    /// A connection from this machine itself.
    pub(super) fn is_local(self) -> bool {
        self.peer.ip().to_canonical().is_loopback() && self.local.ip().to_canonical().is_loopback()
    }
}
