//! Sensors of the companion computer: where each sample goes, and what is told of the place.

use super::super::door::{Event, Notice};
use super::super::io::Output;
use super::Flight;
use crate::sensor::Sample;
use crate::sensor::ring::Measured;
use arrayvec::ArrayVec;
use core::time::Duration;
use vehicle::{DownRange, FlowSample, GnssFix, NavState, Timestamp};

impl Flight {
    pub(super) fn range(&mut self, reading: &vehicle::RangerReading) {
        if self.ring.looks_around(reading) {
            self.watch.ranger(reading, self.estimator.state().position);
        }
        let mut measured = ArrayVec::<Measured, 2>::new();
        self.ring.read(reading, |m| {
            let _ = measured.try_push(m);
        });
        for m in measured {
            match m {
                Measured::Scan(scan) => {
                    self.estimator.scan(&scan);
                    self.navigator.observe(&scan, self.estimator.state());
                }
                Measured::Down(sample) => self.down_range(&sample),
            }
        }
    }

    pub(super) fn down_range(&mut self, sample: &DownRange) {
        self.estimator.down_range(sample);
        self.snapshot.down_range = Some(*sample);
    }

    pub(super) fn gnss(&mut self, fix: &GnssFix) {
        if self.settings.autopilot.gnss {
            self.estimator.gnss(fix);
        }
        self.snapshot.gnss = Some(*fix);
    }

    /// A sample that came over a link.
    pub(super) fn sensed(&mut self, sample: &Sample) {
        match sample {
            Sample::Ranger(reading) => self.range(reading),
            Sample::DownRange(range) => self.down_range(range),
            Sample::Flow(flow) => self.flow(flow),
            Sample::Gnss(fix) => self.gnss(fix),
            Sample::Pose(pose) => self.estimator.external_pose(pose),
        }
    }

    pub(super) fn flow(&mut self, sample: &FlowSample) {
        self.estimator.flow(sample);
        self.snapshot.flow = Some(*sample);
    }

    pub(super) fn notice_localization(&mut self, now: Timestamp, nav: &NavState) {
        let was_lost = self
            .localized_at
            .is_none_or(|at| now.since(at) > Duration::from_millis(500));
        if nav.localization.reset_counter != self.reset_counter {
            self.reset_counter = nav.localization.reset_counter;
            self.controller.reset(nav);
            self.arbiter.relocalized(was_lost);
        }
        if nav.health.position {
            if self.localized_at.is_none() || was_lost {
                let place = self.anchor.to_map(nav.position);
                let notice = Notice::Localized {
                    x_m: place.x(),
                    y_m: place.y(),
                };
                self.emit(Output::Event(Event::Notice(notice)));
            }
            self.localized_at = Some(now);
        } else if self.snapshot.nav.health.position {
            self.emit(Output::Event(Event::Notice(Notice::LocalizationLost)));
        }
    }
}
