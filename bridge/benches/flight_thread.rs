//! How punctual the flight thread is: its own share of the way from a reply to an RC frame, and the jitter of its timer.
//!
//! ```text
//! cargo bench -p bridge --bench flight_thread                      10 s a row
//! cargo bench -p bridge --bench flight_thread -- --seconds 60      for the record
//! cargo bench -p bridge --bench flight_thread -- share|jitter      one of the two
//! ```
//!
//! **share**: a scripted controller at the other end of a pty sends its replies byte by byte (0, 10 and 86.8 us a byte) and takes the
//! time from the last byte of an attitude to the whole SET_RAW_RC. It spins while it waits, so that its own wake-up is not counted. Beside
//! it in the same run: the same pty with a thread that answers without thinking, and the gaps in which the host ran
//! neither.
//!
//! **jitter**: how late the timer rings at 100 Hz and 1 kHz, idle and beside four busy processes; tokio's interval and a plain sleep
//! run in the same seconds.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    missing_docs,
    reason = "a bench prints its figures and fails where it stands"
)]

use bridge::autopilot::flight::{Flight, FlightConfig, Start};
use bridge::io::clock::{Clock, monotonic_ns};
use bridge::io::flight_thread::{self, News};
use bridge::io::realtime::Realtime;
use bridge::io::timer::AbsoluteTimer;
use bridge::settings::Settings;
use msp::message::{
    Altitude, ApiVersion, Attitude, BatteryState, BoxIds, FcVariant, FcVersion, RawImu, RxMap,
};
use msp::{Server, command};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fd::OwnedFd;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use sim::Room;
use std::collections::VecDeque;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use vehicle::{Airframe, RingConfig, Timestamp};

/// Longer than this after an attitude a frame was not caused by it, ns.
const WAIT_NS: u64 = 8_000_000;
/// Bytes of an ATTITUDE reply.
const ATTITUDE_BYTES: u64 = 12;

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let has = |name: &str| args.iter().any(|a| a == name);
    if has("--busy") {
        loop {
            std::hint::spin_loop();
        }
    }
    let seconds = args
        .iter()
        .position(|a| a == "--seconds")
        .and_then(|i| args.get(i + 1)?.parse().ok())
        .unwrap_or(10);
    println!("load average {}", read("/proc/loadavg"));
    let granted = std::thread::spawn(Realtime::enter).join().unwrap();
    println!("{granted}");
    if !has("jitter") {
        // The controller is timed as carefully as the thread it measures.
        std::thread::spawn(move || {
            let _ = Realtime::enter();
            share(seconds);
        })
        .join()
        .unwrap();
    }
    if !has("share") {
        jitter(seconds);
    }
}

fn read(path: &str) -> String {
    std::fs::read_to_string(path)
        .unwrap_or_default()
        .trim()
        .to_owned()
}

/// Every duration, ns: exact quantiles, where the flight thread's own histogram rounds up to an eighth.
#[derive(Default)]
struct Samples(Vec<u64>);

impl Samples {
    fn record(&mut self, took: Duration) {
        self.0.push(took.as_nanos() as u64);
    }

    /// The duration that a share of all does not exceed, us.
    fn quantile_us(&self, share: f64) -> f64 {
        let mut sorted = self.0.clone();
        sorted.sort_unstable();
        let at = (share * sorted.len() as f64).ceil() as usize;
        sorted.get(at.max(1) - 1).copied().unwrap_or(0) as f64 * 1e-3
    }
}

fn row(name: &str, taken: &Samples) {
    let [p50, p99, p999, max] = [0.5, 0.99, 0.999, 1.0].map(|share| taken.quantile_us(share));
    println!(
        "  {name:<44} {:>7} {p50:>8.1} {p99:>8.1} {p999:>8.1} {max:>8.1}",
        taken.0.len()
    );
}

fn head(title: &str) {
    println!("\n{title}");
    println!(
        "  {:<44} {:>7} {:>8} {:>8} {:>8} {:>8}",
        "us", "n", "p50", "p99", "p99.9", "max"
    );
}

// ---- own share -----------------------------------------------------------------------------------------------------

/// A pseudo terminal: the controller's end, and the name of ours.
fn pty() -> (OwnedFd, String) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
    rustix::io::ioctl_fionbio(&master, true).unwrap();
    (master, name)
}

fn share(seconds: u64) {
    for byte_ns in [0, 10_000, 86_800] {
        head(&format!(
            "reply complete -> SET_RAW_RC complete, {} us a byte, {seconds} s",
            byte_ns as f64 * 1e-3
        ));
        let (master, device) = pty();
        let stop = Arc::new(AtomicBool::new(false));
        let echo_stop = Arc::clone(&stop);
        let echo = std::thread::spawn(move || answer_without_thinking(&device, &echo_stop));
        let floor = Controller::new(master, byte_ns).drive_echo(seconds.div_ceil(3));
        stop.store(true, Ordering::Relaxed);
        echo.join().unwrap();
        row("a thread that answers without thinking", &floor);

        let (master, device) = pty();
        let room = Room::named("office").unwrap();
        let clock = Clock::start(1.0);
        let config = FlightConfig {
            plan: Arc::clone(room.floor_plan()),
            ring: RingConfig::built_in("tof32").unwrap(),
            airframe: Airframe::default(),
            start: Start::Known(room.home()),
            settings: Settings::default(),
            seed: 1,
        };
        let flight = Flight::new(clock.now(), config);
        let endpoint = format!("serial://{device}?baudrate=115200")
            .parse()
            .unwrap();
        let handle = flight_thread::start(flight, endpoint, clock, None).unwrap();
        let mut controller = Controller::new(master, byte_ns);
        controller.drive(seconds, || {
            while let Some(news) = handle.poll() {
                if let News::LineAbsent(why) = news {
                    println!("  {why}");
                }
            }
        });
        row(
            "Kestrel: own share (pty, wake-up, tick, write)",
            &controller.own,
        );
        row(
            "whole chain: first reply byte -> RC on the wire",
            &controller.chain,
        );
        row("host: gaps in the spinning controller", &controller.gaps);
        println!(
            "  attitudes answered by a frame of their own: {} of {}",
            controller.own.0.len(),
            controller.attitudes
        );
    }
}

/// The other end of a perfect bridge: reads and writes an RC frame at once.
fn answer_without_thinking(device: &str, stop: &AtomicBool) {
    let endpoint = format!("serial://{device}?baudrate=115200")
        .parse()
        .unwrap();
    let mut line = bridge::io::line::Line::open(&endpoint).unwrap();
    let _ = Realtime::enter();
    let frame = [b'$'; 22];
    let mut buffer = [0u8; 256];
    let mut read = 0;
    while !stop.load(Ordering::Relaxed) {
        let timeout = rustix::event::Timespec {
            tv_sec: 0,
            tv_nsec: 100_000_000,
        };
        let _ = poll(&mut [PollFd::new(&line, PollFlags::IN)], Some(&timeout));
        if let Ok(n) = line.read(&mut buffer) {
            read += n as u64;
            if read >= ATTITUDE_BYTES {
                read -= ATTITUDE_BYTES;
                let _ = line.write(&frame);
            }
        }
    }
}

/// A scripted controller that spins.
struct Controller {
    master: OwnedFd,
    byte_ns: u64,
    server: Server,
    pending: VecDeque<msp::server::Request>,
    /// Bytes to send, and when the next may go.
    queue: Vec<u8>,
    queue_is_attitude: bool,
    started_ns: u64,
    next_byte_ns: u64,
    /// When our transmit wire is free, as far as the controller can tell.
    wire_free_ns: u64,
    attitude: Option<(u64, u64)>,
    attitudes: u64,
    own: Samples,
    chain: Samples,
    gaps: Samples,
    last_ns: u64,
    was_spinning: bool,
}

impl Controller {
    fn new(master: OwnedFd, byte_ns: u64) -> Self {
        Self {
            master,
            byte_ns,
            server: Server::new(),
            pending: VecDeque::new(),
            queue: Vec::new(),
            queue_is_attitude: false,
            started_ns: 0,
            next_byte_ns: 0,
            wire_free_ns: 0,
            attitude: None,
            attitudes: 0,
            own: Samples::default(),
            chain: Samples::default(),
            gaps: Samples::default(),
            last_ns: monotonic_ns(),
            was_spinning: false,
        }
    }

    #[allow(clippy::disallowed_methods, reason = "a bench waits in real time")]
    /// Sends 40 attitudes a second and takes the time until 22 bytes have come.
    fn drive_echo(mut self, seconds: u64) -> Samples {
        // The other end makes the terminal raw when it opens it.
        std::thread::sleep(Duration::from_millis(200));
        let end_ns = monotonic_ns() + seconds * 1_000_000_000;
        let mut next_ns = monotonic_ns();
        let mut buffer = [0u8; 256];
        let (mut sent_ns, mut got, mut waits) = (0, 0, false);
        while monotonic_ns() < end_ns {
            let now_ns = monotonic_ns();
            if self.queue.is_empty() && now_ns >= next_ns {
                next_ns += 25_000_000;
                self.queue = vec![0x55; ATTITUDE_BYTES as usize];
                got = 0;
            }
            if let Some(complete_ns) = self.send(now_ns) {
                (sent_ns, waits) = (complete_ns, true);
            }
            if self.queue.is_empty() && !waits {
                std::thread::sleep(Duration::from_micros(500));
            }
            if let Ok(n) = rustix::io::read(&self.master, &mut buffer) {
                got += n;
                if got >= 22 {
                    (got, waits) = (0, false);
                    self.own
                        .record(Duration::from_nanos(monotonic_ns() - sent_ns));
                }
            }
        }
        self.own
    }

    /// Plays flight controller.
    fn drive(&mut self, seconds: u64, mut look: impl FnMut()) {
        // Warm up until identified and streaming.
        let start_ns = monotonic_ns();
        let warm_ns = start_ns + 2_000_000_000;
        let end_ns = warm_ns + seconds * 1_000_000_000;
        let mut is_warm = false;
        self.last_ns = start_ns;
        let mut buffer = [0u8; 256];
        loop {
            let now_ns = monotonic_ns();
            if !is_warm && now_ns > warm_ns {
                is_warm = true;
                (self.own, self.chain, self.gaps) = Default::default();
                self.attitudes = 0;
            }
            if now_ns > end_ns {
                return;
            }
            if self.attitude.is_some_and(|(_, at)| now_ns > at + WAIT_NS) {
                self.attitude = None;
            }
            if self.queue.is_empty() && self.attitude.is_none() {
                // Nothing to time: let others run.
                let timeout = rustix::event::Timespec {
                    tv_sec: 0,
                    tv_nsec: 1_000_000,
                };
                let _ = poll(
                    &mut [PollFd::new(&self.master, PollFlags::IN)],
                    Some(&timeout),
                );
            } else {
                let gap_us = (now_ns - self.last_ns) / 1_000;
                if self.was_spinning && gap_us >= 5 {
                    self.gaps.record(Duration::from_micros(gap_us));
                }
            }
            self.was_spinning = !self.queue.is_empty() || self.attitude.is_some();
            self.last_ns = monotonic_ns();
            if let Some(complete_ns) = self.send(now_ns)
                && std::mem::take(&mut self.queue_is_attitude)
            {
                self.attitudes += 1;
                self.attitude = Some((self.started_ns, complete_ns));
            }
            if let Ok(n) = rustix::io::read(&self.master, &mut buffer) {
                let read_ns = monotonic_ns();
                self.wire_free_ns = self.wire_free_ns.max(read_ns) + n as u64 * self.byte_ns;
                self.server.handle(&buffer[..n]);
                while let Some(request) = self.server.pop() {
                    if request.command == command::SET_RAW_RC {
                        self.take_rc(read_ns);
                    }
                    self.pending.push_back(request);
                }
                look();
            }
            if self.queue.is_empty()
                && let Some(request) = self.pending.pop_front()
            {
                self.answer(&request);
            }
        }
    }

    /// A whole SET_RAW_RC is there.
    fn take_rc(&mut self, read_ns: u64) {
        let Some((started_ns, complete_ns)) = self.attitude.take() else {
            return;
        };
        let own_ns = read_ns.saturating_sub(complete_ns);
        if own_ns < WAIT_NS {
            self.own.record(Duration::from_nanos(own_ns));
            let wire_ns = self.wire_free_ns.saturating_sub(started_ns);
            self.chain.record(Duration::from_nanos(wire_ns));
        }
    }

    /// The next byte, if it is time; when the last one went out.
    fn send(&mut self, now_ns: u64) -> Option<u64> {
        if self.queue.is_empty() || now_ns < self.next_byte_ns {
            return None;
        }
        if self.started_ns == 0 || self.next_byte_ns == 0 {
            self.started_ns = now_ns;
            // The first byte is complete a byte time after it was begun.
            self.next_byte_ns = now_ns + self.byte_ns;
            if self.byte_ns > 0 {
                return None;
            }
        }
        if self.byte_ns == 0 {
            let bytes = std::mem::take(&mut self.queue);
            let _ = rustix::io::write(&self.master, &bytes);
        } else {
            let byte = self.queue.remove(0);
            let _ = rustix::io::write(&self.master, &[byte]);
            self.next_byte_ns += self.byte_ns;
        }
        if !self.queue.is_empty() {
            return None;
        }
        self.next_byte_ns = 0;
        Some(monotonic_ns())
    }

    fn answer(&mut self, request: &msp::server::Request) {
        let server = &mut self.server;
        match request.command {
            command::API_VERSION => server.answer(
                request,
                // Without MULTIPLE_MSP, so that an attitude is a reply of its own.
                &ApiVersion {
                    protocol: 0,
                    major: 1,
                    minor: 42,
                },
            ),
            command::FC_VARIANT => server.answer(request, &FcVariant { variant: *b"BTFL" }),
            command::FC_VERSION => server.answer(
                request,
                &FcVersion {
                    major: 4,
                    minor: 1,
                    patch: 0,
                    text: None,
                },
            ),
            command::BOXIDS => server.answer(
                request,
                &BoxIds {
                    ids: [0, 1].into_iter().collect(),
                },
            ),
            command::RX_MAP => server.answer(request, &RxMap::aetr()),
            command::ATTITUDE => server.answer(request, &Attitude::default()),
            command::RAW_IMU => server.answer(
                request,
                &RawImu {
                    acc: [0, 0, 2048],
                    ..RawImu::default()
                },
            ),
            command::ALTITUDE => server.answer(request, &Altitude::default()),
            command::BATTERY_STATE => server.answer(request, &BatteryState::default()),
            command::SET_RAW_RC => server.reply(request, &[]),
            _ => server.refuse(request),
        }
        self.queue_is_attitude = request.command == command::ATTITUDE;
        self.queue.clear();
        self.queue.extend_from_slice(self.server.output());
        self.server.clear_output();
        self.started_ns = 0;
        self.next_byte_ns = 0;
    }
}

// ---- jitter --------------------------------------------------------------------------------------------------------

struct Busy(Vec<Child>);

impl Busy {
    fn start(n: usize) -> Self {
        let me = std::env::current_exe().unwrap();
        let start = |_| {
            let mut busy = Command::new(&me);
            busy.arg("--busy").stdout(Stdio::null());
            busy.spawn().unwrap()
        };
        Self((0..n).map(start).collect())
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn jitter(seconds: u64) {
    for busy in [0, 4] {
        for hz in [100, 1_000] {
            head(&format!(
                "late wake-ups at {hz} Hz, {busy} busy processes, {seconds} s"
            ));
            let _busy = Busy::start(busy);
            let rows = std::thread::scope(|scope| {
                [
                    (
                        "flight thread: absolute timer in poll",
                        ours as fn(u64, u64) -> Samples,
                    ),
                    ("tokio interval, current thread", tokio_interval),
                    ("std::thread::sleep", plain_sleep),
                ]
                .map(|(name, measure)| (name, scope.spawn(move || measure(hz, seconds))))
                .map(|(name, thread)| (name, thread.join().unwrap()))
            });
            for (name, h) in rows {
                let missed = (hz * seconds).saturating_sub(h.0.len() as u64);
                row(&format!("{name} ({missed} missed)"), &h);
            }
        }
    }
}

fn ours(hz: u64, seconds: u64) -> Samples {
    let _ = Realtime::enter();
    let clock = Clock::start(1.0);
    let mut timer = AbsoluteTimer::new().unwrap();
    let mut h = Samples::default();
    let period_us = 1_000_000 / hz;
    let mut next_us = period_us;
    while next_us <= seconds * 1_000_000 {
        let at = Timestamp::from_us(next_us);
        timer.set(&clock, at);
        timer.wait_alone();
        let now = clock.now();
        h.record(now.since(at));
        next_us = next_us.max(now.us() / period_us * period_us) + period_us;
    }
    h
}

fn tokio_interval(hz: u64, seconds: u64) -> Samples {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .build()
        .unwrap();
    runtime.block_on(async {
        let period = Duration::from_micros(1_000_000 / hz);
        let mut interval = tokio::time::interval(period);
        interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        let start = tokio::time::Instant::now();
        let mut h = Samples::default();
        interval.tick().await;
        while start.elapsed() < Duration::from_secs(seconds) {
            let at = interval.tick().await;
            h.record(at.elapsed());
        }
        h
    })
}

#[allow(clippy::disallowed_methods, reason = "the plain way, for comparison")]
fn plain_sleep(hz: u64, seconds: u64) -> Samples {
    let mut h = Samples::default();
    let clock = Clock::start(1.0);
    let period_us = 1_000_000 / hz;
    let mut next_us = period_us;
    while next_us <= seconds * 1_000_000 {
        let at = Timestamp::from_us(next_us);
        std::thread::sleep(clock.until(at));
        let now = clock.now();
        h.record(now.since(at));
        next_us = next_us.max(now.us() / period_us * period_us) + period_us;
    }
    h
}
