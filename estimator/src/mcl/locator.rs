//! When to believe the particles: searching, localized, lost.
//!
//! A wrong claim is the worst outcome, so a place is published as ours only after it was confirmed, and it is never given
//! up for a better-looking one on a single update.
//!
//! | State | Goes to | When |
//! | --- | --- | --- |
//! | Searching (known start) | Localized | mass and fit good for half a second |
//! | Searching (unknown start) | Localized | two searches of different views agree with the particles, mass and fit good for a second |
//! | Localized | Lost | fit or mass bad, or no ranges, for two seconds; not while what the plan does not show hides its walls |
//! | Lost | Localized | mass and fit good for a second and no search disagrees; elsewhere: as from an unknown start |

mod asking;

use super::beams::LevelBeam;
use super::cluster::{self, Cluster};
use super::field::Field;
use super::filter::ParticleFilter;
use super::particles::Particles;
use super::planar::Planar;
use super::sensor::{self, ReadingNoise};
use super::stack::Stack;
use crate::EstimatorParams;
use arrayvec::ArrayVec;
use core::f64::consts::TAU;
use std::sync::Arc;
use vehicle::{FloorPlan, Localization, LocalizationState, MapPose, Timestamp};

/// Readings waiting for the next update; two full scans.
const MAX_PENDING: usize = sensor::MAX_READINGS;
/// An update is due when readings of this weight wait (a ray counts 1, a cone 4) ...
const DUE_WEIGHT: u32 = 24;
/// ... or the oldest waits this long, s ...
const DUE_S: f64 = 0.25;
/// ... or the vehicle has moved or turned this far, m and rad.
const DUE_M: f64 = 0.10;
const DUE_RAD: f64 = 0.10;
/// All of a scan is news after moving or turning this far, m and rad.
const NEWS_M: f64 = 0.05;
const NEWS_RAD: f64 = 0.05;
/// News of a vehicle that stands still: none would freeze errors, all would count one view many times.
const NEWS_STILL: f64 = 0.15;
/// A cluster this near to the published pose is the published one.
const SAME_M: f64 = 0.5;
const SAME_RAD: f64 = 0.5;
/// Another cluster must stay heaviest for this long, s, and be this near, m, to take over without a search.
const RIVAL_S: f64 = 1.0;
const RIVAL_REACH_M: f64 = 1.0;
/// While nothing is claimed the published place goes to the heaviest cluster, if that has this share: of two places that look
/// alike the particles like now the one and now the other better.
const TAKEN_MASS: f64 = 0.8;
/// Weight share and fit that count as good, and as bad.
const GOOD_MASS: f64 = 0.8;
const BAD_MASS: f64 = 0.4;
/// Below this fit the published place is doubted: searches look for a better one. Above the other it is not.
const DOUBTED_FIT: f64 = 0.9;
const REASSURED_FIT: f64 = 0.97;
/// Most mass that is published for a place that the ranges contradict, and for one that no search has judged yet.
const DOUBTED_MASS: f64 = 0.5;
const UNCONFIRMED_MASS: f64 = 0.75;
/// The plan is hidden where more than this share of the returns come from open floor and less than the other contradict the place:
/// unmapped things all around, which say nothing about it. What odometry carries on is believed as long as the particles have not
/// spread farther than this, m: every way (or minute) without walls widens them.
const HIDDEN_SHORT: f64 = 0.4;
const HIDDEN_CONTRADICTING: f64 = 0.15;
const HIDDEN_STD_M: f64 = 0.35;
/// Bad for this long is lost, s.
const LOST_S: f64 = 2.0;
/// Time constant of the published fit, s.
const FIT_S: f64 = 0.4;

/// A pose on the plan, from ranges and odometry only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fix {
    /// When it is true: stamp of the newest reading.
    pub at: Timestamp,
    /// Pose on the plan.
    pub pose: MapPose,
    /// Odometry pose at the same moment: carry the fix forward with what odometry did since.
    pub odometry: Planar,
    /// Covariance of x, y, yaw, m2, m rad, rad2.
    pub covariance: [[f64; 3]; 3],
    /// True if the pose jumped: it is no continuation of the one before.
    pub is_jump: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// The start was told; particles are around it.
    Confirming,
    /// The start is not known.
    Searching,
    Localized,
    Lost,
}

/// A cluster that would like to be the published one.
#[derive(Clone, Copy, Debug)]
struct Rival {
    pose: Planar,
    since: Timestamp,
    updates: u32,
}

/// Localization on one plan.
#[derive(Clone, Debug)]
pub struct Locator {
    filter: ParticleFilter,
    phase: Phase,
    pending: ArrayVec<LevelBeam, MAX_PENDING>,
    pending_weight: u32,
    pending_since: Option<Timestamp>,
    /// Newest reading: stamp and odometry pose.
    newest: Option<(Timestamp, Planar)>,
    /// Stamp and odometry pose of the last update.
    updated: Option<(Timestamp, Planar)>,
    held: Option<Planar>,
    rival: Option<Rival>,
    good_since: Option<Timestamp>,
    bad_since: Option<Timestamp>,
    stack: Stack,
    agreements: u32,
    disagrees: bool,
    /// Share that the last search gave to the held place among all that it found.
    search_share: f64,
    /// The published place explains too little of what is seen: searches look for a better one.
    is_doubted: bool,
    /// The held pose continues the one last published, or the told start.
    is_continuous: bool,
    asked: Option<(u32, Timestamp)>,
    next_id: u32,
    status: Localization,
    /// Shares of the returns that fall short of the plan's walls at the held place, and that contradict it; smoothed as the fit is.
    shares: [f64; 2],
    /// Weight share of the held cluster.
    mass: f64,
    covariance: [[f64; 3]; 3],
    good_fit: f64,
    bad_fit: f64,
    noise: ReadingNoise,
}

impl Locator {
    /// A locator without a start: call [`Locator::start_at`] or [`Locator::start_unknown`].
    #[must_use]
    pub fn new(params: &EstimatorParams, plan: &FloorPlan, seed: u64) -> Self {
        let field = Arc::new(Field::new(plan));
        Self {
            filter: ParticleFilter::new(params, field, seed),
            phase: Phase::Searching,
            pending: ArrayVec::new(),
            pending_weight: 0,
            pending_since: None,
            newest: None,
            updated: None,
            held: None,
            rival: None,
            good_since: None,
            bad_since: None,
            stack: Stack::default(),
            agreements: 0,
            disagrees: false,
            search_share: 0.0,
            is_doubted: false,
            is_continuous: false,
            asked: None,
            next_id: 0,
            status: Localization::default(),
            shares: [0.0; 2],
            mass: 0.0,
            covariance: [[0.0; 3]; 3],
            good_fit: params.good_fit,
            bad_fit: params.bad_fit,
            noise: params.into(),
        }
    }

    /// Starts at a told pose, known to within standard deviations of metres and radians.
    pub fn start_at(&mut self, pose: MapPose, std_xy_m: f64, std_yaw_rad: f64) {
        self.forget();
        self.phase = Phase::Confirming;
        self.is_continuous = true;
        self.held = Some(pose.into());
        self.filter.start_around(&pose, std_xy_m, std_yaw_rad);
    }

    /// Starts anywhere on the plan.
    pub fn start_unknown(&mut self) {
        self.forget();
        self.phase = Phase::Searching;
    }

    fn forget(&mut self) {
        self.filter.clear();
        self.pending.clear();
        self.pending_weight = 0;
        self.pending_since = None;
        self.updated = None;
        self.held = None;
        self.rival = None;
        self.good_since = None;
        self.bad_since = None;
        self.stack.clear();
        self.agreements = 0;
        self.search_share = 0.0;
        self.disagrees = false;
        self.is_doubted = false;
        self.is_continuous = false;
        self.shares = [0.0; 2];
        self.asked = None;
        let reset_counter = self.status.reset_counter;
        let state = if self.newest.is_some() {
            LocalizationState::Searching
        } else {
            LocalizationState::Off
        };
        self.status = Localization {
            state,
            reset_counter,
            ..Localization::default()
        };
    }

    /// What is known.
    #[must_use]
    pub const fn status(&self) -> &Localization {
        &self.status
    }

    /// Odometry pose of the last update: what [`Locator::status`] is true at.
    #[must_use]
    pub fn updated_at(&self) -> Option<Planar> {
        self.updated.map(|(_, odometry)| odometry)
    }

    /// Covariance of the published pose: x, y, yaw, m2, m rad, rad2.
    #[must_use]
    pub const fn covariance(&self) -> [[f64; 3]; 3] {
        self.covariance
    }

    /// The particles.
    #[must_use]
    pub const fn particles(&self) -> &Particles {
        self.filter.particles()
    }

    /// The plan's table.
    #[must_use]
    pub const fn field(&self) -> &Arc<Field> {
        self.filter.field()
    }

    /// Adds readings about the body, taken at an odometry pose. Readings older than the last update are used too: they
    /// are attached to odometry, not to time.
    pub fn add(&mut self, at: Timestamp, odometry: &Planar, beams: &[LevelBeam]) {
        if !odometry.is_finite() {
            return;
        }
        if self.newest.is_none_or(|(t, _)| at >= t) {
            self.newest = Some((at, *odometry));
        }
        let axes = odometry.axes();
        for beam in beams {
            if self.pending.try_push(beam.outward(&axes)).is_ok() {
                self.pending_weight += if beam.is_ray() { 1 } else { 4 };
            }
        }
        if !beams.is_empty() {
            self.pending_since.get_or_insert(at);
        }
    }

    /// True if enough readings wait.
    #[must_use]
    pub fn is_due(&self) -> bool {
        let (Some(since), Some((at, pose))) = (self.pending_since, self.newest) else {
            return false;
        };
        let moved = self.updated.is_none_or(|(_, last)| {
            let step = last.step_to(&pose);
            step.length() >= DUE_M || step.yaw.abs() >= DUE_RAD
        });
        self.pending_weight >= DUE_WEIGHT || at.seconds_since(since) >= DUE_S || moved
    }

    /// Time passes: updates the particles if enough readings wait. `noise_scale` is 1 with flow odometry, larger when
    /// odometry is borrowed.
    pub fn update(&mut self, now: Timestamp, noise_scale: f64) -> Option<Fix> {
        self.watch_silence(now);
        if !self.is_due() {
            return None;
        }
        let (at, odometry) = self.newest?;
        let step = self
            .updated
            .map_or_else(Planar::default, |(_, last)| last.step_to(&odometry));
        let dt = self
            .updated
            .map_or(FIT_S, |(then, _)| at.seconds_since(then).clamp(0.0, 10.0));
        let is_first = self.updated.replace((at, odometry)).is_none();
        if self.status.state == LocalizationState::Off {
            self.status.state = LocalizationState::Searching;
        }
        let stacks = match self.phase {
            Phase::Searching | Phase::Lost => true,
            Phase::Localized => self.is_doubted || self.bad_since.is_some(),
            Phase::Confirming => self.bad_since.is_some(),
        };
        if stacks {
            self.stack.add(at, &odometry, &self.pending);
        }
        let axes = odometry.axes();
        let beams: ArrayVec<LevelBeam, MAX_PENDING> =
            self.pending.iter().map(|b| b.inward(&axes)).collect();
        self.pending.clear();
        self.pending_weight = 0;
        self.pending_since = None;

        let news = if is_first {
            1.0
        } else {
            (step.length() / NEWS_M + step.yaw.abs() / NEWS_RAD).clamp(NEWS_STILL, 1.0)
        };
        let corrected = self.filter.drift().corrected(&step);
        let held_before = self.held.map(|h| h.then(&corrected));
        self.rival = self.rival.map(|r| Rival {
            pose: r.pose.then(&corrected),
            ..r
        });
        let updated = self.filter.update(&step, noise_scale, &beams, news)?;
        self.status.effective_particles = updated.effective;
        self.status.particles = self.filter.particles().len() as u32;
        let (cluster, is_jump) = self.choose(at, held_before, &updated.heaviest, &beams);
        self.held = Some(cluster.pose);
        self.status.pose = Some(cluster.pose.into());
        self.mass = cluster.mass;
        self.covariance = cluster.covariance;
        let agreement = sensor::agreement(self.filter.field(), &beams, &cluster.pose);
        let a = if is_jump { 1.0 } else { (dt / FIT_S).min(1.0) };
        if let Some(fit) = agreement.fit() {
            self.status.fit += a * (fit - self.status.fit);
        }
        for (held, share) in self
            .shares
            .iter_mut()
            .zip(agreement.shares().iter().flatten())
        {
            *held += a * (share - *held);
        }
        self.is_continuous &= !is_jump;
        self.judge(at);
        self.status.mass = self.claimed_mass();
        let is_confirmed = self.phase == Phase::Localized
            && !is_jump
            && self.bad_since.is_none()
            && !self.is_hidden()
            && self.mass > GOOD_MASS;
        self.filter
            .learn(is_confirmed.then_some(&cluster), &odometry);
        if self.phase != Phase::Localized {
            return None;
        }
        let is_jump = !self.is_continuous;
        self.is_continuous = true;
        if is_jump {
            self.status.reset_counter = self.status.reset_counter.wrapping_add(1);
        }
        Some(Fix {
            at,
            pose: cluster.pose.into(),
            odometry,
            covariance: cluster.covariance,
            is_jump,
        })
    }

    /// Chooses what to publish: the heaviest cluster if it continues the published pose, else the published place itself
    /// until the rival has proven itself. True if the pose jumped.
    fn choose(
        &mut self,
        at: Timestamp,
        held: Option<Planar>,
        heaviest: &Cluster,
        beams: &[LevelBeam],
    ) -> (Cluster, bool) {
        let Some(held) = held else {
            return (*heaviest, true);
        };
        if heaviest.pose.is_near(&held, SAME_M, SAME_RAD) {
            self.rival = None;
            return (*heaviest, false);
        }
        let rival = match self.rival {
            Some(r) if r.pose.is_near(&heaviest.pose, SAME_M, SAME_RAD) => Rival {
                pose: heaviest.pose,
                updates: r.updates + 1,
                ..r
            },
            _ => Rival {
                pose: heaviest.pose,
                since: at,
                updates: 1,
            },
        };
        self.rival = Some(rival);
        let field = self.filter.field();
        let fit_of = |pose: &Planar| sensor::agreement(field, beams, pose).fit().unwrap_or(0.0);
        let has_lasted = at.seconds_since(rival.since) >= RIVAL_S && rival.updates >= 5;
        let is_better = heaviest.mass > 0.7 && fit_of(&heaviest.pose) > fit_of(&held) + 0.05;
        let is_reachable = heaviest.pose.distance(&held) <= RIVAL_REACH_M;
        let may_switch = match self.phase {
            Phase::Localized => is_better && is_reachable,
            // Nothing is claimed yet, so nothing jumps for anyone.
            Phase::Confirming | Phase::Searching | Phase::Lost => heaviest.mass > TAKEN_MASS,
        };
        if has_lasted && may_switch {
            self.rival = None;
            self.good_since = None;
            self.agreements = 0;
            self.search_share = UNCONFIRMED_MASS;
            return (*heaviest, true);
        }
        let stay = cluster::around(self.filter.particles(), &held)
            .filter(|c| c.mass > 0.02)
            .unwrap_or(Cluster {
                pose: held,
                mass: 0.0,
                covariance: heaviest.covariance,
            });
        (stay, false)
    }

    /// Moves between the states.
    fn judge(&mut self, at: Timestamp) {
        let (mass, fit) = (self.mass, self.status.fit);
        // A plan without open floor has no place to be at, however near its walls are.
        let has_place = self.filter.field().open_area_m2() > 0.0;
        let is_good = mass >= GOOD_MASS && fit >= self.good_fit && has_place;
        let is_unexplained =
            fit < self.bad_fit && !(self.phase == Phase::Localized && self.is_hidden());
        let is_bad = mass < BAD_MASS || is_unexplained;
        self.good_since = if is_good {
            Some(self.good_since.unwrap_or(at))
        } else {
            None
        };
        let good_s = self.good_since.map_or(-1.0, |t| at.seconds_since(t));
        if !is_bad {
            self.bad_since = None;
        } else if self.bad_since.is_none() {
            self.bad_since = Some(at);
            if self.phase == Phase::Localized && !self.is_doubted {
                self.stack.clear();
            }
        }
        if self.phase == Phase::Localized {
            if fit < DOUBTED_FIT && !self.is_doubted {
                self.is_doubted = true;
                if self.bad_since.is_none_or(|t| t == at) {
                    self.stack.clear();
                }
            } else if fit > REASSURED_FIT {
                self.is_doubted = false;
            }
        }
        let claim = match self.phase {
            Phase::Localized => {
                if self
                    .bad_since
                    .is_some_and(|t| at.seconds_since(t) >= LOST_S)
                {
                    self.lose();
                }
                false
            }
            Phase::Confirming => {
                if self
                    .bad_since
                    .is_some_and(|t| at.seconds_since(t) >= LOST_S)
                {
                    // What was told is not true.
                    self.phase = Phase::Searching;
                    self.stack.clear();
                }
                good_s >= 0.5
            }
            Phase::Searching => self.is_confirmed_by_search() && good_s >= 1.0,
            Phase::Lost => good_s >= 1.0 && (!self.disagrees || self.is_confirmed_by_search()),
        };
        if claim {
            self.phase = Phase::Localized;
            self.status.state = LocalizationState::Localized;
            self.bad_since = None;
            self.asked = None;
        }
    }

    /// True while unmapped things hide the plan's walls, nothing contradicts the place, and odometry has not led far on its own.
    fn is_hidden(&self) -> bool {
        let [short, contradicting] = self.shares;
        let [[xx, ..], [_, yy, _], _] = self.covariance;
        short > HIDDEN_SHORT
            && contradicting < HIDDEN_CONTRADICTING
            && xx + yy < HIDDEN_STD_M * HIDDEN_STD_M
    }

    /// What is published as mass. The particles' own share says how they agree with each other, which after a wrong start
    /// they do too: a place that nothing else confirms is claimed by less.
    fn claimed_mass(&self) -> f64 {
        let limit = match self.phase {
            Phase::Confirming => 1.0,
            Phase::Localized if self.bad_since.is_some() => DOUBTED_MASS,
            Phase::Localized => 1.0,
            Phase::Searching | Phase::Lost if self.bad_since.is_some() => DOUBTED_MASS,
            Phase::Searching | Phase::Lost => self.search_share,
        };
        self.mass.min(limit)
    }

    fn is_confirmed_by_search(&self) -> bool {
        self.agreements >= 2 || (self.agreements >= 1 && self.stack.swept_rad() > 0.9 * TAU)
    }

    fn lose(&mut self) {
        self.phase = Phase::Lost;
        self.status.state = LocalizationState::Lost;
        self.is_doubted = false;
        self.good_since = None;
        self.agreements = 0;
        self.disagrees = false;
    }

    fn watch_silence(&mut self, now: Timestamp) {
        let silent = self
            .newest
            .is_some_and(|(at, _)| now.seconds_since(at) > LOST_S);
        if silent && self.phase == Phase::Localized {
            self.lose();
        }
    }
}

#[cfg(test)]
mod tests;
