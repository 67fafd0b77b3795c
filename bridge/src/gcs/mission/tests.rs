//! The mission protocol against scripted stations on links that lose, repeat and reorder.

use super::super::bench::{Bench, Dice, answer, station};
use super::*;
use crate::autopilot::door::{Asked, MissionState, MissionStatus, Refusal};
use proptest::prelude::*;
use vehicle::FloorPlan;
use vehicle::floor_plan::Cell;

use raw::MavMessage as M;

const A: Peer = station(245);
const B: Peer = station(250);

/// A waypoint of frame LOCAL_NED, metres.
fn waypoint(seq: u16, north_m: f64, east_m: f64) -> MissionItem {
    MissionItem {
        seq,
        frame: 1,
        command: 16,
        current: u8::from(seq == 0),
        autocontinue: 1,
        params: [0.0, 0.0, 0.0, f32::NAN],
        x: (north_m * 1e4) as i32,
        y: (east_m * 1e4) as i32,
        z: -1.0,
    }
}

fn route(n: u16) -> Vec<MissionItem> {
    (0..n)
        .map(|seq| waypoint(seq, 1.0 + f64::from(seq) * 0.01, 2.0))
        .collect()
}

/// The service with a vehicle behind it that takes every plan with the next tick.
struct Vehicle {
    service: MissionService,
    bench: Bench,
    out: Outbox,
    now: Timestamp,
    plans: Vec<Arc<Plan>>,
    outcome: Outcome,
}

impl Vehicle {
    fn new(walls: Option<Walls>) -> Self {
        Self {
            service: MissionService::new(walls),
            bench: Bench::default(),
            out: Outbox::default(),
            now: Timestamp::ZERO,
            plans: Vec::new(),
            outcome: Outcome::Accepted,
        }
    }

    fn take(&mut self, from: Peer, m: M) {
        self.service.handle(
            self.now,
            from,
            &Message::Raw(m),
            &self.bench.ctx(),
            &mut self.out,
        );
    }

    fn tick(&mut self, ms: u64) {
        self.now += Duration::from_millis(ms);
        for asked in self.out.asked() {
            if let Request::SetPlan(plan) = &asked.request {
                self.plans.push(Arc::clone(plan));
                self.bench.snapshot.mission = MissionStatus {
                    seq: 0,
                    total: plan.items.len() as u16,
                    state: MissionState::NotStarted,
                };
            }
            let answer = answer(&asked, self.outcome);
            assert!(
                self.service
                    .answer(self.now, &answer, &self.bench.ctx(), &mut self.out)
            );
        }
        self.service
            .tick(self.now, &self.bench.ctx(), &mut self.out);
    }

    /// Mission messages sent, MISSION_CURRENT aside.
    fn said(&mut self) -> Vec<M> {
        self.out.sent_raw()
    }

    fn acks(&mut self) -> Vec<(u8, u8)> {
        let ack = |m| match m {
            M::MISSION_ACK(a) => Some((a.target_system, a.mavtype)),
            _ => None,
        };
        self.said().into_iter().filter_map(ack).collect()
    }

    /// An upload over a perfect link; the final result.
    fn upload(&mut self, from: Peer, items: &[MissionItem]) -> u8 {
        self.take(from, count(items.len() as u16));
        for _ in 0..2 * items.len() + 20 {
            for m in self.said() {
                match m {
                    M::MISSION_REQUEST_INT(r) => self.take(from, int(&items[usize::from(r.seq)])),
                    M::MISSION_ACK(ack) => return ack.mavtype,
                    _ => {}
                }
            }
            self.tick(10);
        }
        panic!("no MISSION_ACK");
    }
}

fn count(n: u16) -> M {
    count_of(n, 0)
}

fn count_of(n: u16, mission_type: u8) -> M {
    M::MISSION_COUNT(raw::MISSION_COUNT_DATA {
        count: n,
        mission_type,
        target_system: 1,
        ..Default::default()
    })
}

fn int(item: &MissionItem) -> M {
    M::MISSION_ITEM_INT(item.to_int(1, 1))
}

fn list(mission_type: u8) -> M {
    M::MISSION_REQUEST_LIST(raw::MISSION_REQUEST_LIST_DATA {
        mission_type,
        ..Default::default()
    })
}

fn request(seq: u16) -> M {
    M::MISSION_REQUEST_INT(raw::MISSION_REQUEST_INT_DATA {
        seq,
        ..Default::default()
    })
}

fn clear(mission_type: u8) -> M {
    M::MISSION_CLEAR_ALL(raw::MISSION_CLEAR_ALL_DATA {
        mission_type,
        ..Default::default()
    })
}

fn bytes(items: &[MissionItem]) -> Vec<[u8; 34]> {
    items.iter().map(MissionItem::bytes).collect()
}

/// What a link does to messages.
#[derive(Clone, Copy, Debug)]
struct Weather {
    loss: f64,
    repeat: f64,
    /// Longest extra delay, ms: reorders.
    jitter_ms: f64,
}

/// A conversation that is longer has failed.
const PATIENCE: Duration = Duration::from_secs(900);

/// Messages on their way, in both directions.
struct Air {
    weather: Weather,
    dice: Dice,
    flying: Vec<(Timestamp, bool, M)>,
}

impl Air {
    fn send(&mut self, now: Timestamp, to_vehicle: bool, m: &M) {
        let copies = if self.dice.roll() < self.weather.repeat {
            2
        } else {
            1
        };
        for _ in 0..copies {
            if self.dice.roll() >= self.weather.loss {
                let delay_ms = 3.0 + self.dice.roll() * self.weather.jitter_ms;
                self.flying.push((
                    now + Duration::from_micros((delay_ms * 1e3) as u64),
                    to_vehicle,
                    m.clone(),
                ));
            }
        }
    }

    fn arrived(&mut self, now: Timestamp) -> Vec<(bool, M)> {
        self.flying.sort_by_key(|(at, ..)| *at);
        let n = self.flying.partition_point(|(at, ..)| *at <= now);
        self.flying
            .drain(..n)
            .map(|(_, to_vehicle, m)| (to_vehicle, m))
            .collect()
    }
}

/// A station: what it does on a message and on time; `Some(result)` ends it.
trait Station {
    fn start(&mut self, now: Timestamp) -> Vec<M>;
    fn take(&mut self, now: Timestamp, m: &M) -> Vec<M>;
    fn tick(&mut self, now: Timestamp) -> Vec<M>;
    fn result(&self) -> Option<Result<(), String>>;
}

/// Flies a station against the vehicle; its result and the seconds it took.
fn converse(
    vehicle: &mut Vehicle,
    station: &mut dyn Station,
    weather: Weather,
    seed: u64,
) -> (Result<(), String>, f64) {
    let mut air = Air {
        weather,
        dice: Dice(seed),
        flying: Vec::new(),
    };
    let begin = vehicle.now;
    for m in station.start(vehicle.now) {
        air.send(vehicle.now, true, &m);
    }
    while vehicle.now.since(begin) < PATIENCE {
        vehicle.tick(5);
        for m in vehicle.said() {
            air.send(vehicle.now, false, &m);
        }
        for (to_vehicle, m) in air.arrived(vehicle.now) {
            if to_vehicle {
                vehicle.take(A, m);
            } else {
                for m in station.take(vehicle.now, &m) {
                    air.send(vehicle.now, true, &m);
                }
            }
        }
        for m in station.tick(vehicle.now) {
            air.send(vehicle.now, true, &m);
        }
        if let Some(result) = station.result() {
            return (result, vehicle.now.seconds_since(begin));
        }
    }
    (Err("still talking".to_owned()), PATIENCE.as_secs_f64())
}

/// A script that answers whatever is asked, and says its last word again when it hears nothing for 1.5 s.
struct PatientUploader {
    items: Vec<MissionItem>,
    heard_at: Timestamp,
    last: Vec<M>,
    result: Option<Result<(), String>>,
}

impl PatientUploader {
    fn new(items: Vec<MissionItem>) -> Self {
        Self {
            items,
            heard_at: Timestamp::ZERO,
            last: Vec::new(),
            result: None,
        }
    }
}

impl Station for PatientUploader {
    fn start(&mut self, now: Timestamp) -> Vec<M> {
        self.heard_at = now;
        self.last = vec![count(self.items.len() as u16)];
        self.last.clone()
    }

    fn take(&mut self, now: Timestamp, m: &M) -> Vec<M> {
        self.heard_at = now;
        match m {
            M::MISSION_REQUEST_INT(r) => {
                self.last = vec![int(&self.items[usize::from(r.seq)])];
                self.last.clone()
            }
            M::MISSION_ACK(ack) => {
                self.result = Some(if ack.mavtype == 0 {
                    Ok(())
                } else {
                    Err(format!("ACK {}", ack.mavtype))
                });
                Vec::new()
            }
            other => panic!("{other:?}"),
        }
    }

    fn tick(&mut self, now: Timestamp) -> Vec<M> {
        if now.since(self.heard_at) < Duration::from_millis(1500) {
            return Vec::new();
        }
        self.heard_at = now;
        self.last.clone()
    }

    fn result(&self) -> Option<Result<(), String>> {
        self.result.clone()
    }
}

/// What MAVSDK 4.1.0 was measured to do: steps back on a late request and ignores requests above its place; never sends
/// an item by itself; gives up after five half seconds of silence or five repeats of one item.
struct StepBackUploader {
    items: Vec<MissionItem>,
    next: u16,
    repeats: u8,
    strikes: u8,
    heard_at: Timestamp,
    result: Option<Result<(), String>>,
}

impl StepBackUploader {
    fn new(items: Vec<MissionItem>) -> Self {
        Self {
            items,
            next: 0,
            repeats: 0,
            strikes: 0,
            heard_at: Timestamp::ZERO,
            result: None,
        }
    }
}

impl Station for StepBackUploader {
    fn start(&mut self, now: Timestamp) -> Vec<M> {
        self.heard_at = now;
        vec![count(self.items.len() as u16)]
    }

    fn take(&mut self, now: Timestamp, m: &M) -> Vec<M> {
        match m {
            M::MISSION_REQUEST_INT(r) if r.seq <= self.next => {
                (self.heard_at, self.strikes) = (now, 0);
                self.repeats = if r.seq + 1 == self.next {
                    self.repeats + 1
                } else {
                    0
                };
                if self.repeats >= 5 {
                    self.result = Some(Err(format!("item {} asked for too often", r.seq)));
                }
                self.next = r.seq + 1;
                vec![int(&self.items[usize::from(r.seq)])]
            }
            M::MISSION_ACK(ack) => {
                let is_done = ack.mavtype == 0 && usize::from(self.next) == self.items.len();
                self.result = Some(if is_done {
                    Ok(())
                } else {
                    Err(format!("ACK {} at {}", ack.mavtype, self.next))
                });
                Vec::new()
            }
            _ => Vec::new(),
        }
    }

    fn tick(&mut self, now: Timestamp) -> Vec<M> {
        if now.since(self.heard_at) < Duration::from_millis(500) {
            return Vec::new();
        }
        (self.heard_at, self.strikes) = (now, self.strikes + 1);
        if self.strikes >= 5 {
            self.result = Some(Err("silence".to_owned()));
        }
        if self.next == 0 {
            vec![count(self.items.len() as u16)]
        } else {
            Vec::new()
        }
    }

    fn result(&self) -> Option<Result<(), String>> {
        self.result.clone()
    }
}

/// A script that reads the plan, asking again after 0.4 s.
#[derive(Default)]
struct Downloader {
    count: Option<u16>,
    got: Vec<MissionItem>,
    asked_at: Timestamp,
}

impl Downloader {
    fn question(&self) -> Vec<M> {
        match self.count {
            None => vec![list(0)],
            Some(_) => vec![request(self.got.len() as u16)],
        }
    }
}

impl Station for Downloader {
    fn start(&mut self, now: Timestamp) -> Vec<M> {
        self.asked_at = now;
        self.question()
    }

    fn take(&mut self, now: Timestamp, m: &M) -> Vec<M> {
        match m {
            M::MISSION_COUNT(c) if self.count.is_none() => self.count = Some(c.count),
            M::MISSION_ITEM_INT(i) if usize::from(i.seq) == self.got.len() => {
                self.got.push(MissionItem::from_int(i))
            }
            _ => return Vec::new(),
        }
        self.asked_at = now;
        if self.result().is_some() {
            Vec::new()
        } else {
            self.question()
        }
    }

    fn tick(&mut self, now: Timestamp) -> Vec<M> {
        if now.since(self.asked_at) < Duration::from_millis(400) {
            return Vec::new();
        }
        self.asked_at = now;
        self.question()
    }

    fn result(&self) -> Option<Result<(), String>> {
        (self.count.map(usize::from) == Some(self.got.len())).then_some(Ok(()))
    }
}

#[test]
fn plans_go_up_and_come_back_bit_for_bit_whatever_the_link_loses() {
    for (loss, seeds, n) in [(0.0, 5, 60), (0.1, 30, 40), (0.3, 60, 25)] {
        for seed in 0..seeds {
            let weather = Weather {
                loss,
                repeat: 0.1,
                jitter_ms: 80.0,
            };
            let mut vehicle = Vehicle::new(None);
            let mut up = PatientUploader::new(route(n));
            let (result, _) = converse(&mut vehicle, &mut up, weather, seed);
            assert_eq!(result, Ok(()), "upload, loss {loss}, seed {seed}");
            assert_eq!(
                bytes(vehicle.service.items()),
                bytes(&up.items),
                "loss {loss}, seed {seed}"
            );
            assert_eq!(
                vehicle.plans.last().map(|p| p.items.len()),
                Some(usize::from(n))
            );
            let mut down = Downloader::default();
            let (result, _) = converse(&mut vehicle, &mut down, weather, seed + 1000);
            assert_eq!(result, Ok(()), "download, loss {loss}, seed {seed}");
            assert_eq!(
                bytes(&down.got),
                bytes(&up.items),
                "loss {loss}, seed {seed}"
            );
        }
    }
}

#[test]
fn plans_of_every_size_survive_every_weather() {
    const RUNS: u64 = 20;
    println!(
        "FIGURES missions up and down, {RUNS} runs a cell, reordered and repeated: identical, longest s"
    );
    for n in [2u16, 50, 500] {
        for loss in [0.0, 0.1, 0.3] {
            let weather = Weather {
                loss,
                repeat: 0.1,
                jitter_ms: 60.0,
            };
            let (mut same, mut longest) = (0, 0f64);
            for seed in 0..RUNS {
                let mut vehicle = Vehicle::new(None);
                let mut up = PatientUploader::new(route(n));
                let (sent, up_s) = converse(&mut vehicle, &mut up, weather, 31 * seed + 7);
                let mut down = Downloader::default();
                let (got, down_s) = converse(&mut vehicle, &mut down, weather, 57 * seed + 3);
                let is_same = bytes(&down.got) == bytes(&up.items);
                same += u64::from(sent.is_ok() && got.is_ok() && is_same);
                longest = longest.max(up_s).max(down_s);
            }
            println!(
                "{n} items, loss {:.0} %: {same} of {RUNS}, {longest:.1}",
                100.0 * loss
            );
            let least = if loss < 0.2 { RUNS } else { RUNS - RUNS / 20 };
            assert!(same >= least, "{n} items, loss {loss}: {same} of {RUNS}");
        }
    }
    println!("END");
}

#[test]
fn five_hundred_items_go_up_quickly_over_a_good_link() {
    let mut vehicle = Vehicle::new(None);
    let weather = Weather {
        loss: 0.0,
        repeat: 0.0,
        jitter_ms: 2.0,
    };
    let (result, seconds) = converse(
        &mut vehicle,
        &mut PatientUploader::new(route(500)),
        weather,
        1,
    );
    assert_eq!(result, Ok(()));
    assert!(
        seconds < 8.0,
        "{seconds} s for 500 items at 5 ms a step each way"
    );
}

#[test]
fn a_station_that_steps_back_on_late_requests_is_followed() {
    for (loss, repeat, seeds) in [(0.0, 0.3, 40), (0.1, 0.1, 60)] {
        for seed in 0..seeds {
            let weather = Weather {
                loss,
                repeat,
                jitter_ms: 60.0,
            };
            let mut vehicle = Vehicle::new(None);
            let mut up = StepBackUploader::new(route(20));
            let (result, seconds) = converse(&mut vehicle, &mut up, weather, seed);
            assert_eq!(
                result,
                Ok(()),
                "loss {loss}, repeat {repeat}, seed {seed}, {seconds} s"
            );
            assert_eq!(bytes(vehicle.service.items()), bytes(&up.items));
        }
    }
}

#[test]
fn while_one_station_uploads_another_is_denied_and_reads_the_old_plan() {
    let mut v = Vehicle::new(None);
    assert_eq!(v.upload(A, &route(3)), 0);
    let old = v.service.items().to_vec();
    v.take(A, count(5));
    v.said();
    for m in [count(2), count(0), clear(0), clear(255)] {
        v.take(B, m);
        assert_eq!(v.acks(), [(250, mission_result::DENIED)]);
    }
    v.take(A, int(&waypoint(0, 9.0, 9.0)));
    v.said();
    v.take(B, int(&waypoint(1, 7.0, 7.0)));
    assert!(
        v.said().is_empty(),
        "items of a station that does not upload are nothing"
    );
    v.take(B, list(0));
    v.take(B, request(0));
    match &v.said()[..] {
        [M::MISSION_COUNT(c), M::MISSION_ITEM_INT(i)] => {
            assert_eq!((c.count, c.target_system), (3, 250));
            assert_eq!(MissionItem::from_int(i).bytes(), old[0].bytes());
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_plan_that_changes_while_it_is_read_is_read_to_its_end_as_it_was() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(3));
    v.take(B, list(0));
    let replacement: Vec<_> = (0..2).map(|seq| waypoint(seq, 5.0, 5.0)).collect();
    assert_eq!(v.upload(A, &replacement), 0);
    v.said();
    v.take(B, request(2));
    assert!(matches!(&v.said()[..], [M::MISSION_ITEM_INT(i)] if i.x == 10_200));
    v.take(B, list(0));
    assert!(matches!(&v.said()[..], [M::MISSION_COUNT(c)] if c.count == 2));
    v.take(B, request(2));
    assert_eq!(v.acks(), [(250, mission_result::INVALID_SEQUENCE)]);
}

#[test]
fn an_abandoned_upload_keeps_the_old_plan() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(3));
    let id = v.service.plan_ids().mission;
    v.take(A, count(4));
    v.take(A, int(&waypoint(0, 4.0, 4.0)));
    for _ in 0..501 {
        v.tick(10);
    }
    assert!(
        v.out
            .said()
            .iter()
            .any(|(_, t)| t == "Mission upload abandoned at item 1 of 4")
    );
    assert_eq!(
        (v.service.plan_ids().mission, v.service.items().len()),
        (id, 3)
    );
    assert_eq!(v.plans.len(), 1, "the vehicle was told nothing");
    assert_eq!(v.upload(B, &route(2)), 0, "and the next station is served");
}

#[test]
fn a_cancelled_upload_keeps_the_old_plan() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(3));
    v.take(A, count(4));
    v.take(
        A,
        M::MISSION_ACK(raw::MISSION_ACK_DATA {
            mavtype: 15,
            ..Default::default()
        }),
    );
    v.said();
    v.tick(300);
    assert!(v.said().is_empty(), "nothing more is asked for");
    assert_eq!(v.service.items().len(), 3);
}

#[test]
fn the_final_ack_is_said_three_times_unless_the_station_goes_on() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(1));
    let mut at = Vec::new();
    for i in 1..=200u64 {
        v.tick(10);
        if !v.acks().is_empty() {
            at.push(i * 10);
        }
    }
    assert_eq!(at, [300, 900]);
    v.take(A, int(&route(1)[0]));
    assert_eq!(v.acks(), [(245, 0)], "the last item again: its ACK again");

    v.upload(A, &route(1));
    v.take(A, list(0));
    v.said();
    v.tick(1000);
    assert!(v.acks().is_empty(), "the station went on");
}

#[test]
fn a_refused_item_names_its_fault_and_keeps_the_old_plan() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(3));
    let wrong = |change: fn(&mut MissionItem)| {
        let mut items = route(2);
        change(&mut items[1]);
        items
    };
    for (items, result) in [
        (wrong(|i| i.command = 209), mission_result::UNSUPPORTED),
        (wrong(|i| i.frame = 10), mission_result::UNSUPPORTED_FRAME),
        (wrong(|i| i.z = f32::NAN), mission_result::INVALID_PARAM7),
        (
            wrong(|i| i.params[3] = f32::INFINITY),
            mission_result::INVALID_PARAM1 + 3,
        ),
        (
            wrong(|i| (i.command, i.params) = (177, [7.0, 1.0, 0.0, 0.0])),
            mission_result::INVALID_PARAM1,
        ),
        (wrong(|i| i.seq = 2), mission_result::INVALID_SEQUENCE),
    ] {
        assert_eq!(v.upload(A, &items), result);
        assert_eq!(v.service.items().len(), 3);
        let said = v.out.said();
        assert!(
            said.last()
                .is_some_and(|(_, t)| t.starts_with("Mission refused: item ")),
            "{said:?}"
        );
    }
}

#[test]
fn a_plan_the_vehicle_refuses_is_not_stored() {
    let mut v = Vehicle::new(None);
    v.outcome = Outcome::Refused(Refusal::ShuttingDown);
    assert_eq!(v.upload(A, &route(2)), mission_result::DENIED);
    assert!(v.service.items().is_empty());
}

#[test]
fn a_vehicle_that_does_not_answer_is_an_error_not_a_wait_for_ever() {
    let mut v = Vehicle::new(None);
    v.take(A, count(1));
    v.take(A, int(&waypoint(0, 1.0, 1.0)));
    let late = v.out.asked().remove(0);
    v.said();
    v.tick(2000);
    assert_eq!(v.acks(), [(245, mission_result::ERROR)]);
    v.tick(2000);
    assert!(v.acks().is_empty());
    let yes = answer(&late, Outcome::Accepted);
    assert!(v.service.answer(v.now, &yes, &v.bench.ctx(), &mut v.out));
    assert_eq!(
        v.service.items().len(),
        1,
        "what the vehicle flies is what is stored"
    );
}

/// An empty room of 10 m by 10 m with a wall around it.
fn room() -> Walls {
    let is_edge = |i: usize| i == 0 || i == 99;
    let cell = |i: usize| {
        if is_edge(i % 100) || is_edge(i / 100) {
            Cell::Occupied
        } else {
            Cell::Free
        }
    };
    let plan =
        FloorPlan::from_cells(100, 0.1, [-5.0, -5.0], (0..10_000).map(cell).collect()).unwrap();
    Walls::new(Arc::new(plan), 0.25)
}

#[test]
fn items_in_a_wall_off_the_plan_or_through_the_ceiling_are_refused_with_the_reason() {
    let mut v = Vehicle::new(Some(room()));
    assert_eq!(
        v.upload(A, &[waypoint(0, 1.0, 1.0), waypoint(1, -4.0, 4.0)]),
        0
    );
    for (item, result, reason) in [
        (
            waypoint(1, 4.85, 0.0),
            mission_result::INVALID_PARAM5_X,
            "from a wall",
        ),
        (
            waypoint(1, 60.0, 0.0),
            mission_result::INVALID_PARAM5_X,
            "outside the floor plan",
        ),
        (
            MissionItem {
                z: -9.0,
                ..waypoint(1, 1.0, 1.0)
            },
            mission_result::INVALID_PARAM7,
            "height 9.00 m",
        ),
    ] {
        assert_eq!(v.upload(A, &[waypoint(0, 1.0, 1.0), item]), result);
        let said = v.out.said();
        assert!(
            said.iter()
                .any(|(_, t)| t.contains("item 1") && t.contains(reason)),
            "{said:?}"
        );
        assert_eq!(v.service.items().len(), 2);
    }
}

#[test]
fn frames_give_the_same_place() {
    let v = Vehicle::new(None);
    let ctx = v.bench.ctx();
    let geo = super::super::convert::GeoAnchor::from_params(&ctx.settings.ground);
    let p = geo.to_global(vehicle::In::new(1.0, 2.0, -1.0));
    let local = plan::plan_item(&waypoint(0, 1.0, 2.0), &ctx);
    let Ok(planner::mission::PlanItem::Waypoint {
        position,
        yaw_rad: None,
        ..
    }) = local
    else {
        panic!("{local:?}")
    };
    for frame in [0, 3, 5, 6] {
        let item = MissionItem {
            frame,
            x: p.lat_e7,
            y: p.lon_e7,
            z: 1.0,
            ..waypoint(0, 0.0, 0.0)
        };
        match plan::plan_item(&item, &ctx) {
            Ok(planner::mission::PlanItem::Waypoint { position: same, .. }) => {
                assert!((same - position).norm() < 0.01, "frame {frame}: {same:?}");
            }
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_home_item_of_an_ardupilot_file_is_skipped_and_a_real_first_item_is_not() {
    let mut v = Vehicle::new(None);
    let (lat, lon) = (
        v.bench.settings.ground.lat0_e7,
        v.bench.settings.ground.lon0_e7,
    );
    let home = MissionItem {
        frame: 0,
        x: lat,
        y: lon,
        z: 0.0,
        ..waypoint(0, 0.0, 0.0)
    };
    v.upload(A, &[home, waypoint(1, 1.0, 1.0)]);
    assert_eq!(v.plans[0].items[0], planner::mission::PlanItem::Skip);
    v.upload(
        A,
        &[
            MissionItem {
                frame: 3,
                z: 1.0,
                ..home
            },
            waypoint(1, 1.0, 1.0),
        ],
    );
    assert_ne!(v.plans[1].items[0], planner::mission::PlanItem::Skip);
    assert_eq!(
        bytes(&v.service.items()[1..]),
        bytes(&[waypoint(1, 1.0, 1.0)])
    );
}

/// An item of a fence or a rally point, in the global frame as stations send them.
fn point(seq: u16, command: u16, param1: f32, lat_e7: i32) -> MissionItem {
    MissionItem {
        seq,
        frame: 5,
        command,
        params: [param1, 0.0, 0.0, 0.0],
        x: 473_977_420 + lat_e7,
        y: 85_455_940 + lat_e7 % 7,
        ..Default::default()
    }
}

/// Sends a list of points as a station does; the result of the last ACK.
fn upload_points(v: &mut Vehicle, from: Peer, kind: u8, items: &[MissionItem]) -> Option<u8> {
    v.take(from, count_of(items.len() as u16, kind));
    let mut result = None;
    loop {
        let said = v.said();
        let mut asked = None;
        for m in said {
            match m {
                M::MISSION_REQUEST_INT(r) if r.mission_type == kind => asked = Some(r.seq),
                M::MISSION_ACK(a) if a.mission_type == kind => result = Some(a.mavtype),
                other => panic!("{other:?}"),
            }
        }
        let Some(seq) = asked else { return result };
        let mut item = items[usize::from(seq)].to_int(1, 1);
        item.mission_type = kind;
        v.take(from, M::MISSION_ITEM_INT(item));
    }
}

/// Reads a list back as a station does.
fn download_points(v: &mut Vehicle, from: Peer, kind: u8) -> (Vec<MissionItem>, u32) {
    v.take(from, list(kind));
    let said = v.said();
    let [M::MISSION_COUNT(head)] = &said[..] else {
        panic!("{said:?}")
    };
    assert_eq!(head.mission_type, kind);
    let mut items = Vec::new();
    for seq in 0..head.count {
        v.take(
            from,
            M::MISSION_REQUEST_INT(raw::MISSION_REQUEST_INT_DATA {
                seq,
                mission_type: kind,
                ..Default::default()
            }),
        );
        let said = v.said();
        let [M::MISSION_ITEM_INT(item)] = &said[..] else {
            panic!("{said:?}")
        };
        assert_eq!(item.mission_type, kind);
        items.push(MissionItem::from_int(item));
    }
    (items, head.opaque_id)
}

fn a_fence() -> Vec<MissionItem> {
    // A sliver to stay out of beside home, and a circle about home to stay in.
    let corner = |seq: u16| point(seq, 5002, 4.0, i32::from(seq) * 1_000 + 500);
    let mut items: Vec<_> = (0..4).map(corner).collect();
    items.push(point(4, 5003, 0.5, 10));
    items
}

#[test]
fn mission_fence_and_rally_points_are_lists_of_their_own() {
    let mut v = Vehicle::new(None);
    let rally = [point(0, 5100, 0.0, 3), point(1, 5100, 0.0, 5)];
    assert_eq!(v.upload(A, &route(3)), 0);
    v.said();
    assert_eq!(
        upload_points(&mut v, A, mission_type::FENCE, &a_fence()),
        Some(0)
    );
    assert_eq!(
        upload_points(&mut v, B, mission_type::RALLY, &rally),
        Some(0)
    );
    let (fence_back, fence_id) = download_points(&mut v, B, mission_type::FENCE);
    let (rally_back, rally_id) = download_points(&mut v, A, mission_type::RALLY);
    assert_eq!(bytes(&fence_back), bytes(&a_fence()));
    assert_eq!(bytes(&rally_back), bytes(&rally));
    let ids = v.service.plan_ids();
    assert_eq!((ids.fence, ids.rally), (fence_id, rally_id));
    assert!(ids.mission != 0 && fence_id != 0 && rally_id != 0 && fence_id != rally_id);
    // What is stored is read again after a restart.
    let mut again = Vehicle::new(None);
    let documents: Vec<_> = v.out.documents.drain(..).collect();
    for document in &documents {
        let ctx = again.bench.ctx();
        again
            .service
            .restore_document(Timestamp::ZERO, document, &ctx, &mut again.out);
    }
    assert_eq!(again.service.plan_ids().fence, fence_id);
    assert_eq!(again.service.plan_ids().rally, rally_id);
    // Clearing one leaves the others; clearing all leaves none.
    v.take(A, clear(mission_type::FENCE));
    assert_eq!(v.acks(), [(245, 0)]);
    let ids = v.service.plan_ids();
    assert_eq!((ids.fence, ids.rally), (0, rally_id));
    assert_ne!(ids.mission, 0);
    v.take(A, clear(mission_type::ALL));
    v.tick(10);
    assert_eq!(v.service.plan_ids(), PlanIds::default());
    v.take(A, list(9));
    assert!(v.acks().contains(&(245, mission_result::UNSUPPORTED)));
}

#[test]
fn a_fence_that_cannot_be_is_refused_and_the_old_one_stays() {
    let mut v = Vehicle::new(None);
    assert_eq!(
        upload_points(&mut v, A, mission_type::FENCE, &a_fence()),
        Some(0)
    );
    let id = v.service.plan_ids().fence;
    let cases: [(Vec<MissionItem>, u8); 6] = [
        (a_fence()[..3].to_vec(), mission_result::INVALID_PARAM1),
        (vec![point(0, 5003, 0.0, 0)], mission_result::INVALID_PARAM1),
        (
            vec![point(0, 5003, f32::NAN, 0)],
            mission_result::INVALID_PARAM1,
        ),
        (vec![point(0, 16, 0.0, 0)], mission_result::UNSUPPORTED),
        (vec![point(0, 5100, 0.0, 0)], mission_result::UNSUPPORTED),
        (
            vec![MissionItem {
                frame: 2,
                ..point(0, 5003, 1.0, 0)
            }],
            mission_result::UNSUPPORTED_FRAME,
        ),
    ];
    for (items, result) in cases {
        assert_eq!(
            upload_points(&mut v, A, mission_type::FENCE, &items),
            Some(result),
            "{items:?}"
        );
    }
    v.take(A, count_of(POINTS_CAPACITY + 1, mission_type::FENCE));
    assert_eq!(v.acks(), [(245, mission_result::NO_SPACE)]);
    // Two stations at once, and one that falls silent.
    v.take(A, count_of(5, mission_type::FENCE));
    v.said();
    v.take(B, count_of(5, mission_type::FENCE));
    assert_eq!(v.acks(), [(250, mission_result::DENIED)]);
    for _ in 0..100 {
        v.tick(100);
    }
    assert_eq!(v.service.plan_ids().fence, id);
    v.said();
    assert_eq!(
        upload_points(
            &mut v,
            B,
            mission_type::FENCE,
            &a_fence()[4..]
                .iter()
                .map(|i| MissionItem { seq: 0, ..*i })
                .collect::<Vec<_>>()
        ),
        Some(0)
    );
    assert_ne!(v.service.plan_ids().fence, id);
}

#[test]
fn a_full_store_takes_512_items_and_no_more() {
    let mut v = Vehicle::new(None);
    assert_eq!(v.upload(A, &route(512)), 0);
    v.take(A, count(513));
    assert_eq!(v.acks(), [(245, mission_result::NO_SPACE)]);
    assert_eq!(v.service.items().len(), 512);
}

#[test]
fn clearing_is_acknowledged_in_the_words_it_was_asked_in() {
    let mut v = Vehicle::new(None);
    for (message, mission_type) in [(clear(255), 255), (clear(0), 0), (count(0), 0)] {
        v.upload(A, &route(2));
        v.said();
        v.take(A, message);
        v.tick(10);
        let acks = v.said();
        assert!(
            matches!(&acks[..], [M::MISSION_ACK(a)] if (a.mavtype, a.mission_type, a.opaque_id) == (0, mission_type, 0)),
            "{acks:?}"
        );
        assert!(v.service.items().is_empty());
        assert_eq!(v.plans.last().map(|p| p.items.len()), Some(0));
    }
}

#[test]
fn an_old_station_is_answered_in_floats_and_partial_lists_are_refused() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(2));
    v.said();
    v.take(
        A,
        M::MISSION_REQUEST(raw::MISSION_REQUEST_DATA {
            seq: 1,
            ..Default::default()
        }),
    );
    assert!(
        matches!(&v.said()[..], [M::MISSION_ITEM(i)] if (i.x - 1.01).abs() < 1e-6 && i.seq == 1)
    );
    v.take(
        A,
        M::MISSION_WRITE_PARTIAL_LIST(raw::MISSION_WRITE_PARTIAL_LIST_DATA::default()),
    );
    assert_eq!(v.acks(), [(245, mission_result::UNSUPPORTED)]);
}

#[test]
fn an_old_station_may_answer_in_floats() {
    let mut v = Vehicle::new(None);
    v.take(A, count(1));
    v.take(A, M::MISSION_ITEM(waypoint(0, 1.5, -2.5).to_float(1, 1)));
    v.tick(10);
    assert_eq!(
        (v.service.items()[0].x, v.service.items()[0].y),
        (15_000, -25_000)
    );
}

#[test]
fn the_plans_id_changes_with_the_plan_and_is_the_same_everywhere() {
    let mut v = Vehicle::new(None);
    v.take(A, count(1));
    v.take(A, int(&waypoint(0, 1.0, 1.0)));
    v.tick(10);
    let id = v.service.plan_ids().mission;
    let sent = v.said();
    assert!(
        sent.iter()
            .any(|m| matches!(m, M::MISSION_ACK(a) if a.opaque_id == id && id != 0)),
        "{sent:?}"
    );
    v.take(B, list(0));
    assert!(matches!(&v.said()[..], [M::MISSION_COUNT(c)] if c.opaque_id == id));
    v.upload(A, &[waypoint(0, 1.0, 1.1)]);
    assert_ne!(v.service.plan_ids().mission, id);
}

#[test]
fn a_stored_plan_is_restored_by_the_next_run_and_a_broken_one_is_dropped_with_a_reason() {
    let mut v = Vehicle::new(None);
    let items = [
        waypoint(0, 1.0, 1.0),
        MissionItem {
            command: 20,
            frame: 2,
            ..waypoint(1, 0.0, 0.0)
        },
    ];
    v.upload(A, &items);
    let document = v.out.documents.pop_back().unwrap();
    assert_eq!(document.name, "mission.json");

    let mut next = Vehicle::new(Some(room()));
    next.service
        .restore(next.now, &document.bytes, &next.bench.ctx(), &mut next.out);
    next.tick(10);
    assert_eq!(bytes(next.service.items()), bytes(&items));
    assert_eq!(
        next.service.plan_ids().mission,
        v.service.plan_ids().mission
    );
    assert_eq!(next.plans[0].items.len(), 2);
    assert!(next.acks().is_empty(), "nobody waits for it");

    let mut outside = Vehicle::new(Some(room()));
    for (broken, reason) in [
        (&b"{"[..], "cannot be read"),
        (
            &document::write(&[waypoint(0, 60.0, 0.0)])[..],
            "item 0: the place is outside",
        ),
    ] {
        outside
            .service
            .restore(outside.now, broken, &outside.bench.ctx(), &mut outside.out);
        outside.tick(10);
        let said = outside.out.said();
        assert!(said[0].1.contains(reason), "{said:?}");
        assert!(outside.plans.is_empty());
    }
}

#[test]
#[expect(deprecated, reason = "stations still send MISSION_SET_CURRENT")]
fn set_current_asks_the_vehicle_and_says_what_came_of_it() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(3));
    let m = standard::MavMessage::MISSION_SET_CURRENT(standard::MISSION_SET_CURRENT_DATA {
        seq: 2,
        target_system: 1,
        target_component: 1,
    });
    v.service.handle(
        v.now,
        A,
        &Message::Standard(m.clone()),
        &v.bench.ctx(),
        &mut v.out,
    );
    assert!(matches!(
        v.out.requests.front(),
        Some(Asked {
            request: Request::SetMissionItem(2),
            ..
        })
    ));
    v.tick(10);
    v.outcome = Outcome::Refused(Refusal::NoSuchItem { seq: 2, total: 1 });
    v.service
        .handle(v.now, A, &Message::Standard(m), &v.bench.ctx(), &mut v.out);
    v.out.said();
    v.tick(10);
    assert_eq!(
        v.out.said()[0].1,
        "Mission item refused: no mission item 2 (there are 1)"
    );
}

#[test]
fn reached_items_are_reported() {
    let mut out = Outbox::default();
    MissionService::new(None).event(&Event::ItemReached(7), &mut out);
    assert_eq!(
        out.sent(),
        [Message::Standard(
            standard::MavMessage::MISSION_ITEM_REACHED(standard::MISSION_ITEM_REACHED_DATA {
                seq: 7
            })
        )]
    );
}

fn any_message() -> impl Strategy<Value = M> {
    let seq = || prop_oneof![0u16..5, any::<u16>()];
    let kind = || prop_oneof![4 => Just(0u8), 1 => any::<u8>()];
    let item = (
        seq(),
        prop_oneof![Just(16u16), Just(22), Just(177), any::<u16>()],
        any::<[u32; 5]>(),
        any::<[i32; 2]>(),
        0u8..12,
    )
        .prop_map(|(seq, command, words, [x, y], frame)| {
            let [a, b, c, d, z] = words.map(f32::from_bits);
            MissionItem {
                seq,
                frame,
                command,
                current: 0,
                autocontinue: 1,
                params: [a, b, c, d],
                x,
                y,
                z,
            }
        });
    prop_oneof![
        (seq(), kind()).prop_map(|(n, kind)| count_of(n, kind)),
        item.prop_map(|i| int(&i)),
        (0u16..5).prop_map(|seq| int(&waypoint(seq, 1.0, 1.0))),
        kind().prop_map(list),
        seq().prop_map(request),
        kind().prop_map(clear),
        any::<u8>().prop_map(|mavtype| M::MISSION_ACK(raw::MISSION_ACK_DATA {
            mavtype,
            ..Default::default()
        })),
    ]
}

proptest! {
    #[test]
    fn no_order_of_messages_panics_or_leaves_half_a_plan(
        script in proptest::collection::vec((any::<bool>(), any_message(), 0u64..400), 0..60)
    ) {
        let mut v = Vehicle::new(Some(room()));
        for (is_a, m, ms) in script {
            v.take(if is_a { A } else { B }, m);
            v.tick(ms);
            let planned = v.plans.last().map_or(0, |p| p.items.len());
            prop_assert_eq!(v.service.items().len(), planned);
            prop_assert_eq!(v.service.plan_ids().mission, fingerprint(v.service.items()));
        }
    }
}
