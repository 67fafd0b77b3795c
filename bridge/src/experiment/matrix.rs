//! The report of a campaign: a matrix to read, and what to fly again.

use super::judge::{Outcome, Trouble};
use super::plan::{Case, Fault, FlownMode};
use crate::autopilot::failsafes::TABLE;
use crate::autopilot::mode::Because;
use std::fmt::Write as _;

/// Faults down, modes across: `good/flown`; then the troubles with the command that flies each again.
#[must_use]
pub fn report(file: &str, flown: &[(Case, Outcome)]) -> String {
    let mut out = String::new();
    let _ = write!(out, "{:18}", "fault");
    for mode in FlownMode::ALL {
        let _ = write!(out, "{:>10}", mode.name());
    }
    let _ = writeln!(
        out,
        "{:>8}{:>7}{:>9}{:>9}{:>8}{:>7}",
        "flown", "safe?", "contacts", "flyaways", "silent", "wrong"
    );
    for fault in Fault::ALL {
        let rows: Vec<&(Case, Outcome)> = flown.iter().filter(|(c, _)| c.fault == fault).collect();
        if rows.is_empty() {
            continue;
        }
        let _ = write!(out, "{:18}", fault.facts().name);
        for mode in FlownMode::ALL {
            let cell = rows.iter().filter(|(c, _)| c.mode == mode);
            let (all, good) = cell.fold((0, 0), |(all, good), (_, o)| {
                (all + 1, good + usize::from(o.is_good()))
            });
            let text = match all {
                0 => "-".to_owned(),
                _ => format!("{good}/{all}"),
            };
            let _ = write!(out, "{text:>10}");
        }
        let with = |is: fn(&Trouble) -> bool| {
            rows.iter()
                .filter(|(_, o)| o.troubles.iter().any(is))
                .count()
        };
        let safe = if fault.facts().has_safe_way {
            "yes"
        } else {
            "no"
        };
        let _ = writeln!(
            out,
            "{:>8}{safe:>7}{:>9}{:>9}{:>8}{:>7}",
            rows.len(),
            with(|t| matches!(t, Trouble::Contact(_))),
            with(|t| matches!(t, Trouble::Flyaway(_))),
            with(|t| matches!(t, Trouble::Silent | Trouble::NeverFlew)),
            with(|t| matches!(t, Trouble::WrongMode(_))),
        );
    }
    let good = flown.iter().filter(|(_, o)| o.is_good()).count();
    let hours = flown.iter().map(|(_, o)| o.duration_s).sum::<f64>() / 3600.0;
    let _ = writeln!(
        out,
        "{good} of {} flights good; {hours:.1} h in the air",
        flown.len()
    );
    let _ = writeln!(out, "flights in which each row acted or told:");
    let mut named: Vec<Because> = Vec::new();
    for because in TABLE.iter().map(|row| row.because) {
        if !named.contains(&because) {
            named.push(because);
            let n = flown.iter().filter(|(_, o)| o.rows.contains(&because));
            let _ = writeln!(out, "  {:36}{:>6}", because.words(), n.count());
        }
    }
    for (case, outcome) in flown.iter().filter(|(_, o)| !o.is_good()) {
        let troubles: Vec<String> = outcome.troubles.iter().map(Trouble::to_string).collect();
        let faults: Vec<&str> = case.faults().map(|f| f.facts().name).collect();
        let _ = writeln!(
            out,
            "  {}: {} in {} ({}): kestrel experiment {file} --seed {}",
            troubles.join(", "),
            faults.join(" + "),
            case.mode.name(),
            case.room,
            case.seed
        );
    }
    out
}
