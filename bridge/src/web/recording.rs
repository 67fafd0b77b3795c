//! A flight log as a recording of the page: what the console would have shown, by flying the log again.
//!
//! File, as the page saves and opens it (`recorder.js`): `KREC1`, a line of JSON (names of the state's numbers, modes, reasons, the plan),
//! then each message of [`topics`] with its u32 length, little-endian, by time.

use super::aboard::plan_json;
use super::picture::Picture;
use super::topics;
use crate::log::replay::{Replay, ReplayError, Seen};
use crate::log::{Header, LogFile};
use std::time::Duration;
use vehicle::{MapAnchor, Timestamp};

/// Looks a second.
const LOOK: Duration = Duration::from_millis(100);
/// Looks between two at particles, histogram, way.
const SELDOM: u32 = 4;
/// Largest recording: what the page keeps. A longer flight is cut off there.
const MOST: usize = 22 << 20;

/// The recording of a log and the parts that follow it.
///
/// # Errors
/// [`ReplayError`]: not a log, or not its first part.
pub fn of(parts: &[LogFile]) -> Result<Vec<u8>, ReplayError> {
    let mut replay = Replay::new(parts, &[])?;
    let config = match parts.first().map(|p| p.header.as_ref()) {
        Some(Ok(header)) => Header::config(header)?,
        _ => return Ok(Vec::new()),
    };
    let anchor = config.plan.anchor();
    let about = serde_json::json!({
        "state": topics::STATE_FIELDS,
        "modes": topics::MODES.iter().map(|m| m.name()).collect::<Vec<_>>(),
        "reasons": topics::REASONS.iter().map(|r| r.words()).collect::<Vec<_>>(),
        "plan": plan_json(&config.plan, &anchor),
    });
    let mut out = format!("KREC1\n{about}\n").into_bytes();
    let mut picture = Picture::default();
    let (mut next, mut count) = (Timestamp::ZERO, 0);
    loop {
        let mut is_due = false;
        let is_more = replay.step(|seen| {
            if let Seen::Tick(snapshot) = seen
                && snapshot.at >= next
            {
                picture.snapshot.clone_from(snapshot);
                is_due = true;
            }
        });
        if is_due {
            next = picture.snapshot.at + LOOK;
            picture.insight.look(replay.flight());
            show(&picture, &anchor, count, &mut out);
            count += 1;
        }
        if !is_more || out.len() > MOST {
            return Ok(out);
        }
    }
}

fn show(p: &Picture, anchor: &MapAnchor, count: u32, out: &mut Vec<u8>) {
    let mut put = |message: Vec<u8>| {
        out.extend_from_slice(&(message.len() as u32).to_le_bytes());
        out.extend_from_slice(&message);
    };
    put(topics::state(p, anchor));
    if let Some(scan) = topics::scan(p) {
        put(scan);
    }
    if count.is_multiple_of(SELDOM) {
        put(topics::particles(p));
        put(topics::histogram(p));
        put(topics::route(p, anchor));
        put(topics::people(p));
    }
}
