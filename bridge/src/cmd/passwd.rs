//! `kestrel passwd`: users of the console.

use super::Usage;
use super::fly::state_folder;
use super::term::Terminal;
use anyhow::{Context as _, Result, anyhow};
use bridge::web::Role;
use bridge::web::ledger::{Books, FILE};
use bridge::web::password;
use clap::Args;
use rustix::termios::{LocalModes, OptionalActions, Termios, isatty, tcgetattr, tcsetattr};
use std::io::{BufRead as _, Write as _, stderr, stdin};
use std::path::PathBuf;
use std::process::ExitCode;

/// Make or change a user of the console.
#[derive(Debug, Args)]
#[command(
    after_help = "The password is asked for, or read from standard input (one line).\n\nExamples:\n  kestrel passwd ana --role admin\n  kestrel passwd guard --role viewer --state-dir /var/lib/kestrel\n  kestrel passwd --list\n  kestrel passwd guard --remove"
)]
pub(crate) struct PasswdArgs {
    /// Log-in name.
    #[arg(value_name = "NAME", required_unless_present = "list")]
    name: Option<String>,
    /// What the user may do: viewer (watch, stop), pilot (fly), engineer (parameters, logs), admin (users). A new user
    /// is a viewer.
    #[arg(long, value_name = "ROLE")]
    role: Option<Role>,
    /// Folder of the accounts; default: $XDG_STATE_HOME/kestrel or ~/.local/state/kestrel.
    #[arg(long, value_name = "DIR")]
    state_dir: Option<PathBuf>,
    /// Remove the user.
    #[arg(long, conflicts_with = "role")]
    remove: bool,
    /// List users and their roles.
    #[arg(long, conflicts_with_all = ["name", "role", "remove"])]
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
        return Ok(ExitCode::SUCCESS);
    }
    let name = args.name.as_deref().unwrap_or_default();
    if args.remove {
        if !books.remove_user(name)? {
            return Err(anyhow!("there is no user `{name}`"));
        }
        terminal.line(&format!("{name} is removed"));
        return Ok(ExitCode::SUCCESS);
    }
    let is_new = books.secret(name)?.is_none();
    let password = ask(name)?;
    let hash = password::hash(&password).map_err(|e| Usage(e.clone()))?;
    books.set_user(name, Some(&hash), args.role, None, None)?;
    let role = books
        .secret(name)?
        .map_or(Role::Viewer, |(_, _, role)| role);
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
