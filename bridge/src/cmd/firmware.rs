//! Starts the real firmware for `kestrel sim --firmware betaflight` and makes a fresh one fit to fly.

use super::Usage;
use super::sim::{SimArgs, Speed};
use super::term::Terminal;
use anyhow::{Context as _, Result, anyhow};
use bridge::fc::conversation::{AskError, Controller};
use bridge::fc::setup::findings::writes;
use bridge::fc::setup::survey::identify;
use bridge::fc::setup::{Survey, apply, findings};
use bridge::io::bench_line::BenchLine;
use bridge::io::clock;
use bridge::io::endpoint::Endpoint;
use bridge::io::firmware::{Firmware, FirmwareLine, find};
use msp::command;
use sim::firmware::betaflight::{Dialect, UART1_PORT};
use std::time::Duration;

/// Longest time in which it ends after the order to restart.
const ENDING: Duration = Duration::from_secs(6);
/// Pause between two looks.
const LOOK: Duration = Duration::from_millis(20);

/// The firmware with its lines open.
pub(crate) fn start(args: &SimArgs, terminal: &mut Terminal) -> Result<FirmwareLine> {
    if args.speed.is_some_and(|speed| speed != Speed::Times(1.0)) {
        return Err(Usage(
            "--speed: the real firmware runs on the wall clock, so it flies at speed 1 only"
                .to_owned(),
        )
        .into());
    }
    let program = find(args.fc_binary.as_deref()).map_err(|e| Usage(e.to_string()))?;
    let mut firmware = Firmware::start(&program, args.fc_dir.as_deref()).map_err(|e| anyhow!(e))?;
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
    if !args.no_provision {
        let survey = Survey::take(&mut bench)?;
        let orders = writes(&findings(&survey, None));
        if !orders.is_empty() {
            let still_missing = |survey: &Survey| {
                let left = writes(&findings(survey, None));
                left.iter().map(|write| write.command).collect()
            };
            apply(&mut bench, &orders, &still_missing, &mut |text| {
                terminal.line(&format!("    {text}"));
            })?;
        }
    }
    drop(bench);
    FirmwareLine::open(firmware, Dialect::of_api(identity.api.minor)).map_err(|e| anyhow!(e))
}

/// The firmware's UART before the simulation takes it over.
struct Bench<'a> {
    line: Option<BenchLine>,
    firmware: &'a mut Firmware,
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
