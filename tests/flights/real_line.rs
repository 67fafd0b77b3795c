//! The flight thread of `kestrel fly` on a real socket: the simulator's flight controller answers at the other end.

#![allow(
    clippy::disallowed_methods,
    clippy::unwrap_used,
    reason = "a real line runs in real time"
)]

use bridge::autopilot::door::{
    Asked, Event, Failure, FailureKind, FailureUnit, Notice, Outcome, Refusal, Request, RequestId,
    Snapshot, Station,
};
use bridge::autopilot::flight::{Flight, FlightConfig, Start};
use bridge::io::clock::Clock;
use bridge::io::flight_thread::{self, News};
use bridge::settings::Settings;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use sim::{Room, SimConfig, SimOutput, Simulator};
use std::fs::File;
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::TcpListener;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use vehicle::{Airframe, RingConfig, Timestamp};

/// Serves the fake controller's UART on one TCP connection, in real time, until told to stop.
fn serve(listener: TcpListener, stop: &AtomicBool) {
    let ring = RingConfig::built_in("tof32").unwrap();
    let mut sim = Simulator::new(SimConfig::new(Room::named("office").unwrap(), ring, 1)).unwrap();
    let (mut stream, _) = listener.accept().unwrap();
    stream.set_nonblocking(true).unwrap();
    stream.set_nodelay(true).unwrap();
    let start = Instant::now();
    let mut buffer = [0u8; 512];
    while !stop.load(Ordering::Relaxed) {
        match stream.read(&mut buffer) {
            Ok(n) => sim.write_fc(0, &buffer[..n]),
            Err(e) if e.kind() == ErrorKind::WouldBlock => {}
            Err(_) => return,
        }
        let now = Timestamp::from_us(start.elapsed().as_micros() as u64);
        let mut out = Vec::new();
        sim.advance(now, &mut |_, output| {
            if let SimOutput::FcBytes { bytes, .. } = output {
                out.extend_from_slice(&bytes);
            }
        });
        if stream.write_all(&out).is_err() {
            return;
        }
        std::thread::sleep(Duration::from_micros(500));
    }
}

#[test]
fn a_controller_on_a_socket_is_found_heard_and_not_flown_without_rangers() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let served = Arc::clone(&stop);
    let server = std::thread::spawn(move || serve(listener, &served));

    let room = Room::named("office").unwrap();
    let clock = Clock::start(1.0);
    let flight = Flight::new(
        clock.now(),
        FlightConfig {
            plan: Arc::clone(room.floor_plan()),
            ring: RingConfig::built_in("tof32").unwrap(),
            airframe: Airframe::default(),
            start: Start::Known(room.home()),
            settings: Settings::default(),
            seed: 1,
        },
    );
    let endpoint = format!("tcpclient://{address}").parse().unwrap();
    let handle = flight_thread::start(flight, endpoint, clock, None).unwrap();

    let mut snapshot = Snapshot::default();
    let deadline = Instant::now() + Duration::from_secs(30);
    while !(snapshot.imu.is_some()
        && snapshot.battery.is_some()
        && snapshot.fc.blocks.is_clear()
        && clock.now().s() > 7.0)
    {
        assert!(Instant::now() < deadline, "{:?}", snapshot.fc);
        std::thread::sleep(Duration::from_millis(20));
        handle.read_snapshot(&mut snapshot);
    }
    assert_eq!(&snapshot.fc.variant, b"BTFL");
    assert!(snapshot.fc.service_rate_hz > 50.0, "{:?}", snapshot.fc);
    let accel = snapshot.imu.unwrap().accel_mps2;
    assert!((accel.z() + 9.8).abs() < 0.5, "at rest: {accel:?}");

    let station = Station {
        system: 255,
        component: 190,
    };
    assert!(handle.ask(Asked {
        id: RequestId(5),
        station,
        request: Request::Arm { force: false }
    }));
    let answer = loop {
        assert!(Instant::now() < deadline, "no answer");
        if let Some(News::Answer(answer)) = handle.poll() {
            break answer;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    assert_eq!(
        (answer.id, answer.outcome),
        (RequestId(5), Outcome::Refused(Refusal::NoRangers))
    );
    assert!(handle.ask(Asked {
        id: RequestId(6),
        station,
        request: Request::Inject(Failure {
            unit: FailureUnit::Motor,
            kind: FailureKind::Off,
            instance: 1,
        })
    }));
    let answer = loop {
        assert!(Instant::now() < deadline, "no answer");
        if let Some(News::Answer(answer)) = handle.poll() {
            break answer;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    assert_eq!(
        (answer.id, answer.outcome),
        (RequestId(6), Outcome::Refused(Refusal::NotSimulated)),
        "nothing is broken on a real vehicle"
    );
    stop.store(true, Ordering::Relaxed);
    server.join().unwrap();
}

/// A pseudo terminal that a cable stands for: the controller's end, and where ours is.
fn plug_in(device: &Path) -> File {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    rustix::io::ioctl_fionbio(&master, true).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
    let _ = std::fs::remove_file(device);
    std::os::unix::fs::symlink(&name, device).unwrap();
    File::from(master)
}

#[test]
fn a_serial_controller_that_is_absent_comes_is_unplugged_and_comes_again_is_found_each_time() {
    let folder = std::env::temp_dir().join(format!("kestrel-line-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let device = folder.join("ttyTEST");
    let room = Room::named("office").unwrap();
    let clock = Clock::start(1.0);
    let flight = Flight::new(
        clock.now(),
        FlightConfig {
            plan: Arc::clone(room.floor_plan()),
            ring: RingConfig::built_in("tof32").unwrap(),
            airframe: Airframe::default(),
            start: Start::Known(room.home()),
            settings: Settings::default(),
            seed: 1,
        },
    );
    let endpoint = format!("serial://{}?baudrate=115200", device.display());
    let handle = flight_thread::start(flight, endpoint.parse().unwrap(), clock, None).unwrap();
    let mut snapshot = Snapshot::default();
    let (mut absent, mut opened, mut lost) = (0, 0, 0);
    let mut look = |snapshot: &mut Snapshot| {
        while let Some(news) = handle.poll() {
            match news {
                News::LineAbsent(why) => {
                    assert!(why.contains("ttyTEST"), "{why}");
                    absent += 1;
                }
                News::LineOpened => opened += 1,
                News::Event(Event::Notice(Notice::FcLost { .. })) => lost += 1,
                _ => {}
            }
        }
        handle.read_snapshot(snapshot);
        (absent, opened, lost)
    };
    let wait = Duration::from_millis(5);

    // Not there: told once, however often it is tried.
    let until = Instant::now() + Duration::from_millis(1_800);
    while Instant::now() < until {
        look(&mut snapshot);
        std::thread::sleep(wait);
    }
    assert_eq!(look(&mut snapshot), (1, 0, 0));

    for round in 1..=2 {
        let mut master = plug_in(&device);
        let ring = RingConfig::built_in("tof32").unwrap();
        let mut sim =
            Simulator::new(SimConfig::new(Room::named("office").unwrap(), ring, 1)).unwrap();
        let start = Instant::now();
        let mut buffer = [0u8; 512];
        loop {
            assert!(
                start.elapsed() < Duration::from_secs(20),
                "{:?}",
                snapshot.fc
            );
            if let Ok(n) = master.read(&mut buffer) {
                sim.write_fc(0, &buffer[..n]);
            }
            let now = Timestamp::from_us(start.elapsed().as_micros() as u64);
            let mut out = Vec::new();
            sim.advance(now, &mut |_, output| {
                if let SimOutput::FcBytes { bytes, .. } = output {
                    out.extend_from_slice(&bytes);
                }
            });
            let _ = master.write_all(&out);
            let (_, opened, _) = look(&mut snapshot);
            if opened == round && snapshot.fc.is_connected && snapshot.imu.is_some() {
                break;
            }
            std::thread::sleep(Duration::from_micros(500));
        }
        // The cable comes out.
        drop(master);
        let since = Instant::now();
        loop {
            let (_, _, lost) = look(&mut snapshot);
            if lost == round && !snapshot.fc.is_connected {
                break;
            }
            assert!(since.elapsed() < Duration::from_secs(5), "not noticed");
            std::thread::sleep(wait);
        }
    }
    std::fs::remove_dir_all(&folder).unwrap();
}
