//! `kestrel keys`: secrets that MAVLink links are signed with.

use super::Usage;
use anyhow::{Context as _, Result, anyhow};
use clap::{Args, Subcommand};
use mavlink_dialect::signing::SigningKey;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Make and show keys of signed MAVLink links.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel keys new pilot.key                       32 random bytes, readable by you only\n  kestrel keys show pilot.key                      64 hexadecimal digits for other programs\n  kestrel sim --mavlink 'udpserver://0.0.0.0:14550?key=file:pilot.key'\n  kestrel sim --mavlink 'udpserver://0.0.0.0:14550?key=pass:our secret'    MAVProxy: signing setup our secret"
)]
pub(crate) struct KeysArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Make a fresh key; an old file is never overwritten.
    New {
        /// Where to.
        file: PathBuf,
    },
    /// Print a key.
    Show {
        /// Which.
        file: PathBuf,
    },
}

pub(crate) fn run(args: &KeysArgs) -> Result<ExitCode> {
    let mut out = std::io::stdout().lock();
    match &args.what {
        What::New { file } => {
            let key = fresh()?;
            store(file, &key)?;
            writeln!(out, "key in {0}; use it as ?key=file:{0}", file.display())?;
        }
        What::Show { file } => {
            let text = std::fs::read_to_string(file)
                .with_context(|| format!("cannot read {}", file.display()))?;
            let key = SigningKey::from_hex(&text)
                .ok_or_else(|| anyhow!("{} holds no key: 64 hexadecimal digits", file.display()))?;
            writeln!(out, "{}", key.to_hex())?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// 32 bytes of the system's random generator.
fn fresh() -> Result<SigningKey> {
    let mut bytes = [0u8; 32];
    File::open("/dev/urandom")
        .and_then(|mut random| random.read_exact(&mut bytes))
        .context("the system gives no random numbers")?;
    Ok(SigningKey::new(bytes))
}

fn store(path: &Path, key: &SigningKey) -> Result<()> {
    let mut file = OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(path)
        .map_err(|e| match e.kind() {
            std::io::ErrorKind::AlreadyExists => {
                Usage(format!("{} is there already", path.display())).into()
            }
            _ => anyhow::Error::new(e).context(format!("cannot write {}", path.display())),
        })?;
    writeln!(file, "{}", key.to_hex()).with_context(|| format!("cannot write {}", path.display()))
}
