//! When the locator asks for a global search, and what it makes of the answer.

use super::{Locator, Phase, SAME_M, SAME_RAD, UNCONFIRMED_MASS};
use crate::mcl::filter::{SEEDED_STD_M, SEEDED_STD_RAD};
use crate::mcl::planar::Planar;
use crate::mcl::search::{SearchRequest, SearchResult};
use std::sync::Arc;
use vehicle::MapPose;

/// A search is decisive if the best place is better than the next by this much log-likelihood; readings of a stacked
/// scan are correlated, so each counts [`READING_WEIGHT`].
const DECISIVE: f64 = 3.0;
const READING_WEIGHT: f64 = 0.25;
/// For the published share each counts this much: as an estimate, not as a reason to fly.
const CLAIM_WEIGHT: f64 = 0.5;
/// The published place is refuted if another is better by this much, and explains this much more of the returns.
const REFUTED: f64 = 6.0;
const REFUTED_FIT: f64 = 0.1;
/// ... and nearly all of them where the plan is hidden (two walls of something unmapped look like a corner of the plan) or the place
/// explains most of what is seen now (glass that the plan shows is looked through: from the other end of a hall it is not).
const REFUTED_UNLESS_BAD_FIT: f64 = 0.9;
/// Unanswered for this long, a search is asked again, s.
const ANSWER_S: f64 = 10.0;

impl Locator {
    /// A search to run outside the loop, if one is wanted now.
    pub fn poll_job(&mut self) -> Option<SearchRequest> {
        let wants = match self.phase {
            Phase::Searching | Phase::Lost => true,
            Phase::Localized => self.is_doubted,
            Phase::Confirming => false,
        };
        let (now, _) = self.updated?;
        let waits = self
            .asked
            .is_some_and(|(_, then)| now.seconds_since(then) < ANSWER_S);
        if !wants || waits || !self.stack.is_ripe() {
            return None;
        }
        let (readings, reference) = self.stack.take()?;
        let id = self.next_id;
        self.next_id = self.next_id.wrapping_add(1);
        self.asked = Some((id, now));
        Some(SearchRequest {
            id,
            field: Arc::clone(self.filter.field()),
            readings,
            reference,
            held: self
                .held
                .filter(|_| matches!(self.phase, Phase::Localized | Phase::Lost)),
            noise: self.noise,
        })
    }

    /// The answer of a search.
    pub fn search_done(&mut self, result: &SearchResult) {
        if self.asked.is_none_or(|(id, _)| id != result.id) {
            return;
        }
        self.asked = None;
        let (Some((_, odometry)), Some(best)) = (self.updated, result.peaks.first()) else {
            return;
        };
        let since = result.reference.step_to(&odometry);
        let here = |pose: MapPose| Planar::from(pose).then(&since);
        let readings = result.readings * READING_WEIGHT;
        if let Some(held) = result.held {
            let advantage = (best.score - held.score) * readings;
            let is_same = Planar::from(held.pose).is_near(&best.pose.into(), SAME_M, SAME_RAD);
            if is_same {
                self.is_doubted = false;
            }
            let is_held = self.phase == Phase::Localized
                && (self.is_hidden() || self.status.fit >= self.bad_fit);
            let least_fit = if is_held {
                REFUTED_UNLESS_BAD_FIT
            } else {
                self.good_fit
            };
            let is_refuted = !is_same
                && advantage >= REFUTED
                && best.fit >= least_fit
                && best.fit >= held.fit + REFUTED_FIT;
            if self.phase == Phase::Localized {
                if !is_refuted {
                    return;
                }
                self.lose();
            }
            // The same walls are seen much better from elsewhere: somebody carried the vehicle, and nothing is left of the
            // place it was at.
            self.is_continuous &= !is_refuted;
        }
        let is_anew = self.phase == Phase::Searching || !self.is_continuous;
        let margin = result.peaks.get(1).map_or(f64::INFINITY, |second| {
            (best.score - second.score) * readings
        });
        let is_decisive = margin >= DECISIVE && best.fit >= self.good_fit;
        let share = |score: f64| libm::exp(((score - best.score) * readings).max(-20.0));
        let claim = |score: f64| libm::exp((score - best.score) * result.readings * CLAIM_WEIGHT);
        let all: f64 = result.peaks.iter().map(|p| claim(p.score)).sum();
        let agrees = self
            .held
            .is_some_and(|held| held.is_near(&here(best.pose), SAME_M, SAME_RAD));
        if agrees {
            self.search_share = 1.0 / all;
            self.agreements += u32::from(is_decisive);
            // A place that the particles were sent to by a search that could not decide is not confirmed by another.
            self.disagrees &= !(is_decisive || self.is_continuous);
            return;
        }
        self.agreements = u32::from(is_decisive && is_anew);
        self.disagrees = true;
        self.search_share = 0.0;
        let peaks = result
            .peaks
            .iter()
            .map(|p| (here(p.pose).into(), share(p.score)));
        let portion = if is_anew { 1.0 } else { 0.7 };
        self.filter.start_at_peaks(peaks, portion);
        if is_anew {
            self.held = Some(here(best.pose));
            self.search_share = 1.0 / all;
            self.is_continuous = false;
            self.rival = None;
            // Told at once, not with the next scan.
            self.status.pose = Some(here(best.pose).into());
            self.status.mass = self.search_share.min(UNCONFIRMED_MASS);
            let variance = [SEEDED_STD_M, SEEDED_STD_M, SEEDED_STD_RAD].map(|s| s * s);
            self.covariance = [
                [variance[0], 0.0, 0.0],
                [0.0, variance[1], 0.0],
                [0.0, 0.0, variance[2]],
            ];
        }
        self.good_since = None;
    }
}
