use super::*;
use proptest::prelude::*;

/// A plan from letters of 0.3 m: `#` wall, `?` unknown.
fn plan(picture: &str) -> Arc<FloorPlan> {
    let rows: Vec<&str> = picture
        .lines()
        .map(str::trim)
        .filter(|l| !l.is_empty())
        .collect();
    let mut cells = Vec::new();
    for row in rows.iter().rev() {
        for _ in 0..6 {
            for letter in row.bytes() {
                let cell = match letter {
                    b'#' => Cell::Occupied,
                    b'?' => Cell::Unknown,
                    _ => Cell::Free,
                };
                cells.extend([cell; 6]);
            }
        }
    }
    Arc::new(FloorPlan::from_cells(rows[0].len() * 6, 0.05, [0.0, 0.0], cells).unwrap())
}

/// Two rooms with a door of 0.9 m, a closet without one, unknown ground outside.
const ROOMS: &str = "
    ????????????????????????
    ?#####################??
    ?#........#......#...#??
    ?#........#......#...#??
    ?#........#......#####??
    ?#...................#??
    ?#...................#??
    ?#...................#??
    ?#........#..........#??
    ?#........#..........#??
    ?#####################??";

fn place(column: f64, row_from_below: f64) -> In<Map> {
    In::new((column + 0.5) * 0.3, (row_from_below + 0.5) * 0.3, 0.0)
}

fn router() -> Router {
    Router::new(plan(ROOMS), 0.16, &PlannerParams::default())
}

fn length(path: &Path) -> f64 {
    path.windows(2).map(|w| (w[1] - w[0]).norm_xy()).sum()
}

#[test]
fn a_door_of_90_centimetres_is_passed_in_the_middle() {
    let path = router()
        .find(place(3.0, 7.0), place(15.0, 7.0), &[])
        .unwrap();
    // The door is the column of x = 3.0 .. 3.3, open from y = 0.9 to 1.8.
    let at_door = path.windows(2).find_map(|w| {
        let (a, b) = (w[0], w[1]);
        let spans = a.x() <= 3.15 && b.x() >= 3.15 && b.x() > a.x();
        spans.then(|| a.y() + (b.y() - a.y()) * (3.15 - a.x()) / (b.x() - a.x()))
    });
    let y = at_door.unwrap();
    assert!((y - 1.35).abs() < 0.12, "passes at {y}: {path:?}");
    assert!(path.len() < 12, "{} corners", path.len());
}

#[test]
fn each_impossible_place_has_its_reason() {
    let mut r = router();
    let from = place(3.0, 7.0);
    let mut ask = |to: In<Map>| r.find(from, to, &[]);
    assert_eq!(
        ask(place(19.0, 8.0)),
        Err(RouteError::NoWay),
        "the closet has no door"
    );
    assert_eq!(ask(place(23.0, 5.0)), Err(RouteError::OutsidePlan));
    assert_eq!(ask(place(-9.0, 5.0)), Err(RouteError::OutsidePlan));
    assert_eq!(ask(In::new(f64::NAN, 0.0, 0.0)), Err(RouteError::NotFinite));
    assert!(matches!(
        ask(place(1.0, 5.0)),
        Err(RouteError::InWall { .. })
    ));
    let beside = In::new(0.6 + 0.1, 1.5, 0.0);
    assert!(
        matches!(ask(beside), Err(RouteError::InWall { clearance_m, .. }) if clearance_m > 0.05)
    );
}

#[test]
fn a_start_inside_the_margin_is_led_out() {
    let start = In::new(0.6 + 0.08, 1.5, 0.0);
    let path = router().find(start, place(5.0, 4.0), &[]).unwrap();
    assert_eq!(path[0], start);
    let clear = router().clearance_m(path[1]).unwrap();
    assert!(clear >= 0.28 - 1e-6, "{clear}");
}

#[test]
fn an_obstacle_in_the_door_leaves_no_way() {
    let mut r = router();
    let (from, to) = (place(3.0, 7.0), place(15.0, 7.0));
    let plug = [In::new(3.15, 1.2, 0.0), In::new(3.15, 1.5, 0.0)];
    assert_eq!(r.find(from, to, &plug), Err(RouteError::NoWay));
    assert!(
        r.find(from, to, &[]).is_ok(),
        "it is forgotten after the search"
    );
}

#[test]
fn a_line_that_keeps_the_margin_is_flown_as_it_is_drawn() {
    // Along a wall, half a metre off: the middle of the room would be nicer, but was not asked for.
    let (a, b) = (place(3.0, 2.0), place(8.0, 2.0));
    let mut r = router();
    let path = r.find(a, b, &[]).unwrap();
    assert_eq!(path.as_slice(), [a, b]);
    let seen = (a + b) * 0.5;
    let around = r.find(a, b, &[seen]).unwrap();
    assert!(around.len() > 2, "something stands there: {around:?}");
}

#[test]
fn in_an_open_room_the_way_is_nearly_straight() {
    let (a, b) = (place(4.0, 3.0), place(7.0, 6.0));
    let path = router().find(a, b, &[]).unwrap();
    assert!(length(&path) < 1.02 * (b - a).norm_xy(), "{path:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn a_way_never_comes_nearer_to_a_wall_than_radius_and_margin(
        a in (2u32..20, 1u32..9), b in (2u32..20, 1u32..9),
    ) {
        let plan = plan(ROOMS);
        let mut r = Router::new(Arc::clone(&plan), 0.16, &PlannerParams::default());
        let (from, to) = (place(f64::from(a.0), f64::from(a.1)), place(f64::from(b.0), f64::from(b.1)));
        prop_assume!(r.clearance_m(from).is_some_and(|d| d > 0.28) && r.clearance_m(to).is_some_and(|d| d > 0.28));
        if let Ok(path) = r.find(from, to, &[]) {
            prop_assert_eq!((path[0], path[path.len() - 1]), (from, to));
            // Measured against the outline of the walls, not the raster the search used.
            let walls = plan.wall_segments();
            for w in path.windows(2) {
                for k in 0..=20 {
                    let p = w[0] + (w[1] - w[0]) * (f64::from(k) / 20.0);
                    let nearest = walls.iter().map(|s| {
                        let (a, b) = (In::new(s.a[0], s.a[1], 0.0), In::<Map>::new(s.b[0], s.b[1], 0.0));
                        let t = ((p - a).dot(&(b - a)) / (b - a).dot(&(b - a))).clamp(0.0, 1.0);
                        (p - (a + (b - a) * t)).norm_xy()
                    }).fold(f64::INFINITY, f64::min);
                    // Cells are crossed up to their corners.
                    prop_assert!(nearest > 0.28 - 0.05, "{nearest} at {p:?}");
                }
            }
        }
    }
}
