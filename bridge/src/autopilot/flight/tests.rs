//! `Flight` against a scripted controller, in virtual time: what it is told, refused and sent.

#![allow(clippy::unwrap_used, reason = "a test fails where it stands")]

use super::*;
use crate::autopilot::door::{Answer, Asked, Outcome, Refusal, Request, RequestId, Station};
use crate::autopilot::handover::Steering;
use crate::autopilot::mode::Mode;
use crate::settings::Origin;
use msp::message::{
    Altitude, Analog, ApiVersion, Attitude, BatteryState, BoxIds, FcVariant, FcVersion, RawImu, Rc,
    RxMap, SetRawRc, StatusEx, StatusExTail, StatusHead, StatusTail,
};
use msp::{Server, command};
use proptest::prelude::*;
use vehicle::floor_plan::Cell;

const ME: Station = Station {
    system: 255,
    component: 190,
};
const THROTTLE: u32 = 1 << 7;
const ANGLE: u32 = 1 << 8;
const ARM_SWITCH: u32 = 1 << 28;
/// Boxes of the script, in the order of the mode flags.
const BOXES: [u8; 3] = [
    msp::firmware::box_id::ARM,
    msp::firmware::box_id::ANGLE,
    msp::firmware::box_id::MSP_OVERRIDE,
];

/// A flight, and a controller that does as it is told.
struct Script {
    flight: Flight,
    server: Server,
    now: Timestamp,
    variant: [u8; 4],
    rx_map: Vec<u8>,
    cycle_time_us: u16,
    blocks: u32,
    is_armed: bool,
    override_is_on: bool,
    /// What its receiver has: roll, pitch, yaw, throttle ...
    receiver_us: [u16; 8],
    /// One request is answered in this time.
    serves_every: Duration,
    next_serve: Timestamp,
    is_silent: bool,
    /// Sends this instead of answers.
    prompt: Option<&'static [u8]>,
    /// A pilot's radio arms, not SET_RAW_RC.
    has_radio: bool,
    /// Latches the first time the switch goes up.
    latches: bool,
    rc: Vec<(Timestamp, Vec<u16>)>,
    told: Vec<String>,
    answers: Vec<Answer>,
}

impl Script {
    fn with(params: &[(&str, &str)]) -> Self {
        let mut settings = Settings::default();
        for (name, value) in params {
            settings.set_text(name, value, Origin::CommandLine).unwrap();
        }
        let plan = FloorPlan::from_cells(40, 0.1, [0.0, 0.0], vec![Cell::Free; 1_600]).unwrap();
        let flight = Flight::new(
            Timestamp::ZERO,
            FlightConfig {
                plan: Arc::new(plan),
                ring: RingConfig::built_in("tof32").unwrap(),
                airframe: Airframe::default(),
                start: Start::Known(MapPose::default()),
                settings,
                seed: 1,
            },
        );
        let mut script = Self {
            flight,
            server: Server::new(),
            now: Timestamp::ZERO,
            variant: *b"BTFL",
            rx_map: vec![0, 1, 3, 2, 4, 5, 6, 7],
            cycle_time_us: 125,
            blocks: 0,
            is_armed: false,
            override_is_on: false,
            receiver_us: [1500, 1500, 1500, 1000, 1000, 1000, 1000, 1000],
            serves_every: Duration::from_millis(5),
            next_serve: Timestamp::ZERO,
            is_silent: false,
            prompt: None,
            has_radio: false,
            latches: false,
            rc: Vec::new(),
            told: Vec::new(),
            answers: Vec::new(),
        };
        script.input(Input::FcOpened);
        script
    }

    fn new() -> Self {
        Self::with(&[])
    }

    fn input(&mut self, input: Input) {
        self.flight.handle(self.now, input);
        while let Some(output) = self.flight.poll() {
            match output {
                Output::Fc(bytes) if !self.is_silent => self.server.handle(&bytes),
                Output::Fc(_) | Output::Job(_) => {}
                Output::Answer(answer) => self.answers.push(answer),
                Output::Event(Event::Notice(notice)) => self.told.push(notice.to_string()),
                Output::Event(_) => {}
            }
        }
    }

    fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now += Duration::from_millis(1);
            if self.now >= self.next_serve
                && let Some(request) = self.server.pop()
            {
                self.next_serve = self.now + self.serves_every;
                self.serve(&request);
                let bytes = self.server.output().to_vec();
                self.server.clear_output();
                for chunk in bytes.chunks(256) {
                    self.input(Input::Fc(chunk.iter().copied().collect()));
                }
            }
            if let Some(prompt) = self.prompt
                && self.now.us().is_multiple_of(50_000)
            {
                self.input(Input::Fc(prompt.iter().copied().collect()));
            }
            if self.flight.deadline() <= self.now {
                self.input(Input::Wake);
            }
        }
    }

    fn serve(&mut self, request: &msp::server::Request) {
        let server = &mut self.server;
        match request.command {
            command::API_VERSION => server.answer(
                request,
                &ApiVersion {
                    protocol: 0,
                    major: 1,
                    minor: 42,
                },
            ),
            command::FC_VARIANT => server.answer(
                request,
                &FcVariant {
                    variant: self.variant,
                },
            ),
            command::FC_VERSION => server.answer(
                request,
                &FcVersion {
                    major: 4,
                    minor: 5,
                    patch: 1,
                    text: None,
                },
            ),
            command::BOXIDS => server.answer(
                request,
                &BoxIds {
                    ids: BOXES.into_iter().collect(),
                },
            ),
            command::RX_MAP => server.answer(
                request,
                &RxMap {
                    map: self.rx_map.iter().copied().collect(),
                },
            ),
            command::ATTITUDE => server.answer(request, &Attitude::default()),
            command::RAW_IMU => server.answer(
                request,
                &RawImu {
                    acc: [0, 0, 2048],
                    ..RawImu::default()
                },
            ),
            command::ALTITUDE => server.answer(request, &Altitude::default()),
            command::BATTERY_STATE => server.answer(request, &BatteryState::default()),
            command::ANALOG => server.answer(request, &Analog::default()),
            command::RC => server.answer(
                request,
                &Rc {
                    channels_us: self.receiver_us.into_iter().collect(),
                },
            ),
            command::STATUS_EX => {
                let flags = [self.is_armed, true, self.override_is_on];
                let mode_flags = (0..).zip(flags).map(|(i, on)| u32::from(on) << i).sum();
                server.answer(
                    request,
                    &StatusEx {
                        head: StatusHead {
                            cycle_time_us: self.cycle_time_us,
                            mode_flags,
                            ..StatusHead::default()
                        },
                        load_pct: 10,
                        tail: StatusExTail::Betaflight {
                            pid_profile_count: 3,
                            rate_profile: 0,
                            tail: StatusTail {
                                arming_disable_count: 29,
                                arming_disable: self.blocks,
                                ..StatusTail::default()
                            },
                        },
                    },
                );
            }
            command::SET_RAW_RC => {
                let channels = request.parse::<SetRawRc>().unwrap().channels_us;
                // The arm channel follows the four sticks in every map of the script.
                let is_high = channels[4] > 1700;
                if is_high && self.latches {
                    self.latches = false;
                    self.blocks |= ARM_SWITCH;
                }
                if !is_high {
                    self.blocks &= !ARM_SWITCH;
                }
                if !self.has_radio {
                    self.is_armed = is_high && self.blocks == 0;
                }
                self.rc.push((self.now, channels.to_vec()));
                server.reply(request, &[]);
            }
            _ => server.refuse(request),
        }
    }

    fn ask(&mut self, request: Request) {
        let id = RequestId(self.answers.len() as u32);
        self.input(Input::Asked(Asked {
            id,
            station: ME,
            request,
        }));
    }

    fn arm(&mut self) {
        self.ask(Request::Arm { force: true });
    }

    fn outcome(&self) -> Outcome {
        self.answers.last().expect("an answer").outcome
    }

    fn was_told(&self, part: &str) -> bool {
        self.told.iter().any(|t| t.contains(part))
    }
}

#[test]
fn an_unknown_firmware_is_watched_and_not_flown() {
    let mut s = Script::new();
    s.variant = *b"EMUF";
    s.run_ms(3_000);
    assert!(s.flight.snapshot().fc.is_connected && s.flight.snapshot().imu.is_some());
    assert!(s.rc.is_empty(), "it gets no RC frame");
    s.arm();
    assert_eq!(
        s.outcome(),
        Outcome::Refused(Refusal::FcUnknown { variant: *b"EMUF" })
    );
    assert!(
        s.was_told("EMUF is not known: watched, not flown"),
        "{:?}",
        s.told
    );
}

#[test]
fn every_blocking_flag_is_named_with_what_to_do() {
    let mut s = Script::new();
    s.blocks = THROTTLE | ANGLE;
    s.run_ms(3_000);
    s.arm();
    let Outcome::Refused(why) = s.outcome() else {
        panic!("{:?}", s.outcome());
    };
    assert_eq!(
        why.to_string(),
        "flight controller blocks arming: THROTTLE (throttle is not low), ANGLE (not level enough)"
    );
    assert!(s.rc.iter().all(|(_, us)| us[4] == 1000));
}

#[test]
fn the_switch_goes_up_only_after_a_second_of_neutral_frames() {
    let mut s = Script::new();
    while s.rc.is_empty() {
        s.run_ms(1);
    }
    s.arm();
    s.run_ms(2_500);
    assert_eq!(s.outcome(), Outcome::Accepted);
    let first = s.rc[0].0;
    let raised = s.rc.iter().find(|(_, us)| us[4] > 1700).unwrap().0;
    let neutral = raised.since(first);
    assert!(neutral >= Duration::from_secs(1), "{neutral:?}");
    assert!(
        s.rc.iter().all(|(_, us)| us[2] == 1000),
        "throttle stays down"
    );
}

#[test]
fn a_latched_arm_switch_is_lowered_and_raised_again() {
    let mut s = Script::new();
    s.run_ms(3_000);
    s.latches = true;
    s.arm();
    s.run_ms(2_500);
    assert_eq!(s.outcome(), Outcome::Accepted);
    assert!(s.flight.snapshot().is_armed);
    let edges =
        s.rc.windows(2)
            .filter(|w| w[0].1[4] < 1700 && w[1].1[4] > 1700)
            .count();
    assert_eq!(edges, 2);
}

#[test]
fn a_disarm_while_arming_answers_both_and_lowers_the_switch() {
    let mut s = Script::new();
    s.run_ms(300);
    s.arm();
    s.run_ms(50);
    s.ask(Request::Disarm { force: false });
    let outcomes: Vec<Outcome> = s.answers.iter().map(|a| a.outcome).collect();
    assert_eq!(
        outcomes,
        [
            Outcome::Refused(Refusal::DisarmedMeanwhile),
            Outcome::Accepted
        ]
    );
    s.run_ms(2_000);
    assert!(s.rc.iter().all(|(_, us)| us[4] == 1000));
}

#[test]
fn a_slow_controller_is_told_once_with_the_line_that_helps() {
    let mut s = Script::new();
    s.serves_every = Duration::from_millis(30);
    s.run_ms(15_000);
    let told: Vec<&String> = s.told.iter().filter(|t| t.contains("FC serves")).collect();
    assert_eq!(told.len(), 1, "{:?}", s.told);
    assert!(
        told[0].contains("set serial_update_rate_hz = 1000"),
        "{told:?}"
    );
    let mut s = Script::new();
    s.run_ms(15_000);
    assert!(!s.was_told("FC serves"), "{:?}", s.told);
}

#[test]
fn a_scheduler_that_stands_still_is_told_and_not_armed() {
    let mut s = Script::new();
    s.cycle_time_us = 0;
    s.run_ms(5_000);
    assert!(s.was_told("stands still"), "{:?}", s.told);
    s.arm();
    assert_eq!(s.outcome(), Outcome::Refused(Refusal::FcStalled));
    s.cycle_time_us = 125;
    s.run_ms(1_000);
    s.arm();
    s.run_ms(1_000);
    assert_eq!(s.outcome(), Outcome::Accepted);
}

#[test]
fn a_reboot_is_survived_and_the_receiver_map_read_again() {
    let mut s = Script::new();
    s.run_ms(2_000);
    s.is_silent = true;
    s.run_ms(1_500);
    assert!(s.was_told("Flight controller lost"), "{:?}", s.told);
    assert!(!s.flight.snapshot().fc.is_connected);
    s.is_silent = false;
    // TAER: throttle first.
    s.rx_map = vec![1, 2, 3, 0, 4, 5, 6, 7];
    s.rc.clear();
    s.run_ms(2_500);
    assert!(s.flight.snapshot().fc.is_connected);
    let (_, us) = s.rc.last().unwrap();
    assert_eq!(us[..4], [1000, 1500, 1500, 1500]);
    assert_eq!(s.told.iter().filter(|t| t.contains("BTFL")).count(), 2);
}

#[test]
fn a_controller_in_its_command_line_is_named_as_such() {
    let mut s = Script::new();
    s.run_ms(2_000);
    s.is_silent = true;
    s.prompt = Some(b"\r\n# status\r\nMCU F405\r\n# ");
    s.run_ms(2_000);
    assert!(s.was_told("leave it with `exit`"), "{:?}", s.told);
    s.is_silent = false;
    s.prompt = None;
    s.run_ms(2_500);
    assert!(s.flight.snapshot().fc.is_connected);
}

#[test]
fn an_unplugged_line_is_told_at_once() {
    let mut s = Script::new();
    s.run_ms(2_000);
    s.input(Input::FcClosed);
    assert!(s.was_told("Flight controller lost"));
    s.input(Input::FcOpened);
    s.run_ms(2_000);
    assert!(s.flight.snapshot().fc.is_connected);
}

fn beside_a_radio() -> Script {
    let mut s = Script::with(&[("KST_RADIO", "1")]);
    s.has_radio = true;
    s.is_armed = true;
    s.receiver_us = [1620, 1430, 1510, 1380, 2000, 2000, 1000, 1000];
    s.run_ms(2_500);
    s
}

#[test]
fn beside_a_radio_the_pilots_sticks_are_repeated_and_his_switch_arms() {
    let mut s = beside_a_radio();
    assert_eq!(s.flight.snapshot().fc.steering, Steering::Pilot);
    let (_, us) = s.rc.last().unwrap();
    // AETR on the wire.
    assert_eq!(us[..4], [1620, 1430, 1380, 1510]);
    assert!(s.flight.snapshot().is_armed, "his radio armed it");
    s.ask(Request::Disarm { force: true });
    assert_eq!(s.outcome(), Outcome::Refused(Refusal::PilotArms));
    s.ask(Request::SetMode(Mode::Hold));
    assert_eq!(s.outcome(), Outcome::Refused(Refusal::PilotSteers));
    s.is_armed = false;
    s.run_ms(200);
    assert!(!s.flight.snapshot().is_armed && s.was_told("Pilot disarmed"));
    s.arm();
    assert_eq!(s.outcome(), Outcome::Refused(Refusal::PilotArms));
}

#[test]
fn a_switch_without_a_request_sends_nothing_and_a_request_starts_from_his_sticks() {
    let mut s = beside_a_radio();
    s.override_is_on = true;
    s.run_ms(200);
    assert!(s.was_told("ask for a mode"), "{:?}", s.told);
    s.rc.clear();
    s.run_ms(500);
    assert!(s.rc.is_empty(), "{:?}", s.rc);
    s.ask(Request::SetMode(Mode::Hold));
    assert_eq!(s.outcome(), Outcome::Accepted);
    s.run_ms(1_000);
    let sticks: Vec<[u16; 4]> =
        s.rc.iter()
            .map(|(_, us)| [us[0], us[1], us[2], us[3]])
            .collect();
    let mut last = [1620, 1430, 1380, 1510];
    for us in sticks {
        // A twentieth of a stick: 25 us from the centre, 50 us of throttle.
        for (i, limit) in [25, 25, 50, 25].into_iter().enumerate() {
            assert!(us[i].abs_diff(last[i]) <= limit, "{last:?} -> {us:?}");
        }
        last = us;
    }
    assert_ne!(last, [1620, 1430, 1380, 1510]);
    s.override_is_on = false;
    s.run_ms(150);
    assert_eq!(s.flight.snapshot().mode.mode, Mode::Stabilized);
    assert!(s.was_told("Pilot took over"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn no_bytes_from_the_line_make_it_panic_or_arm(chunks in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..64), 0..40)) {
        let mut s = Script::new();
        s.run_ms(200);
        for chunk in chunks {
            s.input(Input::Fc(chunk.into_iter().collect()));
            s.run_ms(3);
        }
        prop_assert!(!s.flight.snapshot().is_armed);
        prop_assert!(s.rc.iter().all(|(_, us)| us[4] == 1000));
    }
}
