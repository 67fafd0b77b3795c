//! Rooms to fly in: walls as segments (the truth that sensors and collisions use) and the floor plan derived from them
//! (what the bridge may know).
//!
//! | Name | What it is |
//! | --- | --- |
//! | `office` | 12 x 9 m: lab, workshop, corridor, offices, meeting room, kitchen, store; furnished, no two rooms alike |
//! | `corridor` | a long corridor with a bend and two niches: little to see along it |
//! | `maze` | 6 x 6 m of panels, as in the recorded nano quadcopter flights |
//! | `maze:SEED` | 7 x 7 m of panels, another one for each number |
//!
//! A room of your own is a floor plan: [`Room::from_plan`].

mod corridor;
mod draw;
mod facts;
mod maze;
mod office;
mod random_maze;

pub use facts::{Door, DoorFacts, Place, RoomFacts};

use crate::camera::Scenery;
use crate::walls::Walls;
use std::sync::Arc;
use thiserror::Error;
use vehicle::{FloorPlan, MapAnchor, MapPose, Segment};

/// Walls, furniture, doors and home of a simulated place.
#[derive(Clone, Debug)]
pub struct Room {
    name: String,
    /// What is bumped into and what sound comes back from.
    walls: Walls,
    /// The same without glass, if there is any: what light comes back from.
    opaque: Option<Walls>,
    doors: Vec<Door>,
    plan: Arc<FloorPlan>,
    /// Segments before this one are walls, those before the next furniture, the rest was put there later: for the eye.
    walls_end: usize,
    furniture_end: usize,
}

/// Why there is no such room.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RoomError {
    /// No bundled room of this name.
    #[error("no room named `{0}`; bundled are {list} (or give a floor plan of your own)", list = Room::BUNDLED.join(", "))]
    Unknown(String),
}

impl Room {
    /// Names of the bundled rooms; the first is the default.
    pub const BUNDLED: [&'static str; 3] = ["office", "corridor", "maze"];

    /// A bundled room.
    ///
    /// # Errors
    /// [`RoomError::Unknown`] lists the names.
    pub fn named(name: &str) -> Result<Self, RoomError> {
        match name {
            "office" => Ok(office::draw().finish("office")),
            "corridor" => Ok(corridor::draw().finish("corridor")),
            "maze" => Ok(maze::draw().finish("maze")),
            other if random_seed(other).is_some() => {
                Ok(random_maze::draw(random_seed(other).unwrap_or(0)).finish(other))
            }
            other => Err(RoomError::Unknown(other.to_owned())),
        }
    }

    /// A room whose walls are the outlines of the occupied cells of a floor plan. Doors are not known;
    /// unknown cells are open, so a plan without an outer wall can be left.
    #[must_use]
    pub fn from_plan(name: &str, plan: FloorPlan) -> Self {
        let segments = plan.wall_segments();
        Self {
            name: name.to_owned(),
            walls_end: segments.len(),
            furniture_end: segments.len(),
            walls: Walls::new(segments),
            opaque: None,
            doors: Vec::new(),
            plan: Arc::new(plan),
        }
    }

    /// The room with zones on its plan that are not to be flown over, corners in plan metres.
    #[must_use]
    pub fn with_no_fly(mut self, zones: &[Vec<[f64; 2]>]) -> Self {
        Arc::make_mut(&mut self.plan)
            .no_fly
            .extend_from_slice(zones);
        self
    }

    /// The room with boxes in it that the plan does not show: centre x, y and side, plan metres.
    #[must_use]
    pub fn with_boxes(self, boxes: &[[f64; 3]]) -> Self {
        let mut sides = Vec::with_capacity(4 * boxes.len());
        for [x, y, side] in boxes {
            let h = 0.5 * side;
            let corners = [[-h, -h], [h, -h], [h, h], [-h, h]].map(|[dx, dy]| [x + dx, y + dy]);
            sides.extend((0..4).map(|k| Segment {
                a: corners[k],
                b: corners[(k + 1) % 4],
            }));
        }
        self.with_unmapped(&sides)
    }

    /// The same room with things in it that its floor plan does not show.
    #[must_use]
    pub fn with_unmapped(mut self, obstacles: &[Segment]) -> Self {
        self.walls = self.walls.with(obstacles);
        self.opaque = self.opaque.map(|walls| walls.with(obstacles));
        self
    }

    /// The same room with panes of glass in it, which its floor plan does not show: light passes, sound and vehicles do not.
    #[must_use]
    pub fn with_glass(mut self, panes: &[Segment]) -> Self {
        let walls = self.walls.with(panes);
        let clear = core::mem::replace(&mut self.walls, walls);
        self.opaque.get_or_insert(clear);
        self
    }

    /// The same room as another floor plan shows it: what the bridge may know of it.
    #[must_use]
    pub fn shown_as(mut self, plan: FloorPlan) -> Self {
        self.plan = Arc::new(plan);
        self
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The floor plan the bridge may know: derived from the walls, 0.05 m cells, with home, north and room names.
    #[must_use]
    pub fn floor_plan(&self) -> &Arc<FloorPlan> {
        &self.plan
    }

    /// How the plan lies in the world.
    #[must_use]
    pub fn anchor(&self) -> MapAnchor {
        self.plan.anchor()
    }

    /// Take-off place and heading on the plan (the plan's origin if it names no home).
    #[must_use]
    pub fn home(&self) -> MapPose {
        self.plan.home.unwrap_or_default()
    }

    /// Walls and furniture, plan metres.
    #[must_use]
    pub fn segments(&self) -> &[Segment] {
        self.walls.segments()
    }

    /// Doors, in plan metres.
    #[must_use]
    pub fn doors(&self) -> &[Door] {
        &self.doors
    }

    /// Places and doors in plan and world coordinates: what `rooms.json` holds.
    #[must_use]
    pub fn facts(&self) -> RoomFacts {
        RoomFacts::new(self)
    }

    /// The room as a camera sees it, with walls of it as they stand now.
    pub(crate) fn scenery(&self, walls: &Walls) -> Scenery {
        Scenery::new(self, walls, self.walls_end, self.furniture_end)
    }

    pub(crate) const fn walls(&self) -> &Walls {
        &self.walls
    }

    pub(crate) const fn opaque(&self) -> Option<&Walls> {
        self.opaque.as_ref()
    }
}

/// The number of `maze:7`.
fn random_seed(name: &str) -> Option<u64> {
    name.strip_prefix("maze:")?.parse().ok()
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;
    use vehicle::{In, Map};

    fn bundled() -> impl Iterator<Item = Room> {
        let mazes = (1..=5).map(|seed| format!("maze:{seed}"));
        let names = Room::BUNDLED.iter().map(|n| (*n).to_owned()).chain(mazes);
        names.map(|name| Room::named(&name).unwrap())
    }

    #[test]
    fn an_unknown_name_is_answered_with_the_list() {
        let message = Room::named("castle").unwrap_err().to_string();
        assert!(message.contains("office, corridor, maze"), "{message}");
    }

    #[test]
    fn raster_and_segments_agree_within_a_cell() {
        for room in bundled() {
            let plan = room.floor_plan();
            let r = plan.resolution_m();
            let field = plan.distance_field(1.0);
            // Every point of every wall has an occupied cell next to it ...
            for s in room.segments() {
                for k in 0..=20 {
                    let u = f64::from(k) / 20.0;
                    let p = In::<Map>::new(
                        s.a[0] + u * (s.b[0] - s.a[0]),
                        s.a[1] + u * (s.b[1] - s.a[1]),
                        0.0,
                    );
                    let d = field.at(p);
                    assert!(
                        d <= 1.5 * r,
                        "{}: {p:?} is {d} from the raster",
                        room.name()
                    );
                }
            }
            // ... and every free cell on the border of an occupied one has a wall next to it.
            for row in 0..plan.height() as i64 {
                for column in 0..plan.width() as i64 {
                    let centre = plan.centre_of(column, row);
                    let d = field.at(centre);
                    if plan.is_free(centre) && d <= 1.01 * r {
                        let wall = room.walls().nearest([centre.x(), centre.y()], 1.5 * r);
                        assert!(wall.is_some(), "{}: no wall at {centre:?}", room.name());
                    }
                }
            }
        }
    }

    #[test]
    fn every_place_and_door_can_be_reached_from_home_with_the_planner_s_clearance() {
        for room in bundled() {
            let plan = room.floor_plan();
            let field = plan.distance_field(1.0);
            // Vehicle radius 0.16 m and 0.15 m of margin.
            let reached = flood(plan, |p| field.at(p) > 0.31);
            let facts = room.facts();
            let targets = facts
                .rooms
                .iter()
                .map(|place| (&place.name, place.map_m))
                .chain(facts.doors.iter().map(|door| (&door.name, door.map_m)));
            for (name, [x, y]) in targets {
                let (column, row) = plan.index_of(In::new(x, y, 0.0));
                let i = row as usize * plan.width() + column as usize;
                assert!(reached[i], "{}: {name} cannot be reached", room.name());
            }
        }
    }

    #[test]
    fn places_have_room_to_hover_and_the_office_home_two_metres() {
        for room in bundled() {
            let field = room.floor_plan().distance_field(3.0);
            for place in &room.facts().rooms {
                let d = field.at(In::new(place.map_m[0], place.map_m[1], 0.0));
                assert!(d >= 0.5, "{}: {} has {d} m", room.name(), place.name);
            }
        }
        let office = Room::named("office").unwrap();
        let home = office.home();
        let (d, _) = office.walls().nearest([home.x_m, home.y_m], 5.0).unwrap();
        assert!(d >= 2.0, "{d}");
        assert!(office.facts().rooms.len() >= 5);
    }

    #[test]
    fn home_is_the_zero_of_the_world_and_north_is_up_on_paper() {
        for room in bundled() {
            let facts = room.facts();
            assert_eq!(facts.home.ned_m, [0.0, 0.0]);
            assert!((facts.north_deg - 90.0).abs() < 1e-9);
            for place in &facts.rooms {
                let north_m = place.map_m[1] - facts.home.map_m[1];
                assert!((place.ned_m[0] - north_m).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn no_half_turn_or_quarter_turn_of_the_office_looks_like_the_office() {
        let office = Room::named("office").unwrap();
        let plan = office.floor_plan();
        let field = plan.distance_field(1.0);
        let (cx, cy) = (
            plan.origin()[0] + 0.5 * plan.width() as f64 * plan.resolution_m(),
            plan.origin()[1] + 0.5 * plan.height() as f64 * plan.resolution_m(),
        );
        for quarter in 1..4 {
            let (s, c) = libm::sincos(f64::from(quarter) * core::f64::consts::FRAC_PI_2);
            let misfit = office
                .segments()
                .iter()
                .flat_map(|seg| [seg.a, seg.b])
                .filter(|p| {
                    let (x, y) = (p[0] - cx, p[1] - cy);
                    let turned = In::<Map>::new(cx + c * x - s * y, cy + s * x + c * y, 0.0);
                    field.at(turned) > 0.15
                })
                .count();
            let share = misfit as f64 / (2 * office.segments().len()) as f64;
            assert!(share > 0.3, "turned {quarter} x 90 degrees: {share}");
        }
    }

    #[test]
    fn boxes_that_the_plan_does_not_show_stand_in_the_room() {
        let maze = Room::named("maze:3").unwrap();
        let same = Room::named("maze:3").unwrap();
        assert_eq!(maze.floor_plan(), same.floor_plan());
        assert_ne!(
            maze.floor_plan().cells(),
            Room::named("maze:4").unwrap().floor_plan().cells()
        );
        let home = maze.home();
        let with_box = same.with_boxes(&[[home.x_m + 0.5, home.y_m, 0.2]]);
        let (d, _) = with_box.walls().nearest([home.x_m, home.y_m], 5.0).unwrap();
        assert!((d - 0.4).abs() < 1e-9, "{d}");
        assert_eq!(with_box.floor_plan(), maze.floor_plan());
    }

    #[test]
    fn a_plan_of_your_own_becomes_walls() {
        let office = Room::named("office").unwrap();
        let copy = Room::from_plan("copy", (**office.floor_plan()).clone());
        let home = copy.home();
        let a = office.walls().nearest([home.x_m, home.y_m], 5.0).unwrap().0;
        let b = copy.walls().nearest([home.x_m, home.y_m], 5.0).unwrap().0;
        assert!((a - b).abs() < 0.06, "{a} {b}");
    }

    #[test]
    fn glass_stops_vehicles_and_sound_but_no_light_and_is_on_no_plan() {
        let office = Room::named("office").unwrap();
        let home = office.home();
        let pane = Segment {
            a: [home.x_m + 0.5, home.y_m - 0.5],
            b: [home.x_m + 0.5, home.y_m + 0.5],
        };
        let room = office.with_glass(&[pane]);
        let ahead = |walls: &Walls| {
            let hit = walls.cast([home.x_m, home.y_m], [1.0, 0.0], 10.0);
            hit.map_or(f64::INFINITY, |h| h.distance_m)
        };
        assert!((ahead(room.walls()) - 0.5).abs() < 1e-9);
        assert!(ahead(room.opaque().unwrap()) > 1.0);
        assert!(
            room.floor_plan()
                .is_free(In::new(home.x_m + 0.5, home.y_m, 0.0))
        );
    }

    fn flood(plan: &FloorPlan, passable: impl Fn(In<Map>) -> bool) -> Vec<bool> {
        let home = plan.home.unwrap();
        let mut reached = vec![false; plan.width() * plan.height()];
        let mut stack = vec![plan.index_of(In::new(home.x_m, home.y_m, 0.0))];
        while let Some((column, row)) = stack.pop() {
            let p = plan.centre_of(column, row);
            if !plan.is_free(p) || !passable(p) {
                continue;
            }
            let seen = &mut reached[row as usize * plan.width() + column as usize];
            if !*seen {
                *seen = true;
                stack.extend([
                    (column + 1, row),
                    (column - 1, row),
                    (column, row + 1),
                    (column, row - 1),
                ]);
            }
        }
        reached
    }
}
