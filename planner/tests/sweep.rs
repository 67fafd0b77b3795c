//! Sweeps of recorded floors: the mazes and the laboratory of the localization recordings, printed beside the bound of the
//! spanning tree. (The office belongs to the simulator; its bars are in the flight tests.)

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use planner::patrol::{Method, SweepConfig, sweep};
use std::path::{Path, PathBuf};
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, In, Map};

fn data() -> PathBuf {
    std::env::var_os("KESTREL_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    )
}

fn load(path: &Path) -> Option<FloorPlan> {
    let yaml = std::fs::read_to_string(path).ok()?;
    let folder = path.parent()?;
    Some(FloorPlan::from_yaml(&yaml, |name| std::fs::read(folder.join(name))).unwrap())
}

/// The place with most room in the largest floor that hangs together: recorded plans name no home.
fn roomiest(plan: &FloorPlan) -> In<Map> {
    let field = plan.distance_field(10.0);
    let (w, h) = (plan.width() as i64, plan.height() as i64);
    let is_open =
        |c: i64, r: i64| plan.cell(c, r) == Cell::Free && field.at(plan.centre_of(c, r)) > 0.25;
    let mut seen = vec![false; (w * h) as usize];
    let mut best: Vec<(i64, i64)> = Vec::new();
    for i in 0..w * h {
        let mut floor = Vec::new();
        let mut stack = vec![(i % w, i / w)];
        while let Some((c, r)) = stack.pop() {
            if c < 0 || r < 0 || c >= w || r >= h || seen[(r * w + c) as usize] || !is_open(c, r) {
                continue;
            }
            seen[(r * w + c) as usize] = true;
            floor.push((c, r));
            stack.extend([(c + 1, r), (c - 1, r), (c, r + 1), (c, r - 1)]);
        }
        if floor.len() > best.len() {
            best = floor;
        }
    }
    let centres = best.into_iter().map(|(c, r)| plan.centre_of(c, r));
    centres
        .max_by(|a, b| field.at(*a).total_cmp(&field.at(*b)))
        .unwrap()
}

#[test]
fn recorded_floors_are_swept_beside_the_spanning_tree_bound() {
    let maps = data().join("mcl/maps");
    let mut paths: Vec<PathBuf> = ["maze1a", "maze1b", "maze2", "maze4", "intel"]
        .iter()
        .map(|name| maps.join(format!("{name}.yaml")))
        .collect();
    paths.extend(std::env::var_os("KESTREL_SWEEP_MAP").map(PathBuf::from));
    println!(
        "FIGURES coverage, swath 0.6 m, radius 0.16 m, walls block the swath; bound = area by swath, the spanning tree's over whole cells"
    );
    println!(
        " map       method          area m2  bound m   path m  path/bound  covered %  corners"
    );
    for path in paths {
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let Some(plan) = load(&path) else {
            println!(" {name}: SKIPPED: no {}", path.display());
            continue;
        };
        let start = plan
            .home
            .map_or_else(|| roomiest(&plan), |h| In::new(h.x_m, h.y_m, 0.0));
        for method in [Method::Boustrophedon, Method::SpanningTree] {
            let s = sweep(&plan, start, &SweepConfig::default(), method).unwrap();
            println!(
                " {name:8}  {:14}  {:7.1}  {:7.1}  {:7.1}  {:10.2}  {:9.2}  {:7}",
                format!("{method:?}"),
                s.area_m2,
                s.bound_m,
                s.length_m,
                s.length_m / s.bound_m,
                100.0 * s.covered,
                s.path.len(),
            );
            assert!(s.covered >= 0.97, "{name} {method:?}: {}", s.covered);
        }
    }
    println!("END");
}
