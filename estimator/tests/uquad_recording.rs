//! uQuad's recorded run of 23 March 2012 (data/uquad), stage by stage, and the golden numbers of the final calibration.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

mod support;

use estimator::imu::angles::URUGUAY_DECLINATION_RAD;
use estimator::imu::fir::Fir;
use estimator::imu::frame::{ALTERNATE_START, START};
use estimator::imu::replay::LogRow;
use estimator::imu::ring::FrameRing;
use estimator::imu::{
    Angles, Build, Calibration, ChainConfig, Converter, Counts, ImuChain, ImuEvent, Measured,
    RawFrame, Reading, Reference, Smoothing, ascii, binary,
};
use estimator::thesis::{ThesisConfig, ThesisFilter, ThesisInput};
use nalgebra::Vector3;
use std::path::PathBuf;
use vehicle::Timestamp;

/// Raw row that the first row of the other files belongs to.
const FIRST: usize = 200;

fn folder() -> Option<PathBuf> {
    support::recorded("uquad")
}

struct Recording {
    raw: Vec<LogRow>,
    kalman_in: Vec<Vec<f64>>,
    x_hat: Vec<Vec<f64>>,
    w: Vec<Vec<f64>>,
    old: Calibration,
    last: Calibration,
}

fn recording() -> Option<Recording> {
    let folder = folder()?;
    let text = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    let table = |name: &str| -> Vec<Vec<f64>> {
        text(name)
            .lines()
            .map(|l| l.split_whitespace().map(|w| w.parse().unwrap()).collect())
            .collect()
    };
    Some(Recording {
        raw: text("imu_raw_still.log")
            .lines()
            .map(|l| LogRow::parse(l).unwrap())
            .collect(),
        kalman_in: table("kalman_in_still.log"),
        x_hat: table("x_hat_still.log"),
        w: table("w_still.log"),
        old: Calibration::parse(&text("imu_calib_2012-03.txt")).unwrap(),
        last: Calibration::parse(&text("imu_calib_final.txt")).unwrap(),
    })
}

fn march_2012(calibration: Calibration) -> ImuChain {
    let config = ChainConfig {
        smoothing: Smoothing::MeanOfConverted(8),
        declination_rad: URUGUAY_DECLINATION_RAD,
        build: Build::March2012,
        ..ChainConfig::default()
    };
    let mut chain = ImuChain::new(calibration, config).unwrap();
    chain.set_reference(Reference {
        reference_pa: 101_205.0,
        mag_norm: 0.775,
        ..Reference::default()
    });
    chain
}

fn readings(recording: &Recording) -> Vec<Reading> {
    let mut chain = march_2012(recording.old);
    let mut out = Vec::new();
    for (k, row) in recording.raw.iter().enumerate() {
        chain.frame(Timestamp::from_ms(10 * k as u64), row.frame);
        let reading = chain.take();
        if k >= FIRST {
            out.push(reading.unwrap());
        }
    }
    out
}

/// The eleven converted columns, in the order of kalman_in.
fn columns(m: &Measured) -> Vec<f64> {
    let a = &m.angles;
    let mut out = m.accel_mps2.as_slice().to_vec();
    out.extend(m.gyro_radps.as_slice());
    out.extend([
        a.psi_rad,
        a.phi_rad,
        a.theta_rad,
        m.temperature_degc,
        m.altitude_m,
    ]);
    out
}

fn worst(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

#[test]
fn recorded_conversion_is_reproduced_to_1e_6_on_every_row() {
    let Some(recording) = recording() else { return };
    let readings = readings(&recording);
    assert_eq!(readings.len(), recording.kalman_in.len());
    let mut deviation = 0.0_f64;
    for (reading, row) in readings.iter().zip(&recording.kalman_in) {
        deviation = deviation.max(worst(&columns(&reading.measured), &row[4..]));
        assert_eq!(reading.elapsed_us, row[0] as u64);
    }
    println!(
        "raw -> converted, {} rows: worst deviation {deviation:.2e}",
        readings.len()
    );
    assert!(deviation <= 1e-6, "{deviation:e}");
}

fn of_row(row: &[f64]) -> ThesisInput {
    ThesisInput {
        accel_mps2: Vector3::from_column_slice(&row[4..7]),
        gyro_radps: Vector3::from_column_slice(&row[7..10]),
        angles: Angles {
            psi_rad: row[10],
            phi_rad: row[11],
            theta_rad: row[12],
        },
        altitude_m: row[14],
        accel_is_good: true,
        mag_is_good: true,
        fix: None,
    }
}

#[test]
fn recorded_filter_is_reproduced_to_1e_9_on_every_row() {
    let Some(recording) = recording() else { return };
    let from_recording: Vec<ThesisInput> = recording.kalman_in.iter().map(|r| of_row(r)).collect();
    let from_raw: Vec<ThesisInput> = readings(&recording).iter().map(ThesisInput::from).collect();
    for (name, inputs) in [("recorded", from_recording), ("own", from_raw)] {
        let mut filter = ThesisFilter::new(ThesisConfig::march_2012()).unwrap();
        let mut speeds = [50.0; 4];
        let mut deviation = 0.0_f64;
        for (k, row) in recording.x_hat.iter().enumerate() {
            let dt = recording.kalman_in[k][0] * 1e-6;
            assert!(filter.step(dt, &speeds, &inputs[k]).unwrap().is_empty());
            deviation = deviation.max(worst(&filter.twelve(), row));
            if let Some(w) = recording.w.get(k) {
                speeds = [w[1], w[2], w[3], w[4]];
            }
        }
        println!(
            "filter from {name} conversion, {} rows: worst deviation {deviation:.2e}",
            recording.x_hat.len()
        );
        assert!(deviation <= 1e-9, "{deviation:e}");
    }
}

fn assert_near(name: &str, got: &[f64], golden: &[f64]) {
    assert_eq!(got.len(), golden.len());
    for (g, e) in got.iter().zip(golden) {
        // The golden numbers have nine decimals.
        assert!(
            (g - e).abs() < 1e-8,
            "{name}: {got:?} instead of {golden:?}"
        );
    }
}

fn final_converter(calibration: Calibration) -> Converter {
    Converter {
        reference_pa: 101_205.0,
        ..Converter::new(calibration, URUGUAY_DECLINATION_RAD, Build::Final)
    }
}

fn golden_frame() -> RawFrame {
    RawFrame {
        since_previous_us: 10_000,
        accel: [12, -11, 205],
        gyro: [-22, -31, -14],
        mag: [-94, 129, 7],
        temperature_ddeg: 250,
        pressure_pa: 101_202,
    }
}

#[test]
fn golden_single_frame() {
    let Some(recording) = recording() else { return };
    let m = final_converter(recording.last).convert(&Counts::from(&golden_frame()));
    assert_near(
        "acc",
        m.accel_mps2.as_slice(),
        &[-0.159847844, -0.422375941, 9.771061511],
    );
    assert_near(
        "gyro",
        m.gyro_radps.as_slice(),
        &[0.012526931, -0.037906087, 0.051116003],
    );
    assert_near(
        "mag",
        m.mag.as_slice(),
        &[-0.092627905, 0.667512054, 0.381013627],
    );
    let a = m.angles;
    assert_near(
        "angles",
        &[a.psi_rad, a.phi_rad, a.theta_rad],
        &[-0.043200337, 0.016342594, -1.526547111],
    );
    assert_near("alt", &[m.altitude_m], &[0.250063041]);
}

#[test]
fn golden_fir6_of_rows_195_to_200() {
    let Some(recording) = recording() else { return };
    let mut ring = FrameRing::default();
    for row in &recording.raw[195..=200] {
        assert_eq!(Fir::default().output(&ring), None);
        ring.push(row.frame);
    }
    let filtered = Fir::default().output(&ring).unwrap();
    assert_near("acc", filtered.accel.as_slice(), &[9.6, -10.5, 206.5]);
    assert_near("gyro", filtered.gyro.as_slice(), &[-21.7, -30.8, -13.6]);
    assert_near("mag", filtered.mag.as_slice(), &[-98.0, 129.0, 7.0]);
    assert_near("temp", &[filtered.temperature_ddeg], &[250.0]);
    assert_near("pres", &[filtered.pressure_pa], &[101_204.4]);
    let m = final_converter(recording.last).convert(&filtered);
    assert_near(
        "acc",
        m.accel_mps2.as_slice(),
        &[-0.249407947, -0.405368139, 9.828650535],
    );
    assert_near(
        "gyro",
        m.gyro_radps.as_slice(),
        &[0.012933987, -0.037661510, 0.051636936],
    );
    assert_near(
        "mag",
        m.mag.as_slice(),
        &[-0.108740868, 0.667512054, 0.381013627],
    );
    let a = m.angles;
    assert_near(
        "angles",
        &[a.psi_rad, a.phi_rad, a.theta_rad],
        &[-0.041220158, 0.025348619, -1.545208053],
    );
    assert_near("alt", &[m.altitude_m], &[0.050012128]);
}

#[test]
fn golden_gyro_null_of_the_first_200_rows() {
    let Some(recording) = recording() else { return };
    let config = ChainConfig {
        calibration_frames: 200,
        declination_rad: URUGUAY_DECLINATION_RAD,
        ..ChainConfig::default()
    };
    let mut chain = ImuChain::new(recording.last, config).unwrap();
    for (k, row) in recording.raw[..200].iter().enumerate() {
        chain.frame(Timestamp::from_ms(10 * k as u64), row.frame);
    }
    let Some(ImuEvent::Calibrated(reference)) = chain.poll() else {
        panic!("not calibrated");
    };
    assert_near(
        "null",
        reference.gyro_null_radps.as_slice(),
        &[0.010867093, -0.039281308, 0.054568860],
    );
    assert!((reference.reference_pa - 101_206.0).abs() < 0.05);
    assert!(
        (reference.mag_norm - 0.775).abs() < 0.01,
        "{}",
        reference.mag_norm
    );
    let mut converter = final_converter(recording.last);
    converter.gyro_null_radps = reference.gyro_null_radps;
    let m = converter.convert(&Counts::from(&golden_frame()));
    assert_near(
        "gyro",
        m.gyro_radps.as_slice(),
        &[0.001659839, 0.001375221, -0.003452857],
    );

    // A floor known to be 100 m high.
    let config = ChainConfig {
        calibration_frames: 200,
        start_altitude_m: 100.0,
        ..ChainConfig::default()
    };
    let mut chain = ImuChain::new(recording.last, config).unwrap();
    let mut last = None;
    for (k, row) in recording.raw.iter().enumerate() {
        chain.frame(Timestamp::from_ms(10 * k as u64), row.frame);
        last = chain.take();
    }
    let altitude = last.unwrap().measured.altitude_m;
    assert!((altitude - 100.0).abs() < 1.0, "{altitude}");
}

#[test]
fn from_25_to_40_degrees_the_recorded_calibration_moves_by_its_z_term() {
    let Some(recording) = recording() else { return };
    let converter = final_converter(recording.last);
    let cold = Counts::from(&golden_frame());
    let warm = Counts {
        temperature_ddeg: 400.0,
        ..cold
    };
    let moved = converter.convert(&warm).accel_mps2 - converter.convert(&cold).accel_mps2;
    let expected =
        recording.last.accel.tk_inv * Vector3::new(0.0, 0.0, 0.604_990_434_419_997 * 15.0);
    assert!((moved - expected).amax() < 1e-12);
}

#[test]
fn a_recorded_stream_with_noise_cut_frames_and_wrong_ends_gives_exactly_its_intact_frames() {
    let Some(recording) = recording() else { return };
    let mut stream = b"menu: 2 acc 3 gyro\r\n".to_vec();
    let mut intact = Vec::new();
    for (k, row) in recording.raw[..100].iter().enumerate() {
        let mut bytes = row.frame.emit(START);
        match k % 9 {
            2 => stream.extend_from_slice(b"AZAAC\xff\x00ZZ"),
            4 => {
                stream.extend_from_slice(&bytes[..k % 29 + 1]);
                continue;
            }
            7 => {
                bytes[29] = b'Q';
                stream.extend_from_slice(&bytes);
                continue;
            }
            _ => {}
        }
        stream.extend_from_slice(&bytes);
        intact.push(row.frame);
    }
    let mut decoder = binary::BinaryDecoder::default();
    let got: Vec<RawFrame> = stream
        .iter()
        .filter_map(|&b| decoder.push(b))
        .map(|r| r.frame)
        .collect();
    assert_eq!(got, intact);
}

#[test]
fn text_lines_and_bytes_of_the_recording_give_the_same_readings() {
    let Some(recording) = recording() else { return };
    let mut by_bytes = march_2012(recording.old);
    let mut by_text = march_2012(recording.old);
    let mut decoder = ascii::AsciiDecoder::default();
    for (k, row) in recording.raw.iter().enumerate() {
        let at = Timestamp::from_ms(10 * k as u64);
        let start = if k % 2 == 0 { START } else { ALTERNATE_START };
        by_bytes.bytes(at, &row.frame.emit(start));
        for &b in ascii::format_line(&row.frame).as_bytes() {
            if let Some(frame) = decoder.push(b) {
                by_text.frame(at, frame.unwrap());
            }
        }
        assert_eq!(by_bytes.take(), by_text.take());
    }
    assert_eq!(
        by_bytes.decoder_stats().frames as usize,
        recording.raw.len()
    );
}

#[test]
fn the_recorded_craft_at_rest_is_calibrated_without_complaint() {
    let Some(recording) = recording() else { return };
    let config = ChainConfig {
        calibration_frames: 200,
        ..ChainConfig::default()
    };
    let mut chain = ImuChain::new(recording.last, config).unwrap();
    let mut flags = (0, 0, 0);
    for (k, row) in recording.raw.iter().enumerate() {
        chain.frame(Timestamp::from_ms(10 * k as u64), row.frame);
        if let Some(reading) = chain.take() {
            flags.0 += 1;
            flags.1 += usize::from(reading.accel_is_good);
            flags.2 += usize::from(reading.mag_is_good);
        }
    }
    let events: Vec<ImuEvent> = std::iter::from_fn(|| chain.poll()).collect();
    assert!(
        matches!(events[..], [ImuEvent::Calibrated(_)]),
        "{events:?}"
    );
    assert_eq!(
        flags,
        (41, 41, 41),
        "every norm of a still craft is believed"
    );
}

#[test]
fn a_recorded_receiver_at_rest_starts_at_zero_and_stays_within_metres() {
    use estimator::utm::{SouthernOffset, Utm};
    let Some(folder) = folder() else { return };
    let gpx = std::fs::read_to_string(folder.join("gps_static_still.gpx")).unwrap();
    let attribute = |line: &str, name: &str| -> f64 {
        let from = line.split(&format!("{name}=\"")).nth(1).unwrap();
        from.split('"').next().unwrap().parse().unwrap()
    };
    let places: Vec<Utm> = gpx
        .lines()
        .filter(|l| l.contains("<trkpt"))
        .map(|l| {
            let (lat, lon) = (attribute(l, "lat"), attribute(l, "lon"));
            Utm::from_degrees(lat, lon, SouthernOffset::Uquad).unwrap()
        })
        .collect();
    assert_eq!(places.len(), 40);
    assert!((places[0].easting_m - 576_053.161).abs() < 1e-3);
    assert!((places[0].northing_m - 6_135_581.891).abs() < 2e-3);
    let moved: Vec<[f64; 2]> = places
        .iter()
        .map(|p| p.relative_to(&places[0]).unwrap())
        .collect();
    assert!(moved[0].iter().all(|m| m.abs() < 1e-12));
    assert!(
        moved.iter().all(|[e, n]| e.abs() < 15.0 && n.abs() < 15.0),
        "{moved:?}"
    );
}
