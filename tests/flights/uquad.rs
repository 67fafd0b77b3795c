//! uQuad as one aircraft in the office: bytes of its inertial unit in, messages of its motor driver out, flown by MAVLink.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::autopilot::door::{GoTo, Key, Request, Step};
use bridge::autopilot::flight::Start;
use bridge::autopilot::mode::Mode;
use bridge::gcs::LinkId;
use bridge::io::lockstep::Outgoing;
use bridge::io::uquad_lockstep::{UquadLockstep, UquadLockstepConfig};
use bridge::settings::{Origin, Settings};
use bridge::station::{GroundStation, Reply};
use bridge::uquad::laws::{self, Law};
use control::lqr::Weights;
use control::proportional::{Gains, HoverGains};
use control::setpoint_list::SetpointList;
use estimator::thesis::StateSet;
use flight_tests::modes;
use mavlink_dialect::command::cmd;
use mavlink_dialect::mode::Px4Mode;
use sim::{Room, SimConfig};
use std::time::Duration;
use vehicle::angle::wrap_pi;
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, In, MapPose, RingConfig, UquadAirframe};

const STATION: LinkId = LinkId(0);

struct Flown {
    world: UquadLockstep,
    station: GroundStation,
    heartbeats: u32,
}

impl Flown {
    fn new(seed: u64, states: StateSet) -> Self {
        Self::with_list(seed, states, None)
    }

    fn with_list(seed: u64, states: StateSet, list: Option<SetpointList>) -> Self {
        let law = Law::Optimal(Weights::indoor());
        Self::with(seed, states, list, &law, Settings::default())
    }

    fn with(
        seed: u64,
        states: StateSet,
        list: Option<SetpointList>,
        law: &Law,
        settings: Settings,
    ) -> Self {
        let room = match states {
            StateSet::Full => Room::named("office").unwrap(),
            // It drifts: nothing tells it where it is.
            StateSet::Reduced => hall(),
        };
        let ring = RingConfig::built_in("tof32").unwrap();
        let start = Start::Known(room.home());
        let weights = match law {
            Law::Optimal(weights) => Some(*weights),
            Law::Files { .. } => None,
        };
        let uquad = laws::config(UquadAirframe::default(), states, law).unwrap();
        let mut world = UquadLockstep::new(UquadLockstepConfig {
            sim: SimConfig::new(room, ring, seed),
            start,
            settings,
            documents: Vec::new(),
            uquad,
            weights,
            list,
            has_place: states == StateSet::Full,
        })
        .unwrap();
        world.link_up(STATION);
        Self {
            world,
            station: GroundStation::default(),
            heartbeats: 0,
        }
    }

    fn step(&mut self) {
        let now = self.world.now() + Duration::from_millis(5);
        self.world.advance(now);
        while let Some(out) = self.world.poll() {
            if let Outgoing::Frame(STATION, frame) = out {
                self.station.receive(&frame);
            }
        }
        self.station.tick(now);
        while let Some(frame) = self.station.poll() {
            // The message number of a MAVLink 2 frame is in bytes 7 to 9; that of HEARTBEAT is 0.
            self.heartbeats += u32::from(frame[7..10] == [0, 0, 0]);
            self.world.receive(STATION, &frame, true);
        }
        if std::env::var_os("KESTREL_TRACE").is_some() && now.us().is_multiple_of(500_000) {
            let (t, s) = (self.world.simulator.truth(0), self.world.snapshot());
            println!(
                "{:6.2} true {:?} est {:?} {:?} {:?} {:?} yaw {:.2} w {:?} set point {:?}",
                now.s(),
                t.position,
                s.nav.position,
                self.world.flight.phase(),
                s.mode.mode,
                s.landed,
                t.attitude.yaw(),
                self.world.bus.speeds_radps(),
                s.setpoint
            );
        }
    }

    /// The station falls silent.
    fn step_unheard(&mut self) {
        self.world
            .advance(self.world.now() + Duration::from_millis(5));
        while self.world.poll().is_some() {}
    }

    fn press(&mut self, key: Key) {
        self.world.ask(Request::Key(key));
    }

    fn pass(&mut self, seconds: f64) {
        let until = self.world.now() + Duration::from_secs_f64(seconds);
        while self.world.now() < until {
            self.step();
        }
    }

    fn until(&mut self, what: &str, limit_s: f64, mut is_so: impl FnMut(&Self) -> bool) {
        let until = self.world.now() + Duration::from_secs_f64(limit_s);
        while !is_so(self) {
            assert!(
                self.world.now() < until,
                "{what} did not come: {:?}, {:?}, truth {:?}, {:?}",
                self.world.flight.phase(),
                self.world.snapshot().arm_blocked_by,
                self.world.simulator.truth(0),
                self.station.heard().texts
            );
            self.step();
        }
    }

    fn command(&mut self, command: u16, params: [f32; 7]) -> u8 {
        self.station.command(self.world.now(), command, params);
        self.result(command)
    }

    fn set_mode(&mut self, mode: Px4Mode) -> u8 {
        self.station.set_mode(self.world.now(), mode);
        self.result(cmd::DO_SET_MODE)
    }

    fn result(&mut self, command: u16) -> u8 {
        for _ in 0..2000 {
            if let Some(Reply::Command(answered, result)) = self.station.reply()
                && answered == command
            {
                return result;
            }
            self.step();
        }
        panic!("command {command} was not answered");
    }

    /// Armed, at 1 m, in Hold.
    fn take_off(&mut self) {
        self.until("armable", 20.0, |f| f.station.heard().is_armable);
        self.station.arm(self.world.now(), true);
        assert_eq!(self.result(cmd::COMPONENT_ARM_DISARM), 0);
        let nan = f32::NAN;
        let up = [0.0, 0.0, 0.0, nan, nan, nan, 1.0];
        assert_eq!(self.command(cmd::NAV_TAKEOFF, up), 0);
        self.until("hold at 1 m", 25.0, |f| {
            f.world.snapshot().mode.mode == Mode::Hold
                && (f.world.simulator.truth(0).position.z() + 1.0).abs() < 0.2
        });
    }

    fn land(&mut self) {
        assert_eq!(self.set_mode(modes::LAND), 0);
        self.until("landed and disarmed", 25.0, |f| {
            !f.world.snapshot().is_armed && f.world.simulator.truth(0).on_floor
        });
    }
}

/// Forty metres of open floor.
fn hall() -> Room {
    let cells = vec![Cell::Free; 160 * 160];
    let mut plan = FloorPlan::from_cells(160, 0.25, [0.0, 0.0], cells).unwrap();
    plan.home = Some(MapPose::new(20.0, 20.0, 0.0));
    Room::from_plan("hall", plan)
}

#[test]
fn takes_off_hovers_goes_there_and_lands_by_mavlink() {
    println!("FIGURES uQuad in the office by MAVLink");
    for seed in 1..=2 {
        let mut f = Flown::new(seed, StateSet::Full);
        let initial_yaw = f.world.simulator.truth(0).attitude.yaw();
        f.take_off();
        // In Hold the nose looks around until somebody asks for a heading.
        f.world.ask(Request::GoTo(GoTo {
            yaw_rad: Some(initial_yaw),
            ..GoTo::default()
        }));
        f.pass(8.0);
        let mut sum = 0.0;
        let (mut square, mut n) = (0.0, 0.0);
        let (mut beside, mut height, mut turned) = (0.0_f64, 0.0_f64, 0.0_f64);
        let until = f.world.now() + Duration::from_secs(20);
        while f.world.now() < until {
            f.step();
            let truth = f.world.simulator.truth(0);
            let off = truth.position - In::new(0.0, 0.0, -1.0);
            square += off.norm().powi(2);
            n += 1.0;
            beside = beside.max(off.norm_xy());
            height = height.max(off.z().abs());
            sum -= truth.position.z();
            turned = turned.max(wrap_pi(truth.attitude.yaw() - initial_yaw).abs());
        }
        let rms = f64::sqrt(square / n);
        // A metre to the north.
        let there = In::new(1.0, 0.0, -1.0);
        f.world.ask(Request::GoTo(GoTo {
            north_m: Some(there.x()),
            east_m: Some(there.y()),
            ..GoTo::default()
        }));
        f.until("a metre to the north", 20.0, |f| {
            (f.world.simulator.truth(0).position - there).norm() < 0.15
        });
        println!(
            " seed {seed}: hover 20 s {rms:.3} m RMS; height {:.3} m, at most {height:.3} m off, beside {beside:.3} m, heading {:.1} deg",
            sum / n,
            turned.to_degrees()
        );
        assert!(rms < 0.15, "seed {seed}: {rms}");
        assert!((sum / n - 1.0).abs() < 0.1 && height < 0.1, "seed {seed}");
        assert!(beside < 0.3 && turned < 0.15, "seed {seed}");
        f.land();
        assert_eq!(f.world.simulator.truth(0).contacts, 0, "seed {seed}");
    }
    println!("END");
}

#[test]
fn eight_states_hover_without_a_position_source_and_refuse_to_go_anywhere() {
    let mut f = Flown::new(1, StateSet::Reduced);
    f.take_off();
    let mut off = 0.0_f64;
    for _ in 0..2000 {
        f.step();
        off = off.max((f.world.simulator.truth(0).position.z() + 1.0).abs());
    }
    println!("FIGURES\nuQuad, 8 states by MAVLink, 10 s: height within {off:.3} m\nEND");
    assert!(off < 0.4, "{off}");
    assert_ne!(f.set_mode(modes::RETURN), 0, "nobody knows where home is");
    f.land();
}

#[test]
fn flies_the_list_of_set_points_with_new_gains_for_each_and_returns_to_its_first() {
    // A place, a straight path at 0.4 m/s, a circle of 0.8 m radius back through its start.
    let text = "0.6 0 1.0 0 0 0 0 0 0 0 0 0 0 0 0 0 0\n\
                0.0 0 1.0 0 0 0 -0.4 0 0 0 0 0 1 0 0 0 0\n\
                0.0 0 1.0 0 0 0 0 0.4 0 0 0 0.5 2 0 0 0 0\n";
    let list = SetpointList::parse(text, &UquadAirframe::default()).unwrap();
    let mut f = Flown::with_list(1, StateSet::Full, Some(list));
    f.take_off();
    f.pass(3.0);
    assert_eq!(f.set_mode(modes::MISSION), 0);
    let mut farthest = 0.0_f64;
    let (mut on_circle, mut worst) = (0, 0.0_f64);
    let until = f.world.now() + Duration::from_secs(90);
    let mut rounds = 0;
    while f.world.now() < until && rounds == 0 {
        f.step();
        let p = f.world.simulator.truth(0).position;
        farthest = farthest.max(p.x());
        if let Some((index, done)) = f.world.flight.list_progress() {
            rounds = done;
            if index == 3 && f.world.simulator.truth(0).velocity.norm_xy() > 0.3 {
                // The circle through the origin whose left side goes first: its centre is 0.8 m behind, counter-clockwise.
                on_circle += 1;
                worst = worst.max(((p.x() + 0.8).hypot(p.y()) - 0.8).abs());
            }
        }
    }
    println!(
        "FIGURES\nuQuad's list: {:.0} s a round, circle of 0.8 m at 0.4 m/s within {worst:.3} m (with localization's error)\nEND",
        f.world.now().s()
    );
    assert_eq!(rounds, 1, "round is not flown");
    assert!(farthest > 0.4 && on_circle > 500, "{farthest} {on_circle}");
    assert!(worst < 0.20, "{worst}");
    f.land();
    assert_eq!(f.world.simulator.truth(0).contacts, 0);
}

/// The text of a gain file.
fn gain_file(gains: HoverGains) -> Law {
    let matrix = Gains::from_pattern(&gains).matrix;
    let words: Vec<String> = matrix.transpose().iter().map(f64::to_string).collect();
    Law::Files {
        proportional: words.join(" "),
        integral: None,
    }
}

/// Height above the one it holds, m, that a weight of 0.05 kg too much in the law costs.
fn offset_of_a_wrong_weight(gains: HoverGains) -> f64 {
    let law = gain_file(gains);
    let mut f = Flown::with(1, StateSet::Reduced, None, &law, Settings::default());
    f.take_off();
    f.pass(4.0);
    let height = |f: &Flown| -f.world.simulator.truth(0).position.z();
    let mean = |f: &mut Flown| {
        let mut sum = 0.0;
        for _ in 0..400 {
            f.step();
            sum += height(f);
        }
        sum / 400.0
    };
    let before = mean(&mut f);
    f.press(Key::ToggleManual);
    f.press(Key::Mass(Step::Plus));
    f.pass(4.0);
    mean(&mut f) - before
}

#[test]
fn another_gain_file_is_another_response() {
    // 4.39 rad/s too fast over the gain of the height, (rad/s)/m, and what the filter makes of motors that carry more than it believes.
    let softer = Gains::K_PROP_PPTZ;
    let stiffer = HoverGains {
        z: 2.0 * softer.z,
        climb: 1.4 * softer.climb,
        ..softer
    };
    let [soft_m, stiff_m] = [softer, stiffer].map(offset_of_a_wrong_weight);
    println!(
        "FIGURES\nuQuad, 0.05 kg too much believed: {soft_m:.3} m too high with K_prop_pptz, {stiff_m:.3} m with twice the gain of height\nEND"
    );
    assert!((0.4..0.8).contains(&soft_m), "{soft_m}");
    assert!((0.2..0.75 * soft_m).contains(&stiff_m), "{stiff_m}");
}

#[test]
fn the_keys_of_the_weight_set_the_speed_that_hovers() {
    let mut f = Flown::new(1, StateSet::Full);
    f.take_off();
    f.pass(2.0);
    let hovers_at = |f: &mut Flown, key| {
        f.press(key);
        f.pass(0.1);
        f.world.flight.hover_radps()
    };
    let near = |got: f64, wanted: f64| assert!((got - wanted).abs() < 1e-4, "{got} {wanted}");
    near(f.world.flight.hover_radps(), 312.498_01);
    near(
        hovers_at(&mut f, Key::Mass(Step::Plus)),
        312.498_01, // ignored: manual mode is off
    );
    f.press(Key::ToggleManual);
    near(hovers_at(&mut f, Key::Mass(Step::Plus)), 316.889_44);
    near(hovers_at(&mut f, Key::Mass(Step::Minus)), 312.498_01);
    near(hovers_at(&mut f, Key::Mass(Step::Minus)), 308.041_59);
    near(hovers_at(&mut f, Key::MassDefault), 312.498_01);
    f.press(Key::ToggleManual);
    f.pass(2.0);
    f.land();
    assert_eq!(f.world.simulator.truth(0).contacts, 0);
}

#[test]
fn gains_that_take_long_to_make_do_not_delay_the_loop() {
    let mut f = Flown::new(1, StateSet::Full);
    f.take_off();
    f.pass(3.0);
    f.world.delay_gains(Duration::from_secs(3));
    let yaw = f.world.simulator.truth(0).attitude.yaw();
    f.world.ask(Request::GoTo(GoTo {
        yaw_rad: Some(yaw + 0.6),
        ..GoTo::default()
    }));
    let _ = f.world.flight.take_step();
    let (mut steps, mut height) = (0, 0.0_f64);
    for _ in 0..600 {
        f.step();
        steps += u32::from(f.world.flight.take_step().is_some());
        height = height.max((f.world.simulator.truth(0).position.z() + 1.0).abs());
    }
    // Frames come each 10 ms, and each is answered by motor speeds while the gains are being made.
    assert!((298..=302).contains(&steps), "{steps} steps in 3 s");
    assert!(height < 0.25, "the old gains hold: {height}");
    f.pass(3.0);
    let turned = wrap_pi(f.world.simulator.truth(0).attitude.yaw() - yaw);
    assert!((turned - 0.6).abs() < 0.1, "{turned}");
    f.land();
}

#[test]
fn a_silent_ground_station_is_acted_upon_within_uquads_1_95_s_when_so_set() {
    let mut settings = Settings::default();
    settings
        .set_text("COM_DL_LOSS_T", "1.9", Origin::CommandLine)
        .unwrap();
    let law = Law::Optimal(Weights::indoor());
    let mut f = Flown::with(1, StateSet::Full, None, &law, settings);
    f.take_off();
    f.pass(2.0);
    // From its last heartbeat on.
    let beats = f.heartbeats;
    while f.heartbeats == beats {
        f.step();
    }
    let silent = f.world.now();
    while f.world.snapshot().mode.mode != Mode::Land {
        f.step_unheard();
        assert!(f.world.now().since(silent) < Duration::from_secs(4));
    }
    let after_s = f.world.now().since(silent).as_secs_f64();
    assert!((1.85..=1.95).contains(&after_s), "{after_s} s");
    let until = f.world.now() + Duration::from_secs(25);
    while f.world.snapshot().is_armed {
        f.step_unheard();
        assert!(f.world.now() < until, "never came down");
    }
    assert!(f.world.simulator.truth(0).on_floor);
}
