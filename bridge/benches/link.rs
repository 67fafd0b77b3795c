//! Frames through Kestrel from socket to socket, beside MAVProxy in the same run.
//!
//! ```text
//! cargo build --release && KESTREL_PYTHON=.venv/bin/python cargo bench -p bridge --bench link
//! ```
//!
//! One JSON line each. **forward**: 1,000 messages a second from a companion (`?route=on`) to a station, UDP to UDP: delay, CPU a message,
//! resident memory. **max**: a ladder of rates, 2 s each and at most three tries, to the highest with at most 0.1 % lost. **fan-out**: the same to 1, 4 and 16
//! stations. **start**: from spawn to the first heartbeat. `KESTREL_BIN` names the program (default target/release/kestrel).

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    missing_docs,
    reason = "a bench prints its figures and fails where it stands"
)]

use bridge::io::clock::{monotonic_ns, sleep};
use mavlink_dialect::standard::ATTITUDE_DATA;
use mavlink_dialect::{Address, Encoder, MessageData, raw};
use rustix::net::sockopt::set_socket_recv_buffer_size;
use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Where the send time stands in the frame: ATTITUDE's first fields hold it.
const HEADER: usize = 10;

struct Program {
    name: &'static str,
    child: Child,
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Program {
    fn kestrel(inlet: u16, outlet: u16) -> Self {
        let binary =
            std::env::var("KESTREL_BIN").unwrap_or_else(|_| "target/release/kestrel".to_owned());
        let child = Command::new(binary)
            .args(["sim", "office", "--headless", "--quiet"])
            .args([
                "--mavlink",
                &format!("udpserver://127.0.0.1:{inlet}?route=on"),
            ])
            .args(["--mavlink", &format!("udpserver://127.0.0.1:{outlet}")])
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        Self {
            name: "kestrel",
            child,
        }
    }

    fn mavproxy(inlet: u16, outlets: &[u16]) -> Option<Self> {
        let python = std::env::var("KESTREL_PYTHON").ok()?;
        let script = std::path::Path::new(&python).parent()?.join("mavproxy.py");
        let mut command = Command::new(&python);
        command
            .arg(script)
            .arg(format!("--master=udpin:127.0.0.1:{inlet}"))
            .args([
                "--daemon",
                "--non-interactive",
                "--default-modules=link,output",
            ])
            .env("MAVLINK20", "1")
            .env("HOME", std::env::temp_dir())
            .current_dir(std::env::temp_dir())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        for outlet in outlets {
            command.arg(format!("--out=udpout:127.0.0.1:{outlet}"));
        }
        let child = command.spawn().ok()?;
        Some(Self {
            name: "mavproxy",
            child,
        })
    }

    /// User and system time so far, s.
    fn cpu_s(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap();
        let fields: Vec<&str> = stat
            .rsplit(')')
            .next()
            .unwrap()
            .split_whitespace()
            .collect();
        let ticks: u64 = fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap();
        ticks as f64 / 100.0
    }

    fn resident_mb(&self) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find(|l| l.starts_with("VmRSS")).unwrap();
        line.split_whitespace()
            .nth(1)
            .unwrap()
            .parse::<f64>()
            .unwrap()
            / 1024.0
    }
}

fn socket() -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket
        .set_read_timeout(Some(Duration::from_millis(100)))
        .unwrap();
    // What the program has sent must not be lost here.
    set_socket_recv_buffer_size(&socket, 4 << 20).unwrap();
    socket
}

fn free_port() -> u16 {
    socket().local_addr().unwrap().port()
}

/// A companion and its stations around a program.
struct Table {
    program: Program,
    source: UdpSocket,
    inlet: u16,
    stations: Vec<UdpSocket>,
    outlet: Option<u16>,
    encoder: Encoder,
}

fn beat(encoder: &mut Encoder, kind: u8) -> Vec<u8> {
    let beat = raw::HEARTBEAT_DATA {
        mavtype: kind,
        autopilot: 8,
        mavlink_version: 3,
        ..Default::default()
    };
    encoder.encode(&beat).to_vec()
}

impl Table {
    fn new(is_kestrel: bool, stations: usize) -> Option<Self> {
        let (inlet, outlet) = (free_port(), free_port());
        let stations: Vec<UdpSocket> = (0..stations).map(|_| socket()).collect();
        let program = if is_kestrel {
            Program::kestrel(inlet, outlet)
        } else {
            let outlets: Vec<u16> = stations
                .iter()
                .map(|s| s.local_addr().unwrap().port())
                .collect();
            Program::mavproxy(inlet, &outlets)?
        };
        let mut table = Self {
            program,
            source: socket(),
            inlet,
            stations,
            outlet: is_kestrel.then_some(outlet),
            encoder: Encoder::new(Address {
                system: 7,
                component: 1,
            }),
        };
        // Until the first frame comes through.
        let mut buffer = [0u8; 600];
        for _ in 0..300 {
            table.keep_alive();
            table.send();
            sleep(Duration::from_millis(20));
            let s = &table.stations[0];
            s.set_nonblocking(true).unwrap();
            let mut came = false;
            while let Ok(n) = s.recv(&mut buffer) {
                came |= is_ours(&buffer[..n]);
            }
            s.set_nonblocking(false).unwrap();
            if came {
                sleep(Duration::from_millis(500));
                return Some(table);
            }
        }
        None
    }

    fn keep_alive(&mut self) {
        let mut encoder = Encoder::new(Address {
            system: 250,
            component: 190,
        });
        if let Some(outlet) = self.outlet {
            for s in &self.stations {
                let _ = s.send_to(&beat(&mut encoder, 18), ("127.0.0.1", outlet));
            }
        }
        let bytes = beat(&mut self.encoder, 2);
        let _ = self.source.send_to(&bytes, ("127.0.0.1", self.inlet));
    }

    /// One message with its time in it.
    fn send(&mut self) {
        let now = monotonic_ns();
        let message = ATTITUDE_DATA {
            time_boot_ms: now as u32,
            roll: f32::from_bits((now >> 32) as u32),
            // Never zero, so that nothing is cut.
            yawspeed: 1.0,
            ..Default::default()
        };
        let frame = self.encoder.encode(&message);
        let _ = self.source.send_to(&frame, ("127.0.0.1", self.inlet));
    }

    /// So many a second for a time: (sent, delays of each station in us, CPU us a message).
    fn run(&mut self, hz: f64, seconds: f64) -> (u64, Vec<Vec<f64>>, f64) {
        let over = Arc::new(AtomicBool::new(false));
        let readers: Vec<_> = self
            .stations
            .iter()
            .map(|s| {
                let (s, over) = (s.try_clone().unwrap(), Arc::clone(&over));
                std::thread::spawn(move || {
                    let (mut delays, mut buffer) = (Vec::new(), [0u8; 600]);
                    while !over.load(Ordering::Relaxed) {
                        let Ok(n) = s.recv(&mut buffer) else { continue };
                        let now = monotonic_ns();
                        let mut at = 0;
                        // MAVProxy may put several frames into a datagram.
                        while at + 12 <= n {
                            let len = usize::from(buffer[at + 1]) + 12;
                            if is_ours(&buffer[at..n]) {
                                let word = |i: usize| {
                                    let b = &buffer[at + HEADER + i..];
                                    u64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                                };
                                let sent = word(0) | word(4) << 32;
                                delays.push(now.saturating_sub(sent) as f64 * 1e-3);
                            }
                            at += len;
                        }
                    }
                    delays
                })
            })
            .collect();
        let cpu = self.program.cpu_s();
        let begin = monotonic_ns();
        let mut sent = 0u64;
        let total = (hz * seconds) as u64;
        while sent < total {
            let due = begin + (sent as f64 / hz * 1e9) as u64;
            let now = monotonic_ns();
            if now < due {
                // Short waits spin: sleeping is too coarse for the fast rungs.
                if due - now > 200_000 {
                    sleep(Duration::from_nanos(due - now - 100_000));
                }
                continue;
            }
            self.send();
            sent += 1;
            if sent.is_multiple_of((hz as u64).max(1)) {
                self.keep_alive();
            }
        }
        sleep(Duration::from_millis(300));
        over.store(true, Ordering::Relaxed);
        let delays: Vec<Vec<f64>> = readers.into_iter().map(|r| r.join().unwrap()).collect();
        let used = self.program.cpu_s() - cpu;
        (sent, delays, used * 1e6 / sent as f64)
    }
}

fn is_ours(frame: &[u8]) -> bool {
    frame.len() > HEADER + 8
        && frame[0] == 0xFD
        && frame[5] == 7
        && frame[7..10] == [ATTITUDE_DATA::ID as u8, 0, 0]
}

fn at(sorted: &[f64], share: f64) -> f64 {
    sorted
        .get(((sorted.len() as f64 - 1.0) * share) as usize)
        .copied()
        .unwrap_or(f64::NAN)
}

/// What the program uses without messages to pass on, us of CPU a second.
fn idle(table: &mut Table) -> f64 {
    table.keep_alive();
    let (cpu, begin) = (table.program.cpu_s(), monotonic_ns());
    sleep(Duration::from_secs(3));
    let seconds = (monotonic_ns() - begin) as f64 * 1e-9;
    (table.program.cpu_s() - cpu) * 1e6 / seconds
}

fn main() {
    // `cargo test --benches` passes this.
    if std::env::args().any(|a| a == "--test") {
        return;
    }
    for is_kestrel in [true, false] {
        let Some(mut table) = Table::new(is_kestrel, 1) else {
            println!("SKIPPED: no MAVProxy (KESTREL_PYTHON names a Python that has it)");
            continue;
        };
        let name = table.program.name;
        let idle_us = idle(&mut table);
        let (sent, mut delays, cpu_us) = table.run(1_000.0, 10.0);
        let d = &mut delays[0];
        d.sort_by(f64::total_cmp);
        println!(
            "{{\"bench\":\"link/forward\",\"program\":\"{name}\",\"sent\":{sent},\"got\":{},\"p50_us\":{:.0},\"p99_us\":{:.0},\"p999_us\":{:.0},\"cpu_us_per_message\":{cpu_us:.1},\"without_idle\":{:.1},\"rss_mb\":{:.1}}}",
            d.len(),
            at(d, 0.5),
            at(d, 0.99),
            at(d, 0.999),
            cpu_us - idle_us / 1_000.0,
            table.program.resident_mb()
        );
        let (mut rate, mut highest) = (1_000.0, 0.0);
        while rate < 200_000.0 {
            // Of three tries the best: other programs on the machine take the processor away too.
            let mut lost = f64::INFINITY;
            for _ in 0..3 {
                let (sent, delays, _) = table.run(rate, 2.0);
                lost = lost.min(1.0 - delays[0].len() as f64 / sent as f64);
                if lost <= 0.001 {
                    break;
                }
            }
            if lost > 0.001 {
                println!(
                    "{{\"bench\":\"link/max\",\"program\":\"{name}\",\"rate\":{rate:.0},\"lost\":{lost:.4}}}"
                );
                break;
            }
            highest = rate;
            rate *= core::f64::consts::SQRT_2;
        }
        println!("{{\"bench\":\"link/max\",\"program\":\"{name}\",\"highest\":{highest:.0}}}");
        drop(table);
        for stations in [1, 4, 16] {
            let Some(mut table) = Table::new(is_kestrel, stations) else {
                continue;
            };
            let (sent, delays, cpu_us) = table.run(500.0, 4.0);
            let least = delays.iter().map(Vec::len).min().unwrap_or(0);
            println!(
                "{{\"bench\":\"link/fan-out\",\"program\":\"{name}\",\"stations\":{stations},\"sent\":{sent},\"least_got\":{least},\"cpu_us_per_message_and_station\":{:.1}}}",
                cpu_us / stations as f64
            );
        }
    }
    start();
}

/// From spawn to the first heartbeat at a station that Kestrel calls.
fn start() {
    let binary =
        std::env::var("KESTREL_BIN").unwrap_or_else(|_| "target/release/kestrel".to_owned());
    let mut times = Vec::new();
    for _ in 0..10 {
        let station = socket();
        let port = station.local_addr().unwrap().port();
        let begin = monotonic_ns();
        let child = Command::new(&binary)
            .args([
                "sim",
                "office",
                "--headless",
                "--quiet",
                "--mavlink",
                &format!("udpclient://127.0.0.1:{port}"),
            ])
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let _program = Program {
            name: "kestrel",
            child,
        };
        let mut buffer = [0u8; 600];
        while station.recv(&mut buffer).is_err() {}
        times.push((monotonic_ns() - begin) as f64 * 1e-6);
    }
    times.sort_by(f64::total_cmp);
    println!(
        "{{\"bench\":\"link/start\",\"first_heartbeat_ms_p50\":{:.1},\"max\":{:.1}}}",
        at(&times, 0.5),
        at(&times, 1.0)
    );
}
