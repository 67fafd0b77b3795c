//! `mav log`: list and get.

use super::File;
use super::client::{Client, Silent, TRIES};
use super::console::print;
use anyhow::{Context as _, Result, bail};
use clap::Subcommand;
use mavlink_dialect::Message;
use mavlink_dialect::standard::{
    LOG_ENTRY_DATA, LOG_REQUEST_DATA_DATA, LOG_REQUEST_END_DATA, LOG_REQUEST_LIST_DATA,
    MavMessage as Std,
};
use std::collections::BTreeMap;

#[derive(Debug, Subcommand)]
pub(super) enum What {
    /// Show which logs there are.
    List,
    /// Fetch a log.
    Get {
        /// Its number in the list.
        id: u16,
        /// Where to.
        file: File,
    },
}

pub(super) fn run(client: &mut Client, what: &What) -> Result<()> {
    let logs = list(client)?;
    match what {
        What::List => {
            let line = |l: &LOG_ENTRY_DATA| format!("{:>5}  {:>10} bytes\n", l.id, l.size);
            print(&logs.values().map(line).collect::<String>())
        }
        What::Get { id, file } => {
            let Some(log) = logs.get(id) else {
                bail!("there is no log {id} (`kestrel mav log list`)");
            };
            let bytes = fetch(client, *id, log.size)?;
            std::fs::write(file, &bytes)
                .with_context(|| format!("cannot write {}", file.display()))?;
            print(&format!("{} bytes in {}\n", bytes.len(), file.display()))
        }
    }
}

fn list(client: &mut Client) -> Result<BTreeMap<u16, LOG_ENTRY_DATA>> {
    let question = Std::LOG_REQUEST_LIST(LOG_REQUEST_LIST_DATA {
        start: 0,
        end: u16::MAX,
        target_system: client.vehicle.system,
        target_component: client.vehicle.component,
    });
    let mut logs = BTreeMap::new();
    let entry = |m: &Message| match m {
        Message::Standard(Std::LOG_ENTRY(e)) => Some(e.clone()),
        _ => None,
    };
    let first = client.ask("logs", question, entry)?;
    let count = first.num_logs;
    if count > 0 {
        logs.insert(first.id, first);
    }
    let until = client.within(3.0);
    while logs.len() < usize::from(count) {
        let Some(frame) = client.next(until) else {
            break;
        };
        if let Some(e) = entry(&frame.message) {
            logs.insert(e.id, e);
        }
    }
    Ok(logs)
}

/// Asks for what is missing until nothing is.
fn fetch(client: &mut Client, id: u16, size: u32) -> Result<Vec<u8>> {
    let (target_system, target_component) = (client.vehicle.system, client.vehicle.component);
    let mut bytes = vec![0u8; size as usize];
    // Pieces that came: start and end.
    let mut came: BTreeMap<u32, u32> = BTreeMap::new();
    let mut tries = 0;
    loop {
        let (mut from, mut to) = (0, size);
        for (start, end) in &came {
            if *start > from {
                to = *start;
                break;
            }
            from = from.max(*end);
        }
        if from >= size {
            break;
        }
        client.send(Std::LOG_REQUEST_DATA(LOG_REQUEST_DATA_DATA {
            ofs: from,
            count: to - from,
            id,
            target_system,
            target_component,
        }));
        let before = came.len();
        loop {
            let until = client.within(0.5);
            let mut is_over = true;
            while let Some(frame) = client.next(until) {
                let Message::Standard(Std::LOG_DATA(d)) = &frame.message else {
                    continue;
                };
                let n = usize::from(d.count).min(d.data.len());
                let at = d.ofs as usize;
                if d.id == id && n > 0 && at + n <= bytes.len() {
                    bytes[at..at + n].copy_from_slice(&d.data[..n]);
                    came.insert(d.ofs, d.ofs + n as u32);
                    is_over = d.ofs + n as u32 >= to;
                    break;
                }
            }
            if is_over {
                break;
            }
        }
        tries = if came.len() > before { 0 } else { tries + 1 };
        if tries > TRIES {
            return Err(Silent(format!("log {id}: the vehicle does not answer")).into());
        }
    }
    client.send(Std::LOG_REQUEST_END(LOG_REQUEST_END_DATA {
        target_system,
        target_component,
    }));
    Ok(bytes)
}
