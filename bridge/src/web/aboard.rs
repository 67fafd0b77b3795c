//! The vehicle this console is aboard of, and the routes that are about it alone.

use super::console::ConsoleConfig;
use super::gate::Refused;
use super::picture::Picture;
use super::recording;
use super::routes::{Reply, json, no, unavailable};
use super::signal::Desk;
use crate::gcs::disk::Folder;
use crate::io::net::Joint;
use crate::log::LogFile;
use crate::settings::Settings;
use axum::Extension;
use axum::extract::Path;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use mavlink_dialect::Address;
use std::path::PathBuf;
use std::sync::Arc;
use tokio::sync::watch;
use vehicle::param::ParamKind;
use vehicle::{FloorPlan, MapAnchor};

/// Largest log that is handed out.
const LARGEST_LOG: u64 = 256 << 20;

/// The vehicle, for pages.
pub(super) struct Aboard {
    pub(super) joint: Joint,
    pub(super) feed: watch::Receiver<Arc<Picture>>,
    plan_json: serde_json::Value,
    parameters_json: serde_json::Value,
    pub(super) anchor: MapAnchor,
    pub(super) us: Address,
    /// Its name for people.
    pub(super) name: String,
    /// Its camera, if it has one.
    pub(super) camera: Option<Arc<dyn Desk>>,
    logs: Option<PathBuf>,
}

impl Aboard {
    pub(super) fn new(
        config: ConsoleConfig,
        joint: Joint,
        feed: watch::Receiver<Arc<Picture>>,
    ) -> Self {
        let anchor = config.plan.anchor();
        Self {
            joint,
            feed,
            plan_json: plan_json(&config.plan, &anchor),
            parameters_json: parameters_json(&config.settings),
            anchor,
            us: config.us,
            name: config.vehicle,
            camera: config.camera,
            logs: config.state_dir.map(|d| d.join(Folder::Logs.name())),
        }
    }

    /// What the logs of actions call it.
    pub(super) fn label(&self) -> String {
        format!("vehicle {}", self.us.system)
    }
}

/// Walls as lines, free cells as runs, rooms by name, home: all a page needs to draw.
pub(super) fn plan_json(plan: &FloorPlan, anchor: &MapAnchor) -> serde_json::Value {
    let round = |v: f64| (v * 1e3).round() / 1e3;
    let walls: Vec<[f64; 4]> = plan
        .wall_segments()
        .iter()
        .map(|s| [s.a[0], s.a[1], s.b[0], s.b[1]].map(round))
        .collect();
    let (w, h) = (plan.width(), plan.height());
    // Per row: [kind, length] of equal cells; 0 free, 1 wall, 2 unknown.
    let mut rows = Vec::with_capacity(h);
    for row in 0..h {
        let mut runs: Vec<u32> = Vec::new();
        let mut last = None;
        for column in 0..w {
            let kind = match plan.cell(column as i64, row as i64) {
                vehicle::floor_plan::Cell::Free => 0u32,
                vehicle::floor_plan::Cell::Occupied => 1,
                vehicle::floor_plan::Cell::Unknown => 2,
            };
            match runs.last_mut() {
                Some(n) if last == Some(kind) => *n += 1,
                _ => runs.extend([kind, 1]),
            }
            last = Some(kind);
        }
        rows.push(runs);
    }
    let rooms: Vec<_> = plan
        .rooms
        .iter()
        .map(|r| serde_json::json!({ "name": r.name, "x": round(r.x), "y": round(r.y) }))
        .collect();
    let home = plan.home.unwrap_or_default();
    serde_json::json!({
        "width": w, "height": h, "cell": plan.resolution_m(),
        "origin": plan.origin(), "walls": walls, "rows": rows, "rooms": rooms,
        "home": [home.x_m, home.y_m, home.yaw_rad],
        "north": anchor.north_rad(),
    })
}

/// Every parameter with its range and words; values come by MAVLink.
fn parameters_json(settings: &Settings) -> serde_json::Value {
    let row = |r: crate::settings::Row<'_>| {
        let (range, choices) = match r.meta.kind {
            ParamKind::Float { min, max, .. } => (Some([f64::from(min), f64::from(max)]), None),
            ParamKind::Int { min, max, .. } => (Some([f64::from(min), f64::from(max)]), None),
            ParamKind::Bool { .. } => (Some([0.0, 1.0]), None),
            ParamKind::Choice { names, .. } => (None, Some(names)),
        };
        serde_json::json!({
            "name": r.meta.id, "section": r.section, "doc": r.meta.doc.trim(), "unit": r.meta.unit,
            "default": r.meta.default_value().to_string(), "range": range, "choices": choices,
        })
    };
    serde_json::Value::Array(settings.rows().map(row).collect())
}

pub(super) async fn plan(Extension(aboard): Extension<Arc<Aboard>>) -> Response {
    json(&aboard.plan_json)
}

pub(super) async fn parameters(Extension(aboard): Extension<Arc<Aboard>>) -> Response {
    json(&aboard.parameters_json)
}

pub(super) async fn logs(Extension(aboard): Extension<Arc<Aboard>>) -> Reply {
    let Some(folder) = aboard.logs.clone() else {
        return Ok(json(&serde_json::json!([])));
    };
    let names = tokio::task::spawn_blocking(move || {
        let mut out = Vec::new();
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            if let (Ok(name), Ok(meta)) = (entry.file_name().into_string(), entry.metadata())
                && meta.is_file()
            {
                out.push(serde_json::json!({ "name": name, "bytes": meta.len() }));
            }
        }
        out
    })
    .await
    .map_err(unavailable)?;
    Ok(json(&serde_json::Value::Array(names)))
}

/// Bytes of a log of ours.
fn read_log(folder: &std::path::Path, name: &str) -> Option<Vec<u8>> {
    let path = folder.join(name);
    // A link in the folder leads nowhere.
    let meta = std::fs::symlink_metadata(&path).ok()?;
    if !meta.is_file() || meta.len() > LARGEST_LOG {
        return None;
    }
    std::fs::read(path).ok()
}

impl Aboard {
    /// The folder of logs, for a name that can be in it.
    fn logs_with(&self, name: &str) -> Result<PathBuf, Refused> {
        let nothing = || no(StatusCode::NOT_FOUND, "there is no such log");
        if !crate::gcs::disk::is_plain_name(name) {
            return Err(nothing());
        }
        self.logs.clone().ok_or_else(nothing)
    }
}

fn file(bytes: Vec<u8>) -> Response {
    let mut response = bytes.into_response();
    let headers = response.headers_mut();
    headers.insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static("application/octet-stream"),
    );
    headers.insert(
        header::CONTENT_DISPOSITION,
        HeaderValue::from_static("attachment"),
    );
    response
}

pub(super) async fn log(
    Extension(aboard): Extension<Arc<Aboard>>,
    Path(name): Path<String>,
) -> Reply {
    let folder = aboard.logs_with(&name)?;
    let bytes = tokio::task::spawn_blocking(move || read_log(&folder, &name))
        .await
        .map_err(unavailable)?
        .ok_or_else(|| no(StatusCode::NOT_FOUND, "there is no such log"))?;
    Ok(file(bytes))
}

/// A log flown again for the page. That is work: not while the vehicle flies.
pub(super) async fn recording(
    Extension(aboard): Extension<Arc<Aboard>>,
    Path(name): Path<String>,
) -> Reply {
    if aboard.feed.borrow().snapshot.is_armed {
        return Err(no(
            StatusCode::CONFLICT,
            "not while the motors run: a log is flown again on the same processor",
        ));
    }
    let folder = aboard.logs_with(&name)?;
    let made = tokio::task::spawn_blocking(move || {
        let bytes = read_log(&folder, &name).ok_or("there is no such log")?;
        let mut parts = vec![LogFile::read(&bytes).map_err(|e| e.to_string())?];
        // 7.mcap goes on in 7-2.mcap.
        let stem = name.trim_end_matches(".mcap");
        for part in 2.. {
            let Some(bytes) = read_log(&folder, &format!("{stem}-{part}.mcap")) else {
                break;
            };
            parts.push(LogFile::read(&bytes).map_err(|e| e.to_string())?);
        }
        recording::of(&parts).map_err(|e| e.to_string())
    })
    .await
    .map_err(unavailable)?;
    made.map(file)
        .map_err(|why: String| no(StatusCode::UNPROCESSABLE_ENTITY, &why))
}
