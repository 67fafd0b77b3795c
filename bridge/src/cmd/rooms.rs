//! `kestrel rooms`: the bundled rooms, and one of them as files for other tools.

use super::Usage;
use anyhow::{Context as _, Result};
use clap::Args;
use sim::Room;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vehicle::FloorPlan;

/// List the bundled rooms, or write one as a floor plan.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel rooms\n  kestrel rooms office --export plans/    writes plan.yaml, plan.pgm, rooms.json"
)]
pub(crate) struct RoomsArgs {
    /// A bundled room.
    name: Option<String>,
    /// Folder to write plan.yaml, plan.pgm and rooms.json into.
    #[arg(long, value_name = "DIR", requires = "name")]
    export: Option<PathBuf>,
}

/// A bundled room, or the nearest name to a mistyped one.
pub(crate) fn bundled(name: &str) -> Result<Room> {
    Ok(Room::named(name).map_err(|e| {
        let nearest = bridge::settings::nearest(name, Room::BUNDLED.into_iter());
        Usage(format!(
            "{e}{}",
            nearest
                .map(|n| format!("; did you mean `{n}`?"))
                .unwrap_or_default()
        ))
    })?)
}

/// The floor plan of a bundled room, or one from its YAML file.
pub(crate) fn plan_of(map: &str) -> Result<FloorPlan> {
    if is_file(map) {
        super::load_plan(Path::new(map))
    } else {
        Ok(bundled(map)?.floor_plan().as_ref().clone())
    }
}

/// A path, not a name.
pub(crate) fn is_file(map: &str) -> bool {
    map.contains('/') || map.ends_with(".yaml") || map.ends_with(".yml")
}

pub(crate) fn run(args: &RoomsArgs) -> Result<ExitCode> {
    let mut out = std::io::stdout().lock();
    let names: Vec<&str> = args
        .name
        .as_deref()
        .map_or_else(|| Room::BUNDLED.to_vec(), |n| vec![n]);
    for name in names {
        let room = bundled(name)?;
        let facts = room.facts();
        let plan = room.floor_plan();
        let _ = writeln!(
            out,
            "{name}: {:.1} x {:.1} m, {} rooms, {} doors",
            plan.width() as f64 * plan.resolution_m(),
            plan.height() as f64 * plan.resolution_m(),
            facts.rooms.len(),
            facts.doors.len(),
        );
        if args.name.is_some() {
            for r in &facts.rooms {
                let _ = writeln!(
                    out,
                    "  {:<12} map {:6.2} {:6.2}   N {:+6.2} E {:+6.2}",
                    r.name, r.map_m[0], r.map_m[1], r.ned_m[0], r.ned_m[1]
                );
            }
        }
        if let Some(folder) = &args.export {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("cannot make {}", folder.display()))?;
            let write = |file: &str, bytes: &[u8]| {
                let path = folder.join(file);
                std::fs::write(&path, bytes)
                    .with_context(|| format!("cannot write {}", path.display()))
            };
            write("plan.yaml", plan.to_yaml("plan.pgm").as_bytes())?;
            write("plan.pgm", &plan.to_pgm())?;
            write("rooms.json", &serde_json::to_vec_pretty(&facts)?)?;
            let _ = writeln!(
                out,
                "wrote plan.yaml, plan.pgm, rooms.json to {}",
                folder.display()
            );
        }
    }
    Ok(ExitCode::SUCCESS)
}
