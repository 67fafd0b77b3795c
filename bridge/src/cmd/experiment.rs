//! `kestrel experiment`: a fault-injection campaign in virtual time.

use super::term::Terminal;
use anyhow::{Context as _, Result, anyhow};
use bridge::autopilot::door::Snapshot;
use bridge::experiment::flight::FlyError;
use bridge::experiment::{Campaign, Case, Outcome, fly, report, watch};
use bridge::io::clock::monotonic_ns;
use bridge::io::truth::Row;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Fly seeded faults in simulated rooms and judge every flight by the truth.
#[derive(Debug, Args)]
#[command(
    after_help = "The file says what is combined; each list may be left out, then it holds everything there is:\n\n  rooms = [\"office\", \"corridor\", \"maze\"]\n  modes = [\"hold\", \"position\", \"mission\", \"offboard\"]\n  faults = [\"none\", \"ground-silent\", \"rangers-silent\", \"loop-held\"]\n  seeds = 100\n  [params]\n  LOC_LOST_T = 2.0\n\nExamples:\n  kestrel experiment docs/examples/faults.toml --seeds 100\n  kestrel experiment docs/examples/faults.toml --seed 17      one flight again, with its texts\n  kestrel experiment docs/examples/faults.toml --seed 17 --trace   the same, watched\n\nExit code 1 if a flight went wrong: a contact above 0.3 m/s where a safe way exists, a flyaway, a silent failure, a wrong answer."
)]
pub(crate) struct ExperimentArgs {
    /// The campaign.
    #[arg(value_name = "FILE.toml")]
    file: PathBuf,
    /// Flights, seeds 0 to N - 1; default: the file's.
    #[arg(long, value_name = "N")]
    seeds: Option<u64>,
    /// This flight only (repeatable).
    #[arg(long, value_name = "SEED", conflicts_with = "seeds")]
    seed: Vec<u64>,
    /// Truth beside belief, five times a second, of the flights of --seed.
    #[arg(long, requires = "seed")]
    trace: bool,
    /// Flights at once; default: one for each processor.
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Write the report to a file too.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub(crate) fn run(args: &ExperimentArgs) -> Result<ExitCode> {
    let mut terminal = Terminal::new(false);
    let file = args.file.display().to_string();
    let text =
        std::fs::read_to_string(&args.file).with_context(|| format!("cannot read {file}"))?;
    let campaign = Campaign::parse(&text).with_context(|| format!("in {file}"))?;
    let seeds: Vec<u64> = if args.seed.is_empty() {
        (0..args.seeds.unwrap_or(campaign.seeds)).collect()
    } else {
        args.seed.clone()
    };
    let jobs = args
        .jobs
        .or_else(|| std::thread::available_parallelism().ok().map(usize::from))
        .unwrap_or(1);
    let began_ns = monotonic_ns();
    let flown = if args.trace {
        trace_all(&campaign, &seeds, &mut terminal)?
    } else {
        fly_all(&campaign, &seeds, jobs)?
    };
    let matrix = report(&file, &flown);
    terminal.line(matrix.trim_end());
    terminal.line(&format!(
        "{} flights in {:.0} s",
        flown.len(),
        (monotonic_ns() - began_ns) as f64 * 1e-9
    ));
    if let Some(path) = &args.out {
        std::fs::write(path, &matrix)
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    if !args.seed.is_empty() {
        for (case, outcome) in &flown {
            terminal.line(&format!("{case:?}\n{outcome:?}"));
        }
    }
    let is_good = flown.iter().all(|(_, outcome)| outcome.is_good());
    Ok(ExitCode::from(u8::from(!is_good)))
}

/// Flies all, one after the other, for somebody who watches.
fn trace_all(
    campaign: &Campaign,
    seeds: &[u64],
    terminal: &mut Terminal,
) -> Result<Vec<(Case, Outcome)>> {
    let mut flown = Vec::new();
    for seed in seeds {
        let case = campaign.case(*seed);
        let mut looks = 0_u32;
        let outcome = watch(campaign, &case, &mut |row: &Row, s: &Snapshot| {
            looks += 1;
            if looks.is_multiple_of(40) {
                terminal.line(&line(row, s));
            }
        })?;
        flown.push((case, outcome));
    }
    Ok(flown)
}

/// Where it is, where it believes to be, how fast, why.
fn line(row: &Row, s: &Snapshot) -> String {
    let [x, y, z] = row.position;
    let [ex, ey, ez] = row.est_position;
    let v = s.nav.velocity;
    let health = s.nav.health;
    let flags = [
        (health.attitude, 'a'),
        (health.height, 'h'),
        (health.velocity, 'v'),
        (health.position, 'p'),
    ];
    let flags: String = flags
        .map(|(is, c)| if is { c } else { '-' })
        .into_iter()
        .collect();
    format!(
        "{:6.1} s true {x:6.2} {y:6.2} {z:6.2} yaw {:5.2} believed {ex:6.2} {ey:6.2} {ez:6.2} yaw {:5.2} v {:5.2} {:5.2} {:5.2} {flags} {:?}/{:?} {:?}{}",
        row.t_s,
        row.yaw_rad,
        row.est_yaw_rad,
        v.x(),
        v.y(),
        v.z(),
        s.mode.mode,
        s.mode.because,
        s.nav.localization.state,
        if row.contact { " CONTACT" } else { "" },
    )
}

/// Flies all, several at once, in the order of their seeds.
fn fly_all(campaign: &Campaign, seeds: &[u64], jobs: usize) -> Result<Vec<(Case, Outcome)>> {
    let next = AtomicU64::new(0);
    let done = Mutex::new(Vec::with_capacity(seeds.len()));
    std::thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, 64) {
            scope.spawn(|| {
                while let Some(seed) = seeds.get(next.fetch_add(1, Ordering::Relaxed) as usize) {
                    let case = campaign.case(*seed);
                    let outcome = fly(campaign, &case);
                    if let Ok(mut done) = done.lock() {
                        done.push((case, outcome));
                    }
                }
            });
        }
    });
    let mut flown: Vec<(Case, Result<Outcome, FlyError>)> = done
        .into_inner()
        .map_err(|_| anyhow!("a flight of the campaign ended in a panic"))?;
    flown.sort_by_key(|(case, _)| case.seed);
    flown
        .into_iter()
        .map(|(case, outcome)| Ok((case, outcome?)))
        .collect()
}
