//! The loops closed around an independent vehicle: dead time 60 ms, sticks at 40 Hz.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]

mod plant;

use control::{ControlParams, Controller, Hold, Phase};
use plant::Plant;
use vehicle::{Airframe, Heading, In, NavState, Setpoint, Timestamp};

const RC_PERIOD_S: f64 = 0.025;

struct Flight {
    plant: Plant,
    controller: Controller,
    last: control::ControlOutput,
}

impl Flight {
    fn of(plant: Plant) -> Self {
        let controller = Controller::new(ControlParams::default(), Airframe::default());
        Self {
            plant,
            controller,
            last: Default::default(),
        }
    }

    /// Flies a set point; `each` sees the plant after every stick frame.
    fn fly(&mut self, setpoint: Setpoint, seconds: f64, each: impl FnMut(f64, &Plant)) {
        self.fly_with(setpoint, Phase::Flying, seconds, |nav| nav, each);
    }

    fn fly_with(
        &mut self,
        setpoint: Setpoint,
        phase: Phase,
        seconds: f64,
        see: impl Fn(NavState) -> NavState,
        mut each: impl FnMut(f64, &Plant),
    ) {
        for i in 0..(seconds / RC_PERIOD_S) as usize {
            let nav = see(self.plant.nav());
            let now = self.plant.now();
            self.last = self
                .controller
                .step(now, RC_PERIOD_S, &nav, &setpoint, phase);
            self.plant.fly(self.last.sticks, RC_PERIOD_S);
            each(i as f64 * RC_PERIOD_S, &self.plant);
        }
    }
}

fn hover(x: f64, y: f64, z: f64) -> Setpoint {
    Setpoint::Hover {
        position: In::new(x, y, z),
        heading: Heading::Yaw(0.0),
    }
}

/// Overshoot (share of the step) and time until the error stays below 5 cm.
fn step_response(f: &mut Flight, axis: usize, target: [f64; 3]) -> (f64, f64) {
    let start = f.plant.position[axis];
    let way = target[axis] - start;
    let (mut overshoot, mut settled_at) = (0.0f64, 0.0);
    f.fly(hover(target[0], target[1], target[2]), 8.0, |t, p| {
        overshoot = overshoot.max((p.position[axis] - target[axis]) / way);
        let off: f64 = (0..3).map(|i| (p.position[i] - target[i]).powi(2)).sum();
        if off.sqrt() > 0.05 {
            settled_at = t;
        }
    });
    (overshoot, settled_at)
}

#[test]
fn a_metre_north_east_or_up_settles_within_three_seconds_with_less_than_ten_percent_overshoot() {
    for (axis, target) in [
        (0, [1.0, 0.0, -1.0]),
        (1, [0.0, 1.0, -1.0]),
        (2, [0.0, 0.0, -2.0]),
    ] {
        for yaw in [0.0, 2.0, -1.0] {
            let mut f = Flight::of(Plant::hovering([0.0, 0.0, -1.0]));
            f.plant.yaw = yaw;
            let (overshoot, settled) = step_response(&mut f, axis, target);
            println!(
                "axis {axis} yaw {yaw}: overshoot {:.1} %, settled {settled:.2} s",
                100.0 * overshoot
            );
            assert!(
                overshoot < 0.10,
                "axis {axis}, yaw {yaw}: overshoot {overshoot}"
            );
            assert!(
                settled < 3.0,
                "axis {axis}, yaw {yaw}: settled after {settled} s"
            );
        }
    }
}

#[test]
fn twenty_percent_of_mass_more_or_less_is_flown_as_well() {
    for mass in [0.48, 0.72] {
        let mut f = Flight::of(Plant::new());
        f.plant.mass_kg = mass;
        f.fly_with(hover(0.0, 0.0, -1.0), Phase::SpoolUp, 6.0, |n| n, |_, _| {});
        assert!(f.last.lifted_off);
        let mut worst_height = 0.0f64;
        f.fly(hover(0.0, 0.0, -1.0), 6.0, |_, p| {
            worst_height = worst_height.max((p.position[2] + 1.0).abs());
        });
        println!("mass {mass}: worst height error after take-off {worst_height:.3} m");
        assert!(worst_height < 0.05, "mass {mass}: {worst_height} m");
        let (overshoot, settled) = step_response(&mut f, 0, [1.0, 0.0, -1.0]);
        assert!(
            overshoot < 0.10 && settled < 3.0,
            "mass {mass}: {overshoot} {settled}"
        );
    }
}

#[test]
fn a_steady_half_newton_and_a_crooked_level_are_integrated_away() {
    let mut f = Flight::of(Plant::hovering([0.0, 0.0, -1.0]));
    f.plant.gust_n = [0.5, 0.0];
    f.plant.trim_rad = [0.03, 0.0];
    let mut worst = 0.0f64;
    f.fly(hover(0.0, 0.0, -1.0), 12.0, |_, p| {
        worst = worst.max(p.position[0].hypot(p.position[1]))
    });
    let mut left = 0.0f64;
    f.fly(hover(0.0, 0.0, -1.0), 4.0, |_, p| {
        left = left.max(p.position[0].hypot(p.position[1]))
    });
    println!("gust 0.5 N: pushed {worst:.2} m, left {left:.3} m");
    assert!(worst < 0.5, "pushed {worst} m");
    assert!(left < 0.03, "left {left} m");
}

/// Localization wanders by some centimetres within seconds: the place loop must not make more of it.
#[test]
fn a_place_that_wanders_in_the_estimate_moves_the_vehicle_less() {
    // First-order noise, 4.5 cm, 2 s; a sum of twelve draws is normal enough.
    const SIGMA_M: f64 = 0.045;
    const TAU_S: f64 = 2.0;
    let mut seed = 11_u32;
    let mut normal = || {
        (0..12).fold(-6.0, |sum, _| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum + f64::from(seed >> 8) / f64::from(1 << 24)
        })
    };
    let mut f = Flight::of(Plant::hovering([0.0, 0.0, -1.0]));
    let step = (-RC_PERIOD_S / TAU_S).exp();
    let (mut wander, mut n) = ([0.0; 2], 0.0);
    let (mut moved, mut wandered) = (0.0, 0.0);
    for _ in 0..(600.0 / RC_PERIOD_S) as u32 {
        wander = wander.map(|w| w * step + SIGMA_M * (1.0 - step * step).sqrt() * normal());
        let see = |mut nav: NavState| {
            nav.position += In::new(wander[0], wander[1], 0.0);
            nav
        };
        f.fly_with(
            hover(0.0, 0.0, -1.0),
            Phase::Flying,
            RC_PERIOD_S * 1.01,
            see,
            |_, _| {},
        );
        moved += f.plant.position[0].powi(2) + f.plant.position[1].powi(2);
        wandered += wander[0].powi(2) + wander[1].powi(2);
        n += 1.0;
    }
    let rms = |sum: f64| f64::sqrt(sum / n);
    println!(
        "estimate wanders {:.3} m RMS, the vehicle {:.3} m",
        rms(wandered),
        rms(moved)
    );
    assert!(rms(moved) < rms(wandered));
}

#[test]
fn a_sagging_battery_moves_into_the_hover_throttle() {
    let mut f = Flight::of(Plant::hovering([0.0, 0.0, -1.0]));
    let before = f.controller.hover_throttle();
    f.plant.sag_per_s = 0.002;
    let mut worst = 0.0f64;
    f.fly(hover(0.0, 0.0, -1.0), 90.0, |_, p| {
        worst = worst.max((p.position[2] + 1.0).abs())
    });
    // 18 % less thrust needs 1 / sqrt(0.82) = 1.104 times the motor command.
    let needed = (1.104 * (0.055 + 0.945 * before) - 0.055) / 0.945;
    let learnt = f.controller.hover_throttle();
    println!(
        "sag: worst {worst:.3} m, hover throttle {before:.3} -> {learnt:.3} (needed {needed:.3})"
    );
    assert!(worst < 0.05);
    assert!((learnt - needed).abs() < 0.02);
}

#[test]
fn take_off_and_landing_end_on_the_floor_with_the_motors_free_to_stop() {
    let mut f = Flight::of(Plant::new());
    let mut lift_off_at = None;
    let mut highest = 0.0f64;
    f.fly_with(
        hover(0.0, 0.0, -1.0),
        Phase::SpoolUp,
        7.0,
        |n| n,
        |t, p| {
            if !p.on_floor() {
                lift_off_at.get_or_insert(t);
            }
            highest = highest.max(-p.position[2]);
        },
    );
    println!(
        "lift-off after {lift_off_at:?} s, highest {highest:.3} m, at {:?}",
        f.plant.position
    );
    assert!(lift_off_at.is_some_and(|t| t < 3.0));
    assert!(highest < 1.1 && (f.plant.position[2] + 1.0).abs() < 0.05);

    let land = Setpoint::Land {
        position: In::new(0.0, 0.0, 0.0),
        heading: Heading::Yaw(0.0),
        descent_mps: 0.4,
    };
    let (mut touch_speed, mut touched_at, mut was_flying) = (0.0, 0.0, true);
    let mut speed_before = 0.0;
    f.fly(land, 8.0, |t, p| {
        if was_flying && p.on_floor() {
            (touch_speed, touched_at, was_flying) = (speed_before, t, false);
        }
        speed_before = p.velocity[2];
    });
    println!(
        "touch-down after {touched_at:.2} s at {touch_speed:.2} m/s, landed {}",
        f.last.landed
    );
    assert!(touch_speed < 0.35);
    assert!(f.last.landed && f.last.sticks.throttle < 1e-12 && f.last.hold == Hold::Idle);
    assert!(f.plant.position[0].hypot(f.plant.position[1]) < 0.05);
}

#[test]
fn losing_position_holds_velocity_losing_velocity_holds_height_losing_height_sinks_gently() {
    let mut f = Flight::of(Plant::hovering([0.0, 0.0, -1.5]));
    let sp = hover(0.0, 0.0, -1.5);
    f.fly(sp, 2.0, |_, _| {});
    assert_eq!(f.last.hold, Hold::Position);
    let no_position = |mut n: NavState| {
        n.health.position = false;
        n
    };
    f.fly_with(sp, Phase::Flying, 2.0, no_position, |_, _| {});
    assert_eq!(f.last.hold, Hold::Velocity);
    let no_velocity = move |n: NavState| {
        let mut n = no_position(n);
        n.health.velocity = false;
        n.velocity = In::new(f64::NAN, f64::NAN, n.velocity.z());
        n
    };
    f.fly_with(sp, Phase::Flying, 2.0, no_velocity, |_, _| {});
    assert_eq!(f.last.hold, Hold::Height);
    assert!((f.plant.position[2] + 1.5).abs() < 0.1);
    let blind = move |n: NavState| {
        let mut n = no_velocity(n);
        n.health.height = false;
        n.position = n.position.with_z(f64::NAN);
        n
    };
    let mut fastest = 0.0f64;
    f.fly_with(sp, Phase::Flying, 6.0, blind, |_, p| {
        fastest = fastest.max(p.velocity[2])
    });
    println!(
        "blind: fastest sink {fastest:.2} m/s, height {:.2}",
        -f.plant.position[2]
    );
    assert_eq!(f.last.hold, Hold::Attitude);
    assert!(fastest > 0.1 && fastest < 0.8, "sinks at {fastest} m/s");
}

#[test]
fn a_blind_landing_ends_with_landed() {
    let mut f = Flight::of(Plant::hovering([0.0, 0.0, -1.0]));
    let land = Setpoint::Land {
        position: In::zero(),
        heading: Heading::Rate(0.0),
        descent_mps: 0.4,
    };
    let blind = |mut n: NavState| {
        n.health.height = false;
        n.health.position = false;
        n.health.velocity = false;
        n
    };
    f.fly_with(land, Phase::Flying, 15.0, blind, |_, _| {});
    assert!(f.plant.on_floor() && f.last.landed);
}

#[test]
fn eighty_milliseconds_of_dead_time_more_do_not_make_it_swing() {
    let mut f = Flight::of(Plant::hovering([0.0, 0.0, -1.0]));
    f.plant.dead_time_s = 0.14;
    f.fly(hover(0.5, 0.0, -1.3), 15.0, |_, _| {});
    let mut worst = 0.0f64;
    f.fly(hover(0.5, 0.0, -1.3), 5.0, |_, p| {
        worst = worst.max((p.position[0] - 0.5).hypot(p.position[2] + 1.3));
    });
    assert!(worst < 0.03, "still {worst} m off after 15 s");
}

#[test]
fn going_from_flight_at_speed_to_hover_does_not_jump() {
    let mut f = Flight::of(Plant::hovering([0.0, 0.0, -1.0]));
    let cruise = Setpoint::Velocity {
        velocity: In::new(0.8, 0.0, 0.0),
        down_m: Some(-1.0),
        heading: Heading::Yaw(0.0),
    };
    f.fly(cruise, 4.0, |_, _| {});
    let before = f.last;
    let x = f.plant.position[0];
    f.fly(hover(x, 0.0, -1.0), RC_PERIOD_S, |_, _| {});
    // 15 m/s3 for 25 ms is 0.375 m/s2 or 2.2 degrees.
    assert!((f.last.pitch_sp_rad - before.pitch_sp_rad).abs() < 2.5_f64.to_radians());
    assert!((f.last.sticks.throttle - before.sticks.throttle).abs() < 0.05);
}

#[test]
fn a_pilots_steady_throttle_is_kept_when_control_is_handed_over() {
    let mut f = Flight::of(Plant::hovering([0.0, 0.0, -1.0]));
    f.plant.mass_kg = 0.75;
    // 0.75 * 9.80665 / 18 = 0.4086; root 0.6392; stick 0.6182.
    let stick = vehicle::Sticks {
        throttle: 0.618_2,
        ..vehicle::Sticks::IDLE
    };
    f.plant.fly(stick, 0.5);
    f.plant.velocity = [0.0; 3];
    f.plant.position = [0.0, 0.0, -1.0];
    f.fly(Setpoint::Sticks(stick), 0.2, |_, _| {});
    let mut worst = 0.0f64;
    f.fly(hover(0.0, 0.0, -1.0), 4.0, |_, p| {
        worst = worst.max((p.position[2] + 1.0).abs())
    });
    println!("hand-over with 25 % more mass: worst height error {worst:.3} m");
    assert!(worst < 0.12, "{worst}");
}

#[test]
fn whatever_comes_in_the_sticks_are_finite_and_in_range() {
    let bad = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        1e300,
        -1e300,
        0.0,
    ];
    let mut c = Controller::new(ControlParams::default(), Airframe::default());
    let mut t = 0u64;
    for a in bad {
        for b in bad {
            let mut nav = Plant::hovering([0.0, 0.0, -1.0]).nav();
            nav.position = In::new(a, b, a);
            nav.velocity = In::new(b, 0.1, b);
            nav.accel_mps2 = In::new(a, a, a);
            nav.height_m = b;
            let heading = Heading::Yaw(a);
            let v = In::new(b, a, b);
            for sp in [
                Setpoint::Hover {
                    position: v,
                    heading,
                },
                Setpoint::Velocity {
                    velocity: v,
                    down_m: Some(a),
                    heading,
                },
                Setpoint::Velocity {
                    velocity: v,
                    down_m: None,
                    heading: Heading::Rate(b),
                },
                Setpoint::Attitude {
                    roll_rad: a,
                    pitch_rad: b,
                    heading,
                    lift: vehicle::setpoint::Lift::Thrust(a),
                },
                Setpoint::Land {
                    position: v,
                    heading,
                    descent_mps: a,
                },
                Setpoint::Sticks(vehicle::Sticks {
                    roll: a,
                    pitch: b,
                    yaw: a,
                    throttle: b,
                }),
            ] {
                for phase in [Phase::SpoolUp, Phase::Flying] {
                    t += 20;
                    let out = c.step(
                        Timestamp::from_ms(t),
                        if t.is_multiple_of(40) { a } else { 0.02 },
                        &nav,
                        &sp,
                        phase,
                    );
                    let s = out.sticks;
                    for v in [s.roll, s.pitch, s.yaw] {
                        assert!(v.is_finite() && v.abs() <= 1.0, "{sp:?} -> {s:?}");
                    }
                    assert!((0.0..=1.0).contains(&s.throttle), "{sp:?} -> {s:?}");
                }
            }
        }
    }
    // And afterwards it still flies.
    let mut f = Flight::of(Plant::hovering([0.0, 0.0, -1.0]));
    f.controller = c;
    f.fly(hover(0.0, 0.0, -1.0), 12.0, |_, _| {});
    assert!(
        f.plant.position[0].hypot(f.plant.position[2] + 1.0) < 0.05,
        "{:?}",
        f.plant.position
    );
}

#[test]
fn a_heavier_mass_by_key_lifts_the_throttle_at_once() {
    let mut c = Controller::new(ControlParams::default(), Airframe::default());
    let before = c.hover_throttle();
    c.set_mass(0.65);
    assert!(c.hover_throttle() > before + 0.02);
    c.set_mass(0.6);
    assert!((c.hover_throttle() - before).abs() < 1e-9);
}

#[test]
fn at_idle_nothing_turns() {
    let mut f = Flight::of(Plant::new());
    f.fly_with(hover(0.0, 0.0, -1.0), Phase::Idle, 1.0, |n| n, |_, _| {});
    assert_eq!(f.last.sticks, vehicle::Sticks::IDLE);
}
