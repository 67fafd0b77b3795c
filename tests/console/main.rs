//! The console from outside: who gets in, who may fly, and what bad input comes to. Flights are in real time, on loopback.
//!
//! Rows of the threat table are named in the tests that stand for them.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    missing_docs,
    unreachable_pub,
    reason = "a test program prints its figures and fails where it stands"
)]

mod accounts;
mod beside;
mod client;
mod fleet;
mod latency;
mod vehicle;

use bridge::autopilot::mode::Mode;
use bridge::io::clock::Clock;
use bridge::web::ledger::{Books, FILE, Log};
use bridge::web::{Console, ConsoleConfig, Role, routes_table};
use client::{Browser, raw_request};
use flight_tests::percentile;
use mavlink_dialect::command::{cmd, result};
use mavlink_dialect::mode::Px4Mode;
use mavlink_dialect::{Address, Encoder, raw};
use serde_json::json;
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::time::Duration;
use vehicle::{PASSWORD, Vehicle, start, start_with};

const SECOND: Duration = Duration::from_secs(1);

fn rows(vehicle: &Vehicle, log: Log) -> Vec<String> {
    rows_in(&vehicle.folder, log)
}

fn rows_in(folder: &Path, log: Log) -> Vec<String> {
    // Notes are written by a thread of their own.
    bridge::io::clock::sleep(Duration::from_millis(150));
    let books = Books::open(Some(&folder.join(FILE))).unwrap();
    books
        .rows(log, 100)
        .unwrap()
        .into_iter()
        .map(|r| format!("{}: {}", r.user, r.what))
        .collect()
}

#[test]
fn without_a_session_there_is_nothing_but_login_static_files_and_health() {
    let vehicle = start();
    let nobody = Browser::new(vehicle.address);
    let mut public = Vec::new();
    for (method, path, _) in routes_table() {
        let path = path.replace("{name}", "x");
        let answer = if method == "GET" {
            nobody.get(&path)
        } else {
            nobody.post(&path, &json!({}))
        };
        if answer.status == 401 {
            assert_eq!(answer.json()["detail"], "log in first", "{path}");
        } else {
            public.push(path);
        }
    }
    assert_eq!(
        public,
        ["/health", "/api/login", "/api/enter", "/api/setup"]
    );
    assert_eq!(nobody.get("/").status, 200);
    assert_eq!(nobody.get("/main.js").status, 200);
    for path in [
        "/api/",
        "/api/nothing",
        "/../etc/passwd",
        "/web/main.js",
        "/api/logs/../../console.sqlite3",
    ] {
        assert!([401, 404].contains(&nobody.get(path).status), "{path}");
    }
    assert_eq!(
        nobody.open(&format!("http://{}", vehicle.address)).err(),
        Some(401)
    );
}

#[test]
fn each_role_reaches_its_routes_and_no_others() {
    let vehicle = start();
    for user in [Role::Viewer, Role::Pilot, Role::Engineer, Role::Admin] {
        let browser = Browser::logged_in(vehicle.address, user.name());
        for (method, path, needs) in routes_table() {
            let (Some(needs), "GET") = (needs, method) else {
                continue;
            };
            if path == "/api/socket" {
                continue;
            }
            let status = browser.get(&path.replace("{name}", "actions")).status;
            assert_eq!(status == 403, user < needs, "{user} {path}: {status}");
        }
    }
    let pilot = Browser::logged_in(vehicle.address, "pilot");
    let try_it = pilot.post("/api/users", &json!({ "name": "pilot", "role": "admin" }));
    assert_eq!(try_it.status, 403);
    assert!(
        rows(&vehicle, Log::Intrusions)
            .iter()
            .any(|r| r.starts_with("pilot: POST /api/users needs"))
    );
}

/// Threat 11: cross-site WebSocket hijack, DNS rebinding.
#[test]
fn a_foreign_origin_or_host_is_refused_with_a_good_cookie_too() {
    let vehicle = start();
    let browser = Browser::logged_in(vehicle.address, "admin");
    assert_eq!(browser.open("https://evil.example").err(), Some(403));
    assert_eq!(browser.open("null").err(), Some(403));
    let port = vehicle.address.port();
    for (host, origin, status) in [
        (
            format!("evil.example:{port}"),
            format!("http://evil.example:{port}"),
            403,
        ),
        (
            format!("127.0.0.1:{}", port.wrapping_add(1)),
            "http://127.0.0.1".to_owned(),
            403,
        ),
        (
            format!("127.0.0.1:{port}"),
            "http://evil.example".to_owned(),
            403,
        ),
        (format!("127.0.0.1:{port}"), String::new(), 403),
        (
            format!("localhost:{port}"),
            format!("http://localhost:{port}"),
            200,
        ),
    ] {
        let text = format!(
            "POST /api/logout HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\nCookie: {}\r\nContent-Type: application/json\r\nContent-Length: 2\r\nConnection: close\r\n\r\n",
            browser.cookie
        );
        assert_eq!(
            raw_request(vehicle.address, &text, b"{}").unwrap().status,
            status,
            "{host} {origin}"
        );
    }
    let seen = rows(&vehicle, Log::Intrusions);
    assert!(
        seen.iter().any(|r| r.contains("foreign host evil.example")),
        "{seen:?}"
    );
    assert!(
        seen.iter()
            .any(|r| r.contains("foreign origin https://evil.example")),
        "{seen:?}"
    );
}

/// Threats 1 and 2, the leases and roles of a socket.
#[test]
fn only_fresh_frames_of_the_one_in_control_reach_the_vehicle() {
    let vehicle = start();
    let mut viewer = Browser::logged_in(vehicle.address, "viewer").page();
    let mut pilot = Browser::logged_in(vehicle.address, "pilot").page();
    let mut other = Browser::logged_in(vehicle.address, "pilot2").page();
    assert_ne!(pilot.system(), other.system());
    let verdict = |p: &mut client::Page| {
        let seq = p.seq;
        p.pump(SECOND, |p| p.acks.iter().any(|a| a.0 == seq));
        bridge::io::clock::sleep(Duration::from_millis(220));
        p.acks.iter().find(|a| a.0 == seq).map(|a| a.1)
    };
    viewer.command(cmd::REQUEST_OPERATOR_CONTROL, 1.0, 0.0);
    assert_eq!(verdict(&mut viewer), Some(5), "not his role");
    pilot.command(cmd::COMPONENT_ARM_DISARM, 1.0, 0.0);
    assert_eq!(verdict(&mut pilot), Some(4), "no control, no lease");
    assert!(pilot.take_control());
    assert_eq!(vehicle.shown().owner, Some(pilot.system()));
    // A lease guessed right is of no use to another socket.
    other.lease = pilot.lease;
    other.command(cmd::COMPONENT_ARM_DISARM, 1.0, 0.0);
    assert_eq!(verdict(&mut other), Some(4));
    // Another's system id.
    let mut forger = Encoder::new(Address {
        system: pilot.system(),
        component: 190,
    });
    let frame = forger.encode(&raw::COMMAND_LONG_DATA {
        target_system: 1,
        target_component: 1,
        command: cmd::COMPONENT_ARM_DISARM,
        param1: 1.0,
        ..Default::default()
    });
    other.send_frames(&frame);
    assert_eq!(verdict(&mut other), Some(6));
    // A command that has waited for more than a second, an old lease, a number seen before, garbage.
    pilot.delay_ms = 1_500.0;
    pilot.command(cmd::COMPONENT_ARM_DISARM, 1.0, 0.0);
    assert_eq!(verdict(&mut pilot), Some(3));
    pilot.delay_ms = 0.0;
    let lease = std::mem::replace(&mut pilot.lease, 0);
    pilot.command(cmd::COMPONENT_ARM_DISARM, 1.0, 0.0);
    assert_eq!(verdict(&mut pilot), Some(4));
    pilot.lease = lease;
    pilot.send_frames(&[0xFD, 3, 0, 0, 1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(verdict(&mut pilot), Some(1));
    pilot.write(2, b"short").unwrap();
    pilot.write(1, b"{not json").unwrap();
    assert!(pilot.pump(SECOND, |p| p.states > 3), "still there");
    // What is too long for any frame closes the socket.
    other.write(2, &vec![0; 5_000]).unwrap();
    assert!(other.pump(2 * SECOND, |p| p.closed.is_some()));
    assert!(!vehicle.shown().snapshot.is_armed);
    let seen = rows(&vehicle, Log::Intrusions);
    for row in [
        "viewer: REQUEST_OPERATOR_CONTROL 1 needs another role than viewer",
        "pilot2: a frame of system",
    ] {
        assert!(seen.iter().any(|r| r.starts_with(row)), "{row}: {seen:?}");
    }
}

/// Threat 3, rows 3 and 5 of the bars: a flight with everything that may go wrong with its pilot.
#[test]
fn a_pilot_flies_others_do_not_and_a_viewer_stops_him() {
    let vehicle = start();
    let mut viewer = Browser::logged_in(vehicle.address, "viewer").page();
    let mut pilot = Browser::logged_in(vehicle.address, "pilot").page();
    let mut other = Browser::logged_in(vehicle.address, "pilot2").page();
    let clock = Clock::start(1.0);
    // The firmware wants five seconds of peace after its start; pages that say nothing are gone by then.
    while clock.now().s() < 12.0 && {
        let now = vehicle.shown().snapshot;
        now.arm_blocked_by.is_some() || now.at.s() < 1.0
    } {
        for page in [&mut viewer, &mut pilot, &mut other] {
            page.beat();
            page.pump(Duration::from_millis(100), |_| false);
        }
    }
    assert!(pilot.take_control());
    pilot.command(cmd::COMPONENT_ARM_DISARM, 1.0, 0.0);
    assert_eq!(
        pilot.result(cmd::COMPONENT_ARM_DISARM),
        Some(result::ACCEPTED)
    );
    pilot.command(cmd::NAV_TAKEOFF, f32::NAN, f32::NAN);
    assert_eq!(pilot.result(cmd::NAV_TAKEOFF), Some(result::ACCEPTED));
    let fly_on = |pilot: &mut client::Page, s: u64, x: i16| {
        let begun = clock.now();
        while clock.now().since(begun) < Duration::from_secs(s) {
            pilot.beat();
            pilot.sticks(x, 0);
            pilot.pump(Duration::from_millis(40), |_| false);
        }
    };
    fly_on(&mut pilot, 5, 0);
    assert!(
        vehicle.shown().snapshot.nav.height_m > 0.7,
        "{}",
        vehicle.shown().snapshot.nav.height_m
    );

    // Somebody without control is told so by the vehicle itself, whatever his page says.
    other.command(cmd::REQUEST_OPERATOR_CONTROL, 1.0, 0.0);
    assert_eq!(
        other.result(cmd::REQUEST_OPERATOR_CONTROL),
        Some(result::FAILED)
    );
    assert_eq!(vehicle.shown().owner, Some(pilot.system()));

    // Sticks: from the socket to the RC frame.
    pilot.send(&raw::COMMAND_LONG_DATA {
        target_system: 1,
        target_component: 1,
        command: cmd::DO_SET_MODE,
        param1: 1.0,
        param2: f32::from(Px4Mode { main: 2, sub: 0 }.main),
        ..Default::default()
    });
    vehicle.until("mode Altitude", 2 * SECOND, |s| {
        s.snapshot.mode.mode == Mode::Altitude
    });
    let mut took_ms = Vec::new();
    for i in 0..12 {
        let x = if i % 2 == 0 { 400 } else { -400 };
        let pitch = vehicle.shown().snapshot.sticks.pitch;
        pilot.sticks(x, 0);
        let took = vehicle.until("sticks in RC", SECOND, |s| {
            (s.snapshot.sticks.pitch - pitch).abs() > 0.08
        });
        took_ms.push(took.as_secs_f64() * 1e3);
        pilot.beat();
        pilot.pump(Duration::from_millis(170), |_| false);
    }
    took_ms.sort_by(f64::total_cmp);
    println!(
        "FIGURES\nsticks, socket to RC frame: median {:.1} ms, longest of 12 {:.1} ms (bar 30)\nEND",
        percentile(&took_ms, 0.5),
        took_ms[took_ms.len() - 1]
    );

    // A page that falls silent with its sticks held: centred by the bridge within 250 ms and a tick.
    for _ in 0..15 {
        pilot.sticks(400, 0);
        pilot.pump(Duration::from_millis(40), |_| false);
    }
    pilot.sticks(400, 0);
    let held = vehicle.shown().snapshot.sticks.pitch;
    let took = vehicle.until("centred", SECOND, |s| {
        (s.snapshot.sticks.pitch - held).abs() > 0.08
    });
    println!(
        "FIGURES\nheld sticks of a silent page centred after {:.0} ms (bar 250 and a tick)\nEND",
        took.as_secs_f64() * 1e3
    );
    // Generous: the time itself is judged in virtual time (`dead_man`).
    assert!(took < 2 * SECOND, "{took:?}");

    // STOP by who may not fly.
    pilot.send(&raw::COMMAND_LONG_DATA {
        target_system: 1,
        target_component: 1,
        command: cmd::DO_SET_MODE,
        param1: 1.0,
        param2: 3.0,
        ..Default::default()
    });
    vehicle.until("mode Position", 2 * SECOND, |s| {
        s.snapshot.mode.mode == Mode::Position
    });
    fly_on(&mut pilot, 1, 300);
    viewer.command(cmd::DO_PAUSE_CONTINUE, 0.0, 0.0);
    let took = vehicle.until("stopped", SECOND, |s| s.snapshot.mode.mode == Mode::Hold);
    println!(
        "FIGURES\nSTOP by a viewer: {:.0} ms (bar 100)\nEND",
        took.as_secs_f64() * 1e3
    );
    // Generous: the bar is held in virtual time (`latency`).
    assert!(took < SECOND, "{took:?}");
    assert_eq!(
        vehicle.shown().owner,
        Some(pilot.system()),
        "control stays where it was"
    );

    // Hand-over: the one who asked gets it when the owner gives it up.
    other.command(cmd::REQUEST_OPERATOR_CONTROL, 1.0, 0.0);
    pilot.pump(SECOND, |p| p.control["asking"]["name"] == "pilot2");
    assert_eq!(pilot.control["asking"]["name"], "pilot2");
    pilot.command(cmd::REQUEST_OPERATOR_CONTROL, 0.0, 0.0);
    assert!(other.pump(2 * SECOND, |p| p.lease != 0));
    assert_eq!(vehicle.shown().owner, Some(other.system()));

    // His page is gone: nobody has control, the vehicle holds.
    drop(other);
    vehicle.until("free", 2 * SECOND, |s| s.owner.is_none());
    assert_eq!(vehicle.shown().snapshot.mode.mode, Mode::Hold);
    let log = rows(&vehicle, Log::Actions);
    for row in [
        "pilot: COMPONENT_ARM_DISARM 1",
        "pilot: manual control begins",
        "viewer: DO_PAUSE_CONTINUE 0",
    ] {
        assert!(log.iter().any(|r| r == row), "{row}: {log:?}");
    }
}

/// Threats 9 and 10: floods, and readers that never read.
#[test]
fn two_hundred_sockets_and_a_page_that_never_reads_leave_the_others_alone() {
    let vehicle = start();
    let browser = Browser::logged_in(vehicle.address, "viewer");
    let mut watcher = Browser::logged_in(vehicle.address, "viewer").page();
    let before = resident_kb();
    let origin = format!("http://{}", vehicle.address);
    let (mut pages, mut refused) = (Vec::new(), 0);
    for _ in 0..200 {
        match browser.open(&origin) {
            Ok(page) => pages.push(page),
            Err(_) => refused += 1,
        }
        if refused > 3 {
            break;
        }
    }
    assert!(pages.len() <= 23, "{}", pages.len());
    let idle: Vec<TcpStream> = (0..200)
        .filter_map(|_| TcpStream::connect(vehicle.address).ok())
        .collect();
    // Nobody of them reads; one of them shouts.
    let loud = pages.first_mut().unwrap();
    let ticks = vehicle.shown().snapshot.flight_loop;
    for _ in 0..20_000 {
        loud.beat();
    }
    let states = watcher.states;
    watcher.beat();
    watcher.pump(2 * SECOND, |_| false);
    assert!(
        watcher.states - states > 20,
        "{} states in 2 s",
        watcher.states - states
    );
    let after = vehicle.shown().snapshot.flight_loop;
    assert!(after.ticks > ticks.ticks);
    let grown = resident_kb().saturating_sub(before);
    println!(
        "FIGURES\n{} pages that do not read, 200 idle connections, 20,000 messages: {grown} kB more memory\nEND",
        pages.len()
    );
    assert!(grown < 120_000, "{grown} kB");
    drop((pages, idle));
    bridge::io::clock::sleep(Duration::from_millis(300));
    assert_eq!(
        Browser::logged_in(vehicle.address, "admin")
            .get("/api/session")
            .status,
        200
    );
}

fn resident_kb() -> u64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find(|l| l.starts_with("VmRSS")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}
