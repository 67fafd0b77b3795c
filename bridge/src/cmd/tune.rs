//! `kestrel tune`: a relay test in the simulator, gains from it, and a step flown with the old and the new ones.

use super::Usage;
use super::eval::chart::{self, Panel};
use super::sim::{Built, SimArgs};
use super::term::Terminal;
use anyhow::{Context as _, Result, anyhow, bail};
use bridge::autopilot::door::{OffboardFrame, OffboardSetpoint, Request};
use bridge::autopilot::mode::Mode;
use bridge::io::lockstep::Lockstep;
use bridge::io::logger::WhenFull;
use clap::{Args, ValueEnum};
use control::tuning::{CascadeGains, Relay, StepFigures, Ultimate, step_figures, ultimate};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use vehicle::airframe::GRAVITY_MPS2;

/// Height of the tests, m.
const HEIGHT_M: f64 = 1.0;
/// Between two set points.
const SLICE: Duration = Duration::from_millis(25);
/// Slices whose mean thrust is hover.
const HOVER_SLICES: u32 = 80;
/// The relay's push evens itself out: what it pushes more to one side than to the other moves its middle there, 1/s.
const EVEN_PER_S: f64 = 0.12;
/// Push of the relay, m/s2, and hysteresis, m/s.
const PUSH_MPS2: f64 = 1.2;
const HYSTERESIS_MPS: f64 = 0.04;
/// Length of a relay test and of a step, s.
const RELAY_S: f64 = 16.0;
const STEP_S: f64 = 8.0;
/// Height of the step, m, and the band it shall settle in, as a share.
const STEP_M: f64 = 1.0;
const BAND: f64 = 0.05;

/// Fly a relay test in the simulator and propose gains.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel tune                          level flight in the office; writes tune-level.svg\n  kestrel tune --seed 3\n  kestrel tune --manner inav --out tuning/\n\nOnly the simulator is tuned in: a relay swings the vehicle by a few centimetres. The height's swings are not even enough yet:\n--axis height mostly ends with that error and proposes nothing."
)]
pub(crate) struct TuneArgs {
    #[command(flatten)]
    sim: SimArgs,
    /// What is tuned.
    #[arg(long, value_name = "AXIS", default_value = "level")]
    axis: AxisArg,
    /// Folder for tune.svg.
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum AxisArg {
    Level,
    Height,
    Both,
}

/// One axis under test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Axis {
    Level,
    Height,
}

impl Axis {
    const fn name(self) -> &'static str {
        match self {
            Self::Level => "level",
            Self::Height => "height",
        }
    }

    /// Parameters: place P, velocity P, velocity I.
    const fn parameters(self) -> [&'static str; 3] {
        match self {
            Self::Level => ["MPC_XY_P", "MPC_XY_VEL_P_ACC", "MPC_XY_VEL_I_ACC"],
            Self::Height => ["MPC_Z_P", "MPC_Z_VEL_P_ACC", "MPC_Z_VEL_I_ACC"],
        }
    }
}

/// A vehicle in the air.
struct Flown {
    world: Lockstep,
    hover_thrust: f64,
}

impl Flown {
    fn take_off(args: &SimArgs, params: &[String]) -> Result<Self> {
        let mut args = args.clone();
        args.params.extend_from_slice(params);
        args.params.push("KST_OFFB_AVOID=0".to_owned());
        let Built {
            lockstep: world, ..
        } = args.build(WhenFull::Wait)?;
        let mut flown = Self {
            world,
            hover_thrust: 0.0,
        };
        flown.until("pre-flight checks pass", 30.0, |w| {
            w.now().s() > 1.0 && w.snapshot().arm_blocked_by.is_none()
        })?;
        flown.world.ask(Request::Arm { force: false });
        flown.until("armed", 5.0, |w| w.snapshot().is_armed)?;
        flown.world.ask(Request::Takeoff {
            height_m: Some(HEIGHT_M),
        });
        flown.until("take-off height", 25.0, |w| {
            w.snapshot().mode.mode == Mode::Hold && w.snapshot().nav.height_m > HEIGHT_M - 0.15
        })?;
        flown.pass(6.0);
        // One moment's thrust has the height loop's last word in it: the mean of some is hover.
        let mut sum = 0.0;
        for _ in 0..HOVER_SLICES {
            flown.pass(SLICE.as_secs_f64());
            sum += flown.world.snapshot().thrust_target;
        }
        flown.hover_thrust = sum / f64::from(HOVER_SLICES);
        Ok(flown)
    }

    fn until(&mut self, what: &str, limit_s: f64, is_so: impl Fn(&Lockstep) -> bool) -> Result<()> {
        let until = self.world.now() + Duration::from_secs_f64(limit_s);
        while !is_so(&self.world) {
            if self.world.now() > until {
                bail!("{what}: not within {limit_s} s");
            }
            self.pass(0.02);
        }
        Ok(())
    }

    fn pass(&mut self, seconds: f64) {
        let until = self.world.now() + Duration::from_secs_f64(seconds);
        self.world.advance(until);
        while self.world.poll().is_some() {}
    }

    /// A relay on acceleration against velocity; times, velocities, pushes.
    fn swing(&mut self, axis: Axis) -> Vec<[f64; 3]> {
        let begin = self.world.now().s();
        let start = self.world.snapshot().nav;
        let (height_m, yaw_rad) = (-start.position.z(), start.yaw_rad());
        let mut relay = Relay::new(PUSH_MPS2, HYSTERESIS_MPS);
        let mut rows = Vec::new();
        let mut is_first = true;
        let mut middle_mps2 = 0.0;
        while self.world.now().s() - begin < RELAY_S {
            let nav = self.world.snapshot().nav;
            let (s, c) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
            let forward = nav.velocity.x() * c + nav.velocity.y() * s;
            let climb = -nav.velocity.z();
            let (value, lift, pitch_rad) = match axis {
                Axis::Level => {
                    // It shall also stay where it is: the goal of the velocity leads back.
                    let off = start.position - nav.position;
                    let back = (0.15 * (off.x() * c + off.y() * s)).clamp(-0.05, 0.05);
                    let value = forward - back;
                    let push = relay.step(value);
                    let keep = 2.0 * (height_m + nav.position.z()) - 2.5 * climb;
                    (value, (push, keep), -libm::atan(push / GRAVITY_MPS2))
                }
                Axis::Height => {
                    let back = (0.2 * (height_m + nav.position.z())).clamp(-0.06, 0.06);
                    let value = climb - back;
                    let push = relay.step(value);
                    middle_mps2 += EVEN_PER_S * push * SLICE.as_secs_f64();
                    let off = start.position - nav.position;
                    let home = (off.x() * c + off.y() * s) * 1.2 - forward * 1.8;
                    let pitch = -libm::atan(home.clamp(-1.0, 1.0) / GRAVITY_MPS2);
                    (value, (push, push + middle_mps2), pitch)
                }
            };
            let (push, up_mps2) = lift;
            let thrust = self.hover_thrust * (1.0 + up_mps2 / GRAVITY_MPS2)
                / libm::cos(nav.attitude.tilt()).max(0.8);
            self.world
                .ask(Request::Offboard(OffboardSetpoint::Attitude {
                    roll_rad: 0.0,
                    pitch_rad,
                    yaw_rad: Some(yaw_rad),
                    yaw_rate_radps: None,
                    thrust: thrust.clamp(0.1, 0.9),
                }));
            if is_first {
                is_first = false;
                self.world.ask(Request::SetMode(Mode::Offboard));
            }
            rows.push([self.world.now().s() - begin, value, push]);
            self.pass(SLICE.as_secs_f64());
        }
        self.world.ask(Request::SetMode(Mode::Hold));
        self.pass(4.0);
        rows
    }

    /// A step of the wanted place; times and the share of the way that is done.
    fn step(&mut self, axis: Axis) -> Vec<(f64, f64)> {
        let begin = self.world.now().s();
        let nav = self.world.snapshot().nav;
        let [mut x, y, mut z] = [nav.position.x(), nav.position.y(), nav.position.z()];
        match axis {
            Axis::Level => x += STEP_M,
            Axis::Height => z -= 0.5 * STEP_M,
        }
        let mut path = Vec::new();
        let mut is_first = true;
        while self.world.now().s() - begin < STEP_S {
            self.world.ask(Request::Offboard(OffboardSetpoint::Motion {
                frame: OffboardFrame::Local,
                position: [Some(x), Some(y), Some(z)],
                velocity: [None; 3],
                yaw_rad: Some(nav.yaw_rad()),
                yaw_rate_radps: None,
            }));
            if is_first {
                is_first = false;
                self.world.ask(Request::SetMode(Mode::Offboard));
            }
            let p = self.world.snapshot().nav.position;
            let done = match axis {
                Axis::Level => (p.x() - nav.position.x()) / STEP_M,
                Axis::Height => -(p.z() - nav.position.z()) / (0.5 * STEP_M),
            };
            path.push((self.world.now().s() - begin, done));
            self.pass(SLICE.as_secs_f64());
        }
        path
    }
}

/// What is proposed for an axis.
struct Proposal {
    axis: Axis,
    swing: Vec<[f64; 3]>,
    found: Ultimate,
    old: [f64; 3],
    new: [f64; 3],
    margin: f64,
    paths: [Vec<(f64, f64)>; 2],
    figures: [StepFigures; 2],
}

fn tune(args: &TuneArgs, axis: Axis) -> Result<Proposal> {
    let mut flown = Flown::take_off(&args.sim, &[])?;
    let swing = flown.swing(axis);
    let samples: Vec<(f64, f64)> = swing.iter().map(|[t, v, _]| (*t, *v)).collect();
    let found = ultimate(&samples, PUSH_MPS2, HYSTERESIS_MPS)
        .map_err(|e| anyhow!("relay test of the {} axis: {e}", axis.name()))?;
    let gains = CascadeGains::from_relay(&found);
    let settings = args.sim.settings_now()?;
    let rows = axis.parameters().map(|id| settings.number(id));
    let old = rows.clone().map(|row| row.map_or(f64::NAN, |(v, _)| v));
    let wanted = [gains.place_p, gains.velocity_p, gains.velocity_i];
    // Two digits are more than a test tells; outside its range a parameter would be refused.
    let new: [f64; 3] = core::array::from_fn(|i| {
        let rounded = (wanted[i] * 100.0).round() / 100.0;
        rows[i]
            .as_ref()
            .map_or(rounded, |(_, r)| rounded.clamp(*r.start(), *r.end()))
    });
    let params: Vec<String> = axis
        .parameters()
        .iter()
        .zip(new)
        .map(|(id, v)| format!("{id}={v}"))
        .collect();
    let before = Flown::take_off(&args.sim, &[])?.step(axis);
    let after = Flown::take_off(&args.sim, &params)?.step(axis);
    let figures = [step_figures(&before, BAND), step_figures(&after, BAND)];
    Ok(Proposal {
        axis,
        swing,
        margin: found.gain / new[1],
        found,
        old,
        new,
        paths: [before, after],
        figures,
    })
}

impl Proposal {
    fn tell(&self, terminal: &mut Terminal) {
        let f = &self.found;
        terminal.line(&format!(
            "{}: swings with {:.2} s, {:.3} m/s ({} swings): ultimate gain {:.2} 1/s",
            self.axis.name(),
            f.period_s,
            f.amplitude,
            f.swings,
            f.gain
        ));
        for (i, id) in self.axis.parameters().into_iter().enumerate() {
            terminal.line(&format!(
                "  {id:18} {:.2} -> {:.2}",
                self.old[i], self.new[i]
            ));
        }
        for (name, s) in ["present", "proposed"].into_iter().zip(&self.figures) {
            terminal.line(&format!(
                "  step, {name:8}: overshoot {:.1} %, rise {:.2} s, within 5 % after {:.2} s",
                100.0 * s.overshoot,
                s.rise_s,
                s.settled_s
            ));
        }
        let old_margin = f.gain / self.old[1];
        terminal.line(&format!(
            "  gain margin of the velocity loop: {:.1} dB now, {:.1} dB proposed",
            20.0 * libm::log10(old_margin),
            20.0 * libm::log10(self.margin)
        ));
        let params: Vec<String> = self
            .axis
            .parameters()
            .iter()
            .zip(self.new)
            .map(|(id, v)| format!("--param {id}={v}"))
            .collect();
        terminal.line(&format!("  to fly them: {}", params.join(" ")));
    }

    fn svg(&self) -> String {
        let t: Vec<f64> = self.swing.iter().map(|r| r[0]).collect();
        let [before, after] = &self.paths;
        // One abscissa: the steps end before the relay test does.
        let resampled = |path: &[(f64, f64)]| -> Vec<f64> {
            t.iter()
                .map(|at| {
                    let i = path.partition_point(|(t, _)| t <= at);
                    path.get(i.saturating_sub(1)).map_or(f64::NAN, |(_, v)| *v)
                })
                .collect()
        };
        chart::svg(
            &format!("kestrel tune: {}", self.axis.name()),
            "time, s",
            &t,
            &[
                Panel {
                    title: "relay test: velocity, m/s",
                    lines: vec![("velocity", self.swing.iter().map(|r| r[1]).collect())],
                },
                Panel {
                    title: "relay test: push, m/s2",
                    lines: vec![("push", self.swing.iter().map(|r| r[2]).collect())],
                },
                Panel {
                    title: "step: share of the way",
                    lines: vec![
                        ("present", resampled(before)),
                        ("proposed", resampled(after)),
                    ],
                },
            ],
        )
    }
}

pub(crate) fn run(args: &TuneArgs) -> Result<ExitCode> {
    if args.sim.airframe != super::sim::AirframeArg::Quad {
        return Err(Usage("uQuad's gains are computed, not tuned: see --lqr-q".to_owned()).into());
    }
    let axes: &[Axis] = match args.axis {
        AxisArg::Level => &[Axis::Level],
        AxisArg::Height => &[Axis::Height],
        AxisArg::Both => &[Axis::Level, Axis::Height],
    };
    let mut terminal = Terminal::new(args.sim.quiet);
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot make {}", args.out.display()))?;
    for axis in axes {
        let proposal = tune(args, *axis)?;
        proposal.tell(&mut terminal);
        let path = args.out.join(format!("tune-{}.svg", axis.name()));
        std::fs::write(&path, proposal.svg())
            .with_context(|| format!("cannot write {}", path.display()))?;
        terminal.line(&format!("  picture: {}", path.display()));
    }
    terminal.finish();
    Ok(ExitCode::SUCCESS)
}
