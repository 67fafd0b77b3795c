//! Prints the attitude of a flight controller on a serial port, ten lines a second.
//!
//! `cargo run -p msp --example attitude -- /dev/ttyAMA0 115200`
//!
//! The client has no I/O: this file opens the port, tells the time and carries the bytes.

#![allow(
    clippy::disallowed_methods,
    clippy::disallowed_types,
    reason = "an example is the shell around the core: it opens files and reads the clock"
)]
#![expect(clippy::print_stdout, reason = "that is what it is for")]

use msp::client::{Client, Config, Event};
use msp::{Firmware, Reply};
use rustix::event::{PollFd, PollFlags, Timespec};
use rustix::fs::{Mode, OFlags};
use rustix::termios::OptionalActions;
use std::error::Error;
use std::fs::File;
use std::io::{ErrorKind, Read as _, Write as _};
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let device = arguments.next().ok_or("usage: attitude DEVICE [BAUD]")?;
    let baud = arguments.next().map_or(Ok(115_200), |baud| baud.parse())?;
    let mut port = open(&device, baud)?;

    let start = Instant::now();
    let now_us = || u64::try_from(start.elapsed().as_micros()).unwrap_or(u64::MAX);
    let mut client = Client::new(Config::default());
    client.connect(now_us());
    let (mut bytes, mut printed_us) = ([0; 512], 0);
    loop {
        let count = match port.read(&mut bytes) {
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::WouldBlock => 0,
            Err(error) => return Err(error.into()),
        };
        client.handle(now_us(), &bytes[..count]);
        while let Some(request) = client.poll_transmit(now_us()) {
            port.write_all(request)?;
        }
        while let Some(event) = client.poll_event() {
            match event {
                Event::Reply {
                    reply: Reply::Attitude(attitude),
                    received_us,
                    ..
                } => {
                    if received_us >= printed_us + 100_000 {
                        printed_us = received_us;
                        // Wire units to people's: pitch comes nose down positive.
                        println!(
                            "roll {:6.1}  pitch {:6.1}  heading {:3}   {:.0} answers/s",
                            f64::from(attitude.roll_ddeg) / 10.0,
                            -f64::from(attitude.pitch_ddeg) / 10.0,
                            attitude.yaw_deg,
                            client.statistics().reply_rate_hz,
                        );
                    }
                }
                Event::Reply { .. } => {}
                Event::Identified(identity) => {
                    println!("{identity}");
                    if identity.firmware == Firmware::MultiWii {
                        println!("(MultiWii counts headings from -180 to 180)");
                    }
                }
                event => println!("{event}"),
            }
        }
        let wait_us = client
            .deadline_us()
            .map_or(10_000, |at_us| at_us.saturating_sub(now_us()))
            .clamp(1, 100_000);
        let limit = Timespec {
            tv_sec: 0,
            tv_nsec: i64::try_from(wait_us * 1000)?,
        };
        rustix::event::poll(&mut [PollFd::new(&port, PollFlags::IN)], Some(&limit))?;
    }
}

/// Raw, no flow control, never blocking.
fn open(device: &str, baud: u32) -> Result<File, Box<dyn Error>> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let port = rustix::fs::open(device, flags, Mode::empty())?;
    let mut settings = rustix::termios::tcgetattr(&port)?;
    settings.make_raw();
    settings.set_speed(baud)?;
    rustix::termios::tcsetattr(&port, OptionalActions::Now, &settings)?;
    Ok(File::from(port))
}
