//! Global start: where on the plan could a stacked scan have been taken?
//!
//! An exhaustive match of the scan against the likelihood field over all open poses, coarse to fine: a block of 0.3 m is
//! judged by the best any pose in it could reach (distance minimum over the block), the best blocks are opened into poses
//! 7.5 cm apart, the best of those are refined to 5 mm and a quarter of a degree and must also explain why nothing was
//! seen through walls. A pure function without threads or random numbers: it is run as a job outside the loop.

use super::beams::{Evidence, LevelBeam};
use super::field::Field;
use super::planar::{Axes, Planar};
use super::sensor::{ReadingNoise, SensorModel};
use super::stack::{FULL_SUPPORT, MAX_STACK, Supported};
use arrayvec::ArrayVec;
use core::f64::consts::TAU;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vehicle::MapPose;

/// Most places a search reports.
pub const MAX_PEAKS: usize = 8;
/// Directions tried: every 5 degrees.
const YAWS: usize = 72;
/// Side of a block, m: the square that [`Field::nearest_around`] covers.
const BLOCK_M: f64 = 2.0 * super::field::AROUND_M;
/// Poses along a block's side (7.5 cm apart).
const FINE: usize = 4;
/// Blocks opened.
const MAX_BLOCKS: usize = 4_000;
/// Poses refined.
const MAX_REFINED: usize = 48;
/// Two peaks closer than this are one place.
const SAME_M: f64 = 0.35;
const SAME_RAD: f64 = 0.35;
/// A wall this far before the measured hit should have been hit instead, m.
const THROUGH_M: f64 = 0.25;
/// Deviation of the first look: half a step in place and angle smear a hit by this much, m.
const BROAD_STD_M: f64 = 0.12;

/// A question for [`search`].
#[derive(Clone, Debug, PartialEq)]
pub struct SearchRequest {
    /// Which question; the answer carries it back.
    pub id: u32,
    /// The plan.
    pub field: Arc<Field>,
    /// The stacked scan in the axes of the reference pose.
    pub readings: ArrayVec<Supported, MAX_STACK>,
    /// Odometry pose the scan is given in.
    pub reference: Planar,
    /// Where the reference pose is thought to be on the plan: looked at in any case.
    pub held: Option<Planar>,
    /// How far readings end from walls.
    pub noise: ReadingNoise,
}

/// A place that explains the scan.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Peak {
    /// Where the reference pose is on the plan.
    pub pose: MapPose,
    /// Mean log-likelihood of a reading, 0 at best.
    pub score: f64,
    /// Share of readings that end at a wall and pass through none, 0..=1.
    pub fit: f64,
}

/// The answer of [`search`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SearchResult {
    /// Which question.
    pub id: u32,
    /// Odometry pose of the question.
    pub reference: Planar,
    /// How good the place is that was thought to be ours.
    pub held: Option<Peak>,
    /// Places, best first.
    pub peaks: ArrayVec<Peak, MAX_PEAKS>,
    /// Readings looked at, those of little support counted by their share of it.
    pub readings: f64,
}

/// Looks for the places where the scan could have been taken. Same question, same answer, to the bit.
#[must_use]
pub fn search(request: &SearchRequest) -> SearchResult {
    let mut result = SearchResult {
        id: request.id,
        reference: request.reference,
        held: None,
        peaks: ArrayVec::new(),
        readings: request.readings.iter().map(weight_of).sum(),
    };
    if request.readings.is_empty() {
        return result;
    }
    let matcher = Matcher::new(request);
    let blocks = matcher.blocks();
    let seeds = matcher.open(&blocks);
    let mut peaks: Vec<Peak> = seeds.iter().map(|p| matcher.refine(p)).collect();
    result.held = request.held.map(|p| matcher.refine(&p));
    peaks.extend(result.held);
    sort_best_first(&mut peaks, |p| p.score);
    for p in peaks {
        let is_new = result
            .peaks
            .iter()
            .all(|q| !Planar::from(q.pose).is_near(&p.pose.into(), SAME_M, SAME_RAD));
        if is_new && result.peaks.try_push(p).is_err() {
            break;
        }
    }
    result
}

/// Best first; equals stay in their order, so that the answer does not depend on the sort.
fn sort_best_first<T>(items: &mut [T], score: impl Fn(&T) -> f64) {
    items.sort_by(|a, b| score(b).total_cmp(&score(a)));
}

/// The best blocks. Those that stand first win against equals, so that it does not matter how often this is called on the way.
fn keep_best(blocks: &mut Vec<Scored>) {
    sort_best_first(blocks, |b| f64::from(b.score));
    blocks.truncate(MAX_BLOCKS);
}

/// What a reading counts, 0..=1.
fn weight_of(reading: &Supported) -> f64 {
    f64::from(reading.support) / f64::from(FULL_SUPPORT)
}

struct Matcher<'a> {
    request: &'a SearchRequest,
    field: &'a Field,
    broad: SensorModel,
    sharp: SensorModel,
}

#[derive(Clone, Copy)]
struct Scored {
    /// Units of cells.
    u: f32,
    v: f32,
    yaw: usize,
    score: f32,
}

/// A reading turned into one of the directions, in units of cells.
struct Turned {
    points: [[f32; 2]; 3],
    is_ray: bool,
    evidence: Evidence,
    weight: f32,
}

impl Turned {
    /// The least distance code of its candidate points.
    #[inline]
    fn least(&self, code: impl Fn(f32, f32) -> u8) -> u8 {
        let [a, b, c] = self.points;
        let middle = code(b[0], b[1]);
        if self.is_ray {
            return middle;
        }
        middle.min(code(a[0], a[1])).min(code(c[0], c[1]))
    }
}

impl<'a> Matcher<'a> {
    fn new(request: &'a SearchRequest) -> Self {
        let noise = request.noise;
        let widen = BROAD_STD_M / noise.ray_std_m;
        Self {
            request,
            field: &request.field,
            broad: SensorModel::new(&ReadingNoise {
                ray_std_m: BROAD_STD_M,
                laser_std_m: BROAD_STD_M,
                cone_std_m: noise.cone_std_m * widen.min(1.5),
                ..noise
            }),
            sharp: SensorModel::new(&noise),
        }
    }

    /// The scan turned into one of the directions, in units of cells.
    fn turned(&self, yaw: usize, every: usize) -> Vec<Turned> {
        let turn = Planar::new(0.0, 0.0, yaw as f64 * TAU / YAWS as f64).axes();
        let cell_m = self.field.cell_m();
        self.request
            .readings
            .iter()
            .step_by(every.max(1))
            .map(|r| Turned {
                points: r
                    .beam
                    .points
                    .map(|p| turn.outward(p).map(|v| (v / cell_m) as f32)),
                is_ray: r.beam.is_ray(),
                evidence: r.beam.evidence,
                weight: weight_of(r) as f32,
            })
            .collect()
    }

    /// The best blocks by what any pose in them could reach.
    fn blocks(&self) -> Vec<Scored> {
        let every = self.request.readings.len().div_ceil(96);
        let side = (BLOCK_M / self.field.cell_m()) as f32;
        let columns = (self.field.width() as f32 / side) as usize + 1;
        let rows = (self.field.height() as f32 / side) as usize + 1;
        let step = side / FINE as f32;
        let mut out = Vec::with_capacity(2 * MAX_BLOCKS);
        let mut open = Vec::new();
        for r in 0..rows {
            for c in 0..columns {
                let (u, v) = (c as f32 * side, r as f32 * side);
                let any = (0..FINE * FINE).any(|k| {
                    let (i, j) = ((k % FINE) as f32, (k / FINE) as f32);
                    self.is_possible(u + (i + 0.5) * step, v + (j + 0.5) * step)
                });
                if any {
                    open.push((u + 0.5 * side, v + 0.5 * side));
                }
            }
        }
        for yaw in 0..YAWS {
            let points = self.turned(yaw, every);
            let all: f32 = points.iter().map(|r| r.weight).sum();
            for (u, v) in &open {
                // A large building has a hundred times as many blocks as are opened: only the best so far are held.
                if out.len() == 2 * MAX_BLOCKS {
                    keep_best(&mut out);
                }
                let mut sum = 0.0;
                for reading in &points {
                    let code = reading.least(|px, py| self.field.nearest_around(u + px, v + py));
                    sum += reading.weight * self.broad.log(reading.evidence, code);
                }
                out.push(Scored {
                    u: *u,
                    v: *v,
                    yaw,
                    score: sum / all,
                });
            }
        }
        keep_best(&mut out);
        out
    }

    /// True where a vehicle could be: open floor, its centre not inside a wall.
    fn is_possible(&self, u: f32, v: f32) -> bool {
        self.field.is_open_at(u, v) && self.field.code(u, v) > 16
    }

    /// The poses inside the blocks, the best of each neighbourhood.
    fn open(&self, blocks: &[Scored]) -> Vec<Planar> {
        let side = (BLOCK_M / self.field.cell_m()) as f32;
        let step = side / FINE as f32;
        let every = self.request.readings.len().div_ceil(192);
        let mut poses = Vec::with_capacity(blocks.len());
        for yaw in 0..YAWS {
            let mut points = None;
            for block in blocks.iter().filter(|b| b.yaw == yaw) {
                let points = points.get_or_insert_with(|| self.turned(yaw, every));
                let mut best: Option<Scored> = None;
                for k in 0..FINE * FINE {
                    let u = block.u - 0.5 * side + ((k % FINE) as f32 + 0.5) * step;
                    let v = block.v - 0.5 * side + ((k / FINE) as f32 + 0.5) * step;
                    if !self.is_possible(u, v) {
                        continue;
                    }
                    let mut sum = 0.0;
                    for reading in points.iter() {
                        let code = reading.least(|px, py| self.field.code(u + px, v + py));
                        sum += reading.weight * self.broad.log(reading.evidence, code);
                    }
                    if best.is_none_or(|b| sum > b.score) {
                        best = Some(Scored {
                            u,
                            v,
                            yaw,
                            score: sum,
                        });
                    }
                }
                poses.extend(best);
            }
        }
        sort_best_first(&mut poses, |p| f64::from(p.score));
        let mut out: Vec<Planar> = Vec::with_capacity(MAX_REFINED);
        for s in poses {
            let [ox, oy] = self.field.origin();
            let pose = Planar::new(
                ox + f64::from(s.u) * self.field.cell_m(),
                oy + f64::from(s.v) * self.field.cell_m(),
                s.yaw as f64 * TAU / YAWS as f64,
            );
            if out.iter().all(|q| !q.is_near(&pose, 0.2, 0.2)) {
                out.push(pose);
                if out.len() == MAX_REFINED {
                    break;
                }
            }
        }
        out
    }

    /// Climbs to the nearest maximum, then judges it with walls in the way.
    fn refine(&self, start: &Planar) -> Peak {
        let mut pose = *start;
        let mut model = &self.broad;
        let mut best = self.score(model, &pose);
        let (mut step_m, mut step_rad) = (0.04, 0.035);
        while step_m > 0.004 {
            let mut moved = false;
            for k in 0..6 {
                let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
                let mut next = pose;
                match k / 2 {
                    0 => next.x += sign * step_m,
                    1 => next.y += sign * step_m,
                    _ => next.yaw += sign * step_rad,
                }
                let score = self.score(model, &next);
                if score > best {
                    (pose, best, moved) = (next, score, true);
                }
            }
            if !moved {
                step_m *= 0.5;
                step_rad *= 0.5;
                if step_m < 0.03 && core::ptr::eq(model, &self.broad) {
                    model = &self.sharp;
                    best = self.score(model, &pose);
                }
            }
        }
        let (score, fit) = self.judge(&pose);
        Peak {
            pose: pose.into(),
            score,
            fit,
        }
    }

    fn nearest_m(&self, beam: &LevelBeam, axes: &Axes) -> f64 {
        beam.candidates()
            .iter()
            .map(|p| {
                let [x, y] = axes.outward(*p);
                self.field.distance_m(x, y)
            })
            .fold(f64::INFINITY, f64::min)
    }

    fn score(&self, model: &SensorModel, pose: &Planar) -> f64 {
        let axes = pose.axes();
        let (mut sum, mut all) = (0.0, 0.0);
        for r in &self.request.readings {
            let code = r
                .beam
                .candidates()
                .iter()
                .map(|p| {
                    let [x, y] = axes.outward(*p);
                    let (u, v) = self.field.to_cells(x, y);
                    self.field.code(u, v)
                })
                .min()
                .unwrap_or(255);
            let weight = weight_of(r);
            sum += weight * f64::from(model.log(r.beam.evidence, code));
            all += weight;
        }
        sum / all
    }

    /// Score and fit with walls in the way: a hit behind a wall is as bad as a hit in the open.
    fn judge(&self, pose: &Planar) -> (f64, f64) {
        let (mut sum, mut good, mut all) = (0.0, 0.0, 0.0);
        let axes = pose.axes();
        for r in &self.request.readings {
            let hit = axes.outward(r.beam.points[1]);
            let from = axes.outward(r.beam.origin);
            let length = libm::hypot(hit[0] - from[0], hit[1] - from[1]);
            let short = (length - THROUGH_M).max(0.0) / length.max(1e-6);
            let before = [
                from[0] + (hit[0] - from[0]) * short,
                from[1] + (hit[1] - from[1]) * short,
            ];
            let way = self.field.free_way_m(from, before);
            let is_through = way + 1e-6 < length * short;
            let nearest = if is_through {
                super::field::FAR_M
            } else {
                self.nearest_m(&r.beam, &axes)
            };
            let code = (nearest / super::field::CODE_M).min(255.0) as u8;
            let weight = weight_of(r);
            sum += weight * f64::from(self.sharp.log(r.beam.evidence, code));
            all += weight;
            if nearest < 0.15 {
                good += weight;
            }
        }
        (sum / all, good / all)
    }
}
