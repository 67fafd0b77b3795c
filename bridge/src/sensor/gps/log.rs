//! A GPS log in uQuad's columns, replayed by its own time stamps.
//!
//! Columns, separated by white space: `time fix x y z vx vy vz lat lon speed climb track vel_ok`. Time in seconds; x east, y north, z up,
//! m from the start; lat and lon in degrees; track in degrees. Lines that begin with `#` or `%` are comments.

use super::RawFix;
use core::time::Duration;
use vehicle::{GnssFix, In, Timestamp};

/// Doubt of a logged position, m: the log does not tell.
const DOUBT_M: [f64; 2] = [3.0, 5.0];

/// Why a line is no row.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("GPS log, line {line}: {what}")]
pub struct LogError {
    /// From 1.
    pub line: usize,
    /// What is wrong.
    pub what: String,
}

/// The rows, in order of time.
#[derive(Clone, Debug, Default)]
pub struct Log {
    rows: Vec<(Duration, GnssFix)>,
    next: usize,
    began: Option<Timestamp>,
}

impl Log {
    /// From the text of a log.
    ///
    /// # Errors
    /// The first line that is no row, or goes back in time.
    pub fn from_text(text: &str) -> Result<Self, LogError> {
        let mut rows: Vec<(Duration, GnssFix)> = Vec::new();
        let mut first_s = None;
        for (i, line) in text.lines().enumerate() {
            let content = line.trim();
            if content.is_empty() || content.starts_with(['#', '%']) {
                continue;
            }
            let wrong = |what: String| LogError { line: i + 1, what };
            let v: Vec<f64> = content
                .split_whitespace()
                .map(str::parse)
                .collect::<Result<_, _>>()
                .map_err(|_| wrong("a column is no number".to_owned()))?;
            let [
                time,
                fix,
                x,
                y,
                z,
                vx,
                vy,
                vz,
                lat,
                lon,
                _speed,
                _climb,
                _track,
                vel_ok,
            ] = v[..]
            else {
                return Err(wrong(format!("{} columns instead of 14", v.len())));
            };
            if v.iter().any(|v| !v.is_finite()) {
                return Err(wrong("a column is not finite".to_owned()));
            }
            let since_s = time - *first_s.get_or_insert(time);
            let since = Duration::try_from_secs_f64(since_s)
                .map_err(|_| wrong("time goes back".to_owned()))?;
            if rows.last().is_some_and(|(last, _)| *last > since) {
                return Err(wrong("time goes back".to_owned()));
            }
            if fix < 3.0 {
                continue;
            }
            rows.push((
                since,
                GnssFix {
                    at: Timestamp::ZERO,
                    position: In::new(y, x, -z),
                    velocity: (vel_ok > 0.0).then(|| In::new(vy, vx, -vz)),
                    std_m: DOUBT_M,
                    place_deg: [lat, lon],
                    altitude_m: z,
                    satellites: 0,
                },
            ));
        }
        Ok(Self {
            rows,
            next: 0,
            began: None,
        })
    }

    /// Rows.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.rows.len()
    }

    /// True without rows.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The next row if its time has come; the first call begins.
    pub fn poll(&mut self, now: Timestamp) -> Option<GnssFix> {
        let began = *self.began.get_or_insert(now);
        let (since, fix) = self.rows.get(self.next)?;
        if began + *since > now {
            return None;
        }
        self.next += 1;
        Some(GnssFix { at: now, ..*fix })
    }
}

/// A row of such a log.
#[must_use]
pub fn row(at: Timestamp, raw: &RawFix, fix: &GnssFix) -> String {
    let v = fix.velocity.unwrap_or_default();
    format!(
        "{:.3} {} {:.3} {:.3} {:.3} {:.3} {:.3} {:.3} {:.7} {:.7} {:.3} {:.3} {:.2} {}",
        at.s(),
        raw.mode,
        fix.position.y(),
        fix.position.x(),
        -fix.position.z(),
        v.y(),
        v.x(),
        -v.z(),
        raw.place_deg[0],
        raw.place_deg[1],
        raw.speed_mps.unwrap_or(0.0),
        raw.climb_mps.unwrap_or(0.0),
        raw.track_deg.unwrap_or(0.0),
        u8::from(fix.velocity.is_some()),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_at_their_own_time() {
        let text = "% time fix ...\n10.0 3 1 2 3 0.1 0.2 0.3 -34.9 -56.1 0.2 0.3 26.5 1\n10.5 2 9 9 9 0 0 0 0 0 0 0 0 0\n\n11.0 3 4 5 6 0 0 0 -34.9 -56.1 0 0 0 0\n";
        let mut log = Log::from_text(text).unwrap();
        assert_eq!(log.len(), 2);
        let at = Timestamp::from_ms;
        let first = log.poll(at(5000)).unwrap();
        assert_eq!(first.position, In::new(2.0, 1.0, -3.0));
        assert_eq!(first.velocity, Some(In::new(0.2, 0.1, -0.3)));
        assert_eq!(log.poll(at(5990)), None);
        let second = log.poll(at(6000)).unwrap();
        assert_eq!((second.at, second.velocity), (at(6000), None));
        assert_eq!(log.poll(at(99_000)), None);
    }

    #[test]
    fn a_wrong_line_is_named() {
        let said = |text: &str| Log::from_text(text).unwrap_err().to_string();
        assert_eq!(said("1 3 0"), "GPS log, line 1: 3 columns instead of 14");
        assert!(said("\n1 3 a b c d e f g h i j k l").contains("line 2: a column is no number"));
        let row = "3 0 0 0 0 0 0 0 0 0 0 0 0";
        assert!(said(&format!("5 {row}\n4 {row}")).contains("line 2: time goes back"));
        assert!(said(&format!("NaN {row}")).contains("not finite"));
    }

    #[test]
    fn what_is_written_is_read_again() {
        let raw = RawFix {
            mode: 3,
            place_deg: [1.5, 2.5],
            speed_mps: Some(1.0),
            ..RawFix::default()
        };
        let fix = GnssFix {
            at: Timestamp::ZERO,
            position: In::new(1.0, 2.0, -3.0),
            velocity: Some(In::new(0.5, 0.25, 0.125)),
            std_m: DOUBT_M,
            place_deg: [1.5, 2.5],
            altitude_m: 3.0,
            satellites: 0,
        };
        let mut log = Log::from_text(&row(Timestamp::from_ms(7), &raw, &fix)).unwrap();
        assert_eq!(log.poll(Timestamp::ZERO), Some(fix));
    }
}
