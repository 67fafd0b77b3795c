//! Whatever a peer may put on the wire, the services that take orders neither panic nor hand the vehicle a number that is
//! none.

use super::access::{self, Access};
use super::bench::{Bench, Dice, US, station};
use super::camera::{Camera, VideoStream};
use super::command::{CommandService, Streams};
use super::disk::DiskReply;
use super::ftp::FtpService;
use super::keys::KeyConsole;
use super::log_transfer::LogService;
use super::manual::ManualService;
use super::mission::MissionService;
use super::operator::OperatorControl;
use super::params::ParamService;
use super::setpoint::SetpointService;
use super::telemetry::Telemetry;
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

std::thread_local! {
    static IS_LOOKED_AT: core::cell::Cell<bool> = const { core::cell::Cell::new(false) };
}

/// One service, whatever it is called.
type Feed = Box<dyn FnMut(Timestamp, Peer, &Message, &Context<'_>, &mut Outbox) -> usize>;

/// Every service as a feed that gives back the length of its own description: what grows without bound shows there.
fn services() -> Vec<(&'static str, Feed)> {
    /// Length of the whole state, written out.
    fn size(service: &dyn core::fmt::Debug) -> usize {
        struct Count(usize);
        impl core::fmt::Write for Count {
            fn write_str(&mut self, s: &str) -> core::fmt::Result {
                self.0 += s.len();
                Ok(())
            }
        }
        let mut count = Count(0);
        // Writing it all out takes longer than the message did: now and then is enough.
        if !IS_LOOKED_AT.get() {
            return 0;
        }
        let _ = core::fmt::Write::write_fmt(&mut count, format_args!("{service:?}"));
        count.0
    }
    fn settle(out: &mut Outbox, mut answer: impl FnMut(&Answer, &mut Outbox)) {
        let asked: Vec<_> = out.requests.drain(..).collect();
        for (n, asked) in asked.into_iter().enumerate() {
            // Some are never answered.
            if n % 3 != 2 {
                let outcome = Outcome::Accepted;
                let a = Answer {
                    id: asked.id,
                    station: asked.station,
                    outcome,
                };
                answer(&a, out);
            }
        }
    }
    let mut all: Vec<(&'static str, Feed)> = Vec::new();
    let mut command = CommandService::new();
    all.push((
        "command",
        Box::new(move |now, from, m, ctx, out| {
            command.handle(now, from, m, ctx, &mut NoStreams, out);
            settle(out, |a, out| {
                let _ = command.answer(now, a, ctx, out);
            });
            command.tick(now, ctx, out);
            size(&command)
        }),
    ));
    let mut mission = MissionService::new(None);
    all.push((
        "mission, fence, rally points",
        Box::new(move |now, from, m, ctx, out| {
            mission.handle(now, from, m, ctx, out);
            settle(out, |a, out| {
                let _ = mission.answer(now, a, ctx, out);
            });
            mission.tick(now, ctx, out);
            size(&mission)
        }),
    ));
    let mut keys = KeyConsole::new();
    all.push((
        "keys",
        Box::new(move |now, from, m, ctx, out| {
            keys.handle(now, from, m, ctx, out);
            settle(out, |a, out| {
                let _ = keys.answer(now, a, ctx, out);
            });
            keys.tick(now, ctx, out);
            size(&keys)
        }),
    ));
    let mut ftp = FtpService::new();
    all.push((
        "files",
        Box::new(move |now, from, m, ctx, out| {
            ftp.handle(now, from, m, ctx, out);
            for (ticket, _) in out.jobs.drain(..).collect::<Vec<_>>() {
                let reply = DiskReply::Bytes(vec![7; (now.us() % 500) as usize]);
                ftp.disk(now, ticket, &reply, out);
            }
            ftp.tick(now, out);
            size(&ftp)
        }),
    ));
    let mut logs = LogService::new();
    all.push((
        "logs",
        Box::new(move |now, from, m, ctx, out| {
            logs.handle(now, from, m, ctx, out);
            for (ticket, _) in out.jobs.drain(..).collect::<Vec<_>>() {
                let reply = DiskReply::Bytes(vec![7; (now.us() % 500) as usize]);
                logs.disk(now, ticket, &reply, out);
            }
            logs.tick(now, ctx, out);
            size(&logs)
        }),
    ));
    let mut params = ParamService::new();
    all.push((
        "parameters",
        Box::new(move |now, from, m, ctx, out| {
            params.handle(now, from, m, ctx, out);
            params.tick(now, ctx, out);
            size(&params)
        }),
    ));
    let mut control = OperatorControl::new();
    all.push((
        "operator control",
        Box::new(move |now, from, m, ctx, out| {
            control.handle(now, from, m, out);
            control.tick(now, ctx, out);
            size(&control)
        }),
    ));
    let camera = Camera::new(VideoStream::parse("udp://:5600").ok());
    all.push((
        "camera",
        Box::new(move |now, from, m, ctx, out| {
            camera.handle(now, from, m, true, ctx, out);
            size(&camera)
        }),
    ));
    let access = Access::default();
    all.push((
        "access",
        Box::new(move |_, from, m, ctx, out| {
            access::deny(&access, from, m, ctx, out);
            size(&access)
        }),
    ));
    let mut manual = ManualService::new();
    let mut setpoint = SetpointService::new();
    all.push((
        "sticks and set points",
        Box::new(move |now, from, m, ctx, out| {
            manual.handle(now, from, m, ctx, out);
            setpoint.handle(now, from, m, ctx, out);
            size(&(&manual, &setpoint))
        }),
    ));
    let mut telemetry = Telemetry::new();
    for system in 240..246 {
        telemetry.link_up(Timestamp::ZERO, station(system).link, None);
    }
    all.push((
        "telemetry",
        Box::new(move |now, from, m, ctx, out| {
            let id = m.id();
            let _ = telemetry.set_interval(now, from.link, id, (now.us() % 90_000) as i32 - 10_000);
            telemetry.request_stream(now, from.link, id as u8, Some(id as u16));
            telemetry.radio_status(now, from.link, id as u8);
            telemetry.sent(from.link, 500);
            telemetry.tick(now, ctx, out);
            size(&telemetry)
        }),
    ));
    all
}

/// `KESTREL_FUZZ=N`: N times as many messages for each service (ten minutes each take about 2,000).
#[test]
fn no_service_grows_or_breaks_whatever_it_is_told() {
    const LARGEST: usize = 4_000_000;
    let times: u64 = std::env::var("KESTREL_FUZZ")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(1);
    let raw_ids = raw::MavMessage::all_ids();
    let standard_ids = mavlink_dialect::standard::MavMessage::all_ids();
    println!("FIGURES messages to each service, longest description of its state");
    for (name, mut feed) in services() {
        let bench = Bench::default();
        let mut dice = Dice(0x5EED);
        let (mut now, mut fed, mut largest) = (Timestamp::ZERO, 0u64, 0);
        for step in 0..10_000 * times {
            now += Duration::from_micros((dice.roll() * dice.roll() * 40_000.0) as u64);
            let ids = if dice.roll() < 0.8 {
                raw_ids
            } else {
                standard_ids
            };
            let id = ids[(dice.roll() * ids.len() as f64) as usize % ids.len()];
            let calm = dice.roll();
            let payload: [u8; 255] = core::array::from_fn(|_| {
                let r = dice.roll();
                match () {
                    // Small numbers make conversations: counts, indices, our own ids.
                    () if calm < 0.5 => (r * r * r * 12.0) as u8,
                    () if r < 0.2 => 0xFF,
                    () if r < 0.4 => 0x7F,
                    () => (dice.roll() * 256.0) as u8,
                }
            });
            let Ok(message) = Message::parse(MavlinkVersion::V2, id, &payload) else {
                continue;
            };
            let mut out = Outbox::default();
            let from = station(240 + (dice.roll() * 6.0) as u8);
            IS_LOOKED_AT.set(step % 64 == 0);
            let state = feed(now, from, &message, &bench.ctx(), &mut out);
            fed += 1;
            largest = largest.max(state);
            assert!(
                out.messages.len() <= 2_048,
                "{name}: {} answers to one message",
                out.messages.len()
            );
            assert!(
                largest <= LARGEST,
                "{name}: its state is {largest} characters long"
            );
        }
        println!("{name}: {fed}, {largest}");
        assert!(fed > 1_000 * times);
    }
    println!("END");
}
