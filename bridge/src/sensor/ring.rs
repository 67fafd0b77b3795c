//! The ring of range finders: single readings become scans.
//!
//! Rangers of equal rate and phase fire together; their readings make one scan. A ranger that fires alone makes a scan
//! of its own beams. A ranger that looks down gives a height instead.

use super::stuck::Stuck;
use core::time::Duration;
use vehicle::sample::MAX_BEAMS;
use vehicle::{Beam, DownRange, RangeScan, RangerReading, RingConfig, Timestamp};

/// A ranger silent for longer is left out of the picture.
const FRESH: Duration = Duration::from_secs(1);

/// What a reading completed.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a box would allocate in flight")]
pub enum Measured {
    /// Beams measured together.
    Scan(RangeScan),
    /// Height above what is below.
    Down(DownRange),
}

/// Gathers readings.
#[derive(Clone, Debug)]
pub struct Ring {
    config: RingConfig,
    /// How many rangers fire together with each.
    group_size: Vec<usize>,
    pending: Option<(RangeScan, usize)>,
    latest: Vec<Option<RangerReading>>,
    stuck: Vec<Stuck>,
    horizontal_at: Option<Timestamp>,
}

impl Ring {
    /// A ring that has not measured yet.
    #[must_use]
    pub fn new(config: RingConfig) -> Self {
        let group_size = config
            .rangers
            .iter()
            .map(|a| {
                let together = |b: &&vehicle::RangerConfig| {
                    (b.rate_hz - a.rate_hz).abs() < 1e-9
                        && (b.phase - a.phase).abs() < 1e-9
                        && b.looks_down() == a.looks_down()
                };
                config.rangers.iter().filter(together).count()
            })
            .collect();
        let latest = vec![None; config.rangers.len()];
        let stuck = vec![Stuck::default(); config.rangers.len()];
        Self {
            config,
            group_size,
            pending: None,
            latest,
            stuck,
            horizontal_at: None,
        }
    }

    /// Takes a reading; hands out what it completed (at most a left-over scan and its own). A ranger that has
    /// [frozen](super::stuck) is as good as silent.
    pub fn read(&mut self, reading: &RangerReading, mut out: impl FnMut(Measured)) {
        let index = usize::from(reading.ranger);
        let (Some(ranger), Some(latest)) =
            (self.config.rangers.get(index), self.latest.get_mut(index))
        else {
            return; // Not one of ours.
        };
        if self.stuck[index].is_frozen(reading) {
            return;
        }
        let beams = ranger.beams(reading);
        if ranger.looks_down() {
            out(Measured::Down(DownRange {
                at: reading.at,
                distance_m: beams.first().and_then(|b| b.distance_m),
            }));
            return;
        }
        *latest = Some(reading.clone());
        self.horizontal_at = Some(reading.at);

        if let Some((scan, _)) = self.pending.take_if(|(scan, _)| scan.at != reading.at) {
            out(Measured::Scan(scan));
        }
        let (scan, rangers) = self.pending.get_or_insert_with(|| {
            (
                RangeScan {
                    at: reading.at,
                    beams: arrayvec::ArrayVec::new(),
                },
                0,
            )
        });
        for beam in beams {
            // The ring was checked to fit.
            let _ = scan.beams.try_push(beam);
        }
        *rangers += 1;
        if *rangers >= self.group_size[index]
            && let Some((scan, _)) = self.pending.take()
        {
            out(Measured::Scan(scan));
        }
    }

    /// True if the reading is of a ranger that looks around.
    #[must_use]
    pub fn looks_around(&self, reading: &RangerReading) -> bool {
        let ranger = self.config.rangers.get(usize::from(reading.ranger));
        ranger.is_some_and(|r| !r.looks_down())
    }

    /// When a horizontal ranger spoke last.
    #[must_use]
    pub const fn horizontal_at(&self) -> Option<Timestamp> {
        self.horizontal_at
    }

    /// The newest beams of every horizontal ranger that is not silent, as one picture.
    #[must_use]
    pub fn picture(&self, now: Timestamp) -> Option<RangeScan> {
        let mut beams = arrayvec::ArrayVec::<Beam, MAX_BEAMS>::new();
        let mut at = None;
        for reading in self
            .latest
            .iter()
            .flatten()
            .filter(|r| now.since(r.at) < FRESH)
        {
            at = at.max(Some(reading.at));
            if let Some(ranger) = self.config.rangers.get(usize::from(reading.ranger)) {
                for beam in ranger.beams(reading) {
                    let _ = beams.try_push(beam);
                }
            }
        }
        at.map(|at| RangeScan { at, beams })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(ms: u64, ranger: u8, columns: usize) -> RangerReading {
        RangerReading {
            at: Timestamp::from_ms(ms),
            ranger,
            columns_mm: vec![Some(1000); columns].into_iter().collect(),
        }
    }

    fn collect(ring: &mut Ring, r: &RangerReading) -> Vec<Measured> {
        let mut out = Vec::new();
        ring.read(r, |m| out.push(m));
        out
    }

    #[test]
    fn four_sensors_that_fire_together_make_one_scan_of_32_beams() {
        let mut ring = Ring::new(RingConfig::built_in("tof32").unwrap());
        for ranger in 0..3 {
            assert!(collect(&mut ring, &reading(100, ranger, 8)).is_empty());
        }
        let out = collect(&mut ring, &reading(100, 3, 8));
        assert!(matches!(&out[..], [Measured::Scan(s)] if s.beams.len() == 32));
    }

    #[test]
    fn a_missing_sensor_does_not_hold_up_the_others() {
        let mut ring = Ring::new(RingConfig::built_in("tof32").unwrap());
        collect(&mut ring, &reading(100, 0, 8));
        collect(&mut ring, &reading(100, 1, 8));
        let out = collect(&mut ring, &reading(166, 0, 8));
        assert!(
            matches!(&out[..], [Measured::Scan(s)] if s.beams.len() == 16 && s.at == Timestamp::from_ms(100))
        );
    }

    #[test]
    fn a_sonar_that_looks_down_gives_a_height() {
        let mut ring = Ring::new(RingConfig::built_in("snsi6").unwrap());
        let out = collect(&mut ring, &reading(10, 5, 1));
        assert_eq!(
            out,
            [Measured::Down(DownRange {
                at: Timestamp::from_ms(10),
                distance_m: Some(1.0)
            })]
        );
        assert_eq!(ring.horizontal_at(), None);
    }

    #[test]
    fn a_frozen_ring_is_silent() {
        let mut ring = Ring::new(RingConfig::built_in("tof32").unwrap());
        for ms in (0..10_000).step_by(100) {
            for ranger in 0..4 {
                collect(&mut ring, &reading(ms, ranger, 8));
            }
        }
        assert_eq!(ring.horizontal_at(), Some(Timestamp::from_ms(3000)));
        assert_eq!(ring.picture(Timestamp::from_ms(10_000)), None);
    }

    #[test]
    fn a_reading_of_a_ranger_that_does_not_exist_is_ignored() {
        let mut ring = Ring::new(RingConfig::built_in("sonar8").unwrap());
        assert!(collect(&mut ring, &reading(10, 200, 1)).is_empty());
    }
}
