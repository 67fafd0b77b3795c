//! What the camera must show, from optics by hand.

use super::*;
use crate::{Room, SimConfig, Simulator, Walker};
use core::time::Duration;
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, Frd, MapPose, Ned, RingConfig, Rot};

const FLOOR: [u8; 2] = [122, 131];

/// A room of 6 by 6 m inside, its corner at the origin, and a pillar in the far corner; nobody in it.
fn hall() -> Room {
    let n = 124_usize;
    let mut cells = vec![Cell::Free; n * n];
    for i in 0..n {
        for j in 0..n {
            if i < 2 || j < 2 || i >= n - 2 || j >= n - 2 {
                cells[i * n + j] = Cell::Occupied;
            }
        }
    }
    let mut plan = FloorPlan::from_cells(n, 0.05, [-0.1, -0.1], cells).unwrap();
    plan.home = Some(MapPose::new(3.0, 3.0, 0.0));
    Room::from_plan("hall", plan)
}

fn scenery(room: &Room) -> Scenery {
    room.scenery(room.walls())
}

/// At 3, 3, this high, looking along x of the plan, rolled and pitched.
fn shot(height_m: f64, roll_rad: f64, pitch_rad: f64) -> Shot {
    // North is x of the plan here, so that east is its -y.
    let frd_to_ned = Rot::<Frd, Ned>::from_roll_pitch_yaw(roll_rad, pitch_rad, 0.0);
    let axis = |x, y, z| {
        let v = frd_to_ned * In::<Frd>::new(x, y, z);
        In::<Map>::new(v.x(), -v.y(), -v.z())
    };
    Shot {
        at: Timestamp::ZERO,
        eye: In::new(3.0, 3.0, height_m),
        axes: [
            axis(1.0, 0.0, 0.0),
            axis(0.0, 1.0, 0.0),
            axis(0.0, 0.0, 1.0),
        ],
        movers: ArrayVec::new(),
    }
}

fn person(x: f64, y: f64) -> Mover {
    Mover {
        centre: [x, y],
        radius_m: 0.25,
        heights_m: [0.0, 1.75],
        is_person: true,
    }
}

fn picture(room: &Room, shot: &Shot) -> Picture {
    let mut p = Picture::new(640, 480);
    Camera::new(scenery(room)).render(shot, &mut p);
    p
}

fn colour(p: &Picture, column: usize, row: usize) -> [u8; 2] {
    let at = row / 2 * (p.width / 2) + column / 2;
    [p.u[at], p.v[at]]
}

/// The uppermost row of a column from which everything below is floor.
fn floor_begins(p: &Picture, column: usize) -> usize {
    let is_floor = |row: &usize| colour(p, column, *row) == FLOOR;
    (0..p.height).rev().take_while(is_floor).last().unwrap()
}

#[test]
fn the_wall_ahead_stands_on_the_floor_where_optics_say() {
    let p = picture(&hall(), &shot(1.0, 0.0, 0.0));
    // 3 m ahead and 1 m below: a third of the focal length below the middle.
    let focal = 320.0 / HALF_VIEW;
    let expected = 240.0 + focal / 3.0;
    for column in [10, 320, 630] {
        let row = floor_begins(&p, column) as f64;
        assert!((row - expected).abs() <= 3.0, "{row}, not {expected}");
    }
}

#[test]
fn nose_down_shows_more_floor_and_rolled_right_less_of_it_on_the_right() {
    let level = floor_begins(&picture(&hall(), &shot(1.0, 0.0, 0.0)), 320);
    let down = floor_begins(&picture(&hall(), &shot(1.0, 0.0, -0.2)), 320);
    assert!(down + 50 < level, "{down} {level}");
    let rolled = picture(&hall(), &shot(1.0, 0.3, 0.0));
    let (left, right) = (floor_begins(&rolled, 100), floor_begins(&rolled, 540));
    // The right side hangs low: the world turns the other way.
    assert!(right + 80 < left, "{left} {right}");
}

#[test]
fn a_person_is_seen_where_he_stands_and_hides_what_is_behind() {
    let empty = shot(1.0, 0.0, 0.0);
    let mut somebody = empty.clone();
    // 1 m to the left and 2 m ahead.
    somebody.movers.push(person(5.0, 4.0));
    let (a, b) = (picture(&hall(), &empty), picture(&hall(), &somebody));
    let changed: Vec<usize> = (0..640)
        .filter(|c| colour(&a, *c, 250) != colour(&b, *c, 250))
        .collect();
    let middle = (changed[0] + changed[changed.len() - 1]) as f64 / 2.0;
    let expected = 320.0 - 320.0 / HALF_VIEW * 0.5;
    assert!((middle - expected).abs() < 12.0, "{middle}, not {expected}");
    // His head is 0.75 m above the lens and 2 m away; above it is the wall.
    let top = (0..480)
        .find(|r| a.y[r * 640 + expected as usize] != b.y[r * 640 + expected as usize])
        .unwrap();
    let expected = 240.0 - 320.0 / HALF_VIEW * 0.75 / 1.8;
    assert!(
        (top as f64 - expected).abs() < 12.0,
        "{top}, not {expected}"
    );
}

#[test]
fn who_stands_behind_a_wall_is_not_seen() {
    let mut s = shot(1.0, 0.0, 0.0);
    let empty = picture(&hall(), &s);
    s.movers.push(person(6.8, 3.0));
    assert_eq!(picture(&hall(), &s), empty);
}

#[test]
fn the_vehicle_sees_with_its_true_pose_and_not_itself() {
    let walker = Walker {
        path: vec![[4.5, 3.0]],
        speed_mps: 0.0,
        start: Duration::ZERO,
        then: crate::Then::Stay,
    };
    let config = SimConfig {
        people: vec![walker],
        ..SimConfig::new(hall(), RingConfig::built_in("tof32").unwrap(), 1)
    };
    let sim = Simulator::new(config).unwrap();
    let shot = sim.shot(0);
    assert_eq!(shot.movers.len(), 1);
    assert!(shot.movers[0].is_person);
    let truth = sim.anchor().to_map(sim.truth(0).position);
    let ahead = shot.eye - truth;
    assert!((ahead.norm() - LENS_AHEAD_M).abs() < 1e-9);
    // Home looks along x of the plan.
    assert!(ahead.x() > 0.99 * LENS_AHEAD_M);
    let mut drawn = Picture::new(640, 480);
    Camera::new(sim.scenery()).render(&shot, &mut drawn);
    let mut again = Picture::new(640, 480);
    Camera::new(sim.scenery()).render(&shot, &mut again);
    assert_eq!(drawn, again, "the same shot, the same picture");
}

#[test]
fn every_attitude_and_every_size_is_drawn() {
    let room = Room::named("office").unwrap();
    let mut camera = Camera::new(scenery(&room));
    for size in [[640, 480], [64, 48], [2, 2], [0, 0]] {
        let mut p = Picture::new(size[0], size[1]);
        for k in 0..64 {
            let [a, b, c] = [k % 4, k / 4 % 4, k / 16].map(|i| f64::from(i) * 1.57 - 0.1);
            let frd_to_ned = Rot::<Frd, Ned>::from_roll_pitch_yaw(a, b, c);
            let axis = |x, y, z| {
                let v = frd_to_ned * In::<Frd>::new(x, y, z);
                In::<Map>::new(v.x(), -v.y(), -v.z())
            };
            let mut s = shot(1.0, 0.0, 0.0);
            s.eye = In::new(2.6, 2.0, 0.05);
            s.axes = [
                axis(1.0, 0.0, 0.0),
                axis(0.0, 1.0, 0.0),
                axis(0.0, 0.0, 1.0),
            ];
            s.movers.push(person(2.6, 2.0));
            s.movers.push(person(3.6, 2.5));
            camera.render(&s, &mut p);
            assert!(p.y.iter().all(|y| (16..=235).contains(y)));
        }
    }
}
