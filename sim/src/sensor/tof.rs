//! Multizone time of flight (VL53L5CX class): one depth along the sensor axis per column.
//!
//! Faults as measured on 17 856 column readings of recorded flights in mazes with motion-capture truth; see [`TABLE`].
//! Below 1.5 m nearly all short readings come from the outermost columns (0 and 7 read short in 6 %, 2 to 5 in less than 0.3 %).

use super::View;
use super::ranger::{frame, millimetres};
use crate::noise::Noise;
use arrayvec::ArrayVec;
use core::time::Duration;
use vehicle::sample::MAX_COLUMNS;
use vehicle::{Frd, In, Map, RangerConfig};

/// From the exposure to the reading in our hands.
pub const TOF_LATENCY: Duration = Duration::from_millis(30);

/// What readings do for a range of true depths.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    pub(super) up_to_m: f64,
    pub(super) median_m: f64,
    pub(super) sigma_m: f64,
    /// Shares of readings short and long by more than 0.15 m, and without a return.
    pub(super) short: f64,
    pub(super) long: f64,
    pub(super) none: f64,
}

const fn row(up_to_m: f64, median_m: f64, sigma_m: f64, shares: [f64; 3]) -> Row {
    Row {
        up_to_m,
        median_m,
        sigma_m,
        short: shares[0],
        long: shares[1],
        none: shares[2],
    }
}

/// The measured range model.
pub(super) const TABLE: [Row; 7] = [
    row(0.5, 0.006, 0.010, [0.000, 0.000, 0.004]),
    row(1.0, 0.004, 0.014, [0.003, 0.002, 0.004]),
    row(1.5, -0.001, 0.032, [0.073, 0.010, 0.019]),
    row(2.0, 0.000, 0.023, [0.134, 0.025, 0.105]),
    row(3.0, 0.007, 0.026, [0.085, 0.045, 0.119]),
    row(5.0, -0.008, 0.043, [0.164, 0.007, 0.650]),
    // Beyond what was recorded: next to nothing comes back.
    row(f64::INFINITY, 0.0, 0.05, [0.020, 0.0, 0.970]),
];
/// Up to here short readings depend on the column.
pub(super) const EDGE_UP_TO_M: f64 = 1.5;
/// Share of short readings by distance from the nearer edge, relative to the mean; the mean over eight columns is 1.
const EDGE: [f64; 4] = [3.30, 0.62, 0.04, 0.04];
/// Readings off by more than this count as short or long, m.
pub(super) const OUTLIER_M: f64 = 0.15;
/// Rays are followed this far, m.
const LOOK_M: f64 = 8.0;

/// A sensor with its columns.
#[derive(Clone, Debug)]
pub(super) struct Tof {
    config: RangerConfig,
    noise: Noise,
    rays: ArrayVec<Ray, MAX_COLUMNS>,
}

#[derive(Clone, Copy, Debug)]
struct Ray {
    direction: In<Frd>,
    /// Depth along the axis per length of the ray.
    depth_per_m: f64,
    edge: f64,
}

impl Tof {
    pub(super) fn new(config: &RangerConfig, index: u8, seed: u64, vehicle: usize) -> Self {
        let [axis, right, _] = frame(config);
        let columns = usize::from(config.columns).min(MAX_COLUMNS);
        let rays = (0..columns)
            .map(|column| {
                let (s, c) = libm::sincos(config.column_angle_rad(column));
                let from_edge = column.min(columns - 1 - column);
                Ray {
                    direction: axis * c + right * s,
                    depth_per_m: c,
                    edge: if columns == MAX_COLUMNS {
                        EDGE[from_edge]
                    } else {
                        1.0
                    },
                }
            })
            .collect();
        Self {
            config: config.clone(),
            noise: Noise::new(seed, vehicle, &format!("tof {index}")),
            rays,
        }
    }

    pub(super) fn measure(
        &mut self,
        view: &View<'_>,
        origin: In<Map>,
    ) -> (ArrayVec<Option<u16>, MAX_COLUMNS>, Duration) {
        let mut columns = ArrayVec::new();
        for ray in &self.rays {
            let hit = view.cast_light(origin, ray.direction, LOOK_M);
            let depth_m = hit.map_or(f64::INFINITY, |h| h.distance_m * ray.depth_per_m);
            let read_m = read(&mut self.noise, depth_m, ray.edge);
            columns.push(read_m.and_then(|m| millimetres(m, &self.config)));
        }
        (columns, TOF_LATENCY)
    }
}

/// One column: what a true depth reads.
fn read(noise: &mut Noise, depth_m: f64, edge: f64) -> Option<f64> {
    let row = TABLE.iter().find(|row| depth_m <= row.up_to_m)?;
    let edge = if depth_m < EDGE_UP_TO_M { edge } else { 1.0 };
    // Both are drawn always, so that one column's fate does not shift the numbers of the next.
    let (fate, size) = (noise.unit(), noise.unit());
    let error_m = row.median_m + noise.gauss(row.sigma_m);
    let (none, short) = (row.none, row.short * edge);
    if fate < none {
        None
    } else if fate < none + short {
        let reach_m = depth_m.min(5.0);
        Some((reach_m - OUTLIER_M - size * 0.5 * reach_m).max(0.03))
    } else if fate < none + short + row.long {
        Some(depth_m + OUTLIER_M + size * 0.8)
    } else {
        Some(depth_m + error_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edge_factors_average_to_one() {
        assert!((EDGE.iter().sum::<f64>() / 4.0 - 1.0).abs() < 1e-12);
    }

    /// The measured table beside the simulated one.
    #[test]
    fn readings_follow_the_measured_table() {
        let mut noise = Noise::new(5, 0, "tof table");
        println!("true range     median   sigma   short    long    none   (table in brackets)");
        let mut from_m = 0.05;
        for row in &TABLE[..6] {
            let n = 40_000_u32;
            let (mut errors, mut short, mut long, mut none) = (Vec::new(), 0_u32, 0_u32, 0_u32);
            for i in 0..n {
                let depth_m = from_m + (row.up_to_m - from_m) * f64::from(i) / f64::from(n);
                let edge = EDGE[(i % 4) as usize];
                match read(&mut noise, depth_m, edge).map(|r| r - depth_m) {
                    None => none += 1,
                    Some(e) if e < -OUTLIER_M => short += 1,
                    Some(e) if e > OUTLIER_M => long += 1,
                    Some(e) => errors.push(e),
                }
            }
            errors.sort_by(f64::total_cmp);
            let median = errors[errors.len() / 2];
            let mut spread: Vec<f64> = errors.iter().map(|e| (e - median).abs()).collect();
            spread.sort_by(f64::total_cmp);
            let sigma = 1.4826 * spread[spread.len() / 2];
            let share = |count: u32| f64::from(count) / f64::from(n);
            println!(
                "{from_m:.2} - {:.1} m  {median:+.3} ({:+.3})  {sigma:.3} ({:.3})  {:.3} ({:.3})  {:.3} ({:.3})  {:.3} ({:.3})",
                row.up_to_m,
                row.median_m,
                row.sigma_m,
                share(short),
                row.short,
                share(long),
                row.long,
                share(none),
                row.none
            );
            assert!((median - row.median_m).abs() < 0.002);
            assert!((sigma / row.sigma_m - 1.0).abs() < 0.1);
            for (count, table) in [(short, row.short), (long, row.long), (none, row.none)] {
                assert!((share(count) - table).abs() < 0.01, "{}", share(count));
            }
            from_m = row.up_to_m;
        }
    }

    #[test]
    fn edge_columns_read_short_in_6_percent_and_centre_columns_hardly_ever_below_one_and_a_half_metres()
     {
        let mut noise = Noise::new(6, 0, "tof edge");
        let mut share = |edge: f64| {
            let n = 30_000_u32;
            let short = (0..n).filter(|i| {
                let depth_m = 0.2 + 1.3 * f64::from(*i) / f64::from(n);
                read(&mut noise, depth_m, edge).is_some_and(|r| r < depth_m - OUTLIER_M)
            });
            short.count() as f64 / f64::from(n)
        };
        let (edge, centre) = (share(EDGE[0]), share(EDGE[3]));
        println!(
            "short below 1.5 m: edge columns {edge:.3} (0.06), centre columns {centre:.4} (< 0.003)"
        );
        assert!((0.04..0.12).contains(&edge) && centre < 0.003);
    }
}
