//! `kestrel msp serve`: a simulated flight controller on TCP, for client libraries and configurators.

use super::{Usage, rooms};
use anyhow::{Context as _, Result};
use bridge::io::clock::Clock;
use bridge::io::endpoint::{Endpoint, EndpointError};
use clap::Args;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use sim::{FcConfig, Manner, SimConfig, SimOutput, Simulator, VehicleConfig};
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::process::ExitCode;
use std::time::Duration;
use vehicle::{RingConfig, Timestamp};

#[derive(Debug, Args)]
pub(crate) struct ServeArgs {
    /// Where to listen; one client at a time, as the firmwares' simulator builds do.
    #[arg(value_name = "URL", default_value = "tcpserver://127.0.0.1:5761")]
    listen: String,
    /// MSP commands it handles a second (`serial_update_rate_hz`).
    #[arg(long, value_name = "HZ", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=1000))]
    serial_rate: u32,
    /// Speed of its UART.
    #[arg(long, value_name = "BAUD", default_value_t = 115_200, value_parser = clap::value_parser!(u32).range(1200..=10_000_000))]
    baud: u32,
    /// Which firmware it behaves like (see `kestrel sim --manner`).
    #[arg(long, value_name = "NAME", default_value_t = Manner::default())]
    manner: Manner,
    /// The room it stands in.
    #[arg(long, value_name = "ROOM", default_value = "office")]
    room: String,
}

pub(crate) fn run(args: &ServeArgs) -> Result<ExitCode> {
    let endpoint: Endpoint = args
        .listen
        .parse()
        .map_err(|error: EndpointError| Usage(error.to_string()))?;
    let Endpoint::TcpServer(address) = endpoint else {
        return Err(Usage(format!("{}: use tcpserver://host:port", args.listen)).into());
    };
    let room = rooms::bundled(&args.room)?;
    let ring = RingConfig::built_in("tof32")?;
    let vehicle = VehicleConfig {
        fc: FcConfig {
            manner: args.manner,
            serial_rate_hz: args.serial_rate,
            baud: args.baud,
            ..FcConfig::default()
        },
        ..VehicleConfig::new(room.home(), ring.clone())
    };
    let mut simulator = Simulator::new(SimConfig {
        vehicles: vec![vehicle],
        ..SimConfig::new(room, ring, 1)
    })?;
    let listener =
        TcpListener::bind(&address).with_context(|| format!("cannot listen on {address}"))?;
    let _ = writeln!(
        std::io::stdout(),
        "flight controller on {}: {} requests/s, {} baud; Ctrl-C ends",
        listener.local_addr()?,
        args.serial_rate,
        args.baud
    );
    let _ = std::io::stdout().flush();
    let mut until = Timestamp::ZERO;
    for stream in listener.incoming() {
        // A client that goes is no failure of ours.
        if let Err(error) = stream.and_then(|stream| serve(&mut simulator, &mut until, stream)) {
            tracing::debug!("client: {error}");
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Until the client closes. Time stands still while nobody is there.
fn serve(
    simulator: &mut Simulator,
    until: &mut Timestamp,
    mut stream: TcpStream,
) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_nonblocking(true)?;
    // Half a step of the simulator. Not a time-out of the socket: those are as coarse as the kernel's tick.
    let pause = Timespec {
        tv_sec: 0,
        tv_nsec: 500_000,
    };
    let (start, clock) = (*until, Clock::start(1.0));
    let (mut heard, mut said) = ([0; 2048], Vec::with_capacity(4096));
    loop {
        let mut news = [PollFd::new(&stream, PollFlags::IN)];
        if let Err(error) = poll(&mut news, Some(&pause))
            && error != Errno::INTR
        {
            return Err(error.into());
        }
        match stream.read(&mut heard) {
            Ok(0) => return Ok(()),
            Ok(count) => simulator.write_fc(0, &heard[..count]),
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            Err(error) => return Err(error),
        }
        *until = start + Duration::from_micros(clock.now().us());
        simulator.advance(*until, &mut |_, output| {
            if let SimOutput::FcBytes { bytes, .. } = output {
                said.extend_from_slice(&bytes);
            }
        });
        stream.write_all(&said)?;
        said.clear();
    }
}
