//! What a page wraps its MAVLink frames in, and when a wrapped frame is too old or out of order.
//!
//! | Bytes | Field | |
//! | --- | --- | --- |
//! | 0..8 | `lease` | u64 LE: number of the ownership it flies by ([`Control::lease`](crate::gcs::operator::Control)), 0 none |
//! | 8..12 | `seq` | u32 LE: grows with every message of this socket |
//! | 12..20 | `t_client` | f64 LE: the page's clock, ms, any zero |
//! | 20.. | | MAVLink frames, whole ones |
//!
//! The page's clock is compared with ours by the quickest message so far: what took longer than that one by more than the
//! limit has waited somewhere (a suspended page, a stalled link) and is not carried out any more.

use core::time::Duration;
use vehicle::Timestamp;

/// Bytes before the frames.
pub const HEADER: usize = 20;
/// A command older than this is refused.
pub const COMMAND_AGE: Duration = Duration::from_secs(1);
/// Sticks older than this are not used.
pub const STICKS_AGE: Duration = Duration::from_millis(250);
/// Clocks may drift apart this much, ms per ms.
const DRIFT: f64 = 2e-4;

/// A message taken out of its envelope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opened<'a> {
    /// Ownership it refers to.
    pub lease: u64,
    /// Its number.
    pub seq: u32,
    /// The page's clock, ms.
    pub t_client_ms: f64,
    /// Time it took longer than the quickest one.
    pub age: Duration,
    /// The frames.
    pub frames: &'a [u8],
}

/// What is wrong with a message as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Shorter than the header, or the clock is no number.
    Malformed,
    /// Its number is not larger than the last one.
    OutOfOrder,
}

/// Order and age of one socket's messages.
#[derive(Clone, Copy, Debug, Default)]
pub struct Envelopes {
    last: Option<u32>,
    /// Our clock minus the page's, of the quickest message, ms; and when that was, ms.
    offset: Option<(f64, f64)>,
}

impl Envelopes {
    /// Opens one message.
    ///
    /// # Errors
    /// [`Fault`]: nothing of it may be used but a stop.
    pub fn open<'a>(&mut self, now: Timestamp, bytes: &'a [u8]) -> Result<Opened<'a>, Fault> {
        let (header, frames) = bytes.split_at_checked(HEADER).ok_or(Fault::Malformed)?;
        let field = |at: usize| -> [u8; 8] {
            let mut out = [0; 8];
            out.copy_from_slice(&header[at..at + 8]);
            out
        };
        let lease = u64::from_le_bytes(field(0));
        let t_client_ms = f64::from_le_bytes(field(12));
        let mut seq = [0; 4];
        seq.copy_from_slice(&header[8..12]);
        let seq = u32::from_le_bytes(seq);
        if !t_client_ms.is_finite() || t_client_ms.abs() > 1e15 {
            return Err(Fault::Malformed);
        }
        if self.last.is_some_and(|last| seq <= last) {
            return Err(Fault::OutOfOrder);
        }
        self.last = Some(seq);
        let now_ms = now.us() as f64 * 1e-3;
        let sample = now_ms - t_client_ms;
        let quickest = self.offset.map_or(sample, |(offset, at)| {
            (offset + (now_ms - at) * DRIFT).min(sample)
        });
        self.offset = Some((quickest, now_ms));
        Ok(Opened {
            lease,
            seq,
            t_client_ms,
            age: Duration::from_secs_f64(((sample - quickest) * 1e-3).clamp(0.0, 1e6)),
            frames,
        })
    }
}

/// Wraps frames as a page does: for tests and scripts.
#[must_use]
pub fn wrap(lease: u64, seq: u32, t_client_ms: f64, frames: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(HEADER + frames.len());
    out.extend_from_slice(&lease.to_le_bytes());
    out.extend_from_slice(&seq.to_le_bytes());
    out.extend_from_slice(&t_client_ms.to_le_bytes());
    out.extend_from_slice(frames);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_waited_on_the_way_is_old_whatever_the_pages_clock_shows() {
        let mut envelopes = Envelopes::default();
        let mut age = |now_ms: u64, seq, t_client| {
            let bytes = wrap(1, seq, t_client, &[]);
            envelopes
                .open(Timestamp::from_ms(now_ms), &bytes)
                .map(|o| (o.age.as_secs_f64() * 1e3).round() as u64)
        };
        assert_eq!(age(10_000, 1, 500.0), Ok(0));
        assert_eq!(age(10_040, 2, 520.0), Ok(20));
        assert_eq!(age(12_000, 3, 560.0), Ok(1_940));
        assert_eq!(age(12_001, 3, 2_500.0), Err(Fault::OutOfOrder));
        assert_eq!(age(12_010, 4, 2_510.0), Ok(0));
    }

    #[test]
    fn clocks_that_drift_apart_do_not_make_frames_old() {
        let mut envelopes = Envelopes::default();
        for i in 0..100_000u32 {
            // The page's clock is slow by 100 ppm for more than half an hour.
            let (now_ms, t) = (u64::from(i) * 20, f64::from(i) * 20.0 * (1.0 - 1e-4));
            let bytes = wrap(1, i + 1, t, &[]);
            let opened = envelopes.open(Timestamp::from_ms(now_ms), &bytes).unwrap();
            assert!(
                opened.age < Duration::from_millis(5),
                "{i}: {:?}",
                opened.age
            );
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_fault_or_an_envelope(bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
            let mut envelopes = Envelopes::default();
            if let Ok(opened) = envelopes.open(Timestamp::from_ms(5), &bytes) {
                prop_assert_eq!(opened.frames.len() + HEADER, bytes.len());
            }
        }

        #[test]
        fn no_number_is_taken_twice(seqs in proptest::collection::vec(0u32..50, 1..60)) {
            let (mut envelopes, mut taken) = (Envelopes::default(), Vec::new());
            for seq in seqs {
                if envelopes.open(Timestamp::ZERO, &wrap(0, seq, 0.0, &[])).is_ok() {
                    prop_assert!(!taken.contains(&seq));
                    taken.push(seq);
                }
            }
        }
    }
}
