//! The reference vectors: Jacobians, eight Riccati equations, the flight of hover gains in the non-linear plant.

#![allow(
    clippy::disallowed_methods,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use control::lqr::{Inputs, Motion, State, Trim, dare, trim::Circle, zero_order_hold};
use control::proportional::ErrorLimits;
use nalgebra::{Const, DMatrix, DimMin, SMatrix};
use serde_json::Value;
use std::path::PathBuf;
use vehicle::UquadAirframe;

fn vectors() -> Option<Value> {
    let base = std::env::var_os("KESTREL_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let path = base.join("control/lqr_vectors.json");
    let Ok(text) = std::fs::read_to_string(&path) else {
        println!(
            "SKIPPED: no vectors at {} (set KESTREL_DATA)",
            path.display()
        );
        return None;
    };
    Some(serde_json::from_str(&text).unwrap())
}

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(values) => values.iter().flat_map(numbers).collect(),
        number => vec![number.as_f64().unwrap()],
    }
}

fn matrix<const R: usize, const C: usize>(value: &Value) -> SMatrix<f64, R, C> {
    let numbers = numbers(value);
    assert_eq!(numbers.len(), R * C);
    SMatrix::from_row_slice(&numbers)
}

/// Largest difference over largest entry.
fn relative<const R: usize, const C: usize>(
    got: &SMatrix<f64, R, C>,
    golden: &SMatrix<f64, R, C>,
) -> f64 {
    (got - golden).amax() / golden.amax()
}

fn named<'a>(vectors: &'a Value, name: &str) -> &'a Value {
    let cases = vectors["dare_cases"].as_array().unwrap();
    cases.iter().find(|c| c["name"] == name).unwrap()
}

#[test]
fn the_plant_is_that_of_the_vectors() {
    let Some(v) = vectors() else { return };
    let craft = UquadAirframe::default();
    let p = &v["params"];
    let same = |key: &str, ours: f64| {
        assert!((p[key].as_f64().unwrap() - ours).abs() < 1e-15, "{key}");
    };
    same("m", craft.mass_kg);
    same("arm", craft.arm_m);
    same("Jr", craft.rotor_inertia);
    same("b1", craft.thrust.0);
    same("b2", craft.thrust.1);
    same("d1", craft.drag.0);
    same("d2", craft.drag.1);
    let hover = v["hover_speed_rad_s"].as_f64().unwrap();
    assert!((craft.hover_speed_radps() - hover).abs() < 1e-9);
}

#[test]
fn motion_and_jacobians_are_exact_at_random_points() {
    let Some(v) = vectors() else { return };
    let motion = Motion::of(UquadAirframe::default());
    let mut worst = [0.0_f64; 3];
    let points = v["dynamics_and_jacobians"].as_array().unwrap();
    assert_eq!(points.len(), 6);
    for point in points {
        let x: State = matrix(&point["x"]);
        let u: Inputs = matrix(&point["u"]);
        let (a, b) = motion.jacobians(&x, &u);
        let off = [
            relative(&motion.derivative(&x, &u), &matrix(&point["xdot"])),
            relative(&a, &matrix(&point["A"])),
            relative(&b, &matrix(&point["B"])),
        ];
        worst = core::array::from_fn(|i| worst[i].max(off[i]));
    }
    println!(
        "FIGURES\nequations of motion {:.1e}, A {:.1e}, B {:.1e} off the vectors, relative\nEND",
        worst[0], worst[1], worst[2]
    );
    assert!(worst.iter().all(|w| *w < 1e-12), "{worst:?}");
}

/// One case: P and K against the vectors, spectral radius of the closed loop against its own.
fn solves<const N: usize, const M: usize>(case: &Value) -> (f64, f64, u32)
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let name = case["name"].as_str().unwrap();
    let a: SMatrix<f64, N, N> = matrix(&case["A"]);
    let b: SMatrix<f64, N, M> = matrix(&case["B"]);
    let q = SMatrix::<f64, N, N>::from_diagonal(&matrix::<N, 1>(&case["Q"]));
    let r = SMatrix::<f64, M, M>::from_diagonal(&matrix::<M, 1>(&case["R"]));
    let solution = dare(&a, &b, &q, &r).unwrap();
    let (p, k) = (
        relative(&solution.p, &matrix(&case["P"])),
        relative(&solution.k, &matrix(&case["K"])),
    );
    let closed = a - b * solution.k;
    let eigenvalues = DMatrix::from_column_slice(N, N, closed.as_slice()).complex_eigenvalues();
    let radius = eigenvalues.iter().map(|e| e.norm()).fold(0.0, f64::max);
    let golden = case["spectral_radius"].as_f64().unwrap();
    println!(
        "{name}: P {p:.1e}, K {k:.1e}, spectral radius {radius:.6}, {} rounds",
        solution.rounds
    );
    assert!(
        radius < 1.0 && (radius - golden).abs() < 1e-6,
        "{name}: {radius} {golden}"
    );
    (p, k, solution.rounds)
}

#[test]
fn eight_riccati_equations_to_one_part_in_a_million() {
    let Some(v) = vectors() else { return };
    let cases = v["dare_cases"].as_array().unwrap();
    assert_eq!(cases.len(), 8);
    println!("FIGURES");
    for case in cases {
        let size = (numbers(&case["Q"]).len(), numbers(&case["R"]).len());
        let (p, k, _) = match size {
            (2, 1) => solves::<2, 1>(case),
            (6, 2) => solves::<6, 2>(case),
            (8, 4) => solves::<8, 4>(case),
            (12, 4) => solves::<12, 4>(case),
            (16, 4) => solves::<16, 4>(case),
            other => panic!("{other:?}"),
        };
        assert!(p < 1e-6 && k < 1e-6, "{}: P {p:e}, K {k:e}", case["name"]);
    }
    println!("END");
}

#[test]
fn linearised_and_held_models_are_those_of_the_cases() {
    let Some(v) = vectors() else { return };
    let motion = Motion::of(UquadAirframe::default());
    let mut seen = 0;
    for case in v["dare_cases"].as_array().unwrap() {
        let Some(x) = case.get("x_lin") else { continue };
        let (a, b) = motion.jacobians(&matrix(x), &matrix(&case["u_lin"]));
        let (phi, gamma) = zero_order_hold(&a, &b, 0.01);
        let off = (
            relative(&phi, &matrix(&case["A"])),
            relative(&gamma, &matrix(&case["B"])),
        );
        assert!(off.0 < 1e-13 && off.1 < 1e-12, "{}: {off:?}", case["name"]);
        seen += 1;
    }
    assert_eq!(seen, 4);
}

#[test]
fn the_circle_of_the_vectors_is_our_trim() {
    let Some(v) = vectors() else { return };
    let case = named(&v, "uquad_circle_r1_v1");
    let motion = Motion::of(UquadAirframe::default());
    let circle = Circle {
        speed_mps: 1.0,
        rate_radps: 1.0,
        bearing_rad: 0.0,
    };
    let trim = Trim::circle(&motion, &circle, 0.0).unwrap();
    let state = (trim.state - matrix::<12, 1>(&case["x_lin"])).amax();
    let speeds = (trim.inputs - matrix::<4, 1>(&case["u_lin"])).amax();
    assert!(state < 1e-9 && speeds < 1e-7, "{state:e} {speeds:e}");
    assert!((trim.state[3].to_degrees() + 5.82).abs() < 0.005);
}

#[test]
fn hover_gains_fly_the_step_of_the_vectors() {
    let Some(v) = vectors() else { return };
    let case = named(&v, "uquad_hover_12x4");
    let q = SMatrix::from_diagonal(&matrix::<12, 1>(&case["Q"]));
    let r = SMatrix::from_diagonal(&matrix::<4, 1>(&case["R"]));
    let motion = Motion::of(UquadAirframe::default());
    let hover = Trim::hover(&motion.craft, 0.0);
    let (a, b) = motion.jacobians(&hover.state, &hover.inputs);
    let (phi, gamma) = zero_order_hold(&a, &b, 0.01);
    let k = dare(&phi, &gamma, &q, &r).unwrap().k;

    let rows = v["hover_step_response"]["rows"].as_array().unwrap();
    let mut state: State = matrix(&Value::Array(rows[0].as_array().unwrap()[1..].to_vec()));
    let mut worst = 0.0_f64;
    let mut next = 1;
    for sample in 0..1000 {
        let error = ErrorLimits::default().error(&[0.0; 12], &state.into());
        let u = (hover.inputs + k * error).map(|w| w.clamp(50.0, 450.0));
        for _ in 0..10 {
            let h = 1e-3;
            let k1 = motion.derivative(&state, &u);
            let k2 = motion.derivative(&(state + k1 * (h / 2.0)), &u);
            let k3 = motion.derivative(&(state + k2 * (h / 2.0)), &u);
            let k4 = motion.derivative(&(state + k3 * h), &u);
            state += (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (h / 6.0);
        }
        if (sample + 1) % 25 == 0 {
            let row = numbers(&rows[next]);
            assert!((row[0] - f64::from(sample + 1) * 0.01).abs() < 1e-9);
            let golden = State::from_column_slice(&row[1..]);
            worst = worst.max((state - golden).amax());
            next += 1;
        }
    }
    assert_eq!(next, rows.len());
    println!("FIGURES\nhover step, 40 rows: {worst:.1e} off the vectors (bar 1e-3)\nEND");
    assert!(worst < 1e-3, "{worst}");
}

#[test]
fn spectral_radii_of_the_thesis_sets_are_the_goldens() {
    use control::lqr::{Weights, design};
    let motion = Motion::uquad();
    let hover = Trim::hover(&motion.craft, 0.0);
    let (a, b) = motion.jacobians(&hover.state, &hover.inputs);
    let sets = [
        (
            design::twelve_and_integrals(&motion, &hover, &Weights::uquad()),
            0.99968,
        ),
        (
            design::eight_and_integrals(&motion, &hover, &Weights::uquad()),
            0.99978,
        ),
    ];
    for (design, golden) in sets {
        let design = design.unwrap();
        let (gains, columns) = design.integral.unwrap();
        let mut a16 = SMatrix::<f64, 16, 16>::zeros();
        let mut b16 = SMatrix::<f64, 16, 4>::zeros();
        let mut k16 = SMatrix::<f64, 4, 16>::zeros();
        a16.fixed_view_mut::<12, 12>(0, 0).copy_from(&a);
        b16.fixed_view_mut::<12, 4>(0, 0).copy_from(&b);
        for (i, c) in columns.into_iter().enumerate() {
            a16[(12 + i, c.state())] = 1.0;
        }
        k16.fixed_view_mut::<4, 12>(0, 0)
            .copy_from(&design.gains.matrix);
        k16.fixed_view_mut::<4, 4>(0, 12).copy_from(&gains);
        let (phi, gamma) = zero_order_hold(&a16, &b16, 0.01);
        let closed = phi - gamma * k16;
        // The eight-state set leaves x, y, vqx, vqy alone: those are no part of its loop.
        let kept: Vec<usize> = if golden > 0.9997 {
            vec![2, 3, 4, 5, 8, 9, 10, 11, 12, 13, 14, 15]
        } else {
            (0..16).collect()
        };
        let loop_ = DMatrix::from_fn(kept.len(), kept.len(), |i, j| closed[(kept[i], kept[j])]);
        let radius = loop_
            .complex_eigenvalues()
            .iter()
            .map(|e| e.norm())
            .fold(0.0, f64::max);
        assert!((radius - golden).abs() < 6e-6, "{radius} {golden}");
    }
}
