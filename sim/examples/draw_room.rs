//! Draws the bundled rooms as text, one character per 0.2 m: `cargo run -p sim --example draw_room`.
#![allow(clippy::print_stdout, reason = "drawing is what it is for")]

use sim::Room;
use vehicle::{In, Map};

fn main() -> Result<(), sim::RoomError> {
    for name in Room::BUNDLED {
        let room = Room::named(name)?;
        let plan = room.floor_plan();
        let facts = room.facts();
        println!("{name}:");
        let step = 4;
        for row in (0..plan.height() as i64 / step).rev() {
            let line: String = (0..plan.width() as i64 / step)
                .map(|column| {
                    let occupied = (0..step * step).any(|k| {
                        let (c, r) = (column * step + k % step, row * step + k / step);
                        !plan.is_free(plan.centre_of(c, r))
                    });
                    let here = plan.centre_of(column * step + 2, row * step + 2);
                    let near =
                        |p: &[f64; 2]| (In::<Map>::new(p[0], p[1], 0.0) - here).norm() < 0.15;
                    if near(&facts.home.map_m) {
                        'H'
                    } else if facts.rooms.iter().any(|r| near(&r.map_m)) {
                        'o'
                    } else if facts.doors.iter().any(|d| near(&d.map_m)) {
                        '+'
                    } else if occupied {
                        '#'
                    } else {
                        ' '
                    }
                })
                .collect();
            println!("{line}");
        }
    }
    Ok(())
}
