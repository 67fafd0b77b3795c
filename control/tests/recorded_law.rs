//! The law of March 2012 on the states recorded in flight preparation: the motor speeds recorded beside them.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use control::integral::{COLUMNS_OF_PPTZ, IntegralAction};
use control::proportional::{ErrorLimits, Gains};
use control::state_feedback::{StateFeedback, StateSetpoint};
use std::path::PathBuf;

fn text(name: &str) -> Option<String> {
    let base = std::env::var_os("KESTREL_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let path = base.join("uquad").join(name);
    let text = std::fs::read_to_string(&path).ok();
    if text.is_none() {
        println!(
            "SKIPPED: no recording at {} (set KESTREL_DATA)",
            path.display()
        );
    }
    text
}

fn rows(text: &str) -> Vec<Vec<f64>> {
    let row = |l: &str| l.split_whitespace().map(|w| w.parse().unwrap()).collect();
    text.lines().map(row).collect()
}

#[test]
fn recorded_gains_on_recorded_states_give_the_recorded_speeds() {
    let (Some(states), Some(speeds)) = (text("x_hat_still.log"), text("w_still.log")) else {
        return;
    };
    let mut law = StateFeedback {
        gains: Gains::from_pattern(&Gains::MARCH_2012),
        limits: ErrorLimits::default(),
        integral: None,
    };
    let hover = StateSetpoint {
        state: [0.0; 12],
        speeds_radps: [334.28; 4],
    };
    let (states, speeds) = (rows(&states), rows(&speeds));
    assert_eq!((states.len(), speeds.len()), (20, 19));
    let mut worst = 0.0_f64;
    for (state, recorded) in states.iter().zip(&speeds) {
        let w = law.act(&hover, state.as_slice().try_into().unwrap(), 0.01);
        for (ours, theirs) in w.iter().zip(&recorded[1..]) {
            worst = worst.max((ours - theirs).abs());
        }
    }
    println!("FIGURES\nrecorded law, 19 rows: {worst:.1e} rad/s off the recording (bar 1e-9)\nEND");
    assert!(worst <= 1e-9, "{worst:e}");
}

#[test]
fn the_recorded_gain_files_are_the_tables_in_the_code() {
    let Some(file) = text("K_prop_full_pptz.txt") else {
        return;
    };
    let read = Gains::parse(&file).unwrap();
    let off = (read.matrix - Gains::from_pattern(&Gains::K_PROP_PPTZ).matrix).amax();
    assert!(off < 1e-6, "{off:e}");
    let integral = text("K_int_full_pptz.txt").unwrap();
    let mut action = IntegralAction::parse(&integral, COLUMNS_OF_PPTZ).unwrap();
    // 0.1 m too low for a second: 0.1 m s, times the golden gain of z.
    let mut error = nalgebra::SVector::<f64, 12>::zeros();
    error[2] = 0.1;
    let mut w = [0.0; 4];
    for _ in 0..100 {
        w = action.act(&error, 0.01);
    }
    assert!(w.iter().all(|w| (w - 0.157_279).abs() < 1e-6), "{w:?}");
}
