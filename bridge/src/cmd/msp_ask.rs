//! `kestrel msp ask`: asks a flight controller and prints what it answers.

use super::Usage;
use super::msp::reply_fields;
use anyhow::{Context as _, Result, bail};
use bridge::io::clock::Clock;
use bridge::io::endpoint::{Endpoint, EndpointError};
use bridge::io::line::open_serial;
use clap::Args;
use msp::client::{Client, Config, Event, Schedule};
use msp::{Reply, command};
use rustix::event::{PollFd, PollFlags, Timespec};
use serde_json::json;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::os::fd::{AsFd, BorrowedFd};
use std::process::ExitCode;

/// A controller that is silent for so long is not there, us.
const PATIENCE_US: u64 = 3_000_000;

#[derive(Debug, Args)]
pub(crate) struct AskArgs {
    /// Flight controller: serial:///dev/...?baudrate=N or tcpclient://host:port.
    #[arg(value_name = "URL")]
    fc: String,
    /// What to ask: MSP_ATTITUDE, attitude or 108.
    #[arg(value_name = "MESSAGE", required = true)]
    messages: Vec<String>,
    /// How often each; only the first answers are printed.
    #[arg(long, value_name = "N", default_value_t = 1)]
    count: u32,
}

pub(crate) fn run(args: &AskArgs) -> Result<ExitCode> {
    let asked: Result<Vec<u16>> = args.messages.iter().map(|name| number(name)).collect();
    let asked = asked?;
    let endpoint: Endpoint = args
        .fc
        .parse()
        .map_err(|error: EndpointError| Usage(error.to_string()))?;
    let mut line = Line::open(&endpoint).with_context(|| format!("cannot open {}", args.fc))?;
    let clock = Clock::start(1.0);
    // Questions one after the other and nothing else: the round trip is that of one message.
    let config = Config {
        schedule: Some(Schedule::new()),
        refresh_us: 0,
        ..Config::default()
    };
    let mut client = Client::new(config);
    client.connect(clock.now().us());
    let total = args.count as usize * asked.len();
    let mut round_trips_us = Vec::with_capacity(total);
    let (mut next, mut begun_us) = (0, None);
    let mut heard_us = 0;
    let mut bytes = [0; 4096];
    let mut out = std::io::stdout().lock();
    while round_trips_us.len() < total {
        let count = line.read(&mut bytes)?;
        let now_us = clock.now().us();
        client.handle(now_us, &bytes[..count]);
        while let Some(request) = client.poll_transmit(now_us) {
            line.write(request)?;
        }
        let mut is_answered = false;
        while let Some(event) = client.poll_event() {
            heard_us = now_us;
            match event {
                Event::Identified(_) => is_answered = true,
                Event::Reply {
                    reply,
                    sent_us,
                    received_us,
                } => {
                    round_trips_us.push(received_us - sent_us);
                    is_answered = true;
                    if round_trips_us.len() <= asked.len() {
                        print(&mut out, &reply)?;
                    }
                }
                Event::Refused { command } => {
                    bail!("it refused {} ({command})", command::name(command))
                }
                Event::Unanswered { .. } | Event::Malformed(_) => bail!("{event}"),
                _ => {}
            }
        }
        if is_answered && next < total {
            begun_us.get_or_insert(now_us);
            client.request(asked[next % asked.len()], &[])?;
            next += 1;
            continue;
        }
        if now_us > heard_us + PATIENCE_US {
            bail!(
                "no answer on {}: is a flight controller there, MSP enabled on that port?",
                args.fc
            );
        }
        let until_us = client.deadline_us().unwrap_or(now_us + 10_000);
        line.wait(until_us.saturating_sub(now_us).clamp(1, 100_000))?;
    }
    let took_s = (clock.now().us() - begun_us.unwrap_or(0)) as f64 / 1e6;
    round_trips_us.sort_unstable();
    let at = |percent: usize| round_trips_us[(round_trips_us.len() - 1) * percent / 100];
    if args.count > 1 {
        let _ = writeln!(
            std::io::stderr(),
            "{total} answers in {took_s:.2} s: {:.0}/s, round trip p50 {} us, p99 {} us",
            total as f64 / took_s,
            at(50),
            at(99)
        );
    }
    Ok(ExitCode::SUCCESS)
}

fn print(out: &mut impl Write, reply: &Reply) -> Result<()> {
    let number = reply.command();
    let mut payload = Vec::new();
    reply.emit(&mut payload);
    let object = json!({
        "cmd": number,
        "name": command::name(number),
        "fields": reply_fields(number, &payload)?,
    });
    writeln!(out, "{object}")?;
    Ok(())
}

/// Number of a message by name or number.
fn number(name: &str) -> Result<u16> {
    if let Ok(number) = name.parse() {
        return Ok(number);
    }
    let wanted = name.to_ascii_uppercase();
    let is_it = |known: &str| {
        known == wanted
            || known.strip_prefix("MSP_") == Some(&wanted)
            || known.strip_prefix("MSP2_") == Some(&wanted)
    };
    (0..0x4000)
        .find(|number| is_it(command::name(*number)))
        .ok_or_else(|| {
            Usage(format!(
                "no message `{name}`: write it like MSP_ATTITUDE or 108"
            ))
            .into()
        })
}

/// The line to a controller, never blocking.
enum Line {
    Serial(std::fs::File),
    Tcp(TcpStream),
}

impl Line {
    fn open(endpoint: &Endpoint) -> Result<Self> {
        match endpoint {
            Endpoint::Serial { device, baud } => Ok(Self::Serial(open_serial(device, *baud)?)),
            Endpoint::TcpClient(address) => {
                let stream = TcpStream::connect(address)?;
                stream.set_nodelay(true)?;
                stream.set_nonblocking(true)?;
                Ok(Self::Tcp(stream))
            }
            _ => bail!(Usage(
                "use serial:///dev/...?baudrate=N or tcpclient://host:port".into()
            )),
        }
    }

    fn read(&mut self, into: &mut [u8]) -> Result<usize> {
        let got = match self {
            Self::Serial(file) => file.read(into),
            Self::Tcp(stream) => stream.read(into),
        };
        match got {
            Ok(0) if matches!(self, Self::Tcp(_)) => {
                bail!("the flight controller closed the connection")
            }
            Ok(count) => Ok(count),
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) =>
            {
                Ok(0)
            }
            Err(error) => Err(error.into()),
        }
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        match self {
            Self::Serial(file) => file.write_all(bytes)?,
            Self::Tcp(stream) => stream.write_all(bytes)?,
        }
        Ok(())
    }

    /// Until bytes come, this long at most.
    fn wait(&self, us: u64) -> Result<()> {
        let fd: BorrowedFd<'_> = match self {
            Self::Serial(file) => file.as_fd(),
            Self::Tcp(stream) => stream.as_fd(),
        };
        let limit = Timespec {
            tv_sec: 0,
            tv_nsec: i64::try_from(us * 1000)
                .unwrap_or(1_000_000)
                .min(999_999_999),
        };
        match rustix::event::poll(&mut [PollFd::new(&fd, PollFlags::IN)], Some(&limit)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_go_by_name_and_number() {
        for name in ["MSP_ATTITUDE", "attitude", "108"] {
            assert_eq!(number(name).unwrap(), 108);
        }
        assert_eq!(number("inav_status").unwrap(), 0x2000);
        assert!(number("altitute").is_err());
    }
}
