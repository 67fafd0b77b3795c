//! Sub-commands of the program, one file each.

pub(crate) mod camera;
pub(crate) mod console;
pub(crate) mod demo;
pub(crate) mod doctor;
pub(crate) mod eval;
pub(crate) mod experiment;
pub(crate) mod fc;
pub(crate) mod firmware;
pub(crate) mod fly;
pub(crate) mod keys;
pub(crate) mod log;
pub(crate) mod map;
pub(crate) mod mav;
pub(crate) mod motors;
pub(crate) mod msp;
pub(crate) mod msp_ask;
pub(crate) mod msp_serve;
pub(crate) mod params;
pub(crate) mod passwd;
pub(crate) mod picture;
pub(crate) mod plan;
pub(crate) mod plan_picture;
pub(crate) mod rehearse;
pub(crate) mod replay;
pub(crate) mod rooms;
pub(crate) mod sensors;
pub(crate) mod session;
pub(crate) mod sim;
pub(crate) mod stop;
pub(crate) mod term;
pub(crate) mod tune;
pub(crate) mod uquad;
#[cfg(feature = "video")]
pub(crate) mod video;

use anyhow::{Context as _, Result};
use bridge::gcs::camera::VideoStream;
use bridge::settings::{Origin, Settings};
use std::path::Path;
use vehicle::FloorPlan;

/// The command line asks for something that does not exist: exit code 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Usage(pub(crate) String);

/// Parameters from file and command line over the defaults.
pub(crate) fn settings(config: Option<&Path>, sets: &[String]) -> Result<Settings> {
    let mut settings = Settings::default();
    if let Some(path) = config {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        settings
            .set_toml(&text, Origin::File)
            .with_context(|| format!("in {}", path.display()))?;
    }
    apply_sets(&mut settings, sets)?;
    Ok(settings)
}

/// `--param NAME=VALUE` arguments.
pub(crate) fn apply_sets(settings: &mut Settings, sets: &[String]) -> Result<()> {
    for set in sets {
        let (name, value) = set
            .split_once('=')
            .ok_or_else(|| Usage(format!("--param {set}: write it like NAME=VALUE")))?;
        settings
            .set_text(name, value, Origin::CommandLine)
            .map_err(|e| Usage(e.to_string()))?;
    }
    Ok(())
}

/// `--video URL`.
pub(crate) fn video(url: Option<&str>) -> Result<Option<VideoStream>> {
    url.map(VideoStream::parse)
        .transpose()
        .map_err(|e| Usage(e.to_string()).into())
}

/// A floor plan from its YAML file.
pub(crate) fn load_plan(path: &Path) -> Result<FloorPlan> {
    let text = std::fs::read_to_string(path).with_context(|| {
        format!(
            "cannot read the floor plan {} (a ROS map_server YAML is needed)",
            path.display()
        )
    })?;
    let folder = path.parent().unwrap_or_else(|| Path::new(""));
    FloorPlan::from_yaml(&text, |image| std::fs::read(folder.join(image)))
        .with_context(|| format!("cannot use the floor plan {}", path.display()))
}
