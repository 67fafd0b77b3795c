//! A report at the end of each round of a patrol: rooms visited, time, way, battery, and how long a room was alone.
//!
//! A mission is a patrol if it passes named rooms of the plan. A round ends with the jump back to its beginning, or with the
//! last waypoint. Reports go out as STATUSTEXT and into the program's log.

use super::{Context, Outbox};
use crate::autopilot::door::{Event, Notice, Severity};
use crate::autopilot::mode::{Because, Mode};
use mavlink_dialect::command::cmd;
use mavlink_dialect::mission_item::{MissionItem, Point};
use std::collections::BTreeMap;
use vehicle::{In, Ned, Timestamp};

/// A waypoint this near to a room's place is in that room, m.
const IN_ROOM_M: f64 = 0.6;

/// Keeps the score of a patrol.
#[derive(Debug, Default)]
pub struct PatrolReport {
    /// Mission the tables below are of.
    mission_id: u32,
    /// Room by item.
    rooms: BTreeMap<u16, String>,
    /// Items that end a round.
    ends: Vec<u16>,
    /// A round under way.
    round: Option<Round>,
    rounds_flown: u32,
    /// When each room was visited last, in the flight under way.
    visited: BTreeMap<String, Timestamp>,
    /// Longest time a room was alone since its first visit, s.
    alone: Option<(f64, String)>,
}

#[derive(Debug)]
struct Round {
    since: Timestamp,
    way_m: f64,
    last: In<Ned>,
    rooms: Vec<String>,
}

impl PatrolReport {
    /// Nothing flown yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Learns a mission: `rooms` are the plan's, NED about home.
    pub fn learn(
        &mut self,
        id: u32,
        items: &[MissionItem],
        rooms: &[(String, In<Ned>)],
        ctx: &Context<'_>,
    ) {
        if id == self.mission_id {
            return;
        }
        *self = Self {
            mission_id: id,
            ..Self::default()
        };
        let mut last_waypoint = None;
        for (item, seq) in items.iter().zip(0..) {
            match item.command {
                cmd::NAV_WAYPOINT => {
                    last_waypoint = Some(seq);
                    let point = Point::from_wire(item.frame, item.x, item.y, item.z);
                    let place = super::place::Place::from_point(&point, ctx);
                    let Some(at) = place.and_then(|p| p.whole()) else {
                        continue;
                    };
                    let off = |r: &&(String, In<Ned>)| (r.1 - at).norm_xy();
                    let nearest = rooms.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
                    if let Some((name, _)) = nearest.filter(|r| off(r) < IN_ROOM_M) {
                        self.rooms.insert(seq, name.clone());
                    }
                }
                cmd::DO_JUMP if item.params[0] < f32::from(seq) => self.ends.push(seq),
                _ => {}
            }
        }
        if self.ends.is_empty() {
            self.ends.extend(last_waypoint);
        }
    }

    /// Takes what happened.
    pub fn event(&mut self, now: Timestamp, event: &Event, ctx: &Context<'_>, out: &mut Outbox) {
        match event {
            Event::ItemReached(seq) => self.reached(now, *seq, ctx, out),
            Event::Mode(state) => {
                let mission = ctx.snapshot.mission;
                let for_battery = matches!(
                    state.because,
                    Because::BatteryLow
                        | Because::BatteryReserve
                        | Because::BatteryCritical
                        | Because::BatterySags
                );
                if for_battery && ctx.snapshot.mode.mode == Mode::Mission && mission.total > 0 {
                    let text = format!(
                        "Mission stopped at item {} for the battery; mode Mission resumes there",
                        mission.seq
                    );
                    out.text(Severity::Notice, text);
                }
            }
            Event::Notice(Notice::MissionFinished) => self.round = None,
            Event::Armed(true) => {
                self.visited.clear();
                self.alone = None;
            }
            _ => {}
        }
    }

    /// Takes where the vehicle is.
    pub fn look(&mut self, ctx: &Context<'_>) {
        let s = ctx.snapshot;
        if let Some(round) = &mut self.round
            && s.nav.health.position
        {
            let step_m = (s.nav.position - round.last).norm_xy();
            // Less is noise, more is a jump of the estimate.
            if step_m > 0.05 {
                round.way_m += if step_m < 1.0 { step_m } else { 0.0 };
                round.last = s.nav.position;
            }
        }
    }

    fn reached(&mut self, now: Timestamp, seq: u16, ctx: &Context<'_>, out: &mut Outbox) {
        if self.rooms.is_empty() {
            return;
        }
        let here = ctx.snapshot.nav.position;
        let round = self.round.get_or_insert_with(|| Round {
            since: now,
            way_m: 0.0,
            last: here,
            rooms: Vec::new(),
        });
        if let Some(name) = self.rooms.get(&seq) {
            if !round.rooms.contains(name) {
                round.rooms.push(name.clone());
            }
            if let Some(before) = self.visited.insert(name.clone(), now) {
                let alone_s = now.seconds_since(before);
                if self.alone.as_ref().is_none_or(|(s, _)| alone_s > *s) {
                    self.alone = Some((alone_s, name.clone()));
                }
            }
        }
        if !self.ends.contains(&seq) || round.rooms.is_empty() {
            return;
        }
        self.rounds_flown += 1;
        let battery = ctx
            .snapshot
            .battery
            .and_then(|b| b.remaining)
            .map_or(String::new(), |share| {
                format!(", battery {:.0} %", 100.0 * share)
            });
        let alone = self.alone.as_ref().map_or(String::new(), |(s, name)| {
            format!(", {name} alone {s:.0} s")
        });
        let text = format!(
            "Round {}: {} {}, {:.0} s, {:.1} m{battery}{alone}",
            self.rounds_flown,
            round.rooms.len(),
            if round.rooms.len() == 1 {
                "room"
            } else {
                "rooms"
            },
            now.seconds_since(round.since),
            round.way_m,
        );
        tracing::info!(rooms = %round.rooms.join(", "), "{text}");
        out.text(Severity::Info, text);
        self.round = Some(Round {
            since: now,
            way_m: 0.0,
            last: here,
            rooms: Vec::new(),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::bench::Bench;
    use super::*;
    use crate::autopilot::door::{MissionState, MissionStatus};
    use crate::autopilot::mode::ModeState;

    fn item(command: u16, params: [f32; 4], north_m: f64, east_m: f64) -> MissionItem {
        MissionItem {
            frame: if command == cmd::NAV_WAYPOINT { 1 } else { 2 },
            command,
            params,
            x: (north_m * 1e4) as i32,
            y: (east_m * 1e4) as i32,
            z: -1.0,
            ..Default::default()
        }
    }

    fn rooms() -> Vec<(String, In<Ned>)> {
        vec![
            ("lab".to_owned(), In::new(1.0, 0.0, 0.0)),
            ("hall".to_owned(), In::new(4.0, 0.0, 0.0)),
        ]
    }

    #[test]
    fn each_round_is_reported_with_the_room_that_was_alone_longest() {
        let (mut bench, mut out, mut report) =
            (Bench::default(), Outbox::default(), PatrolReport::new());
        let items = [
            item(cmd::NAV_TAKEOFF, [0.0; 4], 0.0, 0.0),
            item(cmd::NAV_WAYPOINT, [0.0; 4], 1.0, 0.2),
            item(cmd::NAV_WAYPOINT, [0.0; 4], 2.5, 0.0),
            item(cmd::NAV_WAYPOINT, [0.0; 4], 4.0, 0.0),
            item(cmd::DO_JUMP, [1.0, 2.0, 0.0, 0.0], 0.0, 0.0),
            item(cmd::NAV_RETURN_TO_LAUNCH, [0.0; 4], 0.0, 0.0),
        ];
        report.learn(7, &items, &rooms(), &bench.ctx());
        bench.snapshot.nav.health.position = true;
        let mut said = Vec::new();
        for (k, seq) in [0u16, 1, 2, 3, 4, 1, 2, 3, 4, 5].into_iter().enumerate() {
            let now = Timestamp::from_ms(10_000 * (k as u64 + 1));
            for step in 0..10 {
                bench.snapshot.nav.position = In::new(0.1 * f64::from(step), 0.0, -1.0);
                report.look(&bench.ctx());
            }
            report.event(now, &Event::ItemReached(seq), &bench.ctx(), &mut out);
            said.extend(out.said());
        }
        let said: Vec<_> = said.into_iter().map(|(_, text)| text).collect();
        assert_eq!(said.len(), 2, "{said:?}");
        assert!(
            said[0].starts_with("Round 1: 2 rooms, 40 s, "),
            "{}",
            said[0]
        );
        assert!(
            said[1].starts_with("Round 2: 2 rooms, 40 s, "),
            "{}",
            said[1]
        );
        assert!(said[1].ends_with("lab alone 40 s"), "{}", said[1]);
    }

    #[test]
    fn a_mission_that_passes_no_room_is_not_reported_and_a_stop_for_the_battery_is() {
        let (mut bench, mut out, mut report) =
            (Bench::default(), Outbox::default(), PatrolReport::new());
        let items = [item(cmd::NAV_WAYPOINT, [0.0; 4], 9.0, 0.0)];
        report.learn(7, &items, &rooms(), &bench.ctx());
        report.event(
            Timestamp::ZERO,
            &Event::ItemReached(0),
            &bench.ctx(),
            &mut out,
        );
        assert!(out.said().is_empty());
        bench.snapshot.mode.mode = Mode::Mission;
        bench.snapshot.mission = MissionStatus {
            seq: 3,
            total: 9,
            state: MissionState::Active,
        };
        let state = ModeState {
            mode: Mode::Return,
            because: Because::BatteryReserve,
        };
        report.event(Timestamp::ZERO, &Event::Mode(state), &bench.ctx(), &mut out);
        assert!(out.said()[0].1.contains("item 3"));
    }
}
