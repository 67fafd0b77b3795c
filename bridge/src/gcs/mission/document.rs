//! The plan on disk: one JSON object an item, fields as MISSION_ITEM_INT names them, `null` for NaN.

use mavlink_dialect::mission_item::MissionItem;
use serde::{Deserialize, Serialize};

/// File of the stored plan.
pub const DOCUMENT: &str = "mission.json";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Item {
    command: u16,
    frame: u8,
    current: u8,
    autocontinue: u8,
    params: [Option<f32>; 4],
    x: i32,
    y: i32,
    z: Option<f32>,
}

/// The document of a plan.
pub(super) fn write(items: &[MissionItem]) -> Vec<u8> {
    let finite = |v: f32| v.is_finite().then_some(v);
    let items: Vec<Item> = items
        .iter()
        .map(|i| Item {
            command: i.command,
            frame: i.frame,
            current: i.current,
            autocontinue: i.autocontinue,
            params: i.params.map(finite),
            x: i.x,
            y: i.y,
            z: finite(i.z),
        })
        .collect();
    // Numbers, arrays and options cannot fail to serialise.
    serde_json::to_vec_pretty(&items).unwrap_or_default()
}

/// The plan of a document.
///
/// # Errors
/// Not such a document.
pub(super) fn parse(bytes: &[u8]) -> Result<Vec<MissionItem>, serde_json::Error> {
    let items: Vec<Item> = serde_json::from_slice(bytes)?;
    let number = |v: Option<f32>| v.unwrap_or(f32::NAN);
    Ok(items
        .into_iter()
        .zip(0..)
        .map(|(i, seq)| MissionItem {
            seq,
            frame: i.frame,
            command: i.command,
            current: i.current,
            autocontinue: i.autocontinue,
            params: i.params.map(number),
            x: i.x,
            y: i.y,
            z: number(i.z),
        })
        .collect())
}
