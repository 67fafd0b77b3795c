//! Recorded flights of a nano quadcopter in mazes (data/mcl/tof), with motion-capture truth.

use estimator::EstimatorParams;
use estimator::mcl::beams::{LevelBeam, Stance, level};
use estimator::mcl::{Fix, Locator, Planar, search};
use std::path::PathBuf;
use vehicle::{
    FloorPlan, LocalizationState, MapPose, RangeScan, RangerReading, RingConfig, Timestamp,
};

/// The seven flights without kidnapping.
pub const TRACKS: [&str; 7] = [
    "maze1a_exp1_2d_d0",
    "maze1a_exp1_2d_d1",
    "maze1b_exp1_4d_d0",
    "maze1b_exp1_4d_d1",
    "maze2_exp2_2d_d0",
    "maze2_exp2_2d_d1",
    "maze4_exp4_0p2_d0",
];

/// The folder of the recordings, or none with a word why.
pub fn folder() -> Option<PathBuf> {
    let base = std::env::var_os("KESTREL_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let folder = base.join("mcl");
    if folder.is_dir() {
        return Some(folder);
    }
    println!(
        "SKIPPED: no recordings at {} (set KESTREL_DATA)",
        folder.display()
    );
    None
}

/// Which readings a test uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensors {
    /// All 32 columns.
    Columns32,
    /// Per side the minimum of columns 2..=5, as a cone of 22.5 degrees.
    Sonar4,
}

/// One frame of a flight.
pub struct Frame {
    pub node: usize,
    pub frame: usize,
    pub odometry: Planar,
    pub columns_mm: [Option<u16>; 32],
}

/// One flight.
pub struct Track {
    pub plan: FloorPlan,
    pub frames: Vec<Frame>,
    /// By node.
    pub truth: Vec<Option<MapPose>>,
}

pub fn plan(name: &str) -> Option<FloorPlan> {
    let maps = folder()?.join("maps");
    let yaml = std::fs::read_to_string(maps.join(format!("{name}.yaml"))).unwrap();
    Some(FloorPlan::from_yaml(&yaml, |image| std::fs::read(maps.join(image))).unwrap())
}

impl Track {
    pub fn load(name: &str) -> Option<Self> {
        let folder = folder()?.join("tof");
        let map = name
            .trim_start_matches("kidnap_")
            .split('_')
            .next()
            .unwrap();
        let rows = |file: String| -> Vec<Vec<f64>> {
            std::fs::read_to_string(folder.join(file))
                .unwrap()
                .lines()
                .skip(1)
                .map(|l| l.split(',').map(|v| v.parse().unwrap()).collect())
                .collect()
        };
        let frames: Vec<Frame> = rows(format!("{name}.csv"))
            .iter()
            .map(|r| Frame {
                node: r[0] as usize,
                frame: r[1] as usize,
                odometry: Planar::new(r[2], r[3], r[4]),
                columns_mm: std::array::from_fn(|i| (r[5 + i] >= 0.0).then_some(r[5 + i] as u16)),
            })
            .collect();
        let mut truth = vec![None; frames.iter().map(|f| f.node).max().unwrap() + 1];
        for r in rows(format!("{name}_gt.csv")) {
            truth[r[0] as usize] = Some(MapPose::new(r[1], r[2], r[3]));
        }
        Some(Self {
            plan: plan(map)?,
            frames,
            truth,
        })
    }
}

/// A frame as level beams about the body.
pub fn beams(frame: &Frame, sensors: Sensors) -> Vec<LevelBeam> {
    let ring = RingConfig::built_in("tof32").unwrap();
    let mut scan = RangeScan {
        at: Timestamp::ZERO,
        beams: Default::default(),
    };
    for (i, ranger) in ring.rangers.iter().enumerate() {
        let columns = &frame.columns_mm[8 * i..8 * i + 8];
        if sensors == Sensors::Columns32 {
            let reading = RangerReading {
                at: Timestamp::ZERO,
                ranger: i as u8,
                columns_mm: columns.iter().copied().collect(),
            };
            scan.beams.extend(ranger.beams(&reading));
        } else {
            let mut ranger = ranger.clone();
            ranger.kind = vehicle::RangerKind::Sonar;
            ranger.columns = 1;
            ranger.half_cone_deg = 11.25;
            let reading = RangerReading {
                at: Timestamp::ZERO,
                ranger: i as u8,
                columns_mm: [columns[2..6].iter().flatten().min().copied()]
                    .into_iter()
                    .collect(),
            };
            scan.beams.extend(ranger.beams(&reading));
        }
    }
    let stance = Stance {
        roll_rad: 0.0,
        pitch_rad: 0.0,
        height_m: 0.6,
        wall_height_m: 2.0,
    };
    level(&scan, &stance).into_iter().collect()
}

/// Where a run starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// Within 0.15 m and 0.1 rad of the truth.
    Known,
    Unknown,
}

/// What a run gave at one key.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    pub node: usize,
    pub error_m: f64,
    pub error_rad: f64,
    pub state: LocalizationState,
    pub status: vehicle::Localization,
}

/// Flies a track: one key per node, after its frame 0.
pub fn fly(
    track: &Track,
    params: &EstimatorParams,
    sensors: Sensors,
    start: Start,
    seed: u64,
) -> Vec<Key> {
    let mut locator = Locator::new(params, &track.plan, seed);
    if start == Start::Known {
        // Seeded offset within the allowed start error.
        let mut random = estimator::mcl::random::Random::new(seed.wrapping_mul(77) + 5);
        let mut offset = |limit: f64| (f64::from(random.uniform()) * 2.0 - 1.0) * limit;
        let t = track.truth[0].unwrap();
        let p = MapPose::new(
            t.x_m + offset(0.1),
            t.y_m + offset(0.1),
            t.yaw_rad + offset(0.1),
        );
        locator.start_at(p, 0.10, 0.10);
    } else {
        locator.start_unknown();
    }
    let mut keys = Vec::new();
    let mut now = Timestamp::from_ms(1000);
    let mut last: Option<Fix> = None;
    for frame in &track.frames {
        now += std::time::Duration::from_millis(if frame.frame == 0 { 1500 } else { 66 });
        locator.add(now, &frame.odometry, &beams(frame, sensors));
        if let Some(fix) = locator.update(now, 1.0) {
            last = Some(fix);
        }
        if let Some(job) = locator.poll_job() {
            locator.search_done(&search(&job));
        }
        if frame.frame == 0
            && let Some(truth) = track.truth[frame.node]
        {
            let status = *locator.status();
            let pose = status.pose.unwrap_or_default();
            keys.push(Key {
                node: frame.node,
                error_m: pose.distance(&truth),
                error_rad: vehicle::angle::shortest_turn(truth.yaw_rad, pose.yaw_rad).abs(),
                state: status.state,
                status,
            });
        }
    }
    let _ = last;
    keys
}
