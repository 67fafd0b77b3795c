//! A recorded log as text: comma-separated, one row a frame or scan, columns found by their names.
//!
//! | Sensors | Key | Readings, mm, -1 without return |
//! | --- | --- | --- |
//! | `tof32`, `sonar4` | `node`, `frame` | `f0_mm` .. `f7_mm`, `b..`, `l..`, `r..`: depths along the axis, left-most first |
//! | `laser` | `idx` (and `t_s`) | `l0_mm` .. `l59_mm`: bearing -89 + 3 k degrees, counter-clockwise |
//! | `sonar8` | `idx` (and `t_s`) | `s0_mm` .. `s7_mm`: bearing -78.75 + 22.5 k degrees, counter-clockwise |
//!
//! All have `odom_x_m`, `odom_y_m`, `odom_yaw_rad`, of which only the steps from row to row are used.

use crate::mcl::planar::Planar;
use core::str::FromStr;
use thiserror::Error;
use vehicle::{
    Beam, In, MapPose, RangeScan, RangerConfig, RangerKind, RangerReading, RingConfig, Timestamp,
};

/// Frames of one stop follow each other in this time when the log has no stamps, ms (15 Hz).
const FRAME_MS: u64 = 66;
/// And the hop to the next stop takes this long, ms.
const HOP_MS: u64 = 1_500;
/// Half the opening angle of a laser beam, rad.
const LASER_HALF_CONE_RAD: f64 = 0.004;
/// Range of the recorded laser, m.
const LASER_MAX_M: f64 = 40.0;
/// Half cone (15 degrees in all) and range of a sonar of the ring of eight.
const SONAR_HALF_CONE_RAD: f64 = 0.131;
const SONAR_MAX_M: f64 = 4.0;
/// Half cone of four columns of a multizone ranger, degrees.
const FOUR_COLUMNS_HALF_CONE_DEG: f64 = 11.25;

/// Which readings of a log are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensors {
    /// Four multizone time-of-flight rangers: 32 columns.
    Tof32,
    /// Of the same rangers per side the least of columns 2..=5, as a sonar.
    Sonar4,
    /// 60 laser beams over the front half.
    Laser,
    /// Eight sonar-like cones over the front half.
    Sonar8,
}

impl Sensors {
    /// Names, as [`FromStr`] takes them.
    pub const NAMES: [&'static str; 4] = ["tof32", "sonar4", "laser", "sonar8"];

    /// Name of the column that numbers the poses: `node` or `idx`.
    #[must_use]
    pub const fn key(self) -> &'static str {
        match self {
            Self::Tof32 | Self::Sonar4 => "node",
            Self::Laser | Self::Sonar8 => "idx",
        }
    }
}

impl FromStr for Sensors {
    type Err = LogError;
    fn from_str(name: &str) -> Result<Self, LogError> {
        match name {
            "tof32" => Ok(Self::Tof32),
            "sonar4" => Ok(Self::Sonar4),
            "laser" => Ok(Self::Laser),
            "sonar8" => Ok(Self::Sonar8),
            other => Err(LogError::Sensors(other.to_owned())),
        }
    }
}

/// Why a log cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum LogError {
    /// No such set of sensors.
    #[error("no sensor set `{0}`; there are {names}", names = Sensors::NAMES.join(", "))]
    Sensors(String),
    /// The header lacks a column.
    #[error("the log has no column `{0}`, which these sensors need")]
    Column(String),
    /// A value is missing or no number.
    #[error("line {line}: column `{column}` is {what}")]
    Value {
        /// Line of the file, the header is 1.
        line: usize,
        /// Column.
        column: String,
        /// What stands there.
        what: String,
    },
    /// Nothing to do.
    #[error("the log has a header but no rows")]
    Empty,
}

/// One row of a log.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Stop (`node`) or scan (`idx`).
    pub key: u32,
    /// True if a pose is reported after this row: the first of its stop.
    pub is_key: bool,
    /// When it was taken, by its stamp or by the usual spacing.
    pub at: Timestamp,
    /// Odometry pose: drifts, only steps count.
    pub odometry: Planar,
    /// The readings.
    pub scan: RangeScan,
}

/// Rows in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Log {
    /// Which readings were taken.
    pub sensors: Sensors,
    /// The rows.
    pub rows: Vec<Row>,
}

impl Log {
    /// Reads a log.
    ///
    /// # Errors
    /// [`LogError`] names the column or the line.
    pub fn from_csv(text: &str, sensors: Sensors) -> Result<Self, LogError> {
        let table = Table::new(text);
        let key = table.column(sensors.key())?;
        let stamp = table.column("t_s").ok();
        let odometry = [
            table.column("odom_x_m")?,
            table.column("odom_y_m")?,
            table.column("odom_yaw_rad")?,
        ];
        let readings = reading_columns(sensors)
            .iter()
            .map(|name| table.column(name))
            .collect::<Result<Vec<usize>, LogError>>()?;
        let eye = Eye::new(sensors);
        let mut rows: Vec<Row> = Vec::new();
        for line in table.lines() {
            let key = line.whole(key)?;
            let is_key = rows.last().is_none_or(|last| last.key != key);
            let at = match (stamp, rows.last()) {
                (Some(column), _) => stamp_of(&line, column)?,
                (None, None) => Timestamp::from_ms(HOP_MS),
                (None, Some(last)) => {
                    let ms = if is_key { HOP_MS } else { FRAME_MS };
                    last.at + core::time::Duration::from_millis(ms)
                }
            };
            let [x, y, yaw] = [
                line.number(odometry[0])?,
                line.number(odometry[1])?,
                line.number(odometry[2])?,
            ];
            let mm = readings
                .iter()
                .map(|column| Ok(reading(line.number(*column)?)))
                .collect::<Result<Vec<Option<f64>>, LogError>>()?;
            rows.push(Row {
                key,
                is_key,
                at,
                odometry: Planar::new(x, y, yaw),
                scan: eye.scan(at, &mm),
            });
        }
        if rows.is_empty() {
            return Err(LogError::Empty);
        }
        Ok(Self { sensors, rows })
    }

    /// Poses by key, for scoring: columns `node` or `idx`, `x_m`, `y_m`, `yaw_rad`.
    ///
    /// # Errors
    /// [`LogError`] names the column or the line.
    pub fn truth_from_csv(text: &str, sensors: Sensors) -> Result<Vec<(u32, MapPose)>, LogError> {
        let table = Table::new(text);
        let key = table.column(sensors.key())?;
        let pose = [
            table.column("x_m")?,
            table.column("y_m")?,
            table.column("yaw_rad")?,
        ];
        table
            .lines()
            .map(|line| {
                let [x, y, yaw] = [
                    line.number(pose[0])?,
                    line.number(pose[1])?,
                    line.number(pose[2])?,
                ];
                Ok((line.whole(key)?, MapPose::new(x, y, yaw)))
            })
            .collect()
    }
}

/// A second of a log; before zero there is nothing.
fn stamp_of(line: &Line<'_>, column: usize) -> Result<Timestamp, LogError> {
    let s = line.number(column)?;
    if !(0.0..1.0e9).contains(&s) {
        return Err(line.complaint(column, "no time in seconds"));
    }
    // A second is added: stamp zero means "never" in places.
    Ok(Timestamp::from_us((s * 1e6) as u64 + 1_000_000))
}

fn reading(mm: f64) -> Option<f64> {
    (mm >= 0.0).then_some(mm)
}

fn reading_columns(sensors: Sensors) -> Vec<String> {
    let of = |letter: char, count: usize| (0..count).map(move |i| format!("{letter}{i}_mm"));
    match sensors {
        Sensors::Tof32 | Sensors::Sonar4 => "fblr".chars().flat_map(|c| of(c, 8)).collect(),
        Sensors::Laser => of('l', 60).collect(),
        Sensors::Sonar8 => of('s', 8).collect(),
    }
}

/// How readings become beams.
enum Eye {
    Ring(RingConfig),
    /// Bearings clockwise, rad; half cone; farthest.
    Fan(Vec<f64>, f64, f64),
}

impl Eye {
    fn new(sensors: Sensors) -> Self {
        let fan = |first: f64, step: f64, n: u8| -> Vec<f64> {
            (0..n)
                .map(|k| -(first + step * f64::from(k)).to_radians())
                .collect()
        };
        // The built-in ring exists: a test holds it. An empty ring sees nothing.
        let ring = RingConfig::built_in("tof32").unwrap_or_else(|_| RingConfig {
            name: String::new(),
            rangers: Vec::new(),
        });
        match sensors {
            Sensors::Tof32 => Self::Ring(ring),
            Sensors::Sonar4 => Self::Ring(RingConfig {
                rangers: ring
                    .rangers
                    .into_iter()
                    .map(|r| RangerConfig {
                        kind: RangerKind::Sonar,
                        columns: 1,
                        half_cone_deg: FOUR_COLUMNS_HALF_CONE_DEG,
                        ..r
                    })
                    .collect(),
                ..ring_name("sonar4")
            }),
            Sensors::Laser => Self::Fan(fan(-89.0, 3.0, 60), LASER_HALF_CONE_RAD, LASER_MAX_M),
            Sensors::Sonar8 => Self::Fan(fan(-78.75, 22.5, 8), SONAR_HALF_CONE_RAD, SONAR_MAX_M),
        }
    }

    fn scan(&self, at: Timestamp, mm: &[Option<f64>]) -> RangeScan {
        let mut scan = RangeScan {
            at,
            beams: arrayvec::ArrayVec::new(),
        };
        match self {
            Self::Ring(ring) => {
                for (i, (ranger, columns)) in ring.rangers.iter().zip(mm.chunks(8)).enumerate() {
                    let whole = |v: Option<f64>| v.map(|v| v.min(65_535.0) as u16);
                    let columns_mm = if ranger.columns == 1 {
                        let least = columns[2..6].iter().flatten().copied().reduce(f64::min);
                        core::iter::once(whole(least)).collect()
                    } else {
                        columns.iter().map(|v| whole(*v)).collect()
                    };
                    let reading = RangerReading {
                        at,
                        ranger: i as u8,
                        columns_mm,
                    };
                    scan.beams.extend(ranger.beams(&reading));
                }
            }
            Self::Fan(bearings, half_cone_rad, max_m) => {
                scan.beams
                    .extend(bearings.iter().zip(mm).map(|(bearing_rad, mm)| Beam {
                        origin: In::zero(),
                        bearing_rad: *bearing_rad,
                        elevation_rad: 0.0,
                        half_cone_rad: *half_cone_rad,
                        distance_m: mm.map(|mm| mm * 1e-3).filter(|d| *d > 0.0 && d <= max_m),
                        min_m: 0.02,
                        max_m: *max_m,
                    }));
            }
        }
        scan
    }
}

fn ring_name(name: &str) -> RingConfig {
    RingConfig {
        name: name.to_owned(),
        rangers: Vec::new(),
    }
}

/// A header and lines.
struct Table<'a> {
    text: &'a str,
    header: Vec<&'a str>,
}

struct Line<'a> {
    number: usize,
    values: Vec<&'a str>,
    header: &'a [&'a str],
}

impl<'a> Table<'a> {
    fn new(text: &'a str) -> Self {
        let header = text.lines().next().unwrap_or_default();
        Self {
            text,
            header: header.split(',').map(str::trim).collect(),
        }
    }

    fn column(&self, name: &str) -> Result<usize, LogError> {
        self.header
            .iter()
            .position(|h| *h == name)
            .ok_or_else(|| LogError::Column(name.to_owned()))
    }

    fn lines(&self) -> impl Iterator<Item = Line<'_>> {
        self.text
            .lines()
            .enumerate()
            .skip(1)
            .filter(|(_, l)| !l.trim().is_empty())
            .map(|(i, l)| Line {
                number: i + 1,
                values: l.split(',').map(str::trim).collect(),
                header: &self.header,
            })
    }
}

impl Line<'_> {
    fn complaint(&self, column: usize, what: &str) -> LogError {
        LogError::Value {
            line: self.number,
            column: self.header[column].to_owned(),
            what: what.to_owned(),
        }
    }

    fn number(&self, column: usize) -> Result<f64, LogError> {
        let text = self
            .values
            .get(column)
            .ok_or_else(|| self.complaint(column, "missing"))?;
        let value: f64 = text
            .parse()
            .map_err(|_| self.complaint(column, &format!("`{text}`, not a number")))?;
        if value.is_finite() {
            Ok(value)
        } else {
            Err(self.complaint(column, &format!("`{text}`, not finite")))
        }
    }

    fn whole(&self, column: usize) -> Result<u32, LogError> {
        let value = self.number(column)?;
        if (0.0..4.0e9).contains(&value) && (value - libm::floor(value)).abs() < 1e-9 {
            Ok(value as u32)
        } else {
            Err(self.complaint(column, "not a whole number"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sonar_log(row: &str) -> String {
        format!(
            "idx,t_s,odom_x_m,odom_y_m,odom_yaw_rad,s0_mm,s1_mm,s2_mm,s3_mm,s4_mm,s5_mm,s6_mm,s7_mm\n{row}\n"
        )
    }

    #[test]
    fn a_cone_on_the_right_is_at_a_clockwise_bearing_and_minus_one_is_no_return() {
        let text = sonar_log("7,1.5,1.0,2.0,0.5,1000,-1,900,900,900,900,900,2000");
        let log = Log::from_csv(&text, Sensors::Sonar8).unwrap();
        let row = &log.rows[0];
        assert_eq!((row.key, row.is_key, row.scan.beams.len()), (7, true, 8));
        let first = row.scan.beams[0];
        assert!((first.bearing_rad.to_degrees() - 78.75).abs() < 1e-9);
        assert_eq!(first.distance_m, Some(1.0));
        assert_eq!(row.scan.beams[1].distance_m, None);
    }

    #[test]
    fn a_broken_log_is_refused_with_line_and_column() {
        for (row, words) in [
            (
                "7,1.5,nan,2.0,0.5,1,1,1,1,1,1,1,1",
                "line 2: column `odom_x_m` is `nan`, not finite",
            ),
            (
                "7,1.5,1,2.0,0.5,1,1,1,1,1,x,1,1",
                "line 2: column `s5_mm` is `x`, not a number",
            ),
            ("7,1.5,1,2.0,0.5,1,1", "line 2: column `s2_mm` is missing"),
            (
                "7.5,1.5,1,2.0,0.5,1,1,1,1,1,1,1,1",
                "line 2: column `idx` is not a whole number",
            ),
            (
                "7,-3,1,2.0,0.5,1,1,1,1,1,1,1,1",
                "line 2: column `t_s` is no time in seconds",
            ),
            ("", "the log has a header but no rows"),
        ] {
            let error = Log::from_csv(&sonar_log(row), Sensors::Sonar8).unwrap_err();
            assert_eq!(error.to_string(), words);
        }
        let error = Log::from_csv(&sonar_log(""), Sensors::Laser).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the log has no column `l0_mm`, which these sensors need"
        );
    }
}
