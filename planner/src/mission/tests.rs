use super::*;
use proptest::prelude::*;
use vehicle::angle::{shortest_turn, wrap_pi};
use vehicle::{Frd, NavHealth, Rot};

fn nav(x: f64, y: f64, height_m: f64) -> NavState {
    NavState {
        position: In::new(x, y, -height_m),
        height_m,
        health: NavHealth {
            attitude: true,
            height: true,
            velocity: true,
            position: true,
        },
        ..NavState::default()
    }
}

const fn waypoint(x: f64, y: f64, hold_s: f64) -> PlanItem {
    PlanItem::Waypoint {
        position: In::new(x, y, -1.0),
        yaw_rad: None,
        hold_s,
        acceptance_m: 0.0,
    }
}

fn mission(items: &[PlanItem]) -> Mission {
    let mut m = Mission::new(PlannerParams::default());
    m.load(Some(Arc::new(Plan {
        items: items.to_vec(),
    })));
    m.start(0).unwrap();
    m
}

/// Flies perfectly: jumps to whatever is asked for, a step every 100 ms. Returns the items reached and the time.
fn fly(m: &mut Mission, steps: u64) -> (Vec<u16>, bool) {
    let (mut at, mut landed) = (nav(0.0, 0.0, 0.0), true);
    let mut reached = Vec::new();
    for i in 0..steps {
        let s = m.step(Timestamp::from_ms(100 * i), &at, landed);
        reached.extend(s.reached.iter().copied());
        if s.finished {
            return (reached, true);
        }
        match s.leg {
            Leg::Takeoff { height_m, .. } => {
                (at, landed) = (nav(0.0, 0.0, height_m), false);
            }
            Leg::Goto(g) => {
                at = nav(g.position.x(), g.position.y(), -g.position.z());
                if let Some(h) = g.heading {
                    at.attitude = Rot::<Frd, Ned>::from_roll_pitch_yaw(0.0, 0.0, h);
                }
            }
            Leg::Land { .. } | Leg::Return => (at, landed) = (nav(0.0, 0.0, 0.05), true),
            Leg::Hold => {}
        }
    }
    (reached, false)
}

#[test]
fn every_item_is_reached_once_and_in_order_those_without_a_place_too() {
    let mut m = mission(&[
        PlanItem::Takeoff {
            height_m: 1.0,
            yaw_rad: None,
        },
        PlanItem::ChangeSpeed { speed_mps: 0.5 },
        waypoint(1.0, 0.0, 0.0),
        PlanItem::Skip,
        waypoint(1.0, 2.0, 1.0),
        PlanItem::Delay { seconds: 0.5 },
        PlanItem::ConditionYaw {
            yaw_rad: 1.0,
            relative: false,
            turn: Turn::Right,
        },
        PlanItem::LoiterTime {
            position: None,
            yaw_rad: None,
            seconds: 0.3,
        },
        PlanItem::Return,
    ]);
    assert_eq!(fly(&mut m, 200), ((0..9).collect(), true));
    assert_eq!((m.state(), m.seq()), (MissionState::Complete, 8));
}

#[test]
fn a_turn_goes_the_way_round_it_names() {
    for (relative, turn, yaw_deg, degrees) in [
        (false, Turn::Right, -90.0, 270.0),
        (false, Turn::Left, -90.0, -90.0),
        (false, Turn::Left, 90.0, -270.0),
        (false, Turn::Right, 90.0, 90.0),
        (false, Turn::Shortest, -90.0, -90.0),
        (true, Turn::Right, 270.0, 270.0),
        (true, Turn::Left, 200.0, -200.0),
        (false, Turn::Right, -0.5, 0.0),
    ] {
        let mut m = mission(&[PlanItem::ConditionYaw {
            yaw_rad: f64::to_radians(yaw_deg),
            relative,
            turn,
        }]);
        let (mut yaw, mut turned) = (0.0f64, 0.0f64);
        for step in 0..400 {
            let here = NavState {
                attitude: Rot::<Frd, Ned>::from_roll_pitch_yaw(0.0, 0.0, wrap_pi(yaw)),
                ..nav(0.0, 0.0, 1.0)
            };
            let s = m.step(Timestamp::from_ms(step * 50), &here, false);
            if s.finished {
                break;
            }
            let Leg::Goto(Goal {
                heading: Some(heading),
                ..
            }) = s.leg
            else {
                panic!("{:?}", s.leg)
            };
            // A vehicle that turns the shorter way at 1 rad/s.
            let by = shortest_turn(yaw, heading).clamp(-0.05, 0.05);
            (yaw, turned) = (yaw + by, turned + by);
        }
        let off = (turned.to_degrees() - degrees).abs();
        assert!(
            off < 12.0,
            "{relative} {turn:?} {yaw_deg}: turned {:.0}",
            turned.to_degrees()
        );
    }
}

#[test]
fn a_speed_item_changes_the_speed_of_what_follows() {
    let mut m = mission(&[
        PlanItem::ChangeSpeed { speed_mps: 0.4 },
        waypoint(3.0, 0.0, 0.0),
    ]);
    let s = m.step(Timestamp::ZERO, &nav(0.0, 0.0, 1.0), false);
    assert!(matches!(s.leg, Leg::Goto(Goal { speed_mps: Some(v), .. }) if (v - 0.4).abs() < 1e-12));
    assert_eq!((s.reached.as_slice(), s.seq), (&[0u16][..], 1));
}

#[test]
fn a_waypoint_is_reached_within_12_centimetres_and_its_hold_runs_from_there() {
    let mut m = mission(&[waypoint(1.0, 0.0, 2.0), waypoint(5.0, 0.0, 0.0)]);
    let mut reached = |ms: u64, x: f64| {
        m.step(Timestamp::from_ms(ms), &nav(x, 0.0, 1.0), false)
            .reached
            .to_vec()
    };
    assert!(reached(0, 0.85).is_empty());
    assert!(reached(5_000, 0.89).is_empty(), "2 s from here");
    assert!(reached(6_900, 1.0).is_empty());
    assert_eq!(reached(7_000, 1.0), [0]);
}

#[test]
fn pausing_keeps_the_place_and_a_complete_mission_starts_again() {
    let mut m = mission(&[waypoint(0.0, 0.0, 0.0), waypoint(4.0, 0.0, 0.0)]);
    let here = nav(0.0, 0.0, 1.0);
    assert_eq!(
        m.step(Timestamp::ZERO, &here, false).reached.as_slice(),
        &[0]
    );
    m.pause();
    let s = m.step(Timestamp::from_ms(10), &here, false);
    assert_eq!(
        (s.leg, s.seq, m.state()),
        (Leg::Hold, 1, MissionState::Paused)
    );
    m.resume().unwrap();
    let s = m.step(Timestamp::from_ms(20), &nav(4.0, 0.05, 1.0), false);
    assert!(s.finished && s.reached.as_slice() == [1]);
    m.resume().unwrap();
    assert_eq!((m.seq(), m.state()), (0, MissionState::Active));
}

#[test]
fn a_jump_of_two_flies_the_loop_three_times_and_one_for_ever_never_hangs() {
    let mut m = mission(&[
        waypoint(1.0, 0.0, 0.0),
        waypoint(2.0, 0.0, 0.0),
        PlanItem::Jump { to: 0, count: 2 },
    ]);
    assert_eq!(fly(&mut m, 100), (vec![0, 1, 2, 0, 1, 2, 0, 1, 2], true));
    let mut m = mission(&[PlanItem::Jump { to: 0, count: -1 }]);
    let s = m.step(Timestamp::ZERO, &nav(0.0, 0.0, 1.0), false);
    assert_eq!(s.reached.len(), MAX_REACHED);
}

#[test]
fn standing_on_the_floor_before_take_off_is_not_a_landing() {
    let mut m = mission(&[PlanItem::Land {
        position: None,
        yaw_rad: None,
    }]);
    assert!(
        m.step(Timestamp::ZERO, &nav(0.0, 0.0, 0.05), true)
            .reached
            .is_empty()
    );
    assert!(
        m.step(Timestamp::from_ms(100), &nav(0.0, 0.0, 0.5), false)
            .reached
            .is_empty()
    );
    assert!(
        m.step(Timestamp::from_ms(200), &nav(0.0, 0.0, 0.05), true)
            .finished
    );
}

proptest! {
    #[test]
    fn whatever_is_done_the_sequence_stays_inside_the_plan(actions in proptest::collection::vec(0u8..8, 1..60)) {
        let items = [waypoint(0.0, 0.0, 0.0), PlanItem::Jump { to: 0, count: 1 }, waypoint(1.0, 0.0, 0.2), PlanItem::Return];
        let mut m = mission(&items);
        let mut t = 0;
        for a in actions {
            t += 100;
            match a {
                0 => m.pause(),
                1 => { let _ = m.resume(); }
                2 => { let _ = m.start(u16::from(a) + 7); }
                3 => { let _ = m.set_current(2); }
                _ => {
                    let x = f64::from(a % 2);
                    let s = m.step(Timestamp::from_ms(t), &nav(x, 0.0, 1.0), a == 7);
                    prop_assert!(usize::from(s.seq) < items.len());
                    prop_assert!(!s.finished || m.state() == MissionState::Complete);
                }
            }
            prop_assert!(usize::from(m.seq()) < items.len());
        }
    }
}
