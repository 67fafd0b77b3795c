//! A vehicle behind the service, and scripted stations on bad links.

use super::*;

pub(super) const A: Peer = station(245);
pub(super) const B: Peer = station(250);

/// A waypoint of frame LOCAL_NED, metres.
pub(super) fn waypoint(seq: u16, north_m: f64, east_m: f64) -> MissionItem {
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

pub(super) fn route(n: u16) -> Vec<MissionItem> {
    (0..n)
        .map(|seq| waypoint(seq, 1.0 + f64::from(seq) * 0.01, 2.0))
        .collect()
}

/// The service with a vehicle behind it that takes every plan with the next tick.
pub(super) struct Vehicle {
    pub(super) service: MissionService,
    pub(super) bench: Bench,
    pub(super) out: Outbox,
    pub(super) now: Timestamp,
    pub(super) plans: Vec<Arc<Plan>>,
    pub(super) outcome: Outcome,
}

impl Vehicle {
    pub(super) fn new(walls: Option<Walls>) -> Self {
        Self {
            service: MissionService::new(walls),
            bench: Bench::default(),
            out: Outbox::default(),
            now: Timestamp::ZERO,
            plans: Vec::new(),
            outcome: Outcome::Accepted,
        }
    }

    pub(super) fn take(&mut self, from: Peer, m: M) {
        self.service.handle(
            self.now,
            from,
            &Message::Raw(m),
            &self.bench.ctx(),
            &mut self.out,
        );
    }

    pub(super) fn tick(&mut self, ms: u64) {
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
    pub(super) fn said(&mut self) -> Vec<M> {
        self.out.sent_raw()
    }

    pub(super) fn acks(&mut self) -> Vec<(u8, u8)> {
        let ack = |m| match m {
            M::MISSION_ACK(a) => Some((a.target_system, a.mavtype)),
            _ => None,
        };
        self.said().into_iter().filter_map(ack).collect()
    }

    /// An upload over a perfect link; the final result.
    pub(super) fn upload(&mut self, from: Peer, items: &[MissionItem]) -> u8 {
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

pub(super) fn count(n: u16) -> M {
    count_of(n, 0)
}

pub(super) fn count_of(n: u16, mission_type: u8) -> M {
    M::MISSION_COUNT(raw::MISSION_COUNT_DATA {
        count: n,
        mission_type,
        target_system: 1,
        ..Default::default()
    })
}

pub(super) fn int(item: &MissionItem) -> M {
    M::MISSION_ITEM_INT(item.to_int(1, 1))
}

pub(super) fn list(mission_type: u8) -> M {
    M::MISSION_REQUEST_LIST(raw::MISSION_REQUEST_LIST_DATA {
        mission_type,
        ..Default::default()
    })
}

pub(super) fn request(seq: u16) -> M {
    M::MISSION_REQUEST_INT(raw::MISSION_REQUEST_INT_DATA {
        seq,
        ..Default::default()
    })
}

pub(super) fn clear(mission_type: u8) -> M {
    M::MISSION_CLEAR_ALL(raw::MISSION_CLEAR_ALL_DATA {
        mission_type,
        ..Default::default()
    })
}

pub(super) fn bytes(items: &[MissionItem]) -> Vec<[u8; 34]> {
    items.iter().map(MissionItem::bytes).collect()
}

/// What a link does to messages.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weather {
    pub(super) loss: f64,
    pub(super) repeat: f64,
    /// Longest extra delay, ms: reorders.
    pub(super) jitter_ms: f64,
}

/// A conversation that is longer has failed.
pub(super) const PATIENCE: Duration = Duration::from_secs(900);

/// Messages on their way, in both directions.
pub(super) struct Air {
    pub(super) weather: Weather,
    pub(super) dice: Dice,
    pub(super) flying: Vec<(Timestamp, bool, M)>,
}

impl Air {
    pub(super) fn send(&mut self, now: Timestamp, to_vehicle: bool, m: &M) {
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

    pub(super) fn arrived(&mut self, now: Timestamp) -> Vec<(bool, M)> {
        self.flying.sort_by_key(|(at, ..)| *at);
        let n = self.flying.partition_point(|(at, ..)| *at <= now);
        self.flying
            .drain(..n)
            .map(|(_, to_vehicle, m)| (to_vehicle, m))
            .collect()
    }
}

/// A station: what it does on a message and on time; `Some(result)` ends it.
pub(super) trait Station {
    fn start(&mut self, now: Timestamp) -> Vec<M>;
    fn take(&mut self, now: Timestamp, m: &M) -> Vec<M>;
    fn tick(&mut self, now: Timestamp) -> Vec<M>;
    fn result(&self) -> Option<Result<(), String>>;
}

/// Flies a station against the vehicle; its result and the seconds it took.
pub(super) fn converse(
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
pub(super) struct PatientUploader {
    pub(super) items: Vec<MissionItem>,
    pub(super) heard_at: Timestamp,
    pub(super) last: Vec<M>,
    pub(super) result: Option<Result<(), String>>,
}

impl PatientUploader {
    pub(super) fn new(items: Vec<MissionItem>) -> Self {
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
pub(super) struct StepBackUploader {
    pub(super) items: Vec<MissionItem>,
    pub(super) next: u16,
    pub(super) repeats: u8,
    pub(super) strikes: u8,
    pub(super) heard_at: Timestamp,
    pub(super) result: Option<Result<(), String>>,
}

impl StepBackUploader {
    pub(super) fn new(items: Vec<MissionItem>) -> Self {
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
pub(super) struct Downloader {
    pub(super) count: Option<u16>,
    pub(super) got: Vec<MissionItem>,
    pub(super) asked_at: Timestamp,
}

impl Downloader {
    pub(super) fn question(&self) -> Vec<M> {
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

/// An empty room of 10 m by 10 m with a wall around it.
pub(super) fn room() -> Walls {
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
