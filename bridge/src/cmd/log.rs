//! `kestrel log`: flight logs, looked at and written out.

use super::Usage;
use super::eval::chart;
use super::term::Terminal;
use anyhow::{Context as _, Result, bail};
use bridge::log::plot::{self, PANELS, Series};
use bridge::log::uquad::{self, STREAMS};
use bridge::log::{LogFile, LogWriter};
use clap::{Args, Subcommand, ValueEnum};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use vehicle::Timestamp;

/// Look at flight logs.
#[derive(Debug, Args)]
pub(crate) struct LogArgs {
    #[command(subcommand)]
    command: LogCommand,
}

#[derive(Debug, Subcommand)]
enum LogCommand {
    /// What a log holds: program, seed, parameters that are not the defaults, topics, flights, what is missing.
    #[command(
        after_help = "Examples:\n  kestrel log info ~/.local/state/kestrel/logs/0007.mcap\n  kestrel log info 0007.mcap --parameters"
    )]
    Info {
        /// The log.
        file: PathBuf,
        /// Every parameter with its origin.
        #[arg(long)]
        parameters: bool,
    },
    /// Draw position, speed, attitude, sticks, localization, battery and latency over time.
    #[command(
        after_help = "Examples:\n  kestrel log plot 0007.mcap                     writes 0007.svg\n  kestrel log plot 0007.mcap --out flight.html   a page with the texts too"
    )]
    Plot {
        /// The log.
        file: PathBuf,
        /// .svg or .html; default: beside the log.
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Write topics as text: CSV, one file each, or uQuad's formats.
    #[command(
        after_help = "Examples:\n  kestrel log export 0007.mcap --out csv/\n  kestrel log export run.mcap --format uquad --out run/   imu_raw.log, kalman_in.log, x_hat.log, w.log"
    )]
    Export {
        /// The log.
        file: PathBuf,
        /// How.
        #[arg(long, value_enum, default_value_t = Format::Csv)]
        format: Format,
        /// Folder for the files.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// Only this topic (repeatable).
        #[arg(long, value_name = "TOPIC")]
        topic: Vec<String>,
    },
    /// Write the head of a log, or a log whose end is missing, as a complete log.
    #[command(
        after_help = "Examples:\n  kestrel log cut 0007.mcap --out mended.mcap              a torn log with its index\n  kestrel log cut 0007.mcap --until 30 --out start.mcap    its first 30 s, which replay like the whole"
    )]
    Cut {
        /// The log.
        file: PathBuf,
        /// Last second, since the start.
        #[arg(long, value_name = "S")]
        until: Option<f64>,
        /// The new log.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    /// Comma-separated values with a head, one file a topic.
    Csv,
    /// uQuad's text formats.
    Uquad,
}

pub(crate) fn run(args: LogArgs) -> Result<ExitCode> {
    let mut terminal = Terminal::new(false);
    match args.command {
        LogCommand::Info { file, parameters } => {
            terminal.line(info(&file, parameters)?.trim_end());
        }
        LogCommand::Plot { file, out } => {
            let out = out.unwrap_or_else(|| file.with_extension("svg"));
            write(&out, draw(&file, &out)?.as_bytes())?;
            terminal.line(&format!("wrote {}", out.display()));
        }
        LogCommand::Export {
            file,
            format,
            out,
            topic,
        } => {
            std::fs::create_dir_all(&out)
                .with_context(|| format!("cannot make {}", out.display()))?;
            let files = match format {
                Format::Csv => csv(&read(&file)?, &topic),
                Format::Uquad => uquad_files(&read(&file)?),
            };
            if files.is_empty() {
                bail!("nothing of that is in {}", file.display());
            }
            for (name, text) in files {
                let path = out.join(name);
                write(&path, text.as_bytes())?;
                terminal.line(&format!("wrote {}", path.display()));
            }
        }
        LogCommand::Cut { file, until, out } => {
            if until.is_some_and(|s| s.is_nan() || s < 0.0) {
                return Err(Usage("--until is a time in seconds".to_owned()).into());
            }
            let (bytes, seconds) = cut(&read(&file)?, until)?;
            write(&out, &bytes)?;
            terminal.line(&format!("wrote {}: {seconds:.1} s", out.display()));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Reads a log.
pub(crate) fn read(path: &Path) -> Result<LogFile> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    LogFile::read(&bytes).with_context(|| format!("in {}", path.display()))
}

/// A log and the parts that follow it: `0007.mcap`, `0007-2.mcap` ...
pub(crate) fn read_parts(path: &Path) -> Result<Vec<LogFile>> {
    let mut parts = vec![read(path)?];
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    for part in 2.. {
        let next = path.with_file_name(format!("{stem}-{part}.mcap"));
        if !next.exists() {
            break;
        }
        parts.push(read(&next)?);
    }
    Ok(parts)
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

fn info(path: &Path, all_parameters: bool) -> Result<String> {
    let log = read(path)?;
    let mut out = String::new();
    let size = std::fs::metadata(path).map_or(0, |m| m.len());
    let end = if log.is_torn {
        ", its end is missing (`kestrel log cut` mends it)"
    } else {
        ""
    };
    let _ = writeln!(out, "{}: {:.2} MB{end}", path.display(), size as f64 * 1e-6);
    for (name, value) in log
        .metadata
        .iter()
        .filter(|(n, _)| *n != "parameters")
        .flat_map(|(_, m)| m)
    {
        let _ = writeln!(out, "  {name:12} {value}");
    }
    let changed = log
        .metadata
        .get("parameters")
        .into_iter()
        .flatten()
        .filter(|(_, text)| all_parameters || !text.ends_with("(default)"));
    for (name, text) in changed {
        let _ = writeln!(out, "  {name:17} {text}");
    }
    let mut topics: BTreeMap<&str, (u64, usize, u64, u64)> = BTreeMap::new();
    for m in &log.messages {
        let row = topics.entry(&m.topic).or_insert((0, 0, m.ns, m.ns));
        row.0 += 1;
        row.1 += m.data.len();
        row.3 = m.ns;
    }
    for (topic, (count, bytes, first, last)) in topics {
        let seconds = last.saturating_sub(first) as f64 * 1e-9;
        let _ = writeln!(
            out,
            "  {topic:20} {count:7} messages {:9.1} kB over {seconds:.1} s",
            bytes as f64 * 1e-3
        );
    }
    match log.lost() {
        0 => {}
        n => {
            let _ = writeln!(
                out,
                "  {n} records are missing: the disk was too slow or full"
            );
        }
    }
    for (_, summary) in log.values("/summary") {
        let _ = writeln!(out, "  {}", summary["text"].as_str().unwrap_or_default());
    }
    if let Err(e) = &log.header {
        let _ = writeln!(out, "  no replay: {e}");
    }
    Ok(out)
}

fn draw(path: &Path, out: &Path) -> Result<String> {
    let log = read(path)?;
    let pointers = PANELS
        .iter()
        .flat_map(|p| p.lines.iter().map(|(_, at)| *at));
    let Series { t_s, columns } = plot::series(&log, pointers);
    if t_s.is_empty() {
        bail!("{} has no /state to draw", path.display());
    }
    let mut columns = columns.into_iter();
    let panels: Vec<chart::Panel<'_>> = PANELS
        .iter()
        .map(|p| chart::Panel {
            title: p.title,
            lines: p
                .lines
                .iter()
                .filter_map(|(name, _)| Some((*name, columns.next()?)))
                .collect(),
        })
        .collect();
    let title = path.file_name().unwrap_or_default().to_string_lossy();
    let svg = chart::svg(&title, "s since the start", &t_s, &panels);
    if out.extension().is_none_or(|e| e != "html") {
        return Ok(svg);
    }
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>{}</title>\n<body style=\"font-family: system-ui; max-width: 1000px; margin: auto\">\n<pre>{}</pre>\n{svg}<table>\n",
        chart::escape(&title),
        chart::escape(&info(path, false)?),
    );
    let start_ns = log.messages.first().map_or(0, |m| m.ns);
    for (ns, text) in log.values("/log") {
        let _ = writeln!(
            page,
            "<tr><td>{:.2}</td><td>{}</td></tr>",
            ns.saturating_sub(start_ns) as f64 * 1e-9,
            chart::escape(text["message"].as_str().unwrap_or_default())
        );
    }
    page.push_str("</table></body></html>\n");
    Ok(page)
}

/// Name and text of a file for each JSON topic.
fn csv(log: &LogFile, only: &[String]) -> Vec<(String, String)> {
    let mut topics: Vec<&str> = log.messages.iter().map(|m| m.topic.as_str()).collect();
    topics.sort_unstable();
    topics.dedup();
    topics.retain(|t| only.is_empty() || only.iter().any(|o| o == t));
    let mut files = Vec::new();
    for topic in topics.into_iter().filter(|t| *t != "/map" && *t != "/scan") {
        let mut names: Vec<String> = Vec::new();
        let mut rows = Vec::new();
        for (ns, mut value) in log.values(topic) {
            if let Some(map) = value.as_object_mut() {
                map.remove("timestamp");
            }
            let mut row = Vec::new();
            plot::flatten("", &value, &mut row);
            for (name, _) in &row {
                if !names.contains(name) {
                    names.push(name.clone());
                }
            }
            rows.push((ns, row.into_iter().collect::<BTreeMap<_, _>>()));
        }
        if rows.is_empty() {
            continue;
        }
        let mut text = format!("utc_ns,{}\n", names.join(","));
        for (ns, row) in rows {
            text.push_str(&ns.to_string());
            for name in &names {
                text.push(',');
                text.push_str(row.get(name).map_or("", String::as_str));
            }
            text.push('\n');
        }
        files.push((
            format!("{}.csv", topic.trim_start_matches('/').replace('/', "-")),
            text,
        ));
    }
    files
}

fn uquad_files(log: &LogFile) -> Vec<(String, String)> {
    STREAMS
        .iter()
        .filter_map(|stream| {
            let text: String = log
                .values(&format!("/uquad/{stream}"))
                .filter_map(|(_, row)| uquad::line(stream, &row))
                .collect();
            (!text.is_empty()).then(|| (format!("{stream}.log"), text))
        })
        .collect()
}

/// The stream up to a time as a log of its own, and its length, s.
fn cut(log: &LogFile, until_s: Option<f64>) -> Result<(Vec<u8>, f64)> {
    let header = log.header.clone()?;
    let start = header.at;
    let mut writer = LogWriter::new(Arc::new(header))?;
    let mut last = start;
    for record in log.stream()? {
        let at = match &record {
            bridge::log::FlightRecord::Input { at, .. }
            | bridge::log::FlightRecord::Output { at, .. }
            | bridge::log::FlightRecord::Tick { at, .. } => *at,
            bridge::log::FlightRecord::Lost { .. } => last,
        };
        if until_s.is_some_and(|s| at.seconds_since(Timestamp::ZERO) > s) {
            break;
        }
        last = at;
        writer.flight(&record);
    }
    let boot_ns = writer.boot_ns();
    let until_ns = until_s.map_or(u64::MAX, |s| boot_ns.saturating_add((s * 1e9) as u64));
    writer.copy(log.messages.iter().filter(|m| m.ns <= until_ns));
    writer.finish();
    Ok((writer.take_mcap(), last.since(start).as_secs_f64()))
}
