//! The flight harness: simulator, autopilot and a scripted ground station in virtual time.
//!
//! A scenario is built, flown by conditions and judged by truth. When one fails it prints its seed and how to fly it
//! again.
//!
//! ```no_run
//! use flight_tests::Scenario;
//! let mut flight = Scenario::office().seed(7).start();
//! flight.take_off(1.0);
//! flight.wait_s(10.0);
//! assert!(flight.truth().position.norm_xy() < 0.2);
//! ```

mod score;

pub use score::{Errors, percentile};

use bridge::autopilot::door::Snapshot;
use bridge::autopilot::flight::Start;
use bridge::gcs::LinkId;
use bridge::io::lockstep::{Lockstep, LockstepConfig};
use bridge::io::truth::Row;
use bridge::log::record::LogSink;
use bridge::log::writer::MemoryLog;
use bridge::settings::{Origin, Settings};
use bridge::station::{GroundStation, Reply};
use mavlink_dialect::mode::Px4Mode;
use mavlink_dialect::raw;
use sim::{Delivery, Manner, Radio, Room, SimConfig, Truth, VehicleConfig, Walker};
use std::time::Duration;
use vehicle::{MapPose, Pace, RingConfig, Timestamp};

/// The scripted station's link.
const STATION: LinkId = LinkId(0);
/// Virtual time between two looks of the station.
const SLICE: Duration = Duration::from_millis(5);

/// PX4 numbers of the modes tests use.
pub mod modes {
    use mavlink_dialect::mode::Px4Mode;
    /// Hover.
    pub const HOLD: Px4Mode = Px4Mode { main: 4, sub: 3 };
    /// Fly the plan.
    pub const MISSION: Px4Mode = Px4Mode { main: 4, sub: 4 };
    /// Fly home.
    pub const RETURN: Px4Mode = Px4Mode { main: 4, sub: 5 };
    /// Come down.
    pub const LAND: Px4Mode = Px4Mode { main: 4, sub: 6 };
    /// Velocity sticks.
    pub const POSITION: Px4Mode = Px4Mode { main: 3, sub: 0 };
    /// Streamed set points.
    pub const OFFBOARD: Px4Mode = Px4Mode { main: 6, sub: 0 };
}

/// The rooms of a bundled room's plan away from home, nearest first: north, east about home, m.
///
/// # Panics
/// If there is no such room.
#[must_use]
pub fn places(room: &str) -> Vec<[f64; 2]> {
    let facts = Room::named(room).expect("a bundled room").facts();
    let from_home_m = |p: &[f64; 2]| p[0].hypot(p[1]);
    let mut places: Vec<[f64; 2]> = facts
        .rooms
        .iter()
        .map(|r| r.ned_m)
        .filter(|p| from_home_m(p) > 1.0)
        .collect();
    places.sort_by(|a, b| from_home_m(a).total_cmp(&from_home_m(b)));
    places
}

/// What to fly.
#[derive(Clone, Debug)]
pub struct Scenario {
    room: String,
    own_room: Option<Room>,
    seed: u64,
    ring: String,
    start: Option<MapPose>,
    is_unknown: bool,
    people: Vec<Walker>,
    boxes: Vec<[f64; 3]>,
    no_fly: Vec<Vec<[f64; 2]>>,
    flow: bool,
    charge: f64,
    manner: Manner,
    delivery: Delivery,
    serial_rate_hz: u32,
    params: Vec<(String, String)>,
    is_recorded: bool,
}

impl Scenario {
    /// The default room and ring.
    #[must_use]
    pub fn office() -> Self {
        Self::room("office")
    }

    /// A bundled room.
    #[must_use]
    pub fn room(name: &str) -> Self {
        Self {
            room: name.to_owned(),
            own_room: None,
            seed: 1,
            ring: "tof32".to_owned(),
            start: None,
            is_unknown: false,
            people: Vec::new(),
            boxes: Vec::new(),
            no_fly: Vec::new(),
            flow: true,
            charge: 1.0,
            manner: Manner::default(),
            delivery: Delivery::default(),
            serial_rate_hz: 100,
            params: Vec::new(),
            is_recorded: false,
        }
    }

    /// A room made for the test.
    #[must_use]
    pub fn in_room(room: Room) -> Self {
        Self {
            own_room: Some(room.clone()),
            ..Self::room(room.name())
        }
    }

    /// Every random number follows from it.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// A built-in ring.
    #[must_use]
    pub fn ring(mut self, name: &str) -> Self {
        name.clone_into(&mut self.ring);
        self
    }

    /// Somewhere else than home.
    #[must_use]
    pub fn at(mut self, pose: MapPose) -> Self {
        self.start = Some(pose);
        self
    }

    /// It does not know where it stands.
    #[must_use]
    pub fn unknown(mut self) -> Self {
        self.is_unknown = true;
        self
    }

    /// Somebody walks by.
    #[must_use]
    pub fn person(mut self, walker: Walker) -> Self {
        self.people.push(walker);
        self
    }

    /// A box that the plan does not show: centre x, y and side, plan metres.
    #[must_use]
    pub fn unmapped(mut self, place: [f64; 3]) -> Self {
        self.boxes.push(place);
        self
    }

    /// A zone on the plan that is not to be flown over, corners in plan metres.
    #[must_use]
    pub fn no_fly(mut self, corners: &[[f64; 2]]) -> Self {
        self.no_fly.push(corners.to_vec());
        self
    }

    /// Without optical flow.
    #[must_use]
    pub fn without_flow(mut self) -> Self {
        self.flow = false;
        self
    }

    /// Charge of the battery, 0..=1.
    #[must_use]
    pub fn charge(mut self, charge: f64) -> Self {
        self.charge = charge;
        self
    }

    /// Firmware that the fake flight controller pretends to be.
    #[must_use]
    pub fn manner(mut self, manner: Manner) -> Self {
        self.manner = manner;
        self
    }

    /// Settings of the flight controller at the start: beside a radio, as delivered ...
    #[must_use]
    pub fn delivery(mut self, delivery: Delivery) -> Self {
        self.delivery = delivery;
        self
    }

    /// Messages the flight controller answers a second (`serial_update_rate_hz`): 100 unless changed.
    #[must_use]
    pub fn serial_rate(mut self, hz: u32) -> Self {
        self.serial_rate_hz = hz;
        self
    }

    /// A pilot's radio is the receiver; set what it sends with `world.simulator.set_radio`.
    #[must_use]
    pub fn beside_radio(self) -> Self {
        self.delivery(Delivery::BesideRadio).param("KST_RADIO", "1")
    }

    /// A parameter of the vehicle.
    #[must_use]
    pub fn param(mut self, name: &str, value: &str) -> Self {
        self.params.push((name.to_owned(), value.to_owned()));
        self
    }

    /// Its log is kept in memory: [`Flight::log`].
    #[must_use]
    pub fn recorded(mut self) -> Self {
        self.is_recorded = true;
        self
    }

    /// The command that flies this world again, for people.
    #[must_use]
    pub fn command_line(&self) -> String {
        let start = if self.is_unknown {
            " --start unknown"
        } else {
            ""
        };
        let boxes: String = self
            .boxes
            .iter()
            .map(|[x, y, side]| format!(" --obstacle {x:.2},{y:.2},{side:.2}"))
            .collect();
        format!(
            "kestrel sim {} --seed {} --rangers {} --manner {}{start}{boxes}",
            self.room, self.seed, self.ring, self.manner
        )
    }

    /// At time zero.
    ///
    /// # Panics
    /// If the scenario makes no sense.
    #[must_use]
    pub fn start(self) -> Flight {
        let own = self.own_room.clone();
        let room = own
            .unwrap_or_else(|| Room::named(&self.room).expect("a bundled room"))
            .with_boxes(&self.boxes)
            .with_no_fly(&self.no_fly);
        let ring = RingConfig::built_in(&self.ring).expect("a built-in ring");
        let pose = self.start.unwrap_or_else(|| room.home());
        let start = if self.is_unknown {
            Start::Unknown
        } else {
            Start::Known(pose)
        };
        let mut settings = Settings::default();
        for (name, value) in &self.params {
            settings
                .set_text(name, value, Origin::CommandLine)
                .expect("a known parameter");
        }
        let mut vehicle = VehicleConfig {
            flow: self.flow,
            charge: self.charge,
            ..VehicleConfig::new(pose, ring.clone())
        };
        vehicle.fc.manner = self.manner;
        vehicle.fc.delivery = self.delivery;
        vehicle.fc.serial_rate_hz = self.serial_rate_hz;
        let sim = SimConfig {
            vehicles: vec![vehicle],
            people: self.people.clone(),
            ..SimConfig::new(room, ring, self.seed)
        };
        let config = LockstepConfig {
            sim,
            start,
            settings,
            documents: Vec::new(),
        };
        let log = self.is_recorded.then(|| {
            let header = config.header("test").expect("a vehicle");
            MemoryLog::new(header).expect("memory")
        });
        let sink = log.clone().map(|log| Box::new(log) as Box<dyn LogSink>);
        let mut world = Lockstep::with_log(config, sink).expect("a scenario that can start");
        world.link_up(STATION);
        Flight {
            scenario: self,
            world,
            log,
            station: GroundStation::default(),
            rows: Vec::new(),
            pace: Pace::hz(50.0),
        }
    }
}

/// A flight in progress.
pub struct Flight {
    scenario: Scenario,
    /// Simulator, flight and ground.
    pub world: Lockstep,
    /// Its log, if it is recorded.
    pub log: Option<MemoryLog>,
    /// The scripted ground station.
    pub station: GroundStation,
    /// Truth beside estimate, 50 a second.
    pub rows: Vec<Row>,
    pace: Pace,
}

impl Flight {
    /// Virtual time.
    #[must_use]
    pub fn now(&self) -> Timestamp {
        self.world.now()
    }

    /// How the vehicle really is.
    #[must_use]
    pub fn truth(&self) -> Truth {
        self.world.simulator.truth(0)
    }

    /// The pilot's transmitter from now on; none = off.
    pub fn radio(&mut self, radio: Option<Radio>) {
        self.world.simulator.set_radio(0, radio);
    }

    /// What the vehicle believes and does.
    #[must_use]
    pub fn snapshot(&self) -> &Snapshot {
        self.world.snapshot()
    }

    /// One slice of virtual time.
    pub fn step(&mut self) {
        let now = self.world.now() + SLICE;
        self.world.advance_with(now, STATION, &mut self.station);
        if self.pace.is_due(now) {
            self.rows.push(Row::take(
                now,
                &self.world.simulator,
                0,
                self.world.snapshot(),
            ));
            self.trace();
        }
    }

    /// What the station has sent reaches the vehicle now, not with the next [`step`](Self::step).
    pub fn hand_over(&mut self) {
        self.world.hand_over(STATION, &mut self.station);
    }

    /// Time finer than a [`step`](Self::step), without rows; the station beats on.
    pub fn advance(&mut self, by: Duration) {
        let now = self.world.now() + by;
        self.world.advance_with(now, STATION, &mut self.station);
    }

    /// With KESTREL_TRACE set: truth beside belief, twice a second.
    #[expect(
        clippy::print_stdout,
        reason = "asked for by the person at the terminal"
    )]
    fn trace(&self) {
        if !self.rows.len().is_multiple_of(25) || std::env::var_os("KESTREL_TRACE").is_none() {
            return;
        }
        let (t, s) = (self.truth(), self.snapshot());
        println!(
            "{:7.2} true {:?} v {:?} est {:?} v {:?} {:?}/{:?} {:?} {:?} fit {:.2} mass {:.2} throttle {:.2} set point {:?}",
            self.now().s(),
            t.position,
            t.velocity,
            s.nav.position,
            s.nav.velocity,
            s.mode.mode,
            s.mode.because,
            s.landed,
            s.nav.localization.state,
            s.nav.localization.fit,
            s.nav.localization.mass,
            s.sticks.throttle,
            s.setpoint,
        );
    }

    /// Lets time pass.
    pub fn wait_s(&mut self, seconds: f64) {
        let until = self.now() + Duration::from_secs_f64(seconds);
        while self.now() < until {
            self.step();
        }
    }

    /// Flies until something is so.
    ///
    /// # Errors
    /// It was not so in time.
    pub fn try_until(
        &mut self,
        limit_s: f64,
        mut is_so: impl FnMut(&Self) -> bool,
    ) -> Result<(), String> {
        let until = self.now() + Duration::from_secs_f64(limit_s);
        while self.now() < until {
            if is_so(self) {
                return Ok(());
            }
            self.step();
        }
        Err(format!("not within {limit_s} s"))
    }

    /// Flies until something is so.
    ///
    /// # Panics
    /// If it is not so in time; prints how to fly it again.
    pub fn until(&mut self, what: &str, limit_s: f64, is_so: impl FnMut(&Self) -> bool) {
        if self.try_until(limit_s, is_so).is_err() {
            self.fail(&format!("`{what}` did not come within {limit_s} s"));
        }
    }

    /// Ends the test with everything needed to fly it again.
    ///
    /// # Panics
    /// Always.
    pub fn fail(&self, why: &str) -> ! {
        let s = self.snapshot();
        panic!(
            "{why}\n  at {:.2} s, truth {:?}, estimate {:?}, mode {:?}, armed {}, localized {:?}\n  texts {:?}\n  again: {}",
            self.now().s(),
            self.truth().position,
            s.nav.position,
            s.mode,
            s.is_armed,
            s.nav.localization.state,
            self.station.heard().texts,
            self.scenario.command_line(),
        );
    }

    /// Fails unless it is so.
    ///
    /// # Panics
    /// If it is not so.
    pub fn assert(&self, is_so: bool, why: &str) {
        if !is_so {
            self.fail(why);
        }
    }

    /// Sends a command and waits for its result (MAV_RESULT).
    pub fn command(&mut self, command: u16, params: [f32; 7]) -> u8 {
        let now = self.now();
        self.station.command(now, command, params);
        self.result(command)
    }

    fn result(&mut self, command: u16) -> u8 {
        for _ in 0..2_000 {
            if let Some(Reply::Command(answered, result)) = self.station.reply()
                && answered == command
            {
                return result;
            }
            self.step();
        }
        self.fail(&format!("command {command} was not answered"))
    }

    /// Sends a go-to (DO_REPOSITION in its INT form, height kept) and waits for its result.
    pub fn reposition(&mut self, params: [f32; 7], (lat, lon): (f64, f64)) -> u8 {
        let command = mavlink_dialect::command::cmd::DO_REPOSITION;
        self.station.send(&raw::COMMAND_INT_DATA {
            param1: params[0],
            param2: params[1],
            param3: params[2],
            param4: params[3],
            x: (lat * 1e7).round() as i32,
            y: (lon * 1e7).round() as i32,
            z: params[6],
            command,
            target_system: 1,
            target_component: 1,
            frame: 6,
            ..Default::default()
        });
        self.station.expect(command);
        self.result(command)
    }

    /// Sets a mode and waits for the result.
    pub fn set_mode(&mut self, mode: Px4Mode) -> u8 {
        let now = self.now();
        self.station.set_mode(now, mode);
        self.result(mavlink_dialect::command::cmd::DO_SET_MODE)
    }

    /// Waits until armable, arms.
    pub fn arm(&mut self) {
        self.until("armable", 20.0, |f| f.station.heard().is_armable);
        let now = self.now();
        self.station.arm(now, true);
        let result = self.result(mavlink_dialect::command::cmd::COMPONENT_ARM_DISARM);
        self.assert(result == 0, &format!("arming was refused: {result}"));
    }

    /// Arms, takes off, waits until hovering.
    pub fn take_off(&mut self, height_m: f64) {
        self.arm();
        let result = self.command(
            mavlink_dialect::command::cmd::NAV_TAKEOFF,
            [0.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, height_m as f32],
        );
        self.assert(result == 0, &format!("take-off was refused: {result}"));
        self.until("take-off height", 20.0, |f| {
            (f.truth().position.z() + height_m).abs() < 0.15
        });
        self.until("hold", 10.0, |f| {
            f.snapshot().mode.mode == bridge::autopilot::mode::Mode::Hold
        });
    }

    /// Uploads a mission and waits for its acceptance (MAV_MISSION_RESULT).
    pub fn upload(&mut self, items: Vec<raw::MISSION_ITEM_INT_DATA>) -> u8 {
        let now = self.now();
        self.station.upload(now, items);
        for _ in 0..4_000 {
            if let Some(Reply::Upload(result)) = self.station.reply() {
                return result;
            }
            self.step();
        }
        self.fail("the upload was not answered")
    }

    /// Uploads a fence or rally points and waits for the answer (MAV_MISSION_RESULT).
    pub fn upload_list(&mut self, kind: u8, items: Vec<raw::MISSION_ITEM_INT_DATA>) -> u8 {
        let items = items
            .into_iter()
            .map(|item| raw::MISSION_ITEM_INT_DATA {
                mission_type: kind,
                ..item
            })
            .collect();
        self.upload(items)
    }

    /// Waits until landed and disarmed.
    pub fn until_down(&mut self, limit_s: f64) {
        self.until("landed and disarmed", limit_s, |f| {
            !f.snapshot().is_armed && f.truth().on_floor
        });
    }

    /// Estimate against truth so far, in the air.
    #[must_use]
    pub fn errors(&self) -> Errors {
        Errors::of(&self.rows)
    }

    /// Smallest horizontal distance of the true path to a point, m.
    #[must_use]
    pub fn nearest_pass(&self, north_m: f64, east_m: f64) -> f64 {
        self.rows
            .iter()
            .map(|r| (r.position[0] - north_m).hypot(r.position[1] - east_m))
            .fold(f64::INFINITY, f64::min)
    }
}
