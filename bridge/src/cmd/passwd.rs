//! `kestrel passwd`: users of the console.

use super::Usage;
use super::fly::{host_names, state_folder};
use super::term::Terminal;
use anyhow::{Context as _, Result, anyhow};
use bridge::web::Role;
use bridge::web::key::MachineKey;
use bridge::web::ledger::{Books, FILE};
use bridge::web::{certificate_pin, console, password};
use clap::Args;
use rustix::termios::{LocalModes, OptionalActions, Termios, isatty, tcgetattr, tcsetattr};
use std::io::{BufRead as _, Write as _, stderr, stdin};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Make or change a user of the console.
#[derive(Debug, Args)]
#[command(
    after_help = "The password is asked for, or read from standard input (one line).\n\nExamples:\n  kestrel passwd ana --role admin\n  kestrel passwd guard --role viewer --state-dir /var/lib/kestrel\n  kestrel passwd --list\n  kestrel passwd guard --remove\n  kestrel passwd --key guardhouse              a key for `kestrel console` on another machine\n  kestrel passwd --key guardhouse --remove\n\nA running program notices within a second: open sessions of a changed or removed user end."
)]
pub(crate) struct PasswdArgs {
    /// Log-in name.
    #[arg(value_name = "NAME", required_unless_present_any = ["list", "key"])]
    name: Option<String>,
    /// What the user may do: viewer (watch, stop), pilot (fly), engineer (parameters, logs), admin (users). A new user
    /// is a viewer.
    #[arg(long, value_name = "ROLE")]
    role: Option<Role>,
    /// Folder of the accounts; default: $XDG_STATE_HOME/kestrel or ~/.local/state/kestrel.
    #[arg(long, value_name = "DIR")]
    state_dir: Option<PathBuf>,
    /// Make a key by which a console off the drone (`kestrel console`) opens this one, instead of a user. It is printed once. Its
    /// role is the most its users may do here: engineer unless said otherwise.
    #[arg(long, value_name = "NAME", conflicts_with = "name")]
    key: Option<String>,
    /// Days the key is good for.
    #[arg(long, value_name = "N", default_value_t = 365, requires = "key")]
    days: u32,
    /// Remove the user or the key.
    #[arg(long, conflicts_with = "role")]
    remove: bool,
    /// List users and keys with their roles.
    #[arg(long, conflicts_with_all = ["name", "key", "role", "remove"])]
    list: bool,
}

pub(crate) fn run(args: &PasswdArgs) -> Result<ExitCode> {
    let folder = args
        .state_dir
        .clone()
        .or_else(state_folder)
        .ok_or_else(|| {
            Usage("no home folder to keep accounts in: name one with --state-dir".to_owned())
        })?;
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let books = Books::open(Some(&folder.join(FILE)))?;
    let mut terminal = Terminal::new(false);
    if args.list {
        for user in books.users()? {
            terminal.line(&format!("{:<20} {}", user.name, user.role));
        }
        for key in books.keys()? {
            terminal.line(&format!("{:<20} {} (key)", key.name, key.role));
        }
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(name) = &args.key {
        return run_key(args, name, &books, &folder, &mut terminal);
    }
    let name = args.name.as_deref().unwrap_or_default();
    if args.remove {
        if !books.remove_user(name)? {
            return Err(anyhow!("there is no user `{name}`"));
        }
        terminal.line(&format!("{name} is removed"));
        return Ok(ExitCode::SUCCESS);
    }
    let is_new = books.account(name)?.is_none();
    let password = ask(name)?;
    let hash = password::hash(&password).map_err(|e| Usage(e.clone()))?;
    books.set_user(name, Some(&hash), args.role, None, None)?;
    let role = books
        .account(name)?
        .map_or(Role::Viewer, |account| account.role);
    terminal.line(&format!(
        "{name} ({role}) {}",
        if is_new {
            "may log in"
        } else {
            "has a new password"
        }
    ));
    Ok(ExitCode::SUCCESS)
}

/// Makes a key and prints where this machine is with it, or removes one.
fn run_key(
    args: &PasswdArgs,
    name: &str,
    books: &Books,
    folder: &Path,
    terminal: &mut Terminal,
) -> Result<ExitCode> {
    if args.remove {
        if !books.remove_key(name)? {
            return Err(anyhow!("there is no key `{name}`"));
        }
        terminal.line(&format!("the key {name} is removed"));
        return Ok(ExitCode::SUCCESS);
    }
    let is_plain = (1..=24).contains(&name.len())
        && name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "._-".contains(c));
    if !is_plain {
        return Err(
            Usage("a key's name is 1 to 24 letters, digits, dots, dashes".to_owned()).into(),
        );
    }
    let names = host_names();
    let pin = certificate_pin(folder, &names)
        .map_err(|e| anyhow!("the console has no certificate: {e}"))?;
    let key = MachineKey::new(password::random().context("no random numbers")?);
    books.set_key(name, &key, args.role.unwrap_or(Role::Engineer), args.days)?;
    let host = names.first().map_or("THIS-MACHINE", String::as_str);
    terminal.line(&format!(
        "https://{host}:{}/#key={}&pin={pin}",
        console::PORT,
        key.to_hex()
    ));
    terminal.line("Give this to `kestrel console --vehicle` (or its page, tab People); it is not shown again.");
    Ok(ExitCode::SUCCESS)
}

/// The password, typed twice without being shown, or one line of a pipe.
fn ask(name: &str) -> Result<String> {
    let read = || -> Result<String> {
        let mut line = String::new();
        stdin()
            .lock()
            .read_line(&mut line)
            .context("cannot read the password")?;
        Ok(line.trim_end_matches(['\n', '\r']).to_owned())
    };
    if !isatty(stdin()) {
        return read();
    }
    let prompt = |text: &str| -> Result<String> {
        let _ = write!(stderr(), "{text}: ");
        let _silent = Silent::begin();
        let line = read();
        let _ = writeln!(stderr());
        line
    };
    let first = prompt(&format!("Password for {name}"))?;
    if prompt("Again")? != first {
        return Err(Usage("these are two different passwords".to_owned()).into());
    }
    Ok(first)
}

/// What is typed is not shown while this lives.
struct Silent(Option<Termios>);

impl Silent {
    fn begin() -> Self {
        let before = tcgetattr(stdin()).ok();
        if let Some(before) = &before {
            let mut silent = before.clone();
            silent.local_modes.remove(LocalModes::ECHO);
            let _ = tcsetattr(stdin(), OptionalActions::Flush, &silent);
        }
        Self(before)
    }
}

impl Drop for Silent {
    fn drop(&mut self) {
        if let Some(before) = &self.0 {
            let _ = tcsetattr(stdin(), OptionalActions::Flush, before);
        }
    }
}
