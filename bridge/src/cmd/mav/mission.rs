//! `mav mission`: up, down, show.

use super::super::Usage;
use super::File;
use super::client::{Client, Silent};
use super::console::print;
use anyhow::{Context as _, Result, bail};
use bridge::gcs::plan_file::PlanFile;
use clap::Subcommand;
use mavlink_dialect::Message;
use mavlink_dialect::mission_item::{Frame, MissionItem, mission_result, mission_type};
use mavlink_dialect::raw::{self, MavMessage as Raw};
use std::path::Path;
use std::time::Duration;

#[derive(Debug, Subcommand)]
pub(super) enum What {
    /// Upload a plan: mission, and fence and rally points where the file has them.
    Up {
        /// QGroundControl's .plan, or a way point file (QGC WPL 110).
        file: File,
    },
    /// Download mission, fence and rally points.
    Down {
        /// Write a .plan; default: show them.
        file: Option<File>,
    },
    /// Show a file without a vehicle.
    Show {
        /// Which.
        file: File,
    },
}

pub(super) fn show(what: &What) -> Result<()> {
    match what {
        What::Show { file } => print(&to_text(&read(file)?)),
        What::Up { .. } | What::Down { .. } => Ok(()),
    }
}

pub(super) fn run(client: &mut Client, what: &What) -> Result<()> {
    match what {
        What::Up { file } => {
            let plan = read(file)?;
            // A file without a fence leaves the vehicle's fence as it is.
            for (kind, name, items) in [
                (mission_type::FENCE, "fence", &plan.fence),
                (mission_type::RALLY, "rally points", &plan.rally),
            ] {
                if !items.is_empty() {
                    upload(client, kind, name, items)?;
                }
            }
            upload(client, mission_type::MISSION, "mission", &plan.mission)?;
            print(&format!(
                "{} mission items, {} of the fence, {} rally points\n",
                plan.mission.len(),
                plan.fence.len(),
                plan.rally.len()
            ))
        }
        What::Down { file } => {
            let plan = PlanFile {
                mission: download(client, mission_type::MISSION, "mission")?,
                fence: download(client, mission_type::FENCE, "fence")?,
                rally: download(client, mission_type::RALLY, "rally points")?,
                ..PlanFile::default()
            };
            match file {
                None => print(&to_text(&plan)),
                Some(file) => std::fs::write(file, plan.to_json())
                    .with_context(|| format!("cannot write {}", file.display())),
            }
        }
        What::Show { .. } => Ok(()),
    }
}

fn read(path: &Path) -> Result<PlanFile> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    PlanFile::parse(&text).map_err(|why| Usage(format!("{}: {why}", path.display())).into())
}

/// One line an item.
fn to_text(plan: &PlanFile) -> String {
    let mut out = String::new();
    for (name, list) in [
        ("mission", &plan.mission),
        ("fence", &plan.fence),
        ("rally points", &plan.rally),
    ] {
        out.push_str(&format!("{name}: {} items\n", list.len()));
        for i in list {
            let command = mavlink_dialect::command::name(i.command)
                .map_or_else(|| i.command.to_string(), str::to_owned);
            let params: Vec<String> = i.params.iter().map(ToString::to_string).collect();
            let scale = match Frame::from_wire(i.frame) {
                Some(Frame::Local) => 1e-4,
                _ => 1e-7,
            };
            let [x, y] = [i.x, i.y].map(|v| match v {
                i32::MAX => "-".to_owned(),
                v => format!("{:.7}", f64::from(v) * scale),
            });
            out.push_str(&format!(
                "{:>4}  {command:<24} frame {:<2} {x}, {y}, {}  ({})\n",
                i.seq,
                i.frame,
                i.z,
                params.join(", ")
            ));
        }
    }
    out
}

/// The vehicle asks for each item; silence for this long is the end.
const PATIENCE: Duration = Duration::from_secs(5);

fn upload(client: &mut Client, kind: u8, name: &str, items: &[MissionItem]) -> Result<()> {
    let (target_system, target_component) = (client.vehicle.system, client.vehicle.component);
    let Ok(count) = u16::try_from(items.len()) else {
        bail!("{name}: {} items are too many", items.len());
    };
    let begin = Raw::MISSION_COUNT(raw::MISSION_COUNT_DATA {
        count,
        target_system,
        target_component,
        mission_type: kind,
        ..Default::default()
    });
    enum Said {
        Wants(u16),
        Over(u8),
    }
    let us = client.us;
    let said = move |m: &Message| match m {
        Message::Raw(Raw::MISSION_REQUEST_INT(r))
            if r.mission_type == kind && r.target_system == us.system =>
        {
            Some(Said::Wants(r.seq))
        }
        Message::Raw(Raw::MISSION_ACK(a))
            if a.mission_type == kind && a.target_system == us.system =>
        {
            Some(Said::Over(a.mavtype))
        }
        _ => None,
    };
    let mut now = client.ask(name, begin, said)?;
    loop {
        match now {
            Said::Over(mission_result::ACCEPTED) => return Ok(()),
            Said::Over(code) => {
                // The reason comes as a text.
                let until = client.within(0.3);
                while client.next(until).is_some() {}
                bail!("{name}: refused (MAV_MISSION_RESULT {code}); the old one stays");
            }
            Said::Wants(seq) => {
                if let Some(item) = items.get(usize::from(seq)) {
                    let item = raw::MISSION_ITEM_INT_DATA {
                        mission_type: kind,
                        ..item.to_int(target_system, target_component)
                    };
                    client.send(Raw::MISSION_ITEM_INT(item));
                }
            }
        }
        let until = client.now() + PATIENCE;
        now = loop {
            let Some(frame) = client.next(until) else {
                return Err(Silent(format!("{name}: the vehicle fell silent")).into());
            };
            if let Some(said) = said(&frame.message) {
                break said;
            }
        };
    }
}

fn download(client: &mut Client, kind: u8, name: &str) -> Result<Vec<MissionItem>> {
    let (target_system, target_component) = (client.vehicle.system, client.vehicle.component);
    let list = Raw::MISSION_REQUEST_LIST(raw::MISSION_REQUEST_LIST_DATA {
        target_system,
        target_component,
        mission_type: kind,
    });
    let count = client.ask(name, list, |m| match m {
        Message::Raw(Raw::MISSION_COUNT(c)) if c.mission_type == kind => Some(c.count),
        _ => None,
    })?;
    let mut items = Vec::new();
    for seq in 0..count {
        let request = Raw::MISSION_REQUEST_INT(raw::MISSION_REQUEST_INT_DATA {
            target_system,
            target_component,
            seq,
            mission_type: kind,
        });
        items.push(client.ask(name, request, |m| match m {
            Message::Raw(Raw::MISSION_ITEM_INT(i)) if i.mission_type == kind && i.seq == seq => {
                Some(MissionItem::from_int(i))
            }
            _ => None,
        })?);
    }
    client.send(Raw::MISSION_ACK(raw::MISSION_ACK_DATA {
        target_system,
        target_component,
        mission_type: kind,
        ..Default::default()
    }));
    Ok(items)
}
