//! The client on a line that fails in every way we know, in virtual time: it never panics, always finds back, and every
//! fault can be seen in its counters.
//!
//! Two hours of virtual time, twelve with `KESTREL_FULL=1`. A failure names the seed.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    dead_code,
    unreachable_pub,
    missing_docs,
    reason = "shared with other tests"
)]
#![expect(clippy::unwrap_used, reason = "tests")]

mod line;

use line::{Controller, Kind, Wire, events};
use msp::client::{Config, Event, Statistics};
use msp::frame::{Direction, Framing, encode};
use msp::{Client, Server, command};
use std::collections::BTreeMap;

/// What can go wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fault {
    /// Bits flip, both ways.
    BitErrors,
    /// The text console is open: text, no answers; a restart ends it.
    CommandLine,
    /// The boxes change without a restart.
    ConfigurationChange,
    /// Own requests come back on a one-wire line.
    Echo,
    /// 0xFF without end.
    Flood,
    /// Heads of frames whose rest never comes.
    HalfFrames,
    /// Lengths no controller sends.
    Jumbo,
    /// Bytes are lost, both ways.
    LostBytes,
    /// Well-formed replies that do not fit their command.
    Misfits,
    /// Random bytes between the frames.
    Noise,
    /// Everything is refused.
    Refusals,
    /// The controller starts anew, with other boxes and another receiver map.
    Restart,
    /// Replies somebody else asked for, refusals among them.
    SecondClient,
    /// Nothing passes for a while, then all of it at once.
    Stall,
    /// The control loop stands still.
    StandingLoop,
    /// The cable is pulled and put back; what was under way comes late.
    Unplugged,
}

const FAULTS: [Fault; 16] = [
    Fault::BitErrors,
    Fault::CommandLine,
    Fault::ConfigurationChange,
    Fault::Echo,
    Fault::Flood,
    Fault::HalfFrames,
    Fault::Jumbo,
    Fault::LostBytes,
    Fault::Misfits,
    Fault::Noise,
    Fault::Refusals,
    Fault::Restart,
    Fault::SecondClient,
    Fault::Stall,
    Fault::StandingLoop,
    Fault::Unplugged,
];

impl Fault {
    /// How often it must be seen in the counters, from their change.
    fn seen(self, before: &Statistics, after: &Statistics) -> u64 {
        let more = |of: fn(&Statistics) -> u64| of(after) - of(before);
        match self {
            Self::BitErrors | Self::LostBytes => {
                more(|s| s.bad_frames) + more(|s| s.noise_bytes) + more(|s| s.timeouts)
            }
            Self::CommandLine => more(|s| s.noise_bytes).min(more(|s| s.timeouts)),
            Self::ConfigurationChange => more(|s| s.changes),
            Self::Echo => more(|s| s.line.wrong_direction),
            Self::Flood | Self::Noise => more(|s| s.noise_bytes) + more(|s| s.bad_frames),
            Self::HalfFrames => more(|s| s.line.truncated) + more(|s| s.line.checksum),
            Self::Jumbo => more(|s| s.line.oversize),
            Self::Misfits => more(|s| s.malformed).min(more(|s| s.line.malformed)),
            Self::Refusals => more(|s| s.refused),
            // One during the boot grace of another is seen by what it left unanswered.
            Self::Restart => more(|s| s.restarts) + more(|s| s.losses) + more(|s| s.timeouts),
            Self::SecondClient => more(|s| s.stale_replies),
            Self::Stall => more(|s| s.timeouts),
            Self::StandingLoop => more(|s| s.stalls),
            Self::Unplugged => more(|s| s.identifications),
        }
    }
}

/// splitmix64.
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }

    fn between(&mut self, from: u64, to: u64) -> u64 {
        from + self.below(to - from)
    }

    fn byte(&mut self) -> u8 {
        self.next().to_le_bytes()[0]
    }
}

struct Bench {
    client: Client,
    controller: Controller,
    up: Wire,
    down: Wire,
    now_us: u64,
    rc_at_us: u64,
    chance: Chance,
    /// Neither hears nor speaks until then.
    silent_until_us: u64,
    attitudes: u64,
    most_pending: usize,
}

impl Bench {
    fn new(kind: Kind, seed: u64) -> Self {
        let mut chance = Chance(seed);
        let slot_us = [10_000, 10_000, 28_000, 1_000][chance.below(4) as usize];
        let [byte_ns, delay_us] = [[86_800, 0], [10_000, 250], [0, 30]][chance.below(3) as usize];
        let mut client = Client::new(Config::default());
        client.connect(0);
        Self {
            client,
            controller: Controller::new(kind, slot_us),
            up: Wire::new(byte_ns, delay_us),
            down: Wire::new(byte_ns, delay_us),
            now_us: 0,
            rc_at_us: 0,
            chance,
            silent_until_us: 0,
            attitudes: 0,
            most_pending: 0,
        }
    }

    fn run(&mut self, duration_us: u64, fault: Option<Fault>) {
        let end_us = self.now_us + duration_us;
        while self.now_us < end_us {
            self.step(fault);
        }
    }

    fn step(&mut self, fault: Option<Fault>) {
        let now_us = self.now_us;
        let stalled = fault == Some(Fault::Stall) || fault == Some(Fault::Unplugged);
        if !stalled {
            let mut bytes = self.down.receive(now_us);
            self.spoil(&mut bytes, fault, true);
            self.client.handle(now_us, &bytes);
        }
        if now_us >= self.rc_at_us {
            self.client
                .set_rc(now_us, &[1500, 1500, 1000, 1500, 1000, 1000, 1000, 1000]);
            self.rc_at_us = now_us + 25_000;
        }
        let mut sent = Vec::new();
        while let Some(bytes) = self.client.poll_transmit(now_us) {
            sent.extend_from_slice(bytes);
        }
        if fault == Some(Fault::Echo) {
            self.down.send(now_us, &sent);
        }
        self.up.send(now_us, &sent);
        for event in events(&mut self.client) {
            if let Event::Reply {
                reply: msp::Reply::Attitude(_),
                ..
            } = event
            {
                self.attitudes += 1;
            }
        }
        if !stalled {
            let mut bytes = self.up.receive(now_us);
            self.spoil(&mut bytes, fault, false);
            if now_us >= self.silent_until_us {
                self.controller.server.handle(&bytes);
            }
        }
        self.most_pending = self.most_pending.max(self.controller.server.pending());
        if now_us >= self.controller.run_us {
            self.controller.run_us = now_us;
            self.serve(now_us, fault);
        }
        let next = [
            Some(self.controller.run_us),
            Some(self.rc_at_us),
            self.up.next_us().filter(|_| !stalled),
            self.down.next_us().filter(|_| !stalled),
            self.client.deadline_us(),
        ];
        self.now_us = next.into_iter().flatten().min().unwrap().max(now_us + 1);
    }

    /// One run of the controller's serial task.
    fn serve(&mut self, now_us: u64, fault: Option<Fault>) {
        if now_us < self.silent_until_us {
            self.controller.run_us += self.controller.slot_us;
            return;
        }
        match fault {
            Some(Fault::CommandLine) => {
                self.controller.run_us += self.controller.slot_us;
                while self.controller.server.pop().is_some() {}
                if self.chance.below(4) == 0 {
                    let text: &[&[u8]] = &[
                        b"\r\n# ",
                        b"###ERROR IN diff: INVALID ARGUMENT###\r\n",
                        b"Entering CLI Mode, type 'exit' to reboot, or 'help'\r\n",
                        b"set cost = 5$M\r\n",
                    ];
                    let line = text[self.chance.below(4) as usize];
                    self.down.send(now_us, line);
                }
            }
            Some(Fault::Refusals) => {
                self.controller.run_us += self.controller.slot_us;
                if let Some(request) = self.controller.server.pop() {
                    self.controller.server.refuse(&request);
                    let bytes = self.controller.server.output().to_vec();
                    self.controller.server.clear_output();
                    self.down.send(now_us, &bytes);
                }
            }
            _ => {
                let bytes = self.controller.run();
                self.down.send(now_us, &bytes);
                self.interrupt(now_us, fault);
            }
        }
    }

    /// Bytes of others, between the frames of the controller.
    fn interrupt(&mut self, now_us: u64, fault: Option<Fault>) {
        let chance = &mut self.chance;
        let mut bytes = Vec::new();
        match fault {
            Some(Fault::Noise) => bytes.extend((0..chance.below(20)).map(|_| chance.byte())),
            Some(Fault::Flood) => bytes.extend([0xff; 16]),
            Some(Fault::HalfFrames) if chance.below(3) == 0 => {
                let heads: [&[u8]; 4] = [
                    b"$M>\xf0\x6c",
                    b"$X>\x00\x6c\x00\x40\x00abc",
                    b"$M>\xff\x74\x00\x02",
                    b"$X>\x00",
                ];
                bytes.extend_from_slice(heads[chance.below(4) as usize]);
            }
            Some(Fault::Jumbo) if chance.below(3) == 0 => {
                let heads: [&[u8]; 2] = [b"$M>\xff\x74\xff\xff", b"$X>\x00\x6c\x00\xff\xff"];
                bytes.extend_from_slice(heads[chance.below(2) as usize]);
            }
            Some(Fault::Misfits) if chance.below(2) == 0 => {
                for number in [
                    command::ATTITUDE,
                    command::MULTIPLE_MSP,
                    command::STATUS_EX,
                    command::INAV_STATUS,
                ] {
                    encode(
                        Framing::V2,
                        Direction::Reply,
                        number,
                        &[1, 2, 3],
                        &mut bytes,
                    )
                    .unwrap();
                }
                // v2 in v1 with lengths that disagree, the outer checksum right.
                bytes.extend_from_slice(b"$M>\x06\xff\x00\x6c\x00\x01\x00\x00\x94");
            }
            Some(Fault::SecondClient) => {
                let numbers = [
                    command::ATTITUDE,
                    command::ALTITUDE,
                    command::RAW_GPS,
                    command::RC,
                    command::NAME,
                    command::ANALOG,
                    command::MULTIPLE_MSP,
                ];
                let number = numbers[chance.below(7) as usize];
                let direction = if chance.below(10) == 0 {
                    Direction::Error
                } else {
                    Direction::Reply
                };
                let payload: Vec<u8> = (0..chance.below(24)).map(|_| chance.byte()).collect();
                encode(Framing::V1, direction, number, &payload, &mut bytes).unwrap();
            }
            _ => {}
        }
        self.down.send(now_us, &bytes);
    }

    /// What the line does to bytes on the way.
    fn spoil(&mut self, bytes: &mut Vec<u8>, fault: Option<Fault>, _is_down: bool) {
        let chance = &mut self.chance;
        match fault {
            Some(Fault::BitErrors) => {
                for byte in bytes.iter_mut() {
                    if chance.below(100) == 0 {
                        *byte ^= 1 << chance.below(8);
                    }
                }
            }
            Some(Fault::LostBytes) => bytes.retain(|_| chance.below(50) > 0),
            _ => {}
        }
    }

    /// Starts anew with another configuration.
    fn restart(&mut self, silent_us: u64) {
        self.controller.server = Server::new();
        self.down.clear();
        self.up.clear();
        self.silent_until_us = self.now_us + silent_us;
        self.controller.grace_until_us = self.silent_until_us + 5_000_000;
        self.reconfigure();
        let maps = [[0, 1, 3, 2], [1, 2, 3, 0], [0, 1, 2, 3]];
        self.controller.map = maps[self.chance.below(3) as usize];
    }

    fn reconfigure(&mut self) {
        let boxes = &mut self.controller.boxes;
        if boxes.len() < 20 {
            boxes.insert(2, 50 + boxes.len() as u8);
        } else {
            *boxes = vec![0, 1, 2, 27];
        }
    }

    /// Lets one fault happen.
    fn fail(&mut self, fault: Fault) {
        let short_us = self.chance.between(500_000, 5_000_000);
        match fault {
            Fault::ConfigurationChange => self.reconfigure(),
            Fault::Restart => {
                let silent_us = self.chance.between(50_000, 3_000_000);
                self.restart(silent_us);
            }
            Fault::StandingLoop => {
                self.controller.cycle_us = 0;
                self.run(12_000_000, Some(fault));
                self.controller.cycle_us = 125;
            }
            Fault::CommandLine => {
                self.run(short_us, Some(fault));
                self.restart(1_500_000);
            }
            Fault::Unplugged => {
                self.run(short_us, Some(fault));
                self.client.connect(self.now_us);
            }
            Fault::Stall => {
                let stall_us = self.chance.between(350_000, 4_000_000);
                self.run(stall_us, Some(fault));
            }
            _ => self.run(short_us, Some(fault)),
        }
    }

    fn knows_the_truth(&self) -> bool {
        self.client.is_online()
            && self.client.identity().is_some_and(|identity| {
                identity.box_ids.ids.as_slice() == self.controller.boxes
                    && identity.rx_map.map.as_slice() == self.controller.map
            })
    }

    /// Time until the client works as before, and why not.
    fn recover(&mut self) -> Result<u64, String> {
        const LIMIT_US: u64 = 25_000_000;
        let start_us = self.now_us;
        let mut last = String::new();
        while self.now_us < start_us + LIMIT_US {
            let (attitudes, rc) = (self.attitudes, self.controller.rc_us.len());
            self.most_pending = 0;
            self.run(500_000, None);
            let (attitudes, rc) = (self.attitudes - attitudes, self.controller.rc_us.len() - rc);
            // Half a second of the slowest bench: 35 slots a second, no batches.
            let is_through = self.most_pending <= 4;
            if self.knows_the_truth() && is_through && attitudes >= 2 && rc >= 7 {
                return Ok(self.now_us - start_us);
            }
            last = format!(
                "online {}, {attitudes} attitudes and {rc} RC frames in the last half second, {} waited; boxes {:?}, map {:?}",
                self.client.is_online(),
                self.most_pending,
                self.controller.boxes,
                self.controller.map
            );
        }
        Err(format!(
            "not recovered: {last} {:?} {:?}",
            self.client.identity(),
            self.client.statistics()
        ))
    }
}

#[derive(Default)]
struct Seen {
    times: u64,
    worst_recovery_us: u64,
    least_seen: u64,
}

#[test]
fn every_fault_is_survived_and_seen_for_two_hours() {
    let hours = if std::env::var_os("KESTREL_FULL").is_some() {
        12
    } else {
        2
    };
    let per_seed_us = 300_000_000;
    let mut table: BTreeMap<Fault, Seen> = BTreeMap::new();
    let mut total = 0;
    for seed in 1..=hours * 12 {
        let kind = if seed % 3 == 0 {
            Kind::Inav
        } else {
            Kind::Betaflight
        };
        let mut bench = Bench::new(kind, seed);
        bench
            .recover()
            .unwrap_or_else(|why| panic!("seed {seed} never came up: {why}"));
        while bench.now_us < per_seed_us {
            let fault = FAULTS[bench.chance.below(16) as usize];
            let before = *bench.client.statistics();
            bench.fail(fault);
            let recovery_us = bench.recover().unwrap_or_else(|why| {
                panic!("seed {seed}, {fault:?} at {} us: {why}", bench.now_us)
            });
            // A backlog that a fault left behind is gone, and none grows.
            bench.most_pending = 0;
            bench.run(1_000_000, None);
            assert!(
                bench.most_pending <= 4,
                "seed {seed}: {} requests waited at the controller after {fault:?}",
                bench.most_pending
            );
            let mut seen = fault.seen(&before, bench.client.statistics());
            if seen == 0 && fault == Fault::ConfigurationChange {
                // Read again every 10 s, unless a restart came before.
                bench.run(11_000_000, None);
                seen = fault.seen(&before, bench.client.statistics());
            }
            assert!(
                seen > 0,
                "seed {seed}: {fault:?} at {} us left no trace: {:?}",
                bench.now_us,
                bench.client.statistics()
            );
            let row = table.entry(fault).or_default();
            row.least_seen = if row.times == 0 {
                seen
            } else {
                row.least_seen.min(seen)
            };
            row.times += 1;
            row.worst_recovery_us = row.worst_recovery_us.max(recovery_us);
        }
        total += bench.now_us;
    }
    println!("FIGURES msp line faults");
    println!(
        "{:.1} h of virtual time, {} seeds",
        total as f64 / 3.6e9,
        hours * 12
    );
    for (fault, seen) in &table {
        println!(
            "{:<20} {:>4} times, all seen (counters moved by {} at least), back within {:.1} s",
            format!("{fault:?}"),
            seen.times,
            seen.least_seen,
            seen.worst_recovery_us as f64 / 1e6
        );
    }
    println!("END");
    assert_eq!(table.len(), FAULTS.len(), "a fault never came");
}
