//! Whatever a peer may put on the wire, the services that take orders neither panic nor hand the vehicle a number that is
//! none.

use super::bench::{Bench, Dice, US, station};
use super::command::{CommandService, Streams};
use super::disk::DiskReply;
use super::ftp::FtpService;
use super::keys::KeyConsole;
use super::log_transfer::LogService;
use super::manual::ManualService;
use super::mission::MissionService;
use super::setpoint::SetpointService;
use super::{Context, LinkId, Outbox, Peer};
use crate::autopilot::door::{Answer, Outcome, Request};
use core::time::Duration;
use mavlink::MavlinkVersion;
use mavlink_dialect::{Message, raw};
use proptest::prelude::*;
use vehicle::Timestamp;

struct NoStreams;

impl Streams for NoStreams {
    fn set_interval(&mut self, _: Timestamp, _: LinkId, _: u32, _: i32) -> u8 {
        3
    }
    fn interval_us(&self, _: LinkId, _: u32) -> i32 {
        0
    }
    fn request(
        &mut self,
        _: Timestamp,
        _: Peer,
        _: u32,
        _: f32,
        _: &Context<'_>,
        _: &mut Outbox,
    ) -> u8 {
        3
    }
}

/// A payload of an id we declare raw, or of any standard message; small fields are likely to be our own ids.
fn any_message() -> impl Strategy<Value = Message> {
    let raw_ids = raw::MavMessage::all_ids().to_vec();
    let id = prop_oneof![4 => proptest::sample::select(raw_ids), 1 => Just(70u32), 1 => Just(41u32), 1 => Just(110u32), 1 => 117u32..=122];
    // From a seed: a strategy for each byte would take longer than the test.
    (id, any::<u64>()).prop_filter_map("not a message", |(id, seed)| {
        let mut dice = Dice(seed);
        let payload: [u8; 255] = core::array::from_fn(|_| match (dice.roll() * 8.0) as u8 {
            0 | 1 => 0,
            2 => 0xFF,
            3 => 0x7F,
            _ => (dice.roll() * 256.0) as u8,
        });
        Message::parse(MavlinkVersion::V2, id, &payload).ok()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn no_sequence_of_messages_panics(script in proptest::collection::vec((0u8..3, any_message(), 0u64..600), 0..40)) {
        let (mut bench, mut out, mut now) = (Bench::default(), Outbox::default(), Timestamp::ZERO);
        let (mut command, mut mission) = (CommandService::new(), MissionService::new(None));
        let (mut manual, mut setpoint, mut keys) = (ManualService::new(), SetpointService::new(), KeyConsole::new());
        let (mut ftp, mut logs) = (FtpService::new(), LogService::new());
        for (sender, message, ms) in script {
            let from = station(250 + sender);
            now += Duration::from_millis(ms);
            bench.snapshot.is_key_mode = ms % 2 == 0;
            let ctx = bench.ctx();
            command.handle(now, from, &message, &ctx, &mut NoStreams, &mut out);
            mission.handle(now, from, &message, &ctx, &mut out);
            manual.handle(now, from, &message, &ctx, &mut out);
            setpoint.handle(now, from, &message, &ctx, &mut out);
            keys.handle(now, from, &message, &ctx, &mut out);
            ftp.handle(now, from, &message, &ctx, &mut out);
            logs.handle(now, from, &message, &ctx, &mut out);
            prop_assert!(out.jobs.len() <= 20);
            for (ticket, _) in out.jobs.drain(..).collect::<Vec<_>>() {
                let reply = DiskReply::Bytes(vec![7; usize::from(sender) * 100]);
                prop_assert!(ftp.disk(now, ticket, &reply, &mut out) || logs.disk(now, ticket, &reply, &mut out));
            }
            ftp.tick(now, &mut out);
            logs.tick(now, &ctx, &mut out);
            for asked in out.asked() {
                if let Request::Manual(m) = &asked.request {
                    let axes = [m.forward, m.right, m.yaw, m.throttle];
                    prop_assert!(axes.into_iter().flatten().all(|v| (-1.0..=1.0).contains(&v)));
                }
                let answer = Answer { id: asked.id, station: asked.station, outcome: Outcome::Accepted };
                let _ = mission.answer(now, &answer, &ctx, &mut out)
                    || command.answer(now, &answer, &ctx, &mut out)
                    || keys.answer(now, &answer, &ctx, &mut out);
            }
            command.tick(now, &ctx, &mut out);
            mission.tick(now, &ctx, &mut out);
            keys.tick(now, &ctx, &mut out);
            for m in out.sent() {
                let (system, _) = m.target();
                prop_assert!(system == 0 || system == from.address.system || (250..253).contains(&system), "{:?} to {}", m, US);
            }
        }
    }
}
