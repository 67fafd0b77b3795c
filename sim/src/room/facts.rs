//! Places and doors of a room as data for scripts (`rooms.json`).

use super::Room;
use serde::{Deserialize, Serialize};
use vehicle::{In, MapAnchor};

/// A door of a room, plan metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Door {
    /// Its name, `one room-other room`.
    pub name: String,
    /// Centre, right on the plan, m.
    pub x_m: f64,
    /// Centre, up on the plan, m.
    pub y_m: f64,
    /// Free width, m.
    pub width_m: f64,
}

/// What `rooms.json` holds: home, places and doors in plan and world coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RoomFacts {
    /// Name of the room.
    pub name: String,
    /// Take-off place.
    pub home: Place,
    /// Heading at home, clockwise from north, degrees.
    pub home_heading_deg: f64,
    /// Plan direction of north, counter-clockwise from plan x, degrees.
    pub north_deg: f64,
    /// Named places, each with at least 0.5 m of free floor around it.
    pub rooms: Vec<Place>,
    /// Doors.
    pub doors: Vec<DoorFacts>,
}

/// A named point in both coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// Its name.
    pub name: String,
    /// x right, y up on the plan, m.
    pub map_m: [f64; 2],
    /// North, east of home, m.
    pub ned_m: [f64; 2],
}

/// A door in both coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DoorFacts {
    /// Its name, `one room-other room`.
    pub name: String,
    /// Centre, x right, y up on the plan, m.
    pub map_m: [f64; 2],
    /// Centre, north, east of home, m.
    pub ned_m: [f64; 2],
    /// Free width, m.
    pub width_m: f64,
}

impl RoomFacts {
    pub(super) fn new(room: &Room) -> Self {
        let anchor = room.anchor();
        let home = room.home();
        Self {
            name: room.name.clone(),
            home: Place {
                name: "home".to_owned(),
                map_m: [home.x_m, home.y_m],
                ned_m: ned(&anchor, home.x_m, home.y_m),
            },
            home_heading_deg: anchor.yaw_to_ned(home.yaw_rad).to_degrees(),
            north_deg: anchor.north_rad().to_degrees(),
            rooms: room
                .plan
                .rooms
                .iter()
                .map(|place| Place {
                    name: place.name.clone(),
                    map_m: [place.x, place.y],
                    ned_m: ned(&anchor, place.x, place.y),
                })
                .collect(),
            doors: room
                .doors
                .iter()
                .map(|door| DoorFacts {
                    name: door.name.clone(),
                    map_m: [door.x_m, door.y_m],
                    ned_m: ned(&anchor, door.x_m, door.y_m),
                    width_m: door.width_m,
                })
                .collect(),
        }
    }
}

fn ned(anchor: &MapAnchor, x_m: f64, y_m: f64) -> [f64; 2] {
    let p = anchor.to_ned(In::new(x_m, y_m, 0.0));
    [p.x(), p.y()]
}
