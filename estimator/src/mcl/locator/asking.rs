//! When the locator asks for a global search, and what it makes of the answer.

use super::{Locator, Phase, SAME_M, SAME_RAD};
use crate::mcl::planar::Planar;
use crate::mcl::search::{SearchRequest, SearchResult};
use std::sync::Arc;
use vehicle::MapPose;

/// A search is decisive if the best place is better than the next by this much log-likelihood; readings of a stacked
/// scan are correlated, so each counts [`READING_WEIGHT`].
const DECISIVE: f64 = 3.0;
const READING_WEIGHT: f64 = 0.25;
/// Unanswered for this long, a search is asked again, s.
const ANSWER_S: f64 = 10.0;

impl Locator {
    /// A search to run outside the loop, if one is wanted now.
    pub fn poll_job(&mut self) -> Option<SearchRequest> {
        let wants = match self.phase {
            Phase::Searching | Phase::Lost => true,
            Phase::Confirming | Phase::Localized => false,
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
        let (ray_std_m, cone_std_m, random_share) = self.search_params;
        Some(SearchRequest {
            id,
            field: Arc::clone(self.filter.field()),
            readings,
            reference,
            ray_std_m,
            cone_std_m,
            random_share,
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
        let margin = result.peaks.get(1).map_or(f64::INFINITY, |second| {
            (best.score - second.score) * readings
        });
        let is_decisive = margin >= DECISIVE && best.fit >= self.good_fit;
        let agrees = self
            .held
            .is_some_and(|held| held.is_near(&here(best.pose), SAME_M, SAME_RAD));
        if agrees {
            self.agreements += u32::from(is_decisive);
            // A place that the particles were sent to by a search that could not decide is not confirmed by another.
            self.disagrees &= !(is_decisive || self.is_continuous);
            return;
        }
        self.agreements = u32::from(is_decisive && self.phase == Phase::Searching);
        self.disagrees = true;
        let share = |score: f64| libm::exp(((score - best.score) * readings).max(-20.0));
        let peaks = result
            .peaks
            .iter()
            .map(|p| (here(p.pose).into(), share(p.score)));
        let portion = if self.phase == Phase::Searching {
            1.0
        } else {
            0.7
        };
        self.filter.start_at_peaks(peaks, portion);
        if self.phase == Phase::Searching {
            self.held = Some(here(best.pose));
            self.is_continuous = false;
            self.rival = None;
        }
        self.good_since = None;
    }
}
