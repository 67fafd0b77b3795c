//! `kestrel params`: every parameter with its value, range, origin and meaning.

use super::Usage;
use anyhow::Result;
use bridge::settings::Settings;
use clap::Args;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use vehicle::{ParamKind, ParamMeta};

/// List every parameter.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel params\n  kestrel params MIS_TAKEOFF_ALT\n  kestrel params --markdown > docs/parameters.md"
)]
pub(crate) struct ParamsArgs {
    /// Only this parameter, in full.
    name: Option<String>,
    /// The reference page of the documentation.
    #[arg(long)]
    markdown: bool,
    /// The failsafe page of the documentation.
    #[arg(long, hide = true)]
    failsafes: bool,
    /// Configuration file (TOML) to show the values of.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set a parameter: NAME=VALUE (repeatable).
    #[arg(long = "param", value_name = "NAME=VALUE")]
    params: Vec<String>,
}

pub(crate) fn run(args: &ParamsArgs) -> Result<ExitCode> {
    let settings = super::settings(args.config.as_deref(), &args.params)?;
    let text = if args.failsafes {
        bridge::autopilot::failsafe_page::page()
    } else if args.markdown {
        markdown(&settings)
    } else if let Some(name) = &args.name {
        one(&settings, name)?
    } else {
        table(&settings)
    };
    // A closed pipe (`| head`) is not an error.
    let _ = std::io::stdout().write_all(text.as_bytes());
    Ok(ExitCode::SUCCESS)
}

fn one(settings: &Settings, name: &str) -> Result<String> {
    let row = settings
        .rows()
        .find(|r| r.meta.id.eq_ignore_ascii_case(name))
        .ok_or_else(|| {
            let nearest = settings
                .nearest(name)
                .map(|n| format!("; did you mean `{n}`?"))
                .unwrap_or_default();
            Usage(format!("no parameter `{name}`{nearest}"))
        })?;
    Ok(format!(
        "{} = {} {} ({})\n  TOML: [{}] {}\n  range: {}, default {}\n  {}\n",
        row.meta.id,
        row.value,
        row.meta.unit,
        row.origin,
        row.section,
        row.meta.key,
        range(row.meta),
        row.meta.default_value(),
        row.meta.doc.trim(),
    ))
}

fn table(settings: &Settings) -> String {
    let mut out = String::new();
    let mut section = "";
    for row in settings.rows() {
        if row.section != section {
            section = row.section;
            let _ = writeln!(out, "\n[{section}]");
        }
        let value = format!("{} {}", row.value, row.meta.unit);
        let _ = writeln!(
            out,
            "{:<17} {value:<14} {:<22} {:<12} {}",
            row.meta.id,
            range(row.meta),
            row.origin.to_string(),
            row.meta.doc.trim()
        );
    }
    out
}

fn markdown(settings: &Settings) -> String {
    let mut out = String::from(
        "# Parameters\n\nWritten by `kestrel params --markdown`. Set them in a TOML file (`--config`, one table per section), on the\n\
         command line (`--param NAME=VALUE`) or over MAVLink; the later of default, file, stored, command line, MAVLink wins.\n",
    );
    let mut section = "";
    for row in settings.rows() {
        if row.section != section {
            section = row.section;
            let _ = writeln!(
                out,
                "\n## [{section}]\n\n| MAVLink | TOML key | Default | Range | Unit | Meaning |\n| --- | --- | --- | --- | --- | --- |"
            );
        }
        let m = row.meta;
        let _ = writeln!(
            out,
            "| `{}` | `{}` | {} | {} | {} | {} |",
            m.id,
            m.key,
            m.default_value(),
            range(m),
            m.unit,
            m.doc.trim()
        );
    }
    out
}

fn range(meta: &ParamMeta) -> String {
    match meta.kind {
        ParamKind::Float { min, max, .. } => format!("{min}..{max}"),
        ParamKind::Int { min, max, .. } => format!("{min}..{max}"),
        ParamKind::Bool { .. } => "0 or 1".to_owned(),
        ParamKind::Choice { names, .. } => names
            .iter()
            .map(|(name, code)| format!("{code} {name}"))
            .collect::<Vec<_>>()
            .join(", "),
    }
}
