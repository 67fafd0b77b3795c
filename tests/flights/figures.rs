//! Orbit and figure eight by MAVLink commands, flown and judged by truth.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::autopilot::mode::Mode;
use flight_tests::{Flight, Scenario, modes};
use mavlink_dialect::command::cmd;

const ORBIT: u16 = cmd::DO_ORBIT;
const EIGHT: u16 = cmd::DO_FIGURE_EIGHT;
const NAN: f32 = f32::NAN;

fn hovering(seed: u64) -> Flight {
    let mut f = Scenario::office().seed(seed).start();
    f.take_off(1.0);
    f.wait_s(2.0);
    f
}

/// Distances from a curve while it is flown, in its plane, and the angle turned around the centre, clockwise.
struct Watched {
    worst_m: f64,
    turned_rad: f64,
}

fn watch(f: &mut Flight, seconds: f64, off: impl Fn([f64; 2]) -> f64) -> Watched {
    let mut w = Watched {
        worst_m: 0.0,
        turned_rad: 0.0,
    };
    let mut last: Option<f64> = None;
    for _ in 0..(seconds / 0.05) as u32 {
        f.wait_s(0.05);
        let p = f.truth().position;
        w.worst_m = w.worst_m.max(off([p.x(), p.y()]));
        let angle = p.y().atan2(p.x());
        if let Some(last) = last {
            w.turned_rad += vehicle::angle::wrap_pi(angle - last);
        }
        last = Some(angle);
    }
    w
}

#[test]
fn orbits_once_around_its_take_off_and_hovers_again() {
    println!("FIGURES orbit of 0.8 m at 0.5 m/s in the office");
    for (seed, sign) in [(1, 1.0_f64), (2, -1.0)] {
        let mut f = hovering(seed);
        let round = core::f32::consts::TAU;
        // About home: latitude and longitude are not given.
        let result = f.command(
            ORBIT,
            [0.8 * sign as f32, 0.5, 0.0, 2.0 * round, NAN, NAN, NAN],
        );
        f.assert(result == 0, &format!("the orbit was refused: {result}"));
        let centre = f.truth().position;
        f.until("on the circle", 20.0, |f| {
            let p = f.truth().position - centre;
            (p.norm_xy() - 0.8).abs() < 0.05 && f.truth().velocity.norm_xy() > 0.3
        });
        f.wait_s(1.0);
        let [cx, cy] = [centre.x(), centre.y()];
        let w = watch(&mut f, 12.0, |[x, y]| ((x - cx).hypot(y - cy) - 0.8).abs());
        println!(
            " seed {seed}: at most {:.3} m off the circle, turned {:.1} rad in 12 s",
            w.worst_m, w.turned_rad
        );
        f.assert(
            w.worst_m < 0.15,
            &format!("{:.3} m off the circle", w.worst_m),
        );
        f.assert(
            w.turned_rad * sign > 5.0,
            "the other way round, or too slow",
        );
        // The nose points to the centre.
        let to_centre = (-f.truth().position.y() + cy).atan2(-f.truth().position.x() + cx);
        let off = vehicle::angle::wrap_pi(f.truth().attitude.yaw() - to_centre).abs();
        f.assert(
            off < 0.35,
            &format!("the nose is {off:.2} rad off the centre"),
        );
        f.until("hover after two rounds", 30.0, |f| {
            f.truth().velocity.norm_xy() < 0.05
        });
        assert_eq!(f.snapshot().mode.mode, Mode::Hold);
        f.assert(f.truth().contacts == 0, "touched something");
    }
    println!("END");
}

#[test]
fn an_orbit_through_a_wall_is_refused_and_nothing_changes() {
    let mut f = hovering(1);
    let before = f.snapshot().setpoint;
    let result = f.command(ORBIT, [30.0, 0.5, 0.0, 0.0, NAN, NAN, NAN]);
    f.assert(result == 2, &format!("expected DENIED, got {result}"));
    let said = f.station.heard().texts.join("; ");
    f.assert(said.contains("wall") || said.contains("plan"), &said);
    assert_eq!(
        f.command(ORBIT, [0.05, 0.5, 0.0, 0.0, NAN, NAN, NAN]),
        2,
        "no such radius"
    );
    assert_eq!(
        f.command(ORBIT, [0.8, 0.5, 4.0, 0.0, NAN, NAN, NAN]),
        3,
        "no such behaviour"
    );
    f.wait_s(1.0);
    let kept = (before, f.snapshot().setpoint);
    let (
        Some(vehicle::Setpoint::Hover { position: a, .. }),
        Some(vehicle::Setpoint::Hover { position: b, .. }),
    ) = kept
    else {
        f.fail(&format!("{kept:?}"));
    };
    f.assert((a - b).norm() < 0.05, "it stays where it was");
}

#[test]
fn flies_a_figure_eight_until_it_is_stopped() {
    let mut f = hovering(3);
    let result = f.command(EIGHT, [0.8, 0.45, NAN, 0.0, NAN, NAN, NAN]);
    f.assert(result == 0, &format!("refused: {result}"));
    f.until("under way", 25.0, |f| f.truth().velocity.norm_xy() > 0.3);
    f.wait_s(2.0);
    let (a, b) = (0.8_f64, 0.45_f64);
    let on_curve = move |[x, y]: [f64; 2]| {
        (0..360)
            .map(|i| {
                let t = f64::from(i).to_radians();
                (a * t.sin() - x).hypot(-b * (2.0 * t).sin() - y)
            })
            .fold(f64::INFINITY, f64::min)
    };
    let w = watch(&mut f, 15.0, on_curve);
    println!(
        "FIGURES\nfigure eight 0.8 x 0.45 m at 0.5 m/s: at most {:.3} m off\nEND",
        w.worst_m
    );
    f.assert(w.worst_m < 0.18, &format!("{:.3} m off", w.worst_m));
    assert_eq!(f.set_mode(modes::LAND), 0);
    f.until_down(15.0);
    f.assert(f.truth().contacts == 0, "touched something");
}
