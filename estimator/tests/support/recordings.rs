//! Recorded flights (data/mcl) with their truth, and flights joined from them.

use estimator::EstimatorParams;
use estimator::mcl::random::Random;
use estimator::mcl::replay::score::{Judged, judge};
use estimator::mcl::replay::{Begin, Log, Replay, Row, Sensors};
use std::path::PathBuf;
use std::time::Duration;
use vehicle::{FloorPlan, MapPose};

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

/// Seeds of a campaign: all with KESTREL_FULL=1.
pub fn seeds(few: u64, all: u64) -> u64 {
    if std::env::var_os("KESTREL_FULL").is_some_and(|v| v == "1") {
        all
    } else {
        few
    }
}

/// The folder of the recordings, or none with a word why.
pub fn folder() -> Option<PathBuf> {
    super::recorded("mcl")
}

pub fn plan(name: &str) -> Option<FloorPlan> {
    let maps = folder()?.join("maps");
    let yaml = std::fs::read_to_string(maps.join(format!("{name}.yaml"))).unwrap();
    Some(FloorPlan::from_yaml(&yaml, |image| std::fs::read(maps.join(image))).unwrap())
}

/// One flight, seen with one set of sensors.
#[derive(Clone)]
pub struct Track {
    pub name: String,
    pub plan: FloorPlan,
    pub log: Log,
    pub truth: Vec<(u32, MapPose)>,
}

impl Track {
    pub fn load(name: &str, sensors: Sensors) -> Option<Self> {
        let sub = if matches!(sensors, Sensors::Laser | Sensors::Sonar8) {
            "laser"
        } else {
            "tof"
        };
        let folder = folder()?.join(sub);
        let bare = name.trim_start_matches("kidnap_");
        let map = bare.split('_').next().unwrap();
        let text = |file: String| std::fs::read_to_string(folder.join(file)).unwrap();
        Some(Self {
            name: name.to_owned(),
            plan: plan(map)?,
            log: Log::from_csv(&text(format!("{name}.csv")), sensors).unwrap(),
            truth: Log::truth_from_csv(&text(format!("{name}_gt.csv")), sensors).unwrap(),
        })
    }

    /// Stops in order.
    pub fn stops(&self) -> Vec<u32> {
        let keys = self.log.rows.iter().filter(|r| r.is_key);
        keys.map(|r| r.key).collect()
    }

    pub fn truth_at(&self, key: u32) -> Option<MapPose> {
        let found = self.truth.iter().find(|(k, _)| *k == key);
        found.map(|(_, pose)| *pose)
    }

    /// The flight from a stop on.
    pub fn cut_at(&self, key: u32) -> Self {
        let mut cut = self.clone();
        cut.log.rows.retain(|r| r.key >= key);
        cut
    }

    /// This flight up to before stop `until`, then another of the same maze from its stop `from`: carried there without
    /// odometry noticing. Keys of the second count on.
    pub fn joined(&self, until: u32, other: &Self, from: u32) -> Self {
        let mut joined = self.clone();
        joined.name = format!("{}:{until} + {}:{from}", self.name, other.name);
        joined.log.rows.retain(|r| r.key < until);
        joined.truth.retain(|(k, _)| *k < until);
        let last = joined.log.rows.last().unwrap().clone();
        let mut rows = other.log.rows.iter().filter(|r| r.key >= from).peekable();
        let first = rows.peek().unwrap().odometry;
        let mut at = last.at;
        for row in rows {
            at += Duration::from_millis(if row.is_key { 1_500 } else { 66 });
            let mut scan = row.scan.clone();
            scan.at = at;
            joined.log.rows.push(Row {
                key: row.key - from + until,
                at,
                odometry: last.odometry.then(&first.step_to(&row.odometry)),
                scan,
                ..*row
            });
        }
        for (key, pose) in other.truth.iter().filter(|(k, _)| *k >= from) {
            joined.truth.push((key - from + until, *pose));
        }
        joined
    }

    /// A start within 0.15 m and 0.1 rad of the truth, by the seed.
    pub fn start_near_truth(&self, seed: u64) -> MapPose {
        let mut random = Random::new(seed.wrapping_mul(77) + 5);
        let mut offset = |limit: f64| (f64::from(random.uniform()) * 2.0 - 1.0) * limit;
        let first = self.log.rows[0].key;
        let t = self.truth_at(first).unwrap();
        MapPose::new(
            t.x_m + offset(0.1),
            t.y_m + offset(0.1),
            t.yaw_rad + offset(0.1),
        )
    }

    pub fn track(&self, seed: u64) -> Vec<Judged> {
        self.replay(Begin::At(self.start_near_truth(seed)), seed)
    }

    pub fn search(&self, seed: u64) -> Vec<Judged> {
        self.replay(Begin::Anywhere, seed)
    }

    pub fn replay(&self, begin: Begin, seed: u64) -> Vec<Judged> {
        let mut replay = Replay::new(&EstimatorParams::default(), &self.plan, begin, seed);
        judge(&replay.run(&self.log.rows), &self.truth)
    }
}
