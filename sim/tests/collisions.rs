//! Walls stop, people push, vehicles see and hit each other, and nothing ever ends up inside a wall.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    reason = "a test may panic, and figures here are exact by construction"
)]

mod pilot;

use core::time::Duration;
use pilot::{Pilot, office};
use proptest::prelude::*;
use sim::{
    Fault, PERSON_RADIUS_M, Room, SimConfig, SimError, SimOutput, Then, VehicleConfig, Walker,
};
use vehicle::{Airframe, In, Map, MapPose, RingConfig, Segment};

/// Distance from the vehicle's centre to the nearest wall, m.
fn wall_distance(p: &Pilot) -> f64 {
    let at = p.sim.anchor().to_map(p.sim.truth(p.vehicle).position);
    let to = |s: &Segment| {
        let (dx, dy) = (s.b[0] - s.a[0], s.b[1] - s.a[1]);
        let u = ((at.x() - s.a[0]) * dx + (at.y() - s.a[1]) * dy) / (dx * dx + dy * dy);
        let u = u.clamp(0.0, 1.0);
        (at.x() - s.a[0] - u * dx).hypot(at.y() - s.a[1] - u * dy)
    };
    let segments = p.sim.room().segments().iter();
    segments.map(to).fold(f64::INFINITY, f64::min)
}

fn radius_m() -> f64 {
    Airframe::default().radius_m
}

#[test]
fn a_wall_stops_it_and_counts_one_contact() {
    let mut p = Pilot::new(office("tof32", 2));
    p.take_off(1.2);
    assert_eq!(p.sim.truth(0).contacts, 0);
    // North wall of the lab is 2.1 m ahead; hold 9 degrees nose down towards it.
    let hover = p.sim.truth(0).position;
    let mut touched = false;
    for _ in 0..2500 {
        p.fly(1, |p| {
            p.steer_to(hover, 0.0);
            p.sticks_us[0] = 1500;
            p.sticks_us[1] = if touched { 1500 } else { pilot::stick(9.0) };
        });
        let truth = p.sim.truth(0);
        touched |= truth.in_contact;
        assert!(wall_distance(&p) > radius_m() - 1e-3);
        if touched {
            break;
        }
    }
    assert!(touched);
    assert_eq!(p.sim.truth(0).contacts, 1);
    assert!(p.sim.truth(0).velocity.x() < 0.0, "it bounced back");
    // Back to the middle: the episode ends, the count stays.
    p.fly(3000, |p| p.steer_to(hover, 0.0));
    assert!(!p.sim.truth(0).in_contact);
    assert_eq!(p.sim.truth(0).contacts, 1);
}

#[test]
fn a_person_who_walks_into_it_pushes_it_and_one_who_passes_does_not() {
    let contacts = |aside_m: f64| {
        let mut config = office("tof32", 2);
        let x = 2.6 + aside_m;
        config.people.push(Walker {
            path: vec![[x, 0.5], [x, 3.5]],
            speed_mps: 1.0,
            start: Duration::from_secs(12),
            then: Then::Stay,
        });
        let mut p = Pilot::new(config);
        p.take_off(1.2);
        p.fly(6000, |p| p.steer_to(In::new(0.0, 0.0, -1.2), 0.0));
        let person = p.sim.people().next().unwrap();
        assert!((person[1] - 3.5).abs() < 1e-9);
        p.sim.truth(0).contacts
    };
    assert!(contacts(0.0) >= 1);
    assert_eq!(contacts(radius_m() + PERSON_RADIUS_M + 0.35), 0);
}

#[test]
fn two_vehicles_see_each_other_and_collide() {
    let mut config = office("tof32", 4);
    let ring = RingConfig::built_in("tof32").unwrap();
    // One metre north of home (plan up), on the floor beside it.
    config
        .vehicles
        .push(VehicleConfig::new(MapPose::new(2.6, 3.05, 0.0), ring));
    let mut p = Pilot::new(config);
    p.fly(1000, |_| {});
    let front = p.outputs.iter().find_map(|o| match o {
        SimOutput::Ranger(r) if r.ranger == 0 => r.columns_mm[3],
        _ => None,
    });
    // 1 m less the sensor's lever arm and the other's radius.
    let expected_mm = 1000.0 * (1.0 - 0.02 - radius_m());
    let front_mm = f64::from(front.unwrap());
    assert!(
        (front_mm - expected_mm).abs() < 60.0,
        "{front_mm} {expected_mm}"
    );
    // Set down upon it.
    p.sim.carry_to(1, MapPose::new(2.6, 2.25, 0.0));
    p.fly(50, |_| {});
    let (a, b) = (p.sim.truth(0), p.sim.truth(1));
    assert!(a.contacts == 1 && b.contacts == 1);
    assert!((a.position - b.position).norm_xy() > 2.0 * radius_m() - 0.01);
}

#[test]
fn the_floor_plan_does_not_know_people() {
    let mut config = office("tof32", 4);
    config.people.push(Walker {
        path: vec![[2.6, 3.3]],
        speed_mps: 0.0,
        start: Duration::ZERO,
        then: Then::Stay,
    });
    let p = Pilot::new(config);
    assert!(p.sim.floor_plan().is_free(In::<Map>::new(2.6, 3.3, 0.0)));
}

#[test]
fn carried_away_it_does_not_notice_and_the_truth_does() {
    let mut p = Pilot::new(office("tof32", 4));
    p.take_off(1.2);
    let facts = p.sim.facts();
    let meeting = facts.rooms.iter().find(|r| r.name == "meeting").unwrap();
    let before: msp::message::Attitude = p.ask();
    let [x, y] = meeting.map_m;
    p.sim.carry_to(0, MapPose::new(x, y, 0.0));
    let truth = p.sim.truth(0);
    assert!((truth.position.x() - meeting.ned_m[0]).abs() < 1e-9);
    assert!((truth.position.y() - meeting.ned_m[1]).abs() < 1e-9);
    assert!((truth.position.z() + 1.2).abs() < 0.3, "height is kept");
    let after: msp::message::Attitude = p.ask();
    let turned = (i32::from(after.yaw_deg) - i32::from(before.yaw_deg) + 540).rem_euclid(360) - 180;
    // The plan direction 0 is east: it was turned by 90 degrees.
    assert!((turned - 90).abs() < 4, "{turned}");
}

#[test]
fn faults_silence_what_they_name_and_can_be_mended() {
    let mut p = Pilot::new(office("tof32", 4));
    let count = |p: &mut Pilot| {
        p.outputs.clear();
        p.replies.clear();
        p.send(msp::command::ATTITUDE, &[]);
        p.fly(1000, |_| {});
        let of = |f: fn(&SimOutput) -> bool| p.outputs.iter().filter(|o| f(o)).count();
        (
            of(|o| matches!(o, SimOutput::Flow(_))),
            of(|o| matches!(o, SimOutput::DownRange(_))),
            of(|o| matches!(o, SimOutput::Ranger(r) if r.ranger == 2)),
            p.replies.len(),
        )
    };
    let faults = [
        Fault::FlowSilent,
        Fault::DownSilent,
        Fault::RangerSilent(2),
        Fault::FcSilent,
    ];
    let (flow, down, left, replies) = count(&mut p);
    assert!(flow > 45 && down > 35 && left > 12 && replies > 40);
    for fault in faults {
        p.sim.set_fault(0, fault, true);
    }
    assert_eq!(count(&mut p), (0, 0, 0, 0));
    for fault in faults {
        p.sim.set_fault(0, fault, false);
    }
    assert!(count(&mut p).0 > 45);
}

#[test]
fn a_busy_controller_carries_out_forty_a_second_and_an_askew_one_tells_another_roll() {
    let mut p = Pilot::new(office("tof32", 4));
    p.fly(1000, |_| {});
    p.sends_rc = false;
    let answered = |p: &mut Pilot| {
        // No more than its buffer holds.
        for _ in 0..60 {
            p.send(msp::command::ATTITUDE, &[]);
        }
        p.replies.clear();
        p.fly(500, |_| {});
        let answered = p.replies.len();
        p.fly(3000, |_| {});
        answered
    };
    assert!((48..=52).contains(&answered(&mut p)));
    p.sim.set_fault(0, Fault::FcBusy, true);
    assert!((18..=22).contains(&answered(&mut p)));
    p.sim.set_fault(0, Fault::FcBusy, false);
    assert!((48..=52).contains(&answered(&mut p)));
    let roll_ddeg = |p: &mut Pilot| p.ask::<msp::message::Attitude>().roll_ddeg;
    let level = roll_ddeg(&mut p);
    p.sim.set_fault(0, Fault::AttitudeAskew, true);
    assert!((roll_ddeg(&mut p) - level - 150).abs() <= 5);
    p.sim.set_fault(0, Fault::AttitudeAskew, false);
    assert!((roll_ddeg(&mut p) - level).abs() <= 5);
}

#[test]
fn a_start_inside_a_wall_is_refused_with_figures() {
    let mut config = office("tof32", 4);
    config.vehicles[0].start = MapPose::new(5.35, 2.0, 0.0);
    let error = pilot_error(config);
    assert!(matches!(error, SimError::StartBlocked { vehicle: 0, .. }));
    assert!(error.to_string().contains("0.05 m from a wall"), "{error}");
    let mut config = office("tof32", 4);
    // The middle of the long desk in the meeting room, half a metre from its edges.
    config.vehicles[0].start = MapPose::new(5.1, 7.8, 0.0);
    assert!(matches!(pilot_error(config), SimError::StartBlocked { .. }));
    let mut config = office("tof32", 4);
    config.vehicles.clear();
    assert_eq!(pilot_error(config), SimError::NoVehicle);
}

fn pilot_error(config: SimConfig) -> SimError {
    sim::Simulator::new(config).unwrap_err()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    /// Full stick in every direction among the panels of the maze.
    #[test]
    fn nothing_drives_it_into_a_wall(seed in 0u64..1000, kicks in proptest::collection::vec((1100u16..1900, 1100u16..1900), 12)) {
        let ring = RingConfig::built_in("sonar8").unwrap();
        let mut p = Pilot::new(SimConfig::new(Room::named("maze").unwrap(), ring, seed));
        p.take_off(1.0);
        for (roll, pitch) in kicks {
            p.fly(800, |p| {
                let here = p.sim.truth(0).position;
                p.steer_to(here.with_z(-1.0), 0.0);
                (p.sticks_us[0], p.sticks_us[1]) = (roll, pitch);
            });
            let at = p.sim.anchor().to_map(p.sim.truth(0).position);
            prop_assert!((0.0..6.0).contains(&at.x()) && (0.0..6.0).contains(&at.y()));
            prop_assert!(wall_distance(&p) > radius_m() - 5e-3, "{:?}", at);
            prop_assert!(p.sim.truth(0).position.is_finite());
        }
    }
}
