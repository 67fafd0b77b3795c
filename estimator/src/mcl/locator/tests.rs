use super::*;
use crate::mcl::beams::Evidence;
use vehicle::floor_plan::Cell;

const ROOM_M: [f64; 2] = [8.0, 6.0];
const RAYS: usize = 32;

/// An empty room from the origin, walls of a cell around.
fn locator() -> Locator {
    let cell_m = 0.05;
    let (w, h) = (
        (ROOM_M[0] / cell_m) as usize + 2,
        (ROOM_M[1] / cell_m) as usize + 2,
    );
    let cells = (0..w * h)
        .map(|i| {
            let (c, r) = (i % w, i / w);
            if c == 0 || r == 0 || c == w - 1 || r == h - 1 {
                Cell::Occupied
            } else {
                Cell::Free
            }
        })
        .collect();
    let plan = FloorPlan::from_cells(w, cell_m, [-cell_m; 2], cells).unwrap();
    Locator::new(&EstimatorParams::default(), &plan, 7)
}

/// Distance from inside a box (from, to) to its side, m.
fn to_side(from: [f64; 2], to: [f64; 2], p: [f64; 2], d: [f64; 2]) -> f64 {
    (0..2)
        .map(|k| {
            let side = if d[k] > 0.0 { to[k] } else { from[k] };
            if d[k].abs() < 1e-9 {
                f64::INFINITY
            } else {
                (side - p[k]) / d[k]
            }
        })
        .fold(f64::INFINITY, f64::min)
}

/// Flies along x at a speed from (2, 3), nose along x, for so long, s; what each ray reads is told by where it starts and points.
fn fly(
    locator: &mut Locator,
    from_s: f64,
    seconds: f64,
    speed_mps: f64,
    read: impl Fn([f64; 2], [f64; 2]) -> f64,
) -> Vec<LocalizationState> {
    let begin = locator.updated_at().unwrap_or_default().x;
    let mut states = Vec::new();
    for k in 1..=(seconds * 15.0) as u64 {
        let s = k as f64 / 15.0;
        let at = Timestamp::from_ms(((from_s + s) * 1e3) as u64);
        let odometry = Planar::new(begin + speed_mps * s, 0.0, 0.0);
        let eye = [2.0 + odometry.x, 3.0];
        let beams: Vec<LevelBeam> = (0..RAYS)
            .map(|i| {
                let angle = i as f64 * TAU / RAYS as f64;
                let d = [libm::cos(angle), libm::sin(angle)];
                let m = read(eye, d);
                LevelBeam {
                    points: [[d[0] * m, d[1] * m]; 3],
                    origin: [0.0; 2],
                    evidence: match m {
                        m if m < 1.0 => Evidence::RayNear,
                        m if m < 2.0 => Evidence::RayMiddle,
                        _ => Evidence::RayFar,
                    },
                }
            })
            .collect();
        locator.add(at, &odometry, &beams);
        locator.update(at, 1.0);
        states.push(locator.status().state);
    }
    states
}

fn room(p: [f64; 2], d: [f64; 2]) -> f64 {
    to_side([0.0; 2], ROOM_M, p, d)
}

/// A recess that no plan shows, open on the side it is flown into: 1.8 m wide, from x = 2.5 m.
fn recess(p: [f64; 2], d: [f64; 2]) -> f64 {
    let m = to_side([0.0, 2.1], [5.6, 3.9], p, d);
    let end = [p[0] + d[0] * m, p[1] + d[1] * m];
    if end[0] < 2.5 { room(p, d) } else { m }
}

fn localized() -> Locator {
    let mut l = locator();
    l.start_at(MapPose::new(2.0, 3.0, 0.0), 0.1, 0.05);
    let states = fly(&mut l, 0.0, 3.0, 0.0, room);
    assert_eq!(states.last(), Some(&LocalizationState::Localized));
    l
}

#[test]
fn in_a_recess_that_no_plan_shows_the_place_is_carried_on_and_confirmed_outside() {
    let mut l = localized();
    let mut states = fly(&mut l, 3.0, 4.0, 0.6, recess);
    states.extend(fly(&mut l, 7.0, 10.0, 0.0, recess));
    assert!(l.status().fit < 0.5, "{}", l.status().fit);
    states.extend(fly(&mut l, 17.0, 4.0, -0.6, recess));
    states.extend(fly(&mut l, 21.0, 2.0, 0.0, room));
    assert!(
        states.iter().all(|s| *s == LocalizationState::Localized),
        "lost after {:?}",
        states
            .iter()
            .position(|s| *s != LocalizationState::Localized)
    );
    let pose = Planar::from(l.status().pose.unwrap());
    assert!(
        pose.is_near(&Planar::new(2.0, 3.0, 0.0), 0.1, 0.05),
        "{pose:?}"
    );
    assert!(l.status().fit > 0.9);
}

#[test]
fn a_place_that_nothing_confirms_for_minutes_is_lost() {
    let mut l = localized();
    let hidden = |p, d| to_side([1.2, 2.2], [2.8, 3.8], p, d);
    let states = fly(&mut l, 3.0, 240.0, 0.0, hidden);
    assert!(
        states[..300]
            .iter()
            .all(|s| *s == LocalizationState::Localized)
    );
    assert_eq!(states.last(), Some(&LocalizationState::Lost));
}

#[test]
fn returns_from_behind_the_walls_lose_the_place_at_once() {
    let mut l = localized();
    let beyond = |p, d| room(p, d) * 0.5 + 2.2;
    let states = fly(&mut l, 3.0, 5.0, 0.0, beyond);
    assert_eq!(states.last(), Some(&LocalizationState::Lost));
}
