//! One case flown: take-off, mode, fault, and what follows until it is down.

use super::judge::{Judge, Outcome};
use super::plan::{Campaign, Case, Dice, Fault, FlownMode};
use crate::autopilot::door::{HostReport, Request, Snapshot};
use crate::autopilot::flight::Start;
use crate::gcs::LinkId;
use crate::io::lockstep::{Lockstep, LockstepConfig};
use crate::io::truth::Row;
use crate::settings::{Origin, Settings, SettingsError};
use crate::station::{self, GroundStation};
use core::time::Duration;
use mavlink_dialect::mode::Px4Mode;
use mavlink_dialect::raw;
use sim::{Room, SimConfig, VehicleConfig};
use vehicle::{In, MapPose, ParamValue, RingConfig, Segment, Timestamp};

const STATION: LinkId = LinkId(0);
/// Virtual time between two looks.
const SLICE: Duration = Duration::from_millis(5);
/// Pause between two messages of a stream.
const STREAM: f64 = 0.1;
/// Time after the fault that a vehicle has before it is asked to land.
const LEFT_ALONE_S: f64 = 12.0;
/// The same for one whose row takes its time.
const LEFT_LONG_S: f64 = 20.0;
/// The same for one that was carried away and has to find out first, among rooms that look alike.
const LEFT_CARRIED_S: f64 = 40.0;
/// Time it then has to be down.
const LANDING_S: f64 = 35.0;
/// Flying height, m.
const HEIGHT_M: f64 = 1.0;
/// Higher than it stands, m.
const LEFT_FLOOR_M: f64 = 0.2;

const LAND: Px4Mode = Px4Mode { main: 4, sub: 6 };

/// Why a case could not be flown at all.
#[derive(Clone, Debug, thiserror::Error)]
pub enum FlyError {
    /// A parameter of the campaign.
    #[error(transparent)]
    Setting(#[from] SettingsError),
    /// The room or the world.
    #[error("{0}")]
    World(String),
}

/// Flies a case to its end.
///
/// # Errors
/// The campaign names a room or a parameter that does not exist.
pub fn fly(campaign: &Campaign, case: &Case) -> Result<Outcome, FlyError> {
    watch(campaign, case, &mut |_, _| {})
}

/// [`fly`] with somebody who sees truth and belief two hundred times a second.
///
/// # Errors
/// As [`fly`].
pub fn watch(
    campaign: &Campaign,
    case: &Case,
    seen: &mut dyn FnMut(&Row, &Snapshot),
) -> Result<Outcome, FlyError> {
    let mut script = Script::new(campaign, case, seen)?;
    let mut dice = Dice(case.seed ^ 0x00FA_0175);
    if case.fault == Fault::SearchFails {
        // This one is there before the take-off.
        script.fault_comes(case.fault, &mut dice);
        script.climb();
    } else {
        if !script.take_off() {
            return Ok(script.judge.never_flew());
        }
        script.enter(case.mode);
        script.fly(dice.between(1.0, 7.0), |_| false);
        script.fault_comes(case.fault, &mut dice);
    }
    if let Some(second) = case.second {
        script.fly(dice.between(0.5, 4.0), |_| false);
        script.inject(second, &mut dice);
    }
    let left_s = match case.fault {
        Fault::PlaceJumps => LEFT_CARRIED_S,
        fault if fault.facts().is_alone => LEFT_LONG_S,
        _ => LEFT_ALONE_S,
    };
    script.fly(left_s, Script::is_down);
    if !script.is_down() {
        script.ends_stream = true;
        script.station.be_silent(false);
        let now = script.world.now();
        script.station.set_mode(now, LAND);
        script.fly(LANDING_S, Script::is_down);
    }
    let is_down = script.is_down();
    let snapshot = script.world.snapshot().clone();
    Ok(script
        .judge
        .verdict(case, is_down, &snapshot, &script.station.heard().texts))
}

struct Script<'a> {
    seen: &'a mut dyn FnMut(&Row, &Snapshot),
    world: Lockstep,
    station: GroundStation,
    judge: Judge,
    mode: FlownMode,
    place: [f64; 2],
    next_stream_s: f64,
    ends_stream: bool,
    /// The flight loop is held up again and again.
    is_slow: bool,
    next_hold_s: f64,
}

impl<'a> Script<'a> {
    fn new(
        campaign: &Campaign,
        case: &Case,
        seen: &'a mut dyn FnMut(&Row, &Snapshot),
    ) -> Result<Self, FlyError> {
        let world = |e: &dyn std::fmt::Display| FlyError::World(e.to_string());
        let room = Room::named(&case.room).map_err(|e| world(&e))?;
        let facts = room.facts();
        let place = facts
            .rooms
            .iter()
            .map(|r| r.ned_m)
            .filter(|p| p[0].hypot(p[1]) > 1.0)
            .min_by(|a, b| a[0].hypot(a[1]).total_cmp(&b[0].hypot(b[1])))
            .unwrap_or([1.0, 0.0]);
        let ring = RingConfig::built_in("tof32").map_err(|e| world(&e))?;
        let pose = room.home();
        let mut settings = Settings::default();
        for (name, value) in &campaign.params {
            let text = value.to_string();
            settings.set_text(name, text.trim_matches('"'), Origin::File)?;
        }
        let mut lockstep = Lockstep::new(LockstepConfig {
            sim: SimConfig {
                vehicles: vec![VehicleConfig::new(pose, ring.clone())],
                ..SimConfig::new(room, ring, case.seed)
            },
            start: match case.fault {
                Fault::SearchFails => Start::Unknown,
                _ => Start::Known(pose),
            },
            settings,
            documents: Vec::new(),
        })
        .map_err(|e| world(&e))?;
        lockstep.link_up(STATION);
        Ok(Self {
            seen,
            world: lockstep,
            station: GroundStation::default(),
            judge: Judge::default(),
            mode: FlownMode::Hold,
            place,
            next_stream_s: 0.0,
            ends_stream: true,
            is_slow: false,
            next_hold_s: 0.0,
        })
    }

    fn step(&mut self) {
        let now_s = self.world.now().s();
        if !self.ends_stream && now_s >= self.next_stream_s {
            self.next_stream_s = now_s + STREAM;
            self.stream();
        }
        if self.is_slow && now_s >= self.next_hold_s {
            self.next_hold_s = now_s + 0.13;
            self.world.hold_flight(Duration::from_millis(100));
        }
        let now = self.world.now() + SLICE;
        self.world.advance_with(now, STATION, &mut self.station);
        let row = Row::take(now, &self.world.simulator, 0, self.world.snapshot());
        self.judge.look(&row, self.world.snapshot());
        (self.seen)(&row, self.world.snapshot());
    }

    /// Flies for a time, or until something is so.
    fn fly(&mut self, seconds: f64, until: impl Fn(&Self) -> bool) {
        let end: Timestamp = self.world.now() + Duration::from_secs_f64(seconds);
        while self.world.now() < end && !until(self) {
            self.step();
        }
    }

    fn is_down(&self) -> bool {
        !self.world.snapshot().is_armed && self.judge.is_on_floor()
    }

    /// Arms and asks to take off.
    fn climb(&mut self) {
        self.fly(20.0, |s| s.station.heard().is_armable);
        let now = self.world.now();
        self.station.arm(now, true);
        self.fly(5.0, |s| s.world.snapshot().is_armed);
        let now = self.world.now();
        let params = [0.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, HEIGHT_M as f32];
        self.station
            .command(now, mavlink_dialect::command::cmd::NAV_TAKEOFF, params);
        self.fly(2.0, |s| s.judge.height_m() > LEFT_FLOOR_M);
    }

    fn take_off(&mut self) -> bool {
        self.climb();
        self.fly(12.0, |s| {
            s.judge.height_m() > HEIGHT_M - 0.15
                && s.world.snapshot().mode.mode == crate::autopilot::mode::Mode::Hold
        });
        self.judge.height_m() > HEIGHT_M - 0.3
    }

    fn enter(&mut self, mode: FlownMode) {
        self.mode = mode;
        let now = self.world.now();
        let [north, east] = self.place;
        match mode {
            FlownMode::Hold => {}
            FlownMode::Mission => {
                let items = vec![
                    station::waypoint(north, east, -HEIGHT_M, None),
                    station::waypoint(0.0, 0.0, -HEIGHT_M, None),
                    station::waypoint(north, east, -HEIGHT_M, None),
                    station::return_home(),
                ];
                self.station.upload(now, items);
                self.begin_mission();
            }
            FlownMode::Position => {
                self.ends_stream = false;
                self.fly(0.5, |_| false);
                let now = self.world.now();
                self.station.set_mode(now, Px4Mode { main: 3, sub: 0 });
            }
            FlownMode::Offboard => {
                self.ends_stream = false;
                self.fly(0.8, |_| false);
                let now = self.world.now();
                self.station.set_mode(now, Px4Mode { main: 6, sub: 0 });
            }
        }
    }

    fn begin_mission(&mut self) {
        self.fly(1.0, |_| false);
        let now = self.world.now();
        self.station.set_mode(now, Px4Mode { main: 4, sub: 4 });
    }

    fn stream(&mut self) {
        // Towards the place and back, as a pilot would who sees where it is.
        let there = ((self.world.now().s() / 6.0) as u64).is_multiple_of(2);
        let sign = if there { 1.0 } else { -1.0 };
        let [north, east] = self.place;
        let length = north.hypot(east).max(0.1);
        match self.mode {
            FlownMode::Position => self.station.send(&raw::MANUAL_CONTROL_DATA {
                target: 1,
                x: (sign * 250.0) as i16,
                z: 500,
                ..Default::default()
            }),
            FlownMode::Offboard => self.station.send(&raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
                target_system: 1,
                target_component: 1,
                coordinate_frame: 1,
                type_mask: 0b0000_0111 | 0b1_1100_0000 | 0x400 | 0x800,
                vx: (sign * 0.3 * north / length) as f32,
                vy: (sign * 0.3 * east / length) as f32,
                ..Default::default()
            }),
            _ => {}
        }
    }

    /// The first fault: from now on somebody must be told.
    fn fault_comes(&mut self, fault: Fault, dice: &mut Dice) {
        let told = self.station.heard().texts.len();
        self.judge.fault_comes(told);
        self.inject(fault, dice);
    }

    fn inject(&mut self, fault: Fault, dice: &mut Dice) {
        use sim::Fault as Broken;
        let now = self.world.now();
        let sim = &mut self.world.simulator;
        let report = HostReport::default();
        match fault {
            Fault::None => {}
            Fault::GroundSilent => self.station.be_silent(true),
            Fault::SticksStop | Fault::StreamStops => self.ends_stream = true,
            Fault::FcSilent => sim.set_fault(0, Broken::FcSilent, true),
            Fault::FcNoisy => sim.set_fault(0, Broken::FcNoisy, true),
            Fault::FcSlow => {
                sim.set_fault(0, Broken::FcBusy, true);
                self.set("KST_FC_MIN_HZ", ParamValue::Float(60.0));
            }
            Fault::FcLossy => sim.set_fault(0, Broken::FcLossy, true),
            Fault::AttitudeAskew => sim.set_fault(0, Broken::AttitudeAskew, true),
            Fault::LoopHeld => {
                let ms = 350 + dice.roll(700);
                self.world.hold_flight(Duration::from_millis(ms));
            }
            Fault::LoopSlow => self.is_slow = true,
            Fault::RangersSilent => {
                for ranger in 0..4 {
                    sim.set_fault(0, Broken::RangerSilent(ranger), true);
                }
            }
            Fault::OneRangerSilent => {
                sim.set_fault(0, Broken::RangerSilent(dice.roll(4) as u8), true);
            }
            Fault::RangerStuck => sim.set_fault(0, Broken::RangerStuck(dice.roll(4) as u8), true),
            Fault::FlowSilent => sim.set_fault(0, Broken::FlowSilent, true),
            Fault::DownSilent => sim.set_fault(0, Broken::DownSilent, true),
            Fault::MotorDead => sim.set_fault(0, Broken::MotorDead(dice.roll(4) as u8), true),
            Fault::BatteryLow => sim.set_charge(0, 0.12),
            Fault::BatteryCritical => sim.set_charge(0, 0.04),
            Fault::BatterySags => {
                sim.set_charge(0, 0.02);
                self.set("BAT_LOW_THR", ParamValue::Float(0.0));
                self.set("BAT_CRIT_THR", ParamValue::Float(0.0));
                self.set("BAT_V_SAG", ParamValue::Float(3.5));
            }
            Fault::BatteryReserve => {
                self.set("BAT1_CAPACITY", ParamValue::Float(400.0));
                self.set("KST_BAT_RESERVE", ParamValue::Float(600.0));
            }
            Fault::WayBlocked => {
                self.set("KST_PROGRESS_T", ParamValue::Float(6.0));
                self.wall_in();
            }
            Fault::SearchFails => {
                self.set("LOC_SEARCH_T", ParamValue::Float(6.0));
                self.wall_in();
            }
            Fault::PlaceJumps => {
                self.set("KST_JUMPS_MAX", ParamValue::Int(1));
                // It shall come to the jump: until then it may be lost.
                self.set("LOC_LOST_T", ParamValue::Float(8.0));
                self.carry_away(dice);
            }
            Fault::Kidnapped => self.carry_away(dice),
            Fault::Hot => self.world.host(HostReport {
                temperature_c: Some(97.0),
                ..report
            }),
            Fault::DiskFull => self.world.host(HostReport {
                disk_fails: true,
                ..report
            }),
            Fault::ClockJump => self.world.host(HostReport {
                clock_jumped: true,
                ..report
            }),
            Fault::Throttled => self.world.host(HostReport {
                is_throttled: true,
                ..report
            }),
            Fault::Overload => self.world.host(HostReport {
                is_overloaded: true,
                ..report
            }),
            Fault::CtrlC => self.world.shut_down(),
            Fault::Stop => {
                self.station.command(now, 193, [0.0; 7]);
                self.ends_stream = true;
            }
        }
    }

    /// Sets a parameter as a pilot would.
    fn set(&mut self, name: &str, value: ParamValue) {
        if let Some(index) = Settings::default().index_of(name) {
            let index = index as u16;
            self.world.ask(Request::SetParam { index, value });
        }
    }

    /// Another room, another heading.
    fn carry_away(&mut self, dice: &mut Dice) {
        let [north, east] = self.place;
        let there = In::new(north, east, 0.0);
        // Where it is already would be no other place.
        let is_there = (self.judge.place() - there).norm_xy() < 1.0;
        let there = if is_there { In::zero() } else { there };
        let at = self.world.simulator.anchor().to_map(there);
        let pose = MapPose::new(at.x(), at.y(), dice.between(-3.1, 3.1));
        self.world.simulator.carry_to(0, pose);
        self.judge.was_carried();
    }

    /// Four walls around where it is.
    fn wall_in(&mut self) {
        const HALF_M: f64 = 0.9;
        let at = self.world.simulator.anchor().to_map(self.judge.place());
        let corner = |x: f64, y: f64| [at.x() + x * HALF_M, at.y() + y * HALF_M];
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let walls: Vec<Segment> = (0..4)
            .map(|i| {
                let (a, b) = (corners[i], corners[(i + 1) % 4]);
                Segment {
                    a: corner(a.0, a.1),
                    b: corner(b.0, b.1),
                }
            })
            .collect();
        self.world.simulator.raise(&walls);
    }
}
