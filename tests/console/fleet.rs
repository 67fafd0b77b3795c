//! Several vehicles behind one console that is aboard of none of them: two simulators, each with a console of its own.

use crate::client::{Browser, Page};
use crate::vehicle::{Vehicle, folder_with, start_with};
use crate::{SECOND, rows, rows_in};
use bridge::io::clock::Clock;
use bridge::web::key::MachineKey;
use bridge::web::ledger::{Books, FILE, Log};
use bridge::web::place::Place;
use bridge::web::{Console, FleetConfig, Role, about_vehicle, certificate_pin};
use mavlink_dialect::command::{cmd, result};
use serde_json::json;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// A vehicle that lets a console with a key of this role in.
struct Drone {
    vehicle: Vehicle,
    key: MachineKey,
}

impl Drone {
    fn start(n: u8, role: Role) -> Self {
        let vehicle = start_with(&[("owner", Role::Admin)], false, &[]);
        let key = MachineKey::new([n; 32]);
        let books = Books::open(Some(&vehicle.folder.join(FILE))).unwrap();
        books.set_key("guardhouse", &key, role, 1).unwrap();
        Self { vehicle, key }
    }

    /// Plain, on this machine.
    fn place(&self) -> String {
        format!("http://{}/#key={}", self.vehicle.address, self.key.to_hex())
    }

    /// By TLS, known by its certificate.
    fn sealed_place(&self) -> String {
        let pin = certificate_pin(&self.vehicle.folder, &[]).unwrap();
        format!(
            "https://{}/#key={}&pin={pin}",
            self.vehicle.address,
            self.key.to_hex()
        )
    }
}

struct Guardhouse {
    console: Console,
    folder: PathBuf,
}

impl Guardhouse {
    fn start(users: &[(&str, Role)], vehicles: &[(&str, String)]) -> Self {
        let folder = folder_with(users);
        let place = |text: &String| -> Place { text.parse().unwrap() };
        let console = Console::start_fleet(FleetConfig {
            listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            is_default: false,
            state_dir: Some(folder.clone()),
            names: Vec::new(),
            vehicles: vehicles
                .iter()
                .map(|(name, url)| (Some((*name).to_owned()), place(url)))
                .collect(),
        })
        .unwrap();
        let house = Self { console, folder };
        // The address first, then each vehicle.
        for _ in 0..=vehicles.len() {
            let line = house.console.wait_told(10 * SECOND).unwrap();
            assert!(line.is_some(), "not all vehicles were added");
        }
        house
    }

    fn browser(&self, user: &str) -> Browser {
        Browser::logged_in(self.console.address, user)
    }

    fn open(&self, browser: &Browser, vehicle: &str) -> Result<Page, u16> {
        let origin = format!("http://{}", self.console.address);
        browser.open_at(&format!("/api/vehicles/{vehicle}/socket"), &origin)
    }

    fn assign(&self, admin: &Browser, user: &str, vehicle: &str, on: bool) -> u16 {
        let body = json!({ "user": user, "vehicle": vehicle, "on": on });
        admin.post("/api/fleet/assign", &body).status
    }
}

impl Drop for Guardhouse {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

const USERS: [(&str, Role); 4] = [
    ("ana", Role::Pilot),
    ("ben", Role::Pilot),
    ("guard", Role::Viewer),
    ("boss", Role::Admin),
];

/// RNF scalability: many users and craft.
#[test]
fn two_users_of_one_console_see_and_command_each_his_own_of_two_vehicles() {
    let (east, west) = (
        Drone::start(1, Role::Engineer),
        Drone::start(2, Role::Engineer),
    );
    // One over plain HTTP on this machine, one over TLS.
    let house = Guardhouse::start(
        &USERS,
        &[("east", east.place()), ("west", west.sealed_place())],
    );
    let boss = house.browser("boss");
    assert_eq!(house.assign(&boss, "ana", "east", true), 200);
    assert_eq!(house.assign(&boss, "ben", "west", true), 200);
    assert_eq!(house.assign(&boss, "nobody", "west", true), 404);
    assert_eq!(house.assign(&boss, "ben", "north", true), 404);
    let (ana, ben) = (house.browser("ana"), house.browser("ben"));
    assert_eq!(
        house.assign(&ana, "ana", "west", true),
        403,
        "not hers to say"
    );

    // Each lists his own only, and both vehicles are there.
    for (user, his, other) in [(&ana, "east", "west"), (&ben, "west", "east")] {
        let session = user.get("/api/session").json();
        assert_eq!(session["vehicles"], json!([his]));
        assert_eq!(session["vehicle"], json!(null));
        let list = user.get("/api/vehicles").json();
        assert_eq!(list.as_object().unwrap().len(), 1, "{list}");
        assert_eq!(list[his]["is_there"], true, "{list}");
        assert_eq!(list[his]["about"]["name"], "office");
        let plan = user.get(&format!("/api/vehicles/{his}/plan"));
        assert_eq!(plan.status, 200);
        assert!(plan.json()["walls"].as_array().unwrap().len() > 4);
        // Everything about the other one is refused, as is everything about one that is not there.
        for path in about_vehicle() {
            let below = path.trim_start_matches("/api").trim_start_matches('/');
            let below = below.replace("{name}", "1.mcap");
            for name in [other, "north"] {
                let answer = user.get(&format!("/api/vehicles/{name}/{below}"));
                assert_eq!(answer.status, 403, "{name} {below}");
            }
        }
        assert_eq!(house.open(user, other).err(), Some(403));
        assert_eq!(house.open(user, "north").err(), Some(403));
        // Accounts of the vehicle itself are not reached through here.
        for path in ["users", "keys", "audit/logins", "session", "../users"] {
            let answer = user.get(&format!("/api/vehicles/{his}/{path}"));
            assert_eq!(answer.status, 404, "{path}");
        }
        assert_eq!(user.get("/api/plan").status, 404, "no vehicle is named");
    }
    assert_eq!(
        boss.get("/api/vehicles").json(),
        json!({}),
        "not his either"
    );
    let nobody = Browser::new(house.console.address);
    assert_eq!(nobody.get("/api/vehicles/east/plan").status, 401);
    assert_eq!(house.open(&nobody, "east").err(), Some(401));

    // Each flies his own: the lock of each vehicle knows who.
    let mut a = house.open(&ana, "east").unwrap();
    let mut b = house.open(&ben, "west").unwrap();
    assert!(a.take_control() && b.take_control());
    assert_eq!(a.control["owner"]["name"], "ana@guardhouse");
    assert_eq!(b.control["owner"]["name"], "ben@guardhouse");
    let clock = Clock::start(1.0);
    while clock.now().s() < 12.0 && east.vehicle.shown().snapshot.arm_blocked_by.is_some() {
        for page in [&mut a, &mut b] {
            page.beat();
            page.pump(Duration::from_millis(100), |_| false);
        }
    }
    a.command(cmd::COMPONENT_ARM_DISARM, 1.0, 0.0);
    assert_eq!(a.result(cmd::COMPONENT_ARM_DISARM), Some(result::ACCEPTED));
    assert!(east.vehicle.shown().snapshot.is_armed);
    assert!(!west.vehicle.shown().snapshot.is_armed);
    assert_eq!(east.vehicle.shown().owner, Some(a.system()));
    assert_eq!(west.vehicle.shown().owner, Some(b.system()));

    // A guard watches and stops, and no more.
    assert_eq!(house.assign(&boss, "guard", "east", true), 200);
    let mut guard = house.open(&house.browser("guard"), "east").unwrap();
    guard.command(cmd::COMPONENT_ARM_DISARM, 0.0, 0.0);
    let seq = guard.seq;
    assert!(
        guard.pump(SECOND, |p| p.acks.contains(&(seq, 5))),
        "his role"
    );
    guard.command(cmd::DO_PAUSE_CONTINUE, 0.0, 0.0);
    assert_eq!(guard.result(cmd::DO_PAUSE_CONTINUE), Some(result::ACCEPTED));
    assert!(east.vehicle.shown().snapshot.is_armed);

    // What is taken away is closed at once, and nobody is left in control.
    assert_eq!(house.assign(&boss, "ana", "east", false), 200);
    assert!(a.pump(2 * SECOND, |p| p.closed.is_some()));
    assert_eq!(a.closed, Some(4001));
    assert_eq!(ana.get("/api/vehicles/east/plan").status, 403);
    east.vehicle
        .until("free", 2 * SECOND, |s| s.owner.is_none());

    // Both sides wrote it down.
    let here = rows_in(&house.folder, Log::Actions);
    for row in [
        "ana: COMPONENT_ARM_DISARM 1",
        "guard: DO_PAUSE_CONTINUE 0",
        "boss: assigned east: ana",
        "boss: took away east: ana",
    ] {
        assert!(here.iter().any(|r| r == row), "{row}: {here:?}");
    }
    let refused = rows_in(&house.folder, Log::Intrusions);
    for row in [
        "ana: /api/socket of the vehicle west, which is not his",
        "guard: COMPONENT_ARM_DISARM 0 needs another role than viewer",
    ] {
        assert!(refused.iter().any(|r| r == row), "{row}: {refused:?}");
    }
    let there = rows(&east.vehicle, Log::Actions);
    let row = "ana@guardhouse: COMPONENT_ARM_DISARM 1";
    assert!(there.iter().any(|r| r == row), "{there:?}");
}

#[test]
fn a_key_opens_no_more_than_its_role_and_no_longer_than_it_is_there() {
    let drone = Drone::start(3, Role::Viewer);
    let house = Guardhouse::start(&[("ana", Role::Pilot)], &[("east", drone.place())]);
    // The only user there is has what the command line brought.
    let ana = house.browser("ana");
    let mut page = house.open(&ana, "east").unwrap();
    page.command(cmd::REQUEST_OPERATOR_CONTROL, 1.0, 0.0);
    let seq = page.seq;
    assert!(
        page.pump(SECOND, |p| p.acks.contains(&(seq, 5))),
        "a pilot here, but the key is a viewer's there"
    );
    assert_eq!(ana.get("/api/vehicles/east/logs").status, 403, "her role");
    // Removed beside the running program.
    let books = Books::open(Some(&drone.vehicle.folder.join(FILE))).unwrap();
    books.remove_key("guardhouse").unwrap();
    assert!(page.pump(3 * SECOND, |p| p.closed.is_some()));
    assert_eq!(page.closed, Some(4004), "open it again");
    let answer = ana.get("/api/vehicles/east/plan");
    assert_eq!(answer.status, 502);
    let said = answer.json()["detail"].to_string();
    assert!(said.contains("does not know this console's key"), "{said}");
    assert_eq!(house.open(&ana, "east").err(), Some(502));
    assert_eq!(
        ana.get("/api/session").status,
        200,
        "she herself is still in"
    );
}

#[test]
fn a_vehicle_with_another_certificate_or_none_at_all_is_not_spoken_to() {
    let drone = Drone::start(4, Role::Engineer);
    let house = Guardhouse::start(&[("boss", Role::Admin)], &[("east", drone.sealed_place())]);
    let boss = house.browser("boss");
    assert_eq!(boss.get("/api/vehicles/east/plan").status, 200);
    let add = |url: &str| boss.post("/api/fleet", &json!({ "name": "copy", "url": url }));
    let forged = drone
        .sealed_place()
        .split("&pin=")
        .next()
        .unwrap()
        .to_owned()
        + &format!("&pin={}", "0c".repeat(32));
    let refused = add(&forged);
    assert_eq!(refused.status, 502);
    assert!(refused.json()["detail"].to_string().contains("certificate"));
    // Without a pin the first certificate is kept: another one later is refused.
    let unpinned = drone
        .sealed_place()
        .split("&pin=")
        .next()
        .unwrap()
        .to_owned();
    assert_eq!(add(&unpinned).status, 200);
    let kept = Books::open(Some(&house.folder.join(FILE)))
        .unwrap()
        .roster()
        .unwrap();
    assert!(kept.vehicles["copy"].contains("&pin="), "kept");
    for (url, status) in [
        ("https://10.0.0.7:8443/", 422),
        ("http://10.0.0.7:8443/#key=00", 422),
        (
            &format!("https://127.0.0.1:1/#key={}", "ab".repeat(32)),
            200,
        ),
    ] {
        let answer = boss.post("/api/fleet", &json!({ "name": "far", "url": url }));
        assert_eq!(answer.status, status, "{url}: {}", answer.json());
    }
    let list = boss.get("/api/vehicles").json();
    assert_eq!(list["far"]["is_there"], false, "{list}");
    assert_eq!(boss.get("/api/vehicles/far/plan").status, 502);
    // Keys are told to nobody.
    let all = boss.get("/api/fleet");
    assert!(!String::from_utf8_lossy(&all.body).contains(&drone.key.to_hex()));
    assert_eq!(
        boss.post("/api/fleet/remove", &json!({ "name": "far" }))
            .status,
        200
    );
    assert_eq!(boss.get("/api/vehicles/far/plan").status, 403);
}

/// A simulator's link is used once, and leaves a key behind.
#[test]
fn the_link_of_a_simulators_terminal_is_enough() {
    let vehicle = start_with(&[], true, &[]);
    vehicle.until("a link", SECOND, |s| !s.told.is_empty());
    let told = vehicle.shown().told[0].clone();
    let link = told.split_whitespace().last().unwrap().to_owned();
    let house = Guardhouse::start(&[("ana", Role::Pilot)], &[("sim", link.clone())]);
    let ana = house.browser("ana");
    let mut page = house.open(&ana, "sim").unwrap();
    assert!(page.take_control());
    // The same command line again: the link is used up, the key it was changed for opens.
    let again = ana.get("/api/vehicles/sim/plan");
    assert_eq!(again.status, 200);
    let place: Place = link.parse().unwrap();
    let second = Console::start_fleet(FleetConfig {
        listen: SocketAddr::from(([127, 0, 0, 1], 0)),
        is_default: false,
        state_dir: Some(house.folder.clone()),
        names: Vec::new(),
        vehicles: vec![(None, place)],
    })
    .unwrap();
    let lines: Vec<String> = (0..2)
        .map(|_| second.wait_told(10 * SECOND).unwrap().unwrap())
        .collect();
    assert!(
        lines.iter().any(|l| l.starts_with("Vehicle sim: http://")),
        "{lines:?}"
    );
}

#[test]
fn others_reach_a_console_of_several_vehicles_only_when_somebody_has_a_password() {
    let refused = Console::start_fleet(FleetConfig {
        listen: SocketAddr::from(([0, 0, 0, 0], 0)),
        is_default: false,
        state_dir: None,
        names: Vec::new(),
        vehicles: Vec::new(),
    })
    .err()
    .unwrap()
    .to_string();
    assert!(refused.contains("kestrel passwd"), "{refused}");
}
