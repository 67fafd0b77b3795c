//! Reading and writing ROS map_server files. No file is opened here: the caller brings the bytes.

use super::{Cell, Doorway, FloorPlan, MAX_PIXELS, PlanError, Room};
use crate::MapPose;
use image::{ImageReader, Limits};
use std::fmt::Write as _;
use std::io::Cursor;
use yaml_rust2::{Yaml, YamlLoader};

impl FloorPlan {
    /// A plan from its YAML and the bytes of the image it names, fetched by `image_bytes(name)`.
    ///
    /// # Errors
    /// [`PlanError`] names the key or the reason; an error of `image_bytes` becomes [`PlanError::Image`].
    pub fn from_yaml<E: std::fmt::Display>(
        yaml: &str,
        image_bytes: impl FnOnce(&str) -> Result<Vec<u8>, E>,
    ) -> Result<Self, PlanError> {
        let docs = YamlLoader::load_from_str(yaml).map_err(|e| PlanError::Yaml(e.to_string()))?;
        let doc = docs.first().ok_or(PlanError::Key {
            key: "image",
            what: "is missing".to_owned(),
        })?;
        let image_name = doc["image"].as_str().ok_or(PlanError::Key {
            key: "image",
            what: "is missing".to_owned(),
        })?;
        let resolution_m = number(&doc["resolution"]).ok_or(PlanError::Key {
            key: "resolution",
            what: "is missing (m per pixel)".to_owned(),
        })?;
        let origin = numbers(&doc["origin"])
            .filter(|o| o.len() >= 2)
            .ok_or(PlanError::Key {
                key: "origin",
                what: "must be [x, y, yaw]".to_owned(),
            })?;
        if origin.get(2).is_some_and(|yaw| yaw.abs() > 1e-9) {
            return Err(PlanError::Key {
                key: "origin",
                what: "with a yaw is not supported: rotate the image".to_owned(),
            });
        }
        let negate = number(&doc["negate"]).unwrap_or(0.0) != 0.0;
        let occupied = number(&doc["occupied_thresh"]).unwrap_or(0.65);
        let free = number(&doc["free_thresh"]).unwrap_or(0.196);
        if free >= occupied {
            return Err(PlanError::Key {
                key: "free_thresh",
                what: format!("{free} must be below occupied_thresh {occupied}"),
            });
        }

        let bytes =
            image_bytes(image_name).map_err(|e| PlanError::Image(format!("{image_name}: {e}")))?;
        let (width, pixels) = gray_pixels(&bytes)?;
        let cell = |gray: u8| {
            let g = f64::from(gray) / 255.0;
            let occupancy = if negate { g } else { 1.0 - g };
            if occupancy > occupied {
                Cell::Occupied
            } else if occupancy < free {
                Cell::Free
            } else {
                Cell::Unknown
            }
        };
        // Image rows run down, plan rows up.
        let cells: Vec<Cell> = pixels
            .chunks_exact(width)
            .rev()
            .flatten()
            .map(|gray| cell(*gray))
            .collect();
        if !cells.contains(&Cell::Free) {
            return Err(PlanError::NoFreeCell);
        }
        let mut plan = Self::from_cells(width, resolution_m, [origin[0], origin[1]], cells)?;
        plan.read_extras(&doc["kestrel"])?;
        Ok(plan)
    }

    fn read_extras(&mut self, extras: &Yaml) -> Result<(), PlanError> {
        if !extras["home"].is_badvalue() {
            let home = numbers(&extras["home"])
                .filter(|h| h.len() == 3)
                .ok_or(PlanError::Key {
                    key: "kestrel.home",
                    what: "must be [x, y, yaw]".to_owned(),
                })?;
            self.home = Some(MapPose::new(home[0], home[1], home[2]));
        }
        if let Some(deg) = number(&extras["north_deg"]) {
            self.north_rad = deg.to_radians();
        }
        for room in extras["rooms"].as_vec().into_iter().flatten() {
            let (Some(name), Some(x), Some(y)) = (
                room["name"].as_str(),
                number(&room["x"]),
                number(&room["y"]),
            ) else {
                return Err(PlanError::Key {
                    key: "kestrel.rooms",
                    what: "each needs name, x, y".to_owned(),
                });
            };
            self.rooms.push(Room {
                name: name.to_owned(),
                x,
                y,
            });
        }
        for door in extras["doors"].as_vec().into_iter().flatten() {
            let (Some(name), Some(a), Some(b)) =
                (door["name"].as_str(), point(&door["a"]), point(&door["b"]))
            else {
                return Err(PlanError::Key {
                    key: "kestrel.doors",
                    what: "each needs name, a: [x, y], b: [x, y]".to_owned(),
                });
            };
            self.doors.push(Doorway {
                name: name.to_owned(),
                a,
                b,
            });
        }
        for zone in extras["no_fly"].as_vec().into_iter().flatten() {
            let corners: Option<Vec<_>> = zone
                .as_vec()
                .filter(|z| z.len() >= 3)
                .and_then(|z| z.iter().map(point).collect());
            self.no_fly.push(corners.ok_or(PlanError::Key {
                key: "kestrel.no_fly",
                what: "each zone needs at least three corners [x, y]".to_owned(),
            })?);
        }
        Ok(())
    }

    /// The YAML beside an image of the given name.
    #[must_use]
    pub fn to_yaml(&self, image_name: &str) -> String {
        let [x, y] = self.origin();
        let mut out = format!(
            "image: {image_name}\nmode: trinary\nresolution: {:?}\norigin: [{x:?}, {y:?}, 0.0]\nnegate: 0\n\
             occupied_thresh: 0.65\nfree_thresh: 0.196\nkestrel:\n  north_deg: {:?}\n",
            self.resolution_m(),
            self.north_rad.to_degrees(),
        );
        // Writing to a String cannot fail.
        if let Some(h) = self.home {
            let _ = writeln!(out, "  home: [{:?}, {:?}, {:?}]", h.x_m, h.y_m, h.yaw_rad);
        }
        if !self.rooms.is_empty() {
            out.push_str("  rooms:\n");
            for r in &self.rooms {
                let _ = writeln!(
                    out,
                    "    - {{name: {:?}, x: {:?}, y: {:?}}}",
                    r.name, r.x, r.y
                );
            }
        }
        if !self.doors.is_empty() {
            out.push_str("  doors:\n");
            for d in &self.doors {
                let _ = writeln!(
                    out,
                    "    - {{name: {:?}, a: {:?}, b: {:?}}}",
                    d.name, d.a, d.b
                );
            }
        }
        if !self.no_fly.is_empty() {
            out.push_str("  no_fly:\n");
            for zone in &self.no_fly {
                let _ = writeln!(out, "    - {zone:?}");
            }
        }
        out
    }

    /// The image as binary PGM: occupied 0, free 254, unknown 205, as map_server writes it.
    #[must_use]
    pub fn to_pgm(&self) -> Vec<u8> {
        let mut out = format!("P5\n{} {}\n255\n", self.width(), self.height()).into_bytes();
        for row in self.cells().chunks_exact(self.width()).rev() {
            out.extend(row.iter().map(|c| match c {
                Cell::Occupied => 0u8,
                Cell::Free => 254,
                Cell::Unknown => 205,
            }));
        }
        out
    }
}

/// Width and 8-bit grey values, rows from the top; at least one pixel.
pub(super) fn gray_pixels(bytes: &[u8]) -> Result<(usize, Vec<u8>), PlanError> {
    let broken = |e: &dyn std::fmt::Display| PlanError::Image(e.to_string());
    let reader = || {
        let mut reader = ImageReader::new(Cursor::new(bytes))
            .with_guessed_format()
            .map_err(|e| broken(&e))?;
        let mut limits = Limits::default();
        limits.max_alloc = Some(8 * MAX_PIXELS);
        reader.limits(limits);
        Ok::<_, PlanError>(reader)
    };
    let (w, h) = reader()?.into_dimensions().map_err(|e| broken(&e))?;
    let pixels = u64::from(w) * u64::from(h);
    if pixels == 0 {
        return Err(PlanError::NoFreeCell);
    }
    if pixels > MAX_PIXELS {
        return Err(PlanError::TooLarge { pixels });
    }
    let gray = reader()?.decode().map_err(|e| broken(&e))?.into_luma8();
    Ok((w as usize, gray.into_raw()))
}

fn number(y: &Yaml) -> Option<f64> {
    match y {
        Yaml::Integer(i) => Some(*i as f64),
        Yaml::Real(_) => y.as_f64(),
        _ => None,
    }
    .filter(|v| v.is_finite())
}

fn point(y: &Yaml) -> Option<[f64; 2]> {
    numbers(y)?.try_into().ok()
}

fn numbers(y: &Yaml) -> Option<Vec<f64>> {
    y.as_vec()?.iter().map(number).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::In;
    use proptest::prelude::*;

    const YAML: &str = "image: a.pgm\nresolution: 0.5\norigin: [-1.0, 2, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";

    fn pgm(w: usize, pixels: &[u8]) -> Vec<u8> {
        let mut v = format!("P5\n{w} {}\n255\n", pixels.len() / w).into_bytes();
        v.extend(pixels);
        v
    }

    #[test]
    fn image_row_zero_is_the_top_of_the_plan() {
        let image = pgm(2, &[0, 254, 254, 205]);
        let plan = FloorPlan::from_yaml(YAML, |_| Ok::<_, String>(image)).unwrap();
        assert_eq!(plan.at(In::new(-0.9, 2.9, 0.0)), Cell::Occupied);
        assert_eq!(plan.at(In::new(-0.4, 2.9, 0.0)), Cell::Free);
        assert_eq!(plan.at(In::new(-0.4, 2.1, 0.0)), Cell::Unknown);
    }

    #[test]
    fn a_plan_survives_writing_and_reading() {
        let cells = vec![
            Cell::Free,
            Cell::Occupied,
            Cell::Unknown,
            Cell::Free,
            Cell::Free,
            Cell::Occupied,
        ];
        let mut plan = FloorPlan::from_cells(3, 0.05, [-1.5, 0.25], cells).unwrap();
        plan.home = Some(MapPose::new(1.0, 2.0, -0.5));
        plan.north_rad = 0.25_f64.to_degrees().to_radians();
        plan.rooms.push(Room {
            name: "lab".to_owned(),
            x: 0.5,
            y: 0.75,
        });
        plan.doors.push(Doorway {
            name: "lab \"east\"".to_owned(),
            a: [0.5, 1.0],
            b: [1.25, -1e-7],
        });
        plan.no_fly.push(vec![[0.0, 0.0], [1.0, 0.5], [0.0, 2.0]]);
        let pgm = plan.to_pgm();
        let read = FloorPlan::from_yaml(&plan.to_yaml("x.pgm"), |_| Ok::<_, String>(pgm)).unwrap();
        assert!((read.north_rad - plan.north_rad).abs() < 1e-12);
        assert_eq!(
            (read.cells(), &read.rooms, read.home),
            (plan.cells(), &plan.rooms, plan.home)
        );
        assert_eq!((&read.doors, &read.no_fly), (&plan.doors, &plan.no_fly));
    }

    #[test]
    fn each_fault_is_named() {
        let load = |yaml: &str, image: Vec<u8>| {
            FloorPlan::from_yaml(yaml, |_| Ok::<_, String>(image))
                .unwrap_err()
                .to_string()
        };
        let good = || pgm(1, &[254]);
        assert!(load("resolution: 1", good()).contains("`image` is missing"));
        assert!(load("image: a\norigin: [0,0,0]", good()).contains("`resolution` is missing"));
        assert!(
            load("image: a\nresolution: -1\norigin: [0,0,0]", good())
                .contains("is outside 0.005..=1")
        );
        let no_width = load(YAML, b"P5\n0 0\n255\n".to_vec());
        assert_eq!(no_width, PlanError::NoFreeCell.to_string());
        let kestrel = |extras: &str| load(&format!("{YAML}kestrel: {extras}"), good());
        assert!(kestrel("{doors: [{name: a, a: [1, 2]}]}").contains("kestrel.doors"));
        assert!(kestrel("{no_fly: [[[1, 2], [2, 3]]]}").contains("three corners"));
        assert!(load(YAML, b"not an image".to_vec()).contains("PGM or PNG"));
        assert!(load(YAML, pgm(1, &[0])).contains("no free cell"));
        assert!(load(YAML, b"P5\n100000 100000\n255\n".to_vec()).contains("at most"));
        let missing =
            FloorPlan::from_yaml(YAML, |name| Err(format!("no file {name}"))).unwrap_err();
        assert!(missing.to_string().contains("no file a.pgm"));
    }

    proptest! {
        #[test]
        fn no_text_and_no_bytes_make_it_panic(text in "\\PC*", bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = FloorPlan::from_yaml(&text, |_| Ok::<_, String>(bytes.clone()));
            let _ = FloorPlan::from_yaml(YAML, |_| Ok::<_, String>(bytes));
        }
    }
}
