//! `kestrel console`: the page for several vehicles, on a machine that is none of them.

use super::Usage;
use super::fly::{host_names, state_folder};
use super::stop::Stop;
use super::term::Terminal;
use anyhow::Result;
use bridge::web::place::Place;
use bridge::web::{Console, FleetConfig, console};
use clap::Args;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::time::Duration;

/// Serve the console for several vehicles: each user sees and commands those assigned to him.
#[derive(Debug, Args)]
#[command(
    after_help = "Every vehicle keeps its own console (kestrel fly --console, kestrel sim); this one opens them with a key. Vehicles and whom they\n\
    are assigned to are kept; they are changed on the page (tab People) too.\n\n\
    Examples:\n  kestrel passwd --key guardhouse                    on the drone: prints the address with a key\n  \
    kestrel console --vehicle 'https://drone.local:8443/#key=...&pin=...'\n  \
    kestrel console --vehicle 'east=http://127.0.0.1:8443/#enter=...' --vehicle 'west=http://127.0.0.1:8453/#enter=...'   two simulators\n  \
    kestrel console --listen 0.0.0.0:8443              for other machines; somebody must have a password:\n  \
    kestrel passwd ana --role admin --state-dir ~/.local/state/kestrel-console"
)]
pub(crate) struct ConsoleArgs {
    /// A vehicle's console with its key, or the link of a simulator's terminal; a name in front of it is what the vehicle is called
    /// here. Several are allowed; those of earlier runs are known.
    #[arg(long, value_name = "[NAME=]URL")]
    vehicle: Vec<Wanted>,
    /// Where to listen; default: 127.0.0.1:8443 or the next free port.
    #[arg(long, value_name = "ADDR")]
    listen: Option<SocketAddr>,
    /// Folder of accounts, vehicles and certificate; default: $XDG_STATE_HOME/kestrel-console or ~/.local/state/kestrel-console.
    #[arg(long, value_name = "DIR")]
    state_dir: Option<PathBuf>,
}

/// A vehicle of the command line.
#[derive(Clone, Debug)]
struct Wanted {
    name: Option<String>,
    place: Place,
}

impl FromStr for Wanted {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // A name has no colon; an address has one before any equals sign.
        let (name, url) = match text.split_once('=') {
            Some((name, url)) if !name.contains(':') => (Some(name), url),
            _ => (None, text),
        };
        let is_plain = |n: &str| {
            (1..=32).contains(&n.len())
                && n.starts_with(|c: char| c.is_ascii_alphanumeric())
                && n.chars()
                    .all(|c| c.is_ascii_alphanumeric() || "._-".contains(c))
        };
        if name.is_some_and(|n| !is_plain(n)) {
            return Err("a vehicle's name is 1 to 32 letters, digits, dots, dashes".to_owned());
        }
        Ok(Self {
            name: name.map(str::to_owned),
            place: url.parse()?,
        })
    }
}

pub(crate) fn run(args: ConsoleArgs) -> Result<ExitCode> {
    let folder = args
        .state_dir
        .or_else(|| state_folder().map(|d| d.with_file_name("kestrel-console")))
        .ok_or_else(|| {
            Usage("no home folder to keep accounts in: name one with --state-dir".to_owned())
        })?;
    std::fs::create_dir_all(&folder)?;
    let stop = Stop::listen()?;
    let console = Console::start_fleet(FleetConfig {
        listen: args
            .listen
            .unwrap_or_else(|| SocketAddr::from(([127, 0, 0, 1], console::PORT))),
        is_default: args.listen.is_none(),
        state_dir: Some(folder),
        names: host_names(),
        vehicles: args
            .vehicle
            .into_iter()
            .map(|w| (w.name, w.place))
            .collect(),
    })?;
    let mut terminal = Terminal::new(false);
    while stop.count() == 0 {
        match console.wait_told(Duration::from_millis(200)) {
            Ok(Some(line)) => terminal.line(&line),
            Ok(None) => {}
            Err(_) => return Err(anyhow::anyhow!("the console has ended")),
        }
    }
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_stands_before_the_address_or_is_left_away() {
        let key = "ab".repeat(32);
        let named: Wanted = format!("east=https://drone:8443/#key={key}")
            .parse()
            .unwrap();
        assert_eq!(named.name.as_deref(), Some("east"));
        assert_eq!(named.place.shown(), "https://drone:8443");
        let plain: Wanted = format!("https://drone:8443/#key={key}").parse().unwrap();
        assert_eq!(plain.name, None);
        assert!(
            format!("a b=https://drone/#key={key}")
                .parse::<Wanted>()
                .is_err()
        );
        assert!("https://drone".parse::<Wanted>().is_err());
    }
}
