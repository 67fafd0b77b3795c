//! A simulated vehicle in real time behind a console, and what a test wants to know of it.

use bridge::autopilot::door::Snapshot;
use bridge::autopilot::flight::Start;
use bridge::io::clock::Clock;
use bridge::io::lockstep::{Lockstep, LockstepConfig, Outgoing, our_address};
use bridge::io::net::{LinkEvent, Links, Wanted};
use bridge::settings::Settings;
use bridge::web::ledger::{Books, FILE};
use bridge::web::{Console, ConsoleConfig, Picture, Role, password};
use sim::{Room, SimConfig, VehicleConfig};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;
use vehicle::RingConfig;

/// Everybody's password here.
pub const PASSWORD: &str = "a long enough secret";

/// What the vehicle's thread shows.
#[derive(Clone, Debug, Default)]
pub struct Shown {
    pub snapshot: Snapshot,
    pub owner: Option<u8>,
    pub told: Vec<String>,
}

pub struct Vehicle {
    pub address: SocketAddr,
    pub folder: PathBuf,
    shown: Arc<Mutex<Shown>>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Users of each role: `viewer`, `pilot`, `engineer`, `admin`, and a second pilot `pilot2`.
pub fn start() -> Vehicle {
    start_with(
        &[
            ("viewer", Role::Viewer),
            ("pilot", Role::Pilot),
            ("pilot2", Role::Pilot),
            ("engineer", Role::Engineer),
            ("admin", Role::Admin),
        ],
        false,
        &[],
    )
}

fn fresh_folder() -> PathBuf {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let n = NEXT.fetch_add(1, Ordering::Relaxed);
    let folder = std::env::temp_dir().join(format!("kestrel-console-{}-{n}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// A fresh folder with accounts in it; everybody's password is [`PASSWORD`].
pub fn folder_with(users: &[(&str, Role)]) -> PathBuf {
    let folder = fresh_folder();
    let books = Books::open(Some(&folder.join(FILE))).unwrap();
    // One hash for all: each costs a tenth of a second.
    let hash = password::hash(PASSWORD).unwrap();
    for (name, role) in users {
        books
            .set_user(name, Some(&hash), Some(*role), None, None)
            .unwrap();
    }
    folder
}

pub fn start_with(users: &[(&str, Role)], has_link: bool, wanted: &[Wanted]) -> Vehicle {
    let folder = folder_with(users);
    let room = Room::named("office").unwrap();
    let settings = Settings::default();
    let vehicle = VehicleConfig::new(room.home(), RingConfig::built_in("tof32").unwrap());
    let start = Start::Known(room.home());
    let sim = SimConfig {
        vehicles: vec![vehicle],
        ..SimConfig::new(room, RingConfig::built_in("tof32").unwrap(), 1)
    };
    let mut lockstep = Lockstep::new(LockstepConfig {
        sim,
        start,
        settings: settings.clone(),
        documents: Vec::new(),
    })
    .unwrap();
    let links = Links::open(wanted).unwrap();
    let mut console = Console::start(
        ConsoleConfig {
            listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            is_default: false,
            state_dir: Some(folder.clone()),
            has_link,
            names: Vec::new(),
            vehicle: "office".to_owned(),
            us: our_address(&settings),
            plan: lockstep.simulator.floor_plan(),
            settings,
            camera: None,
        },
        links.joint(),
    )
    .unwrap();
    let address = console.address;
    let shown = Arc::<Mutex<Shown>>::default();
    let is_over = Arc::<AtomicBool>::default();
    let (seen, over) = (Arc::clone(&shown), Arc::clone(&is_over));
    let thread = std::thread::spawn(move || {
        let clock = Clock::start(1.0);
        while !over.load(Ordering::Relaxed) {
            let next = lockstep.now() + Duration::from_millis(2);
            let mut event = links.wait(clock.until(next));
            while let Some(e) = event {
                match e {
                    LinkEvent::Up(link) => lockstep.link_up(link),
                    LinkEvent::Down(link) => lockstep.link_down(link),
                    LinkEvent::Bytes {
                        link,
                        bytes,
                        is_datagram,
                    } => lockstep.receive(link, &bytes, is_datagram),
                }
                event = links.poll();
            }
            lockstep.advance(clock.now().min(lockstep.now() + Duration::from_millis(200)));
            while let Some(out) = lockstep.poll() {
                if let Outgoing::Frame(link, frame) = out {
                    links.send(link, frame);
                }
            }
            let control = lockstep.ground.control();
            {
                let mut s = seen.lock().unwrap();
                s.snapshot.clone_from(lockstep.snapshot());
                s.owner = control.owner.map(|(_, system)| system);
                while let Some(line) = console.poll_told() {
                    s.told.push(line);
                }
            }
            if console.wants_picture() {
                let mut picture = Picture {
                    snapshot: lockstep.snapshot().clone(),
                    control,
                    ..Picture::default()
                };
                picture.insight.look(&lockstep.flight);
                console.show(picture);
            }
        }
    });
    Vehicle {
        address,
        folder,
        shown,
        is_over,
        thread: Some(thread),
    }
}

impl Vehicle {
    pub fn shown(&self) -> Shown {
        self.shown.lock().unwrap().clone()
    }

    /// Waits for something to be so; the time it took.
    pub fn until(&self, what: &str, most: Duration, is_so: impl Fn(&Shown) -> bool) -> Duration {
        let clock = Clock::start(1.0);
        loop {
            let shown = self.shown();
            let took = Duration::from_micros(clock.now().us());
            if is_so(&shown) {
                return took;
            }
            assert!(
                took < most,
                "not within {most:?}: {what}; {:?} {:?}",
                shown.snapshot.mode,
                shown.snapshot.arm_blocked_by
            );
            bridge::io::clock::sleep(Duration::from_micros(500));
        }
    }
}

impl Drop for Vehicle {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
