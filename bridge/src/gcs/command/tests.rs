//! Every row of the command table, the rules all commands share, and commands nobody would send.

mod desk;
mod modes;

use super::super::bench::{Bench, answer, station};
use super::super::convert::GeoAnchor;
use super::super::keys;
use super::super::params::Identity;
use super::*;
use crate::autopilot::door::{Failure, FailureKind, FailureUnit};
use crate::autopilot::door::{FcStatus, GoTo, Key, Refusal, Step};
use crate::autopilot::door::{MotorTurn, Sensor};
use crate::autopilot::mode::Mode;
use desk::*;
use proptest::prelude::*;
use raw::MavMessage as M;
use vehicle::{In, Rot};

#[test]
fn arming_and_disarming_with_every_magic_number() {
    for (params, request) in [
        ([1.0, 0.0], Request::Arm { force: false }),
        ([1.0, NAN], Request::Arm { force: false }),
        ([1.0, 21196.0], Request::Arm { force: true }),
        ([1.0, 2989.0], Request::Arm { force: true }),
        ([0.0, 0.0], Request::Disarm { force: false }),
        ([0.0, 21196.0], Request::Disarm { force: true }),
        ([0.0, 2989.0], Request::Disarm { force: false }),
    ] {
        assert_eq!(came(&first(400, &params)), Came::Asked(request.clone()));
        assert_eq!(
            came(&int(400, 0, [params[0], params[1], 0.0, 0.0], 0, 0, 0.0)),
            Came::Asked(request)
        );
    }
    for p1 in [NAN, 2.0, -1.0, f32::INFINITY] {
        assert_eq!(
            refused(&mut Desk::new(), &first(400, &[p1]), "parameter 1"),
            result::DENIED
        );
    }
}

#[test]
fn take_off_heights_are_above_sea_level_for_px4_and_above_home_for_others() {
    let take_off =
        |desk: &mut Desk, z: f32| desk.came(&long(22, [NAN, NAN, NAN, NAN, NAN, NAN, z]));
    let height = |height_m: Option<f64>| Came::Asked(Request::Takeoff { height_m });
    let mut desk = Desk::new();
    let ceiling = desk.bench.settings.autopilot.ceiling_m;
    assert_eq!(take_off(&mut desk, NAN), height(None), "the parameter's");
    for (z, expect) in [
        (1.5, Some(1.5)),
        (0.1, Some(0.3)),
        (50.0, Some(ceiling)),
        (0.0, None),
        (-1.0, None),
    ] {
        assert_eq!(take_off(&mut Desk::new(), z), height(expect), "{z}");
    }
    desk.bench.settings.ground.alt0_m = 400.0;
    let mut desk_high = Desk::new();
    desk_high.bench.settings.ground.alt0_m = 400.0;
    assert_eq!(take_off(&mut desk_high, 401.5), height(Some(1.5)));
    let mut generic = Desk::new();
    generic.bench.settings.ground.alt0_m = 400.0;
    generic.bench.settings.ground.identity = Identity::Generic;
    assert_eq!(take_off(&mut generic, 1.5), height(Some(1.5)));
    let mut framed = Desk::new();
    framed.bench.settings.ground.alt0_m = 400.0;
    assert_eq!(
        framed.came(&int(22, 3, [0.0; 4], 0, 0, 1.5)),
        height(Some(1.5)),
        "COMMAND_INT says it itself"
    );
    assert_eq!(
        came(&int(22, 77, [0.0; 4], 0, 0, 1.5)),
        Came::Acked(result::UNSUPPORTED_MAV_FRAME)
    );
    assert_eq!(
        refused(
            &mut Desk::new(),
            &long(22, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, f32::INFINITY]),
            "height"
        ),
        2
    );
}

fn turn(motor: u8, percent: f64, time_s: f64) -> Request {
    Request::TurnMotor(MotorTurn {
        motor: Some(motor),
        percent,
        time_s,
    })
}

#[test]
fn simple_commands_ask_for_what_they_say() {
    for (message, request) in [
        (first(21, &[NAN; 7]), Request::SetMode(Mode::Land)),
        (first(20, &[NAN; 7]), Request::SetMode(Mode::Return)),
        (first(17, &[0.0; 7]), Request::Stop),
        (first(193, &[0.0]), Request::Stop),
        (first(193, &[1.0]), Request::SetMode(Mode::Mission)),
        (first(300, &[2.0, 5.0]), Request::StartMission { first: 2 }),
        (first(300, &[NAN, NAN]), Request::StartMission { first: 0 }),
        (first(300, &[-1.0]), Request::StartMission { first: 0 }),
        (first(224, &[3.0]), Request::SetMissionItem(3)),
        (first(178, &[1.0, 0.5, -1.0]), Request::ChangeSpeed(0.5)),
        (first(178, &[1.0, 99.0, -1.0]), Request::ChangeSpeed(1.5)),
        (first(179, &[1.0]), Request::SetHome(None)),
        (first(185, &[1.0]), Request::Disarm { force: true }),
        (first(241, &[0.0; 7]), Request::EndBenchWork),
        (first(241, &[1.0]), Request::Calibrate(Sensor::Gyroscope)),
        (
            first(241, &[0.0, 0.0, 0.0, 0.0, 1.0]),
            Request::Calibrate(Sensor::Accelerometer),
        ),
        (
            first(241, &[0.0, 0.0, 0.0, 0.0, 2.0]),
            Request::Calibrate(Sensor::Level),
        ),
        (
            int(241, 0, [0.0; 4], 2, 0, 0.0),
            Request::Calibrate(Sensor::Level),
        ),
        (
            first(420, &[7.0, 2.0, 3.0]),
            Request::Inject(Failure {
                unit: FailureUnit::Distance,
                kind: FailureKind::Stuck,
                instance: 3,
            }),
        ),
        (first(246, &[1.0]), Request::RestartFc),
        (first(246, &[1.0, 1.0, 1.0]), Request::RestartFc),
        (first(209, &[2.0, 0.0, 8.0, 1.5]), turn(2, 8.0, 1.5)),
        (first(209, &[2.0, 1.0, 1080.0, 1.5]), turn(2, 8.0, 1.5)),
        (first(310, &[0.25, 2.0, 0.0, 0.0, 3.0]), turn(3, 25.0, 2.0)),
        (
            first(310, &[NAN, 0.0, 0.0, 0.0, 1.0]),
            Request::EndBenchWork,
        ),
        (
            int(21, 0, [NAN; 4], i32::MAX, i32::MAX, NAN),
            Request::SetMode(Mode::Land),
        ),
    ] {
        assert_eq!(came(&message), Came::Asked(request), "{message:?}");
    }
    for (message, result) in [
        (first(178, &[1.0, -1.0]), result::ACCEPTED),
        (first(178, &[1.0, NAN]), result::DENIED),
        (first(193, &[NAN]), result::DENIED),
        (first(224, &[-1.0]), result::DENIED),
        (first(300, &[70_000.0]), result::DENIED),
        (first(185, &[0.0]), result::ACCEPTED),
        (first(179, &[0.0]), result::DENIED),
        (first(245, &[1.0]), result::ACCEPTED),
        (first(245, &[2.0]), result::UNSUPPORTED),
        (first(241, &[0.0, 1.0]), result::UNSUPPORTED),
        (first(241, &[1.0, 0.0, 0.0, 0.0, 1.0]), result::UNSUPPORTED),
        (first(246, &[0.0]), result::ACCEPTED),
        (first(246, &[0.0, 1.0]), result::UNSUPPORTED),
        (first(246, &[2.0, 2.0]), result::UNSUPPORTED),
        (first(209, &[0.0, 0.0, 5.0, 1.0]), result::DENIED),
        (first(209, &[1.0, 2.0, 5.0, 1.0]), result::UNSUPPORTED),
        (first(209, &[1.0, 0.0, 5.0, 1.0, 4.0]), result::UNSUPPORTED),
        (first(310, &[0.1, 1.0, 0.0, 0.0, 33.0]), result::UNSUPPORTED),
        (first(1000, &[0.0]), result::UNSUPPORTED),
        (first(1001, &[0.0]), result::UNSUPPORTED),
        (first(2000, &[0.0]), result::UNSUPPORTED),
        (first(521, &[1.0]), result::UNSUPPORTED),
        (first(4242, &[1.0]), result::UNSUPPORTED),
        (first(65_535, &[NAN; 7]), result::UNSUPPORTED),
    ] {
        assert_eq!(came(&message), Came::Acked(result), "{message:?}");
    }
}

#[test]
fn motors_and_reboot_are_denied_while_armed() {
    let mut desk = Desk::new();
    desk.bench.snapshot.is_armed = true;
    for (message, result) in [
        (first(246, &[1.0]), result::DENIED),
        (first(209, &[1.0]), result::DENIED),
        (first(310, &[1.0]), result::DENIED),
    ] {
        assert_eq!(refused(&mut desk, &message, "disarm first"), result);
    }
    assert_eq!(
        desk.came(&first(401, &[])),
        Came::Acked(result::TEMPORARILY_REJECTED)
    );
}

#[test]
fn the_pilot_is_told_whether_arming_would_be_refused() {
    let mut desk = Desk::new();
    assert_eq!(
        refused(&mut desk, &first(401, &[]), "Ready to arm"),
        result::ACCEPTED
    );
    desk.bench.snapshot.arm_blocked_by = Some(Refusal::NoRangers);
    assert_eq!(
        refused(&mut desk, &first(401, &[]), "range finders are silent"),
        result::ACCEPTED
    );
}

#[test]
fn streams_are_set_read_and_requested_for_the_asking_link() {
    let mut desk = Desk::new();
    assert_eq!(
        desk.came(&first(511, &[30.0, 20_000.0])),
        Came::Acked(result::ACCEPTED)
    );
    assert_eq!(desk.streams.intervals, [(A.link, 30, 20_000)]);
    for params in [[NAN, 1.0], [30.0, NAN], [-1.0, 1.0], [30.0, f32::INFINITY]] {
        assert_eq!(desk.came(&first(511, &params)), Came::Acked(result::DENIED));
    }
    desk.send(A, &first(510, &[30.0]));
    let sent = desk.out.sent();
    let interval = standard_interval(50_000, 30);
    assert!(sent.contains(&interval), "{sent:?}");
    for (message, id, param2, result) in [
        (first(512, &[148.0]), 148, 0.0, result::ACCEPTED),
        (first(512, &[435.0, 3.0]), 435, 3.0, result::ACCEPTED),
        (first(512, &[9999.0]), 9999, 0.0, result::UNSUPPORTED),
        (first(520, &[1.0]), 148, 0.0, result::ACCEPTED),
        (first(519, &[1.0]), 300, 0.0, result::ACCEPTED),
        (first(410, &[NAN; 7]), 242, 0.0, result::ACCEPTED),
    ] {
        assert_eq!(desk.came(&message), Came::Acked(result));
        assert_eq!(
            desk.streams.requested.last(),
            Some(&(id, f32::to_bits(param2)))
        );
    }
    assert_eq!(desk.came(&first(512, &[NAN])), Came::Acked(result::DENIED));
}

fn standard_interval(interval_us: i32, message_id: u16) -> Message {
    use mavlink_dialect::standard::{MESSAGE_INTERVAL_DATA, MavMessage};
    Message::Standard(MavMessage::MESSAGE_INTERVAL(MESSAGE_INTERVAL_DATA {
        interval_us,
        message_id,
    }))
}

#[test]
fn user_1_carries_the_key_console_and_types_twice_what_comes_twice() {
    let mut desk = Desk::new();
    for code in 0..=127u8 {
        let expect = match keys::key(code) {
            Some(key) => Came::Asked(Request::Key(key)),
            None => Came::Acked(result::DENIED),
        };
        assert_eq!(came(&first(31010, &[f32::from(code)])), expect, "{code}");
    }
    let up = first(31010, &[f32::from(b'e')]);
    assert_eq!(
        desk.came(&up),
        Came::Asked(Request::Key(Key::Height(Step::Plus)))
    );
    assert_eq!(
        desk.came(&up),
        Came::Asked(Request::Key(Key::Height(Step::Plus))),
        "a second stroke"
    );
    assert_eq!(
        desk.came(&repeat(&up, 1)),
        Came::Acked(result::IN_PROGRESS),
        "a repeat"
    );
    assert_eq!(came(&first(31010, &[NAN])), Came::Acked(result::DENIED));
}

#[test]
fn the_vehicles_answer_becomes_the_ack_to_who_asked() {
    let mut desk = Desk::new();
    desk.send(A, &first(400, &[1.0]));
    desk.send(B, &first(22, &[NAN; 7]));
    let asked = desk.out.asked();
    let no = answer(&asked[1], Outcome::Refused(Refusal::NotArmed));
    assert!(
        desk.service
            .answer(desk.now, &no, &desk.bench.ctx(), &mut desk.out)
    );
    let yes = answer(&asked[0], Outcome::Accepted);
    assert!(
        desk.service
            .answer(desk.now, &yes, &desk.bench.ctx(), &mut desk.out)
    );
    assert!(
        !desk
            .service
            .answer(desk.now, &yes, &desk.bench.ctx(), &mut desk.out),
        "claimed once"
    );
    assert_eq!(
        desk.acks(),
        [(250, 22, result::DENIED), (255, 400, result::ACCEPTED)]
    );
    assert_eq!(desk.out.said()[0].1, "Take-off refused: not armed");
}

#[test]
fn refusals_carry_their_class() {
    for (why, result) in [
        (Refusal::FcSilent, result::TEMPORARILY_REJECTED),
        (Refusal::Flying, result::DENIED),
        (Refusal::Unsupported, result::UNSUPPORTED),
    ] {
        let mut desk = Desk::new();
        desk.send(A, &first(400, &[1.0]));
        let no = answer(&desk.out.asked()[0], Outcome::Refused(why));
        desk.service
            .answer(desk.now, &no, &desk.bench.ctx(), &mut desk.out);
        assert_eq!(desk.acks(), [(255, 400, result)]);
    }
}

#[test]
fn a_repeat_is_answered_and_not_carried_out_again() {
    let mut desk = Desk::new();
    let arm = first(400, &[1.0]);
    desk.send(A, &arm);
    let asked = desk.out.asked();
    assert_eq!(
        desk.came(&repeat(&arm, 1)),
        Came::Acked(result::IN_PROGRESS)
    );
    assert_eq!(
        desk.came(&arm),
        Came::Acked(result::IN_PROGRESS),
        "uncounted, while it runs"
    );
    desk.send(B, &arm);
    assert_eq!(desk.out.asked().len(), 1, "another station's is its own");
    desk.service.answer(
        desk.now,
        &answer(&asked[0], Outcome::Accepted),
        &desk.bench.ctx(),
        &mut desk.out,
    );
    desk.acks();
    assert_eq!(
        desk.came(&repeat(&arm, 2)),
        Came::Acked(result::ACCEPTED),
        "its ACK was lost"
    );
    assert_eq!(
        desk.came(&arm),
        Came::Asked(Request::Arm { force: false }),
        "a new one"
    );
    desk.out.asked();
    desk.now += Duration::from_secs(4);
    assert_eq!(
        desk.came(&repeat(&first(224, &[1.0]), 1)),
        Came::Asked(Request::SetMissionItem(1)),
        "first heard of now"
    );
}

#[test]
fn a_slow_command_is_in_progress_within_100_ms_and_failed_after_10_s() {
    let mut desk = Desk::new();
    desk.send(A, &first(400, &[1.0]));
    let mut acks = Vec::new();
    for i in 1..=600u64 {
        desk.tick(20);
        acks.extend(
            desk.acks()
                .into_iter()
                .map(|(_, _, result)| (i * 20, result)),
        );
    }
    assert_eq!(acks, [(80, result::IN_PROGRESS), (10_000, result::FAILED)]);
}

#[test]
fn cancelling_an_arm_disarms() {
    let mut desk = Desk::new();
    desk.send(A, &first(400, &[1.0]));
    desk.out.asked();
    let cancel = Message::Raw(M::COMMAND_CANCEL(raw::COMMAND_CANCEL_DATA {
        command: 400,
        ..Default::default()
    }));
    desk.send(B, &cancel);
    assert!(desk.acks().is_empty(), "not theirs");
    desk.send(A, &cancel);
    assert_eq!(desk.acks(), [(255, 400, result::CANCELLED)]);
    assert_eq!(
        desk.out.asked()[0].request,
        Request::Disarm { force: false }
    );
    desk.send(A, &cancel);
    assert!(desk.acks().is_empty(), "nothing runs any more");
}

#[test]
fn a_33rd_command_waits_until_one_is_answered() {
    let mut desk = Desk::new();
    for seq in 0..32 {
        assert_eq!(
            desk.came(&first(224, &[seq as f32])),
            Came::Asked(Request::SetMissionItem(seq))
        );
    }
    assert_eq!(
        desk.came(&first(400, &[1.0])),
        Came::Acked(result::TEMPORARILY_REJECTED)
    );
    let yes = Answer {
        id: RequestId(1),
        station: A.station(),
        outcome: Outcome::Accepted,
    };
    assert!(
        desk.service
            .answer(desk.now, &yes, &desk.bench.ctx(), &mut desk.out)
    );
    desk.acks();
    assert_eq!(
        desk.came(&first(400, &[1.0])),
        Came::Asked(Request::Arm { force: false })
    );
}

fn any_f32() -> impl Strategy<Value = f32> {
    prop_oneof![
        Just(NAN),
        Just(0.0f32),
        Just(-1.0),
        Just(1.0),
        Just(f32::INFINITY),
        any::<u32>().prop_map(f32::from_bits)
    ]
}

fn any_number() -> impl Strategy<Value = u16> {
    prop_oneof![
        proptest::sample::select(vec![
            17u16, 20, 21, 22, 176, 178, 179, 185, 192, 193, 209, 224, 241, 245, 246, 262, 300,
            310, 400, 401, 410, 510, 511, 512, 519, 520, 611, 31010,
        ]),
        any::<u16>(),
    ]
}

proptest! {
    #[test]
    fn every_command_is_acked_or_asked_whatever_its_parameters(
        number in any_number(), p in [any_f32(), any_f32(), any_f32(), any_f32(), any_f32(), any_f32(), any_f32()],
        frame in 0u8..14, x: i32, y: i32, is_int: bool, armed: bool, mode in 0usize..9
    ) {
        let mut desk = Desk::new();
        desk.bench.snapshot.is_armed = armed;
        desk.bench.snapshot.mode.mode = Mode::ALL[mode];
        desk.bench.snapshot.fc = FcStatus::default();
        let message = if is_int { int(number, frame, [p[0], p[1], p[2], p[3]], x, y, p[6]) } else { long(number, p) };
        desk.send(A, &message);
        let asked = desk.out.asked();
        let acks = desk.acks();
        // The origin is three parameters and an ACK.
        prop_assert!(acks.len() == 1 || (acks.is_empty() && asked.len() == 1), "{:?} {:?}", acks, asked);
        for a in asked {
            match a.request {
                Request::GoTo(to) => {
                    let all = [to.north_m, to.east_m, to.down_m, to.yaw_rad, to.speed_mps];
                    prop_assert!(all.into_iter().flatten().all(f64::is_finite));
                }
                Request::Takeoff { height_m } => prop_assert!(height_m.is_none_or(|h| (0.3..=2.3).contains(&h))),
                Request::ChangeSpeed(v) => prop_assert!(v > 0.0 && v.is_finite()),
                Request::SetHome(Some(home)) => prop_assert!(home.is_finite()),
                _ => {}
            }
        }
    }
}
