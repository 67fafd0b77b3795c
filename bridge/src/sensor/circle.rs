//! A circle of laser points as rangers of the ring.
//!
//! A turning laser measures some 400 points a turn, one after the other. They are gathered in columns of 6 degrees; up to
//! six neighbouring columns are one ranger, which is measured within a tenth of a turn and so has a time of its own:
//! a vehicle that turns while the laser does bends no walls. Columns in which the laser sees the vehicle itself are left
//! out of the ring, so nobody takes them for open space.
//!
//! A column reads what its middle ray hits, unless at least two of its points are clearly nearer (a chair leg beside the
//! ray): then the second nearest of them. One point alone is dust.

use arrayvec::ArrayVec;
use core::time::Duration;
use vehicle::angle::wrap_pi;
use vehicle::sample::MAX_COLUMNS;
use vehicle::{RangerConfig, RangerKind, RangerReading, Timestamp};

/// Columns of a whole circle.
pub const COLUMNS: usize = 60;
/// Width of a column, degrees.
pub const COLUMN_DEG: f64 = 360.0 / COLUMNS as f64;
/// Most columns of one ranger.
const COLUMNS_OF_RANGER: u8 = 6;
/// Nearer than the middle ray's hit by this is another thing, mm.
const CLEARLY_NEARER_MM: u16 = 250;
/// Parts of a turn further apart in time than this are of different turns, whatever their angles.
const PART_AT_MOST: Duration = Duration::from_millis(150);

/// How a lidar is mounted and what of it counts.
#[derive(Clone, Debug, PartialEq)]
pub struct Mount {
    /// Name of the sensor.
    pub name: String,
    /// Where it sits, m from the body centre, forward right down.
    pub offset_m: [f64; 3],
    /// Where its zero looks, clockwise from body forward, degrees.
    pub yaw_deg: f64,
    /// Mounted upside down: its angles run the other way round.
    pub is_upside_down: bool,
    /// Shortest and longest distance that counts, m.
    pub range_m: [f64; 2],
    /// Turns a second.
    pub rate_hz: f64,
    /// Bearings in the body's frame where it sees the vehicle itself, clockwise from and to, degrees.
    pub blind_deg: Vec<[f64; 2]>,
    /// Time from measuring to the end of the packet beyond what the wire takes.
    pub latency: Duration,
}

impl Mount {
    /// At the body centre, looking ahead, nothing blind.
    #[must_use]
    pub fn new(name: &str, range_m: [f64; 2], rate_hz: f64) -> Self {
        Self {
            name: name.to_owned(),
            offset_m: [0.0; 3],
            yaw_deg: 0.0,
            is_upside_down: false,
            range_m,
            rate_hz,
            blind_deg: Vec::new(),
            latency: Duration::ZERO,
        }
    }

    /// Columns that count: runs of first column and number.
    fn runs(&self) -> Vec<(u8, u8)> {
        let is_blind = |column: usize| {
            let from_deg = -180.0 + COLUMN_DEG * column as f64;
            self.blind_deg.iter().any(|arc| overlaps(*arc, from_deg))
        };
        let mut runs: Vec<(u8, u8)> = Vec::new();
        for column in (0..COLUMNS).filter(|c| !is_blind(*c)) {
            let column = column as u8;
            match runs.last_mut() {
                Some((first, n)) if *first + *n == column && *n < COLUMNS_OF_RANGER => *n += 1,
                _ => runs.push((column, 1)),
            }
        }
        runs
    }

    /// The rangers that a lidar mounted like this is, in the order it sweeps them.
    #[must_use]
    pub fn rangers(&self) -> Vec<RangerConfig> {
        let runs = self.runs();
        let n = runs.len().max(1) as f64;
        (0u8..)
            .zip(&runs)
            .map(|(i, (first, columns))| {
                let width_deg = COLUMN_DEG * f64::from(*columns);
                RangerConfig {
                    name: format!("{} {i}", self.name),
                    kind: RangerKind::Laser,
                    bearing_deg: -180.0 + COLUMN_DEG * f64::from(*first) + 0.5 * width_deg,
                    elevation_deg: 0.0,
                    offset_m: self.offset_m,
                    columns: *columns,
                    field_of_view_deg: width_deg,
                    half_cone_deg: 0.4,
                    min_m: self.range_m[0],
                    max_m: self.range_m[1],
                    rate_hz: self.rate_hz,
                    phase: f64::from(i) / n,
                    source: self.name.clone(),
                }
            })
            .collect()
    }
}

/// True if an arc (clockwise, may cross 180) and a column share more than an edge.
fn overlaps([from, to]: [f64; 2], column_from: f64) -> bool {
    let eps = 1e-9;
    let arc_deg = (to - from).rem_euclid(360.0);
    let column_into_arc = (column_from - from).rem_euclid(360.0);
    let arc_into_column = (from - column_from).rem_euclid(360.0);
    arc_deg > eps && (column_into_arc < arc_deg - eps || arc_into_column < COLUMN_DEG - eps)
}

/// One measured point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// When it was measured.
    pub at: Timestamp,
    /// Angle of the lidar, clockwise from its zero, rad.
    pub angle_rad: f64,
    /// Length, mm; none without a return.
    pub distance_mm: Option<u16>,
}

/// What a column has seen in this turn.
#[derive(Clone, Copy, Debug, Default)]
struct Column {
    points: u16,
    /// The valid point nearest to the middle: how far off, rad, and its length.
    middle: Option<(f64, u16)>,
    /// Nearest and second nearest.
    nearest: [Option<u16>; 2],
}

impl Column {
    fn add(&mut self, aside_rad: f64, distance_mm: Option<u16>) {
        self.points = self.points.saturating_add(1);
        let Some(mm) = distance_mm else { return };
        if self.middle.is_none_or(|(aside, _)| aside_rad < aside) {
            self.middle = Some((aside_rad, mm));
        }
        match self.nearest {
            [Some(first), _] if mm >= first => {
                if self.nearest[1].is_none_or(|second| mm < second) {
                    self.nearest[1] = Some(mm);
                }
            }
            [first, _] => self.nearest = [Some(mm), first],
        }
    }

    fn reading(&self) -> Option<u16> {
        let (_, middle) = self.middle?;
        match self.nearest[1] {
            Some(second) if second.saturating_add(CLEARLY_NEARER_MM) < middle => Some(second),
            _ => Some(middle),
        }
    }
}

/// Gathers points into readings of the rangers of [`Mount::rangers`].
#[derive(Clone, Debug)]
pub struct Circle {
    first_ranger: u8,
    mount: Mount,
    /// Ranger and column of each column of the circle.
    places: [Option<(u8, u8)>; COLUMNS],
    columns_of: Vec<u8>,
    /// The ranger being swept.
    current: Option<u8>,
    began: Timestamp,
    newest: Timestamp,
    gathered: [Column; MAX_COLUMNS],
}

impl Circle {
    /// For a lidar whose first ranger has this index in the ring.
    #[must_use]
    pub fn new(mount: Mount, first_ranger: u8) -> Self {
        let mut places = [None; COLUMNS];
        let runs = mount.runs();
        for (ranger, (first, n)) in (0u8..).zip(&runs) {
            for column in 0..*n {
                places[usize::from(first + column)] = Some((ranger, column));
            }
        }
        Self {
            first_ranger,
            mount,
            places,
            columns_of: runs.iter().map(|(_, n)| *n).collect(),
            current: None,
            began: Timestamp::ZERO,
            newest: Timestamp::ZERO,
            gathered: [Column::default(); MAX_COLUMNS],
        }
    }

    /// How it is mounted.
    #[must_use]
    pub const fn mount(&self) -> &Mount {
        &self.mount
    }

    /// Takes a point; hands out the ranger that it completes, if it is the first of the next one.
    pub fn add(&mut self, point: &Point, out: &mut impl FnMut(RangerReading)) {
        if !point.angle_rad.is_finite() {
            return;
        }
        let turn = if self.mount.is_upside_down { -1.0 } else { 1.0 };
        let bearing = wrap_pi(turn * point.angle_rad + self.mount.yaw_deg.to_radians());
        let column_rad = COLUMN_DEG.to_radians();
        let along = (bearing + core::f64::consts::PI) / column_rad;
        let index = (along as usize).min(COLUMNS - 1);
        let place = self.places[index];
        let ranger = place.map(|(ranger, _)| ranger);
        if ranger != self.current || point.at.since(self.began) > PART_AT_MOST {
            self.close(out);
            self.current = ranger;
            self.began = point.at;
        }
        self.newest = point.at;
        let Some((_, column)) = place else { return };
        let aside_rad = (along - index as f64 - 0.5).abs() * column_rad;
        let [min_m, max_m] = self.mount.range_m;
        let counts = |mm: &u16| (min_m..=max_m).contains(&(f64::from(*mm) * 1e-3));
        self.gathered[usize::from(column)].add(aside_rad, point.distance_mm.filter(counts));
    }

    /// Hands out what was gathered. A part with a column that no point fell into was not swept whole: it is no reading,
    /// because what was not measured is not open.
    fn close(&mut self, out: &mut impl FnMut(RangerReading)) {
        let Some(ranger) = self.current.take() else {
            return;
        };
        let n = usize::from(self.columns_of[usize::from(ranger)]);
        let columns = &self.gathered[..n];
        if columns.iter().all(|c| c.points > 0) {
            let columns_mm: ArrayVec<Option<u16>, MAX_COLUMNS> =
                columns.iter().map(Column::reading).collect();
            out(RangerReading {
                at: self.began + self.newest.since(self.began) / 2 - self.mount.latency,
                ranger: self.first_ranger + ranger,
                columns_mm,
            });
        }
        self.gathered = [Column::default(); MAX_COLUMNS];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use vehicle::RingConfig;

    fn turn(
        circle: &mut Circle,
        from_ms: u64,
        length: impl Fn(f64) -> Option<u16>,
    ) -> Vec<RangerReading> {
        let mut out = Vec::new();
        for i in 0..450u32 {
            let deg = f64::from(i) * 0.8;
            let point = Point {
                at: Timestamp::from_ms(from_ms) + Duration::from_micros(u64::from(i) * 222),
                angle_rad: deg.to_radians(),
                distance_mm: length(deg),
            };
            circle.add(&point, &mut |r| out.push(r));
        }
        out
    }

    #[test]
    fn a_whole_circle_is_the_built_in_ring() {
        let rangers = Mount::new("laser", [0.15, 12.0], 10.0).rangers();
        let built_in = RingConfig::built_in("lidar60").unwrap();
        assert_eq!(rangers.len(), built_in.rangers.len());
        for (a, b) in rangers.iter().zip(&built_in.rangers) {
            assert!((a.bearing_deg - b.bearing_deg).abs() < 1e-9);
            assert_eq!((a.columns, a.kind), (b.columns, b.kind));
        }
    }

    #[test]
    fn two_turns_give_every_ranger_with_the_time_it_was_swept() {
        let mut circle = Circle::new(Mount::new("l", [0.15, 12.0], 10.0), 3);
        let mut out = turn(&mut circle, 0, |_| Some(2000));
        out.extend(turn(&mut circle, 100, |_| Some(2000)));
        let rangers: Vec<u8> = out.iter().map(|r| r.ranger).collect();
        // The lidar begins ahead: ranger 5 of the ten is the first whole one, and the half behind is not told twice.
        assert_eq!(rangers[..6], [3 + 5, 3 + 6, 3 + 7, 3 + 8, 3 + 9, 3]);
        assert!(rangers.len() >= 19, "{rangers:?}");
        for reading in &out {
            assert!(
                reading.columns_mm.iter().all(|c| *c == Some(2000)),
                "{reading:?}"
            );
        }
        let first = out[0].at;
        assert!(
            first > Timestamp::from_ms(3) && first < Timestamp::from_ms(7),
            "{first:?}"
        );
    }

    #[test]
    fn a_wall_to_the_right_is_read_to_the_right_however_the_lidar_is_mounted() {
        for (yaw_deg, is_upside_down) in [(0.0, false), (90.0, false), (-135.0, true)] {
            let mount = Mount {
                yaw_deg,
                is_upside_down,
                ..Mount::new("l", [0.15, 12.0], 10.0)
            };
            let rangers = mount.rangers();
            let mut circle = Circle::new(mount, 0);
            let sign = if is_upside_down { -1.0 } else { 1.0 };
            let length = |deg: f64| {
                let bearing = (sign * deg + yaw_deg).rem_euclid(360.0);
                Some(if (60.0..120.0).contains(&bearing) {
                    1000
                } else {
                    3000
                })
            };
            turn(&mut circle, 0, length);
            let out = turn(&mut circle, 100, length);
            let mut near = 0;
            for reading in &out {
                let config = &rangers[usize::from(reading.ranger)];
                for (column, mm) in reading.columns_mm.iter().enumerate() {
                    let bearing = config.column_bearing_rad(column).to_degrees();
                    assert_eq!(
                        *mm == Some(1000),
                        (60.0..120.0).contains(&bearing),
                        "{bearing}"
                    );
                    near += usize::from(*mm == Some(1000));
                }
            }
            assert!(near >= 10, "{near}");
        }
    }

    #[test]
    fn a_chair_leg_beside_the_ray_counts_and_one_speck_of_dust_does_not() {
        let mut circle = Circle::new(Mount::new("l", [0.15, 12.0], 10.0), 0);
        // 0.8 degrees apart: a leg of 2 degrees has two points, at the edge of its column.
        let length = |deg: f64| {
            Some(match deg {
                d if (6.3..7.9).contains(&d) => 800,
                d if (19.9..20.1).contains(&d) => 500,
                _ => 3000,
            })
        };
        let out = turn(&mut circle, 0, length);
        let ahead = out.iter().find(|r| r.ranger == 5).unwrap();
        assert_eq!(ahead.columns_mm[1], Some(800));
        assert_eq!(ahead.columns_mm[3], Some(3000));
    }

    #[test]
    fn where_it_sees_the_vehicle_itself_there_is_no_ranger() {
        let mount = Mount {
            blind_deg: vec![[150.0, -150.0], [33.0, 34.0]],
            ..Mount::new("l", [0.15, 12.0], 10.0)
        };
        let rangers = mount.rangers();
        for r in &rangers {
            for column in 0..usize::from(r.columns) {
                let deg = r.column_bearing_rad(column).to_degrees();
                assert!(deg.abs() < 150.0 && (deg - 33.0).abs() > 0.1, "{deg}");
            }
        }
        assert_eq!(
            rangers.iter().map(|r| u32::from(r.columns)).sum::<u32>(),
            60 - 10 - 1
        );
        let mut circle = Circle::new(mount, 0);
        turn(&mut circle, 0, |_| Some(2000));
        let out = turn(&mut circle, 100, |_| Some(2000));
        assert!(out.iter().all(|r| usize::from(r.ranger) < rangers.len()));
        assert!(out.len() >= rangers.len() - 1);
    }

    #[test]
    fn a_part_with_a_packet_missing_is_no_reading_and_no_return_is_one_without_length() {
        let mut circle = Circle::new(Mount::new("l", [0.15, 12.0], 10.0), 0);
        let mut out = Vec::new();
        for i in (0..450u32).filter(|i| !(7..24).contains(i)) {
            let point = Point {
                at: Timestamp::from_us(u64::from(i) * 222),
                angle_rad: (f64::from(i) * 0.8).to_radians(),
                distance_mm: None,
            };
            circle.add(&point, &mut |r| out.push(r));
        }
        assert!(out.iter().all(|r| r.ranger != 5), "{out:?}");
        assert!(
            out.iter()
                .any(|r| r.ranger == 6 && r.columns_mm.iter().all(Option::is_none))
        );
    }

    proptest! {
        #[test]
        fn any_points_give_readings_of_the_ring(
            points in proptest::collection::vec((any::<f64>(), any::<Option<u16>>(), 0u64..40_000), 0..400),
            blind in proptest::collection::vec((-400.0..400.0f64, -400.0..400.0f64), 0..4),
        ) {
            let mount = Mount { blind_deg: blind.iter().map(|(a, b)| [*a, *b]).collect(), ..Mount::new("l", [0.1, 12.0], 10.0) };
            let rangers = mount.rangers();
            prop_assert!(rangers.iter().map(|r| usize::from(r.columns)).sum::<usize>() <= COLUMNS);
            let mut circle = Circle::new(mount, 0);
            let mut at = Timestamp::ZERO;
            for (angle_rad, distance_mm, us) in points {
                at += Duration::from_micros(us);
                let mut bad = false;
                circle.add(&Point { at, angle_rad, distance_mm }, &mut |r| {
                    let config = rangers.get(usize::from(r.ranger));
                    bad |= config.is_none_or(|c| usize::from(c.columns) != r.columns_mm.len());
                    bad |= r.columns_mm.iter().flatten().any(|mm| !(100..=12_000).contains(mm));
                });
                prop_assert!(!bad);
            }
        }
    }
}
