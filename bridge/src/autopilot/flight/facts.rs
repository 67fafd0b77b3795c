//! What the supervisor's table looks at.

use super::super::endurance::Endurance;
use super::super::failsafes::Facts;
use super::super::modes::Air;
use super::super::watch::Look;
use super::Flight;
use estimator::kalman::Aid;
use vehicle::{NavState, Timestamp};

impl Flight {
    pub(super) fn keep_watch(&mut self, now: Timestamp, dt_s: f64, nav: &NavState) {
        let filter = self.estimator.navigation();
        let refused_s = [Aid::Roll, Aid::Pitch]
            .map(|aid| filter.refused_s(aid))
            .into_iter()
            .fold(0.0, f64::max);
        let is_online = self.fc.is_connected && self.client.is_online();
        // What it manages while it is kept busy, and what arrives of it.
        let line = self.client.statistics();
        let answers_hz = line.service_rate_hz.min(line.reply_rate_hz);
        self.watch.look(&Look {
            now,
            dt_s,
            nav,
            is_flying: self.air == Air::Flying,
            tilt_refused_s: refused_s,
            setpoint: self.snapshot.setpoint,
            goal: self.navigator.goal().map(|goal| goal.position),
            battery: self.snapshot.battery,
            fc_rate_hz: is_online.then_some(answers_hz),
            beats: (
                self.snapshot.flight_loop.ticks,
                self.snapshot.flight_loop.missed,
            ),
            params: &self.settings.autopilot,
        });
    }

    /// What the rows of the table look at.
    pub(super) fn facts(
        &self,
        now: Timestamp,
        loop_gap_s: f64,
        spare_s: Option<f64>,
        nav: &NavState,
    ) -> Facts<'_> {
        let since =
            |at: Option<Timestamp>| at.map_or(f64::INFINITY, |at| now.since(at).as_secs_f64());
        let watched = self
            .watch
            .facts(now, nav.position, &self.settings.autopilot);
        Facts {
            mode: self.arbiter.mode().mode,
            is_flying: self.air == Air::Flying,
            is_armed: self.arming.is_armed(),
            has_attitude_and_height: nav.health.attitude && nav.health.height,
            not_localized_s: since(self.localized_at),
            search_s: self.arbiter.search_s(),
            rangers_silent_s: since(self.ring.horizontal_at()),
            ground_silent_s: self.ground_heard.map(|at| now.since(at).as_secs_f64()),
            offboard_silent_s: self.arbiter.offboard_silent_s(now),
            manual_silent_s: self.arbiter.manual_silent_s(now),
            battery: self.snapshot.battery.and_then(|b| b.remaining),
            spare_s,
            fc_silent_s: self.fc_silent_s(now),
            loop_gap_s,
            ..watched
        }
    }

    /// Time the battery lasts beyond the way home and the landing, s.
    pub(super) fn spare_s(&mut self, nav: &NavState) -> Option<f64> {
        if let Some(battery) = &self.snapshot.battery {
            self.endurance.sample(battery, self.air == Air::Flying);
        }
        let left_s = self.endurance.left_s(&self.settings.autopilot);
        let way_m = self.navigator.way_home_m(nav);
        (self.snapshot.endurance_s, self.snapshot.way_home_m) = (left_s, way_m);
        let cruise_mps = self.settings.planner.cruise_mps;
        let home_s = Endurance::home_s(way_m?, nav.height_m, cruise_mps, &self.settings.autopilot);
        Some(left_s? - home_s)
    }
}
