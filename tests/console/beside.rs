//! The flight thread of `kestrel fly`, with a fake controller on a socket, beside everything the console has to bear: 16 viewers that
//! read, pages being loaded, 50,000 MAVLink messages a second. What it costs is printed: this machine has other work too.

use crate::client::Browser;
use crate::vehicle::folder_with;
use bridge::autopilot::door::{LoopStatus, Snapshot};
use bridge::autopilot::flight::{Flight, FlightConfig, Start};
use bridge::autopilot::ground::{Ground, GroundConfig, GroundOutput};
use bridge::io::clock::{Clock, sleep};
use bridge::io::flight_thread::{self, News};
use bridge::io::lockstep::our_address;
use bridge::io::net::{LinkEvent, Links, Wanted};
use bridge::settings::Settings;
use bridge::web::{Console, ConsoleConfig, Picture, Role};
use mavlink_dialect::{Address, Encoder, raw};
use sim::{Room, SimConfig, SimOutput, Simulator};
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;
use vehicle::{Airframe, RingConfig, Timestamp};

const LASTS: Duration = Duration::from_secs(5);
const FLOOD_HZ: u64 = 50_000;

/// The fake controller on one TCP connection, in real time.
fn controller(listener: &TcpListener, over: &AtomicBool) {
    let ring = RingConfig::built_in("tof32").unwrap();
    let mut sim = Simulator::new(SimConfig::new(Room::named("office").unwrap(), ring, 1)).unwrap();
    let (mut stream, _) = listener.accept().unwrap();
    stream.set_nonblocking(true).unwrap();
    stream.set_nodelay(true).unwrap();
    let clock = Clock::start(1.0);
    let mut buffer = [0; 512];
    while !over.load(Ordering::Relaxed) {
        match stream.read(&mut buffer) {
            Ok(n) => sim.write_fc(0, &buffer[..n]),
            Err(e) if e.kind() == ErrorKind::WouldBlock => {}
            Err(_) => return,
        }
        let mut out = Vec::new();
        sim.advance(clock.now(), &mut |_, output| {
            if let SimOutput::FcBytes { bytes, .. } = output {
                out.extend_from_slice(&bytes);
            }
        });
        if stream.write_all(&out).is_err() {
            return;
        }
        sleep(Duration::from_micros(500));
    }
}

/// Who bears what.
struct Load {
    pages: usize,
    loads_pages: bool,
    flood_hz: u64,
}

struct Outcome {
    status: LoopStatus,
    /// Bytes the viewers read.
    seen: u64,
    /// Messages of the flood.
    flooded: u64,
    /// Ticks of the flight thread, a second.
    ticks_hz: f64,
}

#[expect(clippy::too_many_lines, reason = "one scene from start to end")]
fn run(load: &Load) -> Outcome {
    let over = Arc::new(AtomicBool::new(false));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let fc = listener.local_addr().unwrap();
    let ends = Arc::clone(&over);
    let controller = thread::spawn(move || controller(&listener, &ends));

    let room = Room::named("office").unwrap();
    let settings = Settings::default();
    let plan = Arc::clone(room.floor_plan());
    let clock = Clock::start(1.0);
    let flight = Flight::new(
        clock.now(),
        FlightConfig {
            plan: Arc::clone(&plan),
            ring: RingConfig::built_in("tof32").unwrap(),
            airframe: Airframe::default(),
            start: Start::Known(room.home()),
            settings: settings.clone(),
            seed: 1,
        },
    );
    let us = our_address(&settings);
    let mut ground = Ground::new(GroundConfig {
        us,
        settings: settings.clone(),
        anchor: plan.anchor(),
        plan: Arc::clone(&plan),
        airframe: Airframe::default(),
        boot_utc_us: 1,
        documents: Vec::new(),
    });
    let wanted = Wanted {
        endpoint: "udpserver://127.0.0.1:0".parse().unwrap(),
        is_default: false,
        policy: Default::default(),
    };
    let links = Links::open(&[wanted]).unwrap();
    let udp: SocketAddr = links.described[0]
        .trim_start_matches("udpserver://")
        .parse()
        .unwrap();
    let folder = folder_with(&[("viewer", Role::Viewer)]);
    let mut console = Console::start(
        ConsoleConfig {
            listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            is_default: false,
            state_dir: Some(folder.clone()),
            has_link: false,
            names: Vec::new(),
            vehicle: "office".to_owned(),
            us,
            plan,
            settings,
            camera: None,
        },
        links.joint(),
    )
    .unwrap();
    let at = console.address;
    let endpoint = format!("tcpclient://{fc}").parse().unwrap();
    let handle = flight_thread::start(flight, endpoint, clock, None).unwrap();

    let (seen, flooded) = (Arc::<AtomicU64>::default(), Arc::<AtomicU64>::default());
    let begins = Arc::new(AtomicBool::new(false));
    let mut others = Vec::new();
    let browser = Browser::logged_in(at, "viewer");
    for n in 0..load.pages {
        let (ends, starts, seen) = (Arc::clone(&over), Arc::clone(&begins), Arc::clone(&seen));
        let (loads, browser) = (load.loads_pages && n < 2, browser.clone());
        others.push(thread::spawn(move || {
            let mut page = browser.page();
            while !ends.load(Ordering::Relaxed) {
                let before = page.states;
                page.pump(Duration::from_millis(100), |_| false);
                seen.fetch_add(u64::from(page.states - before), Ordering::Relaxed);
                page.beat();
                if loads && starts.load(Ordering::Relaxed) {
                    for path in ["/", "/main.js", "/plan.js", "/style.css", "/api/plan"] {
                        assert_eq!(browser.get(path).status, 200);
                    }
                }
            }
        }));
    }
    if load.flood_hz > 0 {
        let (ends, starts, sent) = (Arc::clone(&over), Arc::clone(&begins), Arc::clone(&flooded));
        let hz = load.flood_hz;
        others.push(thread::spawn(move || {
            let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
            let mut encoder = Encoder::new(Address {
                system: 99,
                component: 190,
            });
            let frame = encoder.encode(&raw::HEARTBEAT_DATA::default()).to_vec();
            let many = frame.repeat(50);
            let clock = Clock::start(1.0);
            let mut due = clock.now();
            while !ends.load(Ordering::Relaxed) {
                if !starts.load(Ordering::Relaxed) || clock.now() < due {
                    sleep(Duration::from_micros(500));
                    due = due.max(clock.now());
                    continue;
                }
                // Fifty messages a datagram, one datagram each so many microseconds.
                due += Duration::from_micros(50 * 1_000_000 / hz);
                if socket.send_to(&many, udp).is_ok() {
                    sent.fetch_add(50, Ordering::Relaxed);
                }
            }
        }));
    }

    let mut snapshot = Snapshot::default();
    let mut tick = 0;
    let mut began: Option<(Timestamp, u64)> = None;
    let deadline = clock.now() + Duration::from_secs(60);
    loop {
        let mut event = links.wait(Duration::from_millis(2));
        for _ in 0..256 {
            let Some(e) = event.take() else { break };
            let now = clock.now();
            match e {
                LinkEvent::Up(link) => drop(ground.link_up(now, link)),
                LinkEvent::Down(link) => ground.link_down(link),
                LinkEvent::Bytes {
                    link,
                    bytes,
                    is_datagram,
                } => {
                    ground.receive(now, link, &bytes, is_datagram);
                }
            }
            event = links.poll();
        }
        let now = clock.now();
        while let Some(news) = handle.poll() {
            match news {
                News::Answer(answer) => ground.answer(now, &answer),
                News::Event(event) => ground.event(now, &event),
                _ => {}
            }
        }
        handle.read_snapshot(&mut snapshot);
        if snapshot.flight_loop.ticks != tick {
            tick = snapshot.flight_loop.ticks;
            ground.snapshot(now, &snapshot);
        }
        if ground.deadline() <= now {
            ground.tick(now);
        }
        while let Some(output) = ground.poll() {
            match output {
                GroundOutput::Send { link, bytes } => links.send(link, bytes),
                GroundOutput::Request(asked) => drop(handle.ask(asked)),
                _ => {}
            }
        }
        if console.wants_picture() {
            let mut picture = Picture {
                snapshot: snapshot.clone(),
                control: ground.control(),
                ..Picture::default()
            };
            handle.read_insight(&mut picture.insight);
            console.show(picture);
        }
        match began {
            None => {
                assert!(now < deadline, "not ready: {:?}", snapshot.fc);
                let is_watched = seen.load(Ordering::Relaxed) >= 20 * load.pages as u64;
                if snapshot.fc.is_connected && snapshot.imu.is_some() && is_watched {
                    begins.store(true, Ordering::Relaxed);
                    began = Some((now, snapshot.flight_loop.ticks));
                    seen.store(0, Ordering::Relaxed);
                }
            }
            Some((since, _)) if now.since(since) >= LASTS => break,
            Some(_) => {}
        }
    }
    let (since, ticks) = began.unwrap();
    let lasted_s = clock.now().since(since).as_secs_f64();
    over.store(true, Ordering::Relaxed);
    assert!(snapshot.fc.is_connected, "the controller was lost");
    drop(handle);
    controller.join().unwrap();
    for other in others {
        other.join().unwrap();
    }
    std::fs::remove_dir_all(folder).unwrap();
    Outcome {
        status: snapshot.flight_loop,
        seen: seen.load(Ordering::Relaxed),
        flooded: flooded.load(Ordering::Relaxed),
        ticks_hz: (snapshot.flight_loop.ticks - ticks) as f64 / lasted_s,
    }
}

/// Threat 9: flood and exhaustion; row 9 of the bars.
#[test]
fn the_flight_thread_keeps_its_beat_beside_16_viewers_page_loads_and_a_flood() {
    println!(
        "FIGURES flight thread, 5 s each: own share of reply to RC frame, age of the attitude in it"
    );
    for (name, load) in [
        (
            "alone",
            Load {
                pages: 0,
                loads_pages: false,
                flood_hz: 0,
            },
        ),
        (
            "16 viewers, two of them loading pages",
            Load {
                pages: 16,
                loads_pages: true,
                flood_hz: 0,
            },
        ),
        (
            "and 50,000 messages a second",
            Load {
                pages: 16,
                loads_pages: true,
                flood_hz: FLOOD_HZ,
            },
        ),
    ] {
        let o = run(&load);
        println!(
            " {name}: share {}; age {}; {:.0} ticks/s, {} missed; viewers saw {}, flood {}",
            o.status.reply_to_command,
            o.status.sample_to_command,
            o.ticks_hz,
            o.status.missed,
            o.seen,
            o.flooded
        );
        // Generous: what is bad on any machine.
        assert!(o.ticks_hz > 10.0, "{name}: {} ticks a second", o.ticks_hz);
        if load.pages > 0 {
            assert!(
                o.seen > load.pages as u64 * 10,
                "{name}: the viewers saw {}",
                o.seen
            );
        }
    }
    println!("END");
}
