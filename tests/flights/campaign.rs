//! The fault-injection campaign: every fault in every mode and room, judged by truth.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::autopilot::failsafes::TABLE;
use bridge::experiment::{Campaign, Fault, Trouble, fly, report};
use bridge::io::clock::monotonic_ns;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// From so many flights on every fault is flown and every row acts or tells at least so often.
const WHOLE: u64 = 2_000;
const LEAST: usize = 20;

#[test]
fn faults_in_all_modes_and_rooms_end_as_their_row_says() {
    // A share of it; the whole with KESTREL_CAMPAIGN=2000.
    let flights: u64 = match std::env::var("KESTREL_CAMPAIGN") {
        Ok(n) => n.parse().unwrap(),
        Err(_) => 2 * Fault::ALL.len() as u64,
    };
    let campaign = Campaign::default();
    let (next, flown) = (AtomicU64::new(0), Mutex::new(Vec::new()));
    let began = monotonic_ns();
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= flights {
                        break;
                    }
                    let case = campaign.case(seed);
                    let outcome = fly(&campaign, &case).unwrap();
                    flown.lock().unwrap().push((case, outcome));
                }
            });
        }
    });
    let mut flown = flown.into_inner().unwrap();
    flown.sort_by_key(|(case, _)| case.seed);
    println!("FIGURES");
    println!("{}", report("docs/examples/faults.toml", &flown));
    println!(
        "{flights} flights in {:.0} s",
        (monotonic_ns() - began) as f64 * 1e-9
    );
    println!("END");
    let bad: Vec<_> = flown.iter().filter(|(_, o)| !o.is_good()).collect();
    assert!(
        bad.is_empty(),
        "{} of {flights} flights went wrong",
        bad.len()
    );
    if flights >= WHOLE {
        for fault in Fault::ALL {
            let of_fault = flown.iter().filter(|(c, _)| c.faults().any(|f| f == fault));
            let times = of_fault.count();
            assert!(times >= LEAST, "{}: {times} flights", fault.facts().name);
        }
        for row in &TABLE {
            let acted = flown.iter().filter(|(_, o)| o.rows.contains(&row.because));
            let acted = acted.count();
            assert!(acted >= LEAST, "{}: {acted} flights", row.because.words());
        }
    }
}

#[test]
fn a_vehicle_without_its_failsafe_is_caught_by_the_judge() {
    // Without the row nobody acts: the campaign must see that.
    let mut campaign = Campaign::parse("faults = [\"ground-silent\"]\nmodes = [\"hold\"]").unwrap();
    campaign
        .params
        .insert("NAV_DLL_ACT".to_owned(), "disabled".to_owned().into());
    let mut case = campaign.case(1);
    case.second = None;
    let outcome = fly(&campaign, &case).unwrap();
    assert!(
        outcome.troubles.contains(&Trouble::Silent),
        "{:?}",
        outcome.troubles
    );
}
