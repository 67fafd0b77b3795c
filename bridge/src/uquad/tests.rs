#![allow(
    clippy::print_stdout,
    reason = "a test says which recording it does not find, and its figures"
)]

use super::*;
use control::integral::COLUMNS_OF_PPTZ;
use estimator::imu::fir::Fir;
use estimator::imu::replay::LogRow;
use std::path::PathBuf;

fn folder() -> Option<PathBuf> {
    let base = std::env::var_os("KESTREL_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let folder = base.join("uquad");
    if folder.is_dir() {
        return Some(folder);
    }
    println!(
        "SKIPPED: no recordings at {} (set KESTREL_DATA)",
        folder.display()
    );
    None
}

fn text(name: &str) -> Option<String> {
    Some(std::fs::read_to_string(folder()?.join(name)).unwrap())
}

fn table(name: &str) -> Option<Vec<Vec<f64>>> {
    let rows = text(name)?
        .lines()
        .map(|l| l.split_whitespace().map(|w| w.parse().unwrap()).collect())
        .collect();
    Some(rows)
}

/// Steps of the recorded frames, each changed by `change`.
fn run(
    config: UquadConfig,
    calibration: &str,
    change: impl Fn(usize, &mut RawFrame),
) -> Option<(Vec<Step>, Vec<Said>)> {
    let calibration = Calibration::parse(&text(calibration)?).unwrap();
    let mut uquad = Uquad::new(calibration, config).unwrap();
    let (mut steps, mut said) = (Vec::new(), Vec::new());
    for (k, line) in text("imu_raw_still.log")?.lines().enumerate() {
        let mut frame = LogRow::parse(line).unwrap().frame;
        change(k, &mut frame);
        let at = Timestamp::from_ms(10 * k as u64);
        steps.extend(uquad.frame(at, frame, &mut |s| said.push(s)));
    }
    Some((steps, said))
}

fn worst(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

#[test]
fn chain_a_from_raw_counts_to_motor_speeds_is_the_recorded_run_on_every_row() {
    let Some((steps, said)) = run(
        UquadConfig::march_2012(),
        "imu_calib_2012-03.txt",
        |_, _| {},
    ) else {
        return;
    };
    assert!(said.is_empty(), "{said:?}");
    let (kalman_in, x_hat, w) = (
        table("kalman_in_still.log").unwrap(),
        table("x_hat_still.log").unwrap(),
        table("w_still.log").unwrap(),
    );
    assert_eq!((steps.len(), steps[0].frame), (kalman_in.len(), 200));
    let mut deviation = [0.0_f64; 3];
    for (k, step) in steps.iter().enumerate() {
        let m = &step.reading.measured;
        let mut converted = m.accel_mps2.as_slice().to_vec();
        converted.extend(m.gyro_radps.as_slice());
        let a = &m.angles;
        converted.extend([
            a.psi_rad,
            a.phi_rad,
            a.theta_rad,
            m.temperature_degc,
            m.altitude_m,
        ]);
        deviation[0] = deviation[0].max(worst(&converted, &kalman_in[k][4..]));
        if let Some(row) = x_hat.get(k) {
            deviation[1] = deviation[1].max(worst(&step.state[..12], row));
        }
        if let Some(row) = w.get(k) {
            deviation[2] = deviation[2].max(worst(&step.speeds_radps, &row[1..]));
        }
    }
    println!(
        "FIGURES\nuQuad chain A, {} / {} / {} rows: converted {:.1e} (bar 1e-6), filter {:.1e} (1e-9), motor speeds {:.1e} rad/s (1e-9)\nEND",
        kalman_in.len(),
        x_hat.len(),
        w.len(),
        deviation[0],
        deviation[1],
        deviation[2]
    );
    assert!(
        deviation[0] <= 1e-6 && deviation[1] <= 1e-9 && deviation[2] <= 1e-9,
        "{deviation:?}"
    );
}

fn corrected(calibration_frames: u32) -> UquadConfig {
    let mut config = UquadConfig::corrected();
    config.imu.calibration_frames = calibration_frames;
    config
}

#[test]
fn corrected_mode_holds_still_on_the_still_recording() {
    let Some((steps, said)) = run(corrected(100), "imu_calib_final.txt", |_, _| {}) else {
        return;
    };
    assert!(
        matches!(said[..], [Said::Imu(ImuEvent::Calibrated(_))]),
        "{said:?}"
    );
    assert_eq!(steps.len(), 141);
    for step in &steps {
        let tilt = step.state[3].abs().max(step.state[4].abs());
        assert!(tilt < 0.1 && step.state[2].abs() < 1.0, "{step:?}");
        let first = steps[0].state[5];
        assert!((step.state[5] - first).abs() < 0.1);
        assert!(
            step.speeds_radps
                .iter()
                .all(|w| (238.0..=368.16).contains(w))
        );
    }
}

#[test]
fn same_recording_same_bits() {
    let Some((a, _)) = run(corrected(100), "imu_calib_final.txt", |_, _| {}) else {
        return;
    };
    let (b, _) = run(corrected(100), "imu_calib_final.txt", |_, _| {}).unwrap();
    let bits = |steps: &[Step]| -> Vec<u64> {
        steps
            .iter()
            .flat_map(|s| s.state.into_iter().chain(s.speeds_radps).map(f64::to_bits))
            .collect()
    };
    assert_eq!(bits(&a), bits(&b));
}

#[test]
fn one_long_gap_is_survived_and_ten_late_frames_stop_the_loop() {
    let gap = |k: usize, f: &mut RawFrame| {
        if k == 150 {
            f.since_previous_us = 1_200_000;
        }
    };
    let Some((steps, said)) = run(corrected(100), "imu_calib_final.txt", gap) else {
        return;
    };
    assert_eq!(steps.len(), 141);
    assert!(
        said.iter()
            .any(|s| matches!(s, Said::Period(PeriodFault::Gap { errors: 5, .. })))
    );
    let late = |k: usize, f: &mut RawFrame| {
        if k >= 150 {
            f.since_previous_us = 15_000;
        }
    };
    let (steps, said) = run(corrected(100), "imu_calib_final.txt", late).unwrap();
    assert_eq!(steps.len(), 150 - 99 + 9);
    assert_eq!(said.last(), Some(&Said::Stopped));
}

#[test]
fn a_stuck_gyro_is_left_out_by_name_and_the_estimate_stays_sound() {
    let stuck = |k: usize, f: &mut RawFrame| {
        if k >= 120 {
            f.gyro = [-22, -31, -14];
        }
    };
    let Some((steps, said)) = run(corrected(100), "imu_calib_final.txt", stuck) else {
        return;
    };
    let left_out = said.iter().filter(|s| **s == Said::LeftOut(Channel::Gyro));
    assert_eq!(left_out.count(), 1, "said once: {said:?}");
    assert!(
        steps
            .iter()
            .all(|s| s.state.iter().all(|x| x.abs() < 100.0))
    );
}

#[test]
fn a_barometer_switched_off_is_left_out_and_height_stays_sound() {
    let off = |k: usize, f: &mut RawFrame| {
        if k >= 120 {
            f.pressure_pa = 0;
        }
    };
    let Some((steps, said)) = run(corrected(100), "imu_calib_final.txt", off) else {
        return;
    };
    assert!(said.contains(&Said::LeftOut(Channel::Altitude)), "{said:?}");
    assert!(steps.iter().all(|s| s.state[2].abs() < 5.0));
}

#[test]
fn horizontal_gains_on_eight_states_are_refused_with_both_names() {
    let calibration = Calibration::parse(&"1 ".repeat(36)).unwrap_err();
    assert!(calibration.to_string().contains("singular"));
    let identity = "1 0 0 0 1 0 0 0 1 0 0 0 ".repeat(3);
    let calibration = Calibration::parse(&identity).unwrap();
    let mut config = UquadConfig::corrected();
    config.filter.states = StateSet::Reduced;
    assert!(Uquad::new(calibration, config.clone()).is_ok());
    config.gains.matrix[(0, 0)] = 1.0;
    let error = Uquad::new(calibration, config).unwrap_err().to_string();
    assert!(error.contains("states = 8") && error.contains("gains for x"));
}

#[test]
fn the_gain_files_of_the_recording_load() {
    let Some(pptz) = text("K_prop_full_pptz.txt") else {
        return;
    };
    let read = Gains::parse(&pptz).unwrap();
    let built = Gains::from_pattern(&Gains::K_PROP_PPTZ);
    assert!((read.matrix - built.matrix).amax() < 1e-12);
    assert!(Gains::parse(&text("K_prop_full_ppzt.txt").unwrap()).is_ok());
    let integral = text("K_int_full_pptz.txt").unwrap();
    assert!(IntegralAction::parse(&integral, COLUMNS_OF_PPTZ).is_ok());
    let cut = &pptz[..pptz.len() / 2];
    assert!(
        Gains::parse(cut)
            .unwrap_err()
            .to_string()
            .contains("4 x 12 = 48 are needed")
    );
}

#[test]
fn a_weight_that_no_motor_carries_hovers_at_the_fastest_speed() {
    let craft = vehicle::UquadAirframe::default();
    assert!((laws_hover(&craft, 1.75) - 316.889_44).abs() < 1e-4);
    assert!((laws_hover(&craft, 10.0) - 387.0).abs() < 1e-12);
}

#[test]
fn speeds_stand_between_two_actions_and_the_length_of_the_filter_is_the_delay_of_the_first_step() {
    let frame = |k: u32| RawFrame {
        since_previous_us: 10_000,
        // It leans more and more, so that every action differs.
        accel: [(k.saturating_sub(40) / 2) as i16, 0, 256],
        mag: [500, 0, -300],
        temperature_ddeg: 250,
        pressure_pa: 101_325,
        ..RawFrame::default()
    };
    let speeds = |steps_per_action: u32, mean: usize| {
        let mut config = corrected(20);
        config.steps_per_action = steps_per_action;
        config.imu.smoothing = Smoothing::Fir(Fir::mean(mean).unwrap());
        let calibration = crate::io::uquad_lockstep::simulated_calibration();
        let mut uquad = Uquad::new(calibration, config).unwrap();
        (0..200)
            .filter_map(|k| {
                uquad.frame(
                    Timestamp::from_us(10_000 * u64::from(k)),
                    frame(k),
                    &mut |_| (),
                )
            })
            .map(|s| s.speeds_radps)
            .collect::<Vec<_>>()
    };
    let bits = |speeds: [f64; 4]| speeds.map(f64::to_bits);
    let changes = |speeds: &[[f64; 4]]| {
        speeds
            .windows(2)
            .filter(|w| bits(w[0]) != bits(w[1]))
            .count()
    };
    let (every, third) = (speeds(1, 6), speeds(3, 6));
    assert_eq!(every.len(), third.len());
    let (n, m) = (changes(&every), changes(&third));
    assert!(n > 100 && m.abs_diff(n / 3) <= 2, "{n} and {m} changes");
    assert!(
        speeds(1, 31).len() < every.len(),
        "a longer filter fills later"
    );
}
