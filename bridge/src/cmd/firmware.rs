//! The real firmware for `kestrel sim --firmware betaflight` (started here) or `inav` (started by the user), made fit to fly.

use super::Usage;
use super::sim::{DialectArg, FirmwareArg, SimArgs, Speed};
use super::term::Terminal;
use anyhow::{Context as _, Result, anyhow};
use bridge::fc::conversation::{AskError, Controller};
use bridge::fc::setup::findings::writes;
use bridge::fc::setup::survey::identify;
use bridge::fc::setup::{Survey, apply, findings};
use bridge::io::bench_line::BenchLine;
use bridge::io::clock;
use bridge::io::endpoint::{Endpoint, EndpointError};
use bridge::io::firmware::process;
use bridge::io::firmware::{FirmwareLine, InavLine, Outside, find};
use msp::{Firmware, command};
use sim::firmware::betaflight::{Dialect, UART1_PORT};
use sim::firmware::inav::SETTLE;
use std::time::Duration;

/// Longest time in which it ends after the order to restart.
const ENDING: Duration = Duration::from_secs(6);
/// Pause between two looks.
const LOOK: Duration = Duration::from_millis(20);

/// The firmware with its lines open; none if the built-in controller flies.
pub(crate) fn start(args: &SimArgs, terminal: &mut Terminal) -> Result<Option<Outside>> {
    let line = match args.firmware {
        FirmwareArg::BuiltIn => return Ok(None),
        FirmwareArg::Betaflight => Outside::Betaflight(Box::new(betaflight(args, terminal)?)),
        FirmwareArg::Inav => Outside::Inav(Box::new(inav(args, terminal)?)),
    };
    Ok(Some(line))
}

/// Writes what is missing, unless the user forbids it.
fn provision(
    args: &SimArgs,
    controller: &mut dyn Controller,
    terminal: &mut Terminal,
) -> Result<()> {
    if args.no_provision {
        return Ok(());
    }
    let orders = writes(&findings(&Survey::take(controller)?, None));
    if !orders.is_empty() {
        let still_missing = |survey: &Survey| {
            let left = writes(&findings(survey, None));
            left.iter().map(|write| write.command).collect()
        };
        apply(controller, &orders, &still_missing, &mut |text| {
            terminal.line(&format!("    {text}"));
        })?;
    }
    Ok(())
}

fn real_time(args: &SimArgs) -> Result<()> {
    if args.speed.is_some_and(|speed| speed != Speed::Times(1.0)) {
        return Err(Usage(
            "--speed: the real firmware runs on the wall clock, so it flies at speed 1 only"
                .to_owned(),
        )
        .into());
    }
    Ok(())
}

fn inav(args: &SimArgs, terminal: &mut Terminal) -> Result<InavLine> {
    real_time(args)?;
    let parse = |url: &str| -> Result<Endpoint> {
        url.parse()
            .map_err(|e: EndpointError| Usage(e.to_string()).into())
    };
    let fc = parse(args.fc.as_deref().ok_or_else(|| {
        Usage("--firmware inav: name the MSP port it is flown by, for example --fc tcpclient://127.0.0.1:5770".to_owned())
    })?)?;
    let sensors = match &args.fc_sim {
        Some(url) => parse(url)?,
        None => next_port(&fc).ok_or_else(|| {
            Usage(
                "--fc-sim: name a second MSP port of the INAV, for the simulated sensors"
                    .to_owned(),
            )
        })?,
    };
    if fc == sensors {
        return Err(Usage("--fc and --fc-sim must be two ports".to_owned()).into());
    }
    let mut bench = BenchLine::open(fc.clone()).map_err(|e| anyhow!(e))?;
    let identity = identify(&mut bench).context("the firmware's first answer")?;
    if identity.firmware != Firmware::Inav {
        return Err(Usage(format!("{fc} is {identity}, not INAV")).into());
    }
    terminal.line(&format!("  It is {identity}; sensors on {sensors}"));
    provision(args, &mut bench, terminal)?;
    drop(bench);
    Ok(InavLine::new(fc, sensors, SETTLE))
}

/// INAV's simulator build listens for UART 1, 2 ... on ports in a row.
fn next_port(fc: &Endpoint) -> Option<Endpoint> {
    let Endpoint::TcpClient(address) = fc else {
        return None;
    };
    let (host, port) = address.rsplit_once(':')?;
    let next = port.parse::<u16>().ok()?.checked_add(1)?;
    Some(Endpoint::TcpClient(format!("{host}:{next}")))
}

fn betaflight(args: &SimArgs, terminal: &mut Terminal) -> Result<FirmwareLine> {
    real_time(args)?;
    let program = find(args.fc_binary.as_deref()).map_err(|e| Usage(e.to_string()))?;
    let mut firmware =
        process::Firmware::start(&program, args.fc_dir.as_deref()).map_err(|e| anyhow!(e))?;
    terminal.line(&format!(
        "  Firmware {}, words in {}",
        program.display(),
        firmware.log().display()
    ));
    let mut bench = Bench {
        line: None,
        firmware: &mut firmware,
        starts_left: 4,
    };
    bench.open().context("the firmware's first answer")?;
    let identity = identify(&mut bench).context("the firmware's first answer")?;
    terminal.line(&format!("  It is {identity}"));
    provision(args, &mut bench, terminal)?;
    drop(bench);
    let dialect = match args.fc_dialect {
        Some(DialectArg::Bf46) => Dialect::Betaflight46,
        Some(DialectArg::Bf2026) => Dialect::Betaflight2026,
        None => Dialect::of_api(identity.api.minor),
    };
    FirmwareLine::open(firmware, dialect).map_err(|e| anyhow!(e))
}

/// The firmware's UART before the simulation takes it over.
struct Bench<'a> {
    line: Option<BenchLine>,
    firmware: &'a mut process::Firmware,
    /// How often it may be started again because it does not answer.
    starts_left: u32,
}

impl Bench<'_> {
    /// Opens the line. A firmware whose scheduler got stuck at the start does not answer; it is started again.
    fn open(&mut self) -> Result<(), AskError> {
        let failed = |e: String| AskError::Line(e);
        loop {
            self.firmware
                .wait_until_it_listens()
                .map_err(|e| failed(e.to_string()))?;
            let endpoint = Endpoint::TcpClient(format!("127.0.0.1:{UART1_PORT}"));
            let mut line = BenchLine::open(endpoint).map_err(|e| failed(e.to_string()))?;
            let answer = line.ask(command::API_VERSION, &[]);
            if answer.is_ok() || self.starts_left == 0 {
                self.line = Some(line);
                return answer.map(drop);
            }
            self.starts_left -= 1;
            drop(line);
            self.firmware.restart().map_err(|e| failed(e.to_string()))?;
        }
    }
}

impl Controller for Bench<'_> {
    fn ask(&mut self, command: u16, payload: &[u8]) -> Result<Vec<u8>, AskError> {
        match &mut self.line {
            Some(line) => line.ask(command, payload),
            None => Err(AskError::Line("closed".to_owned())),
        }
    }

    /// A restart of this firmware is the end of its process, and we are who starts it again.
    fn come_back(&mut self) -> Result<(), AskError> {
        self.line = None;
        for _ in 0..ENDING.as_millis() / LOOK.as_millis() {
            match self.firmware.restart_if_ended() {
                Ok(true) => return self.open(),
                Ok(false) => clock::sleep(LOOK),
                Err(e) => return Err(AskError::Line(e.to_string())),
            }
        }
        Err(AskError::Line("the firmware did not restart".to_owned()))
    }
}
