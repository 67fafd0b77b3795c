//! `kestrel fc passthrough`.

use super::super::Usage;
use super::super::stop::Stop;
use super::{FcLine, say};
use anyhow::{Context as _, Result};
use bridge::io::endpoint::{Endpoint, EndpointError};
use bridge::io::passthrough::{Door, Ended};
use clap::Args;
use std::process::ExitCode;

/// Where configurators look for a firmware simulator.
pub(crate) const LISTEN: &str = "tcpserver://127.0.0.1:5761";

#[derive(Clone, Debug, Args)]
pub(super) struct PassthroughArgs {
    #[command(flatten)]
    line: FcLine,
    /// Where the configurator connects; one client at a time. Whoever reaches it can do anything to the controller.
    #[arg(long, value_name = "URL", default_value = LISTEN)]
    listen: String,
}

/// Opens the door that a URL names.
pub(crate) fn open_door(url: &str) -> Result<Door> {
    let endpoint: Endpoint = url
        .parse()
        .map_err(|e: EndpointError| Usage(e.to_string()))?;
    let Endpoint::TcpServer(address) = endpoint else {
        return Err(Usage(format!("{url}: use tcpserver://host:port")).into());
    };
    Door::open(&address).with_context(|| format!("cannot listen on {address}"))
}

pub(super) fn run(args: &PassthroughArgs) -> Result<ExitCode> {
    let stop = Stop::listen()?;
    let is_over = || stop.count() > 0;
    let door = open_door(&args.listen)?;
    // Before anybody comes: a wrong URL, a wrong baud rate are said now.
    drop(args.line.open()?);
    say(&format!(
        "{} is on tcp://{}, one client at a time, while it is disarmed; Ctrl-C ends",
        args.line.fc,
        door.address()?
    ));
    while let Some(client) = door.wait(&is_over) {
        let mut line = match args.line.open() {
            Ok(line) => line,
            Err(e) => {
                say(&format!("{e:#}"));
                continue;
            }
        };
        let who = client.peer_addr().map(|a| a.to_string());
        say(&format!("{} has the line", who.unwrap_or_default()));
        match door.carry(&mut line, client, &is_over)? {
            Ended::Stopped => break,
            ended => say(&ended.to_string()),
        }
    }
    Ok(ExitCode::SUCCESS)
}
