//! STATUSTEXT: sentences for the pilot, in pieces of 50 bytes, the same sentence not twice in a row.
//!
//! A text of up to 50 bytes is one frame with `id` 0. A longer one is cut into chunks that share an `id`; the receiver
//! joins them by `chunk_seq` and knows the end by a chunk with a NUL, so a text whose last chunk is full is followed by
//! an empty one.

use super::convert::severity_code;
use crate::autopilot::door::Severity;
use core::time::Duration;
use mavlink_dialect::raw::{MavMessage, STATUSTEXT_DATA};
use std::collections::VecDeque;
use vehicle::Timestamp;

/// Bytes of one chunk.
const CHUNK_LEN: usize = 50;
/// Longest text; what is longer is cut.
const MAX_LEN: usize = 10 * CHUNK_LEN;
/// Texts kept for the status line.
const KEPT: usize = 32;
/// The same text again within this time is not sent.
const REPEAT_AFTER: Duration = Duration::from_secs(2);
/// Texts that may come at once, and a second; critical ones always pass.
const BURST: u32 = 20;
const TEXTS_PER_S: f64 = 10.0;

/// One text that was told to the pilots.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Told {
    /// When.
    pub at: Timestamp,
    /// How loud.
    pub severity: Severity,
    /// What.
    pub text: String,
}

/// Cuts texts into STATUSTEXT frames and remembers the last ones.
#[derive(Debug)]
pub struct TextService {
    told: VecDeque<Told>,
    next_id: u16,
    allowance: f64,
    refilled: Timestamp,
    suppressed: u64,
    /// Texts told since the start, those forgotten too.
    total: u64,
}

impl Default for TextService {
    fn default() -> Self {
        Self {
            told: VecDeque::with_capacity(KEPT),
            next_id: 1,
            allowance: f64::from(BURST),
            refilled: Timestamp::ZERO,
            suppressed: 0,
            total: 0,
        }
    }
}

impl TextService {
    /// Nothing told yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The frames of a text; none if the same was just told, or too many are.
    pub fn say(&mut self, now: Timestamp, severity: Severity, text: &str) -> Vec<MavMessage> {
        let text = plain(text);
        let is_repeat =
            self.told.iter().rev().any(|t| {
                now.since(t.at) < REPEAT_AFTER && t.text == text && t.severity == severity
            });
        self.allowance = (self.allowance + now.since(self.refilled).as_secs_f64() * TEXTS_PER_S)
            .min(f64::from(BURST));
        self.refilled = now;
        if is_repeat || (self.allowance < 1.0 && severity > Severity::Critical) {
            self.suppressed += 1;
            return Vec::new();
        }
        self.allowance = (self.allowance - 1.0).max(0.0);
        let frames = self.frames(severity, &text);
        if self.told.len() == KEPT {
            self.told.pop_front();
        }
        self.total += 1;
        self.told.push_back(Told {
            at: now,
            severity,
            text,
        });
        frames
    }

    /// The last texts, oldest first.
    pub fn told(&self) -> impl DoubleEndedIterator<Item = &Told> {
        self.told.iter()
    }

    /// Those told since `seen`, which moves on; more than are kept are skipped.
    pub fn since(&self, seen: &mut u64) -> impl Iterator<Item = &Told> {
        let fresh = self.total.saturating_sub(*seen);
        *seen = self.total;
        let skipped = self.told.len().saturating_sub(fresh as usize);
        self.told.iter().skip(skipped)
    }

    /// Texts that were not sent: repeats, and more than pilots can read.
    #[must_use]
    pub const fn suppressed(&self) -> u64 {
        self.suppressed
    }

    /// The frames of a text, neither remembered nor held back: for greetings.
    #[must_use]
    pub fn frames(&mut self, severity: Severity, text: &str) -> Vec<MavMessage> {
        let text = plain(text);
        let text = text.as_bytes();
        let severity = severity_code(severity);
        let frame = |chunk: &[u8], id, chunk_seq| {
            let mut field = [0u8; CHUNK_LEN];
            field[..chunk.len()].copy_from_slice(chunk);
            MavMessage::STATUSTEXT(STATUSTEXT_DATA {
                severity,
                text: field.into(),
                id,
                chunk_seq,
            })
        };
        if text.len() <= CHUNK_LEN {
            return vec![frame(text, 0, 0)];
        }
        let id = self.next_id;
        self.next_id = self.next_id.checked_add(1).unwrap_or(1);
        let mut frames: Vec<_> = (0u8..)
            .zip(text.chunks(CHUNK_LEN))
            .map(|(i, chunk)| frame(chunk, id, i))
            .collect();
        if text.len().is_multiple_of(CHUNK_LEN) {
            frames.push(frame(&[], id, frames.len() as u8));
        }
        frames
    }
}

/// Printable ASCII only: consoles differ in what else they show, and a chunk may not end inside a character.
fn plain(text: &str) -> String {
    text.chars()
        .take(MAX_LEN)
        .map(|c| {
            if c.is_ascii_graphic() || c == ' ' {
                c
            } else {
                '?'
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parts(frames: &[MavMessage]) -> Vec<(String, u16, u8)> {
        frames
            .iter()
            .map(|m| match m {
                MavMessage::STATUSTEXT(t) => {
                    (t.text.to_str().unwrap().to_owned(), t.id, t.chunk_seq)
                }
                other => panic!("{other:?}"),
            })
            .collect()
    }

    #[test]
    fn fifty_bytes_are_one_frame_and_fifty_one_are_two() {
        let mut service = TextService::new();
        let fifty = "x".repeat(50);
        assert_eq!(
            parts(&service.say(Timestamp::ZERO, Severity::Info, &fifty)),
            [(fifty.clone(), 0, 0)]
        );
        let long = format!("{fifty}y");
        let got = parts(&service.say(Timestamp::ZERO, Severity::Info, &long));
        assert_eq!(got, [(fifty, 1, 0), ("y".to_owned(), 1, 1)]);
    }

    #[test]
    fn a_text_that_fills_its_last_chunk_is_ended_by_an_empty_one() {
        let mut service = TextService::new();
        let got = parts(&service.say(Timestamp::ZERO, Severity::Info, &"z".repeat(100)));
        assert_eq!(got.len(), 3);
        assert_eq!(got[2], (String::new(), 1, 2));
    }

    #[test]
    fn the_same_text_is_told_again_only_after_two_seconds() {
        let mut service = TextService::new();
        let mut say = |ms| {
            service
                .say(Timestamp::from_ms(ms), Severity::Warning, "not localized")
                .len()
        };
        assert_eq!([say(0), say(100), say(1_900), say(2_000)], [1, 0, 0, 1]);
        assert_eq!(service.suppressed(), 2);
    }

    #[test]
    fn a_flood_is_thinned_but_critical_texts_pass() {
        let mut service = TextService::new();
        let told: usize = (0..1_000)
            .map(|i| {
                service
                    .say(Timestamp::from_ms(i), Severity::Info, &format!("text {i}"))
                    .len()
            })
            .sum();
        assert!((25..=35).contains(&told), "{told}");
        assert_eq!(
            service
                .say(Timestamp::from_ms(1_000), Severity::Critical, "fire")
                .len(),
            1
        );
        assert!(service.told().count() <= KEPT);
    }

    #[test]
    fn what_is_not_ascii_becomes_a_question_mark() {
        assert_eq!(plain("h\u{f6}he\n\0"), "h?he??");
    }
}
