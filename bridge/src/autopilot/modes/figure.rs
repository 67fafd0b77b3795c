//! A figure flown in Hold: orbit and figure eight (MAV_CMD_DO_ORBIT, MAV_CMD_DO_FIGURE_EIGHT).
//!
//! The way there is a route; a curve of least jerk joins the figure at its speed; on the figure the wanted place runs along, waits for a vehicle that is held
//! back, and velocities pass the limiter as those of every mode do.

use super::{Cockpit, refusal_of};
use crate::autopilot::door::{FigureRequest, Refusal};
use core::f64::consts::TAU;
use planner::navigator::Goal;
use planner::trajectory::{Figure, Motion, Nose, Piece};
use vehicle::angle::wrap_pi;
use vehicle::{Heading, In, Ned, Setpoint};

/// Sideways acceleration on a figure, m/s2.
const ACCEL_MPS2: f64 = 1.0;
/// The figure begins when the vehicle is this near to where it joins, m.
const AT_START_M: f64 = 0.45;
/// Error of place to velocity, 1/s.
const PULL_PER_S: f64 = 1.3;
/// The velocity loop answers so late: the velocity asked for is that of the figure this much later, s.
const LEAD_S: f64 = 0.30;
/// With this error the place on the figure stands still, m.
const WAIT_M: f64 = 0.6;
/// Time of the joining curve, s, and how far round it joins, rad of the figure's phase.
const JOIN_S: f64 = 2.0;

/// A figure under way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FigureFlight {
    figure: Figure,
    centre: In<Ned>,
    speed_mps: f64,
    nose: Nose,
    initial_yaw_rad: f64,
    /// Phase left to fly; none = for ever.
    left: Option<f64>,
    phase: f64,
    stage: Stage,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// On the way to where it joins.
    There,
    /// From rest to the figure's speed.
    Join { curve: Piece, time_s: f64 },
    /// On it.
    Round,
}

/// What a step comes to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// Fly this.
    Fly(Setpoint),
    /// Done: hover here.
    Done {
        /// m.
        position: In<Ned>,
        /// rad.
        yaw_rad: f64,
    },
}

impl FigureFlight {
    /// Takes a request; nothing has changed when it is refused.
    ///
    /// # Errors
    /// A number is none, or the figure leads through a wall or off the plan.
    pub fn begin(c: &mut Cockpit<'_>, asked: &FigureRequest) -> Result<Self, Refusal> {
        let figure = Figure::from(*asked);
        let centre = In::new(
            asked.north_m.unwrap_or_else(|| c.nav.position.x()),
            asked.east_m.unwrap_or_else(|| c.nav.position.y()),
            c.clamped_down_m(asked.down_m.unwrap_or_else(|| c.nav.position.z())),
        );
        let numbers = [asked.speed_mps.unwrap_or(0.5), asked.rounds.unwrap_or(1.0)];
        if figure.check().is_err() || !centre.is_finite() || numbers.iter().any(|v| !v.is_finite())
        {
            return Err(Refusal::BadNumber);
        }
        c.navigator
            .check_places(figure.outline(centre))
            .map_err(|e| refusal_of(&e))?;
        let fastest = figure.fastest_mps(ACCEL_MPS2).min(1.2);
        let speed_mps = asked.speed_mps.unwrap_or(0.5).clamp(0.1, fastest);
        let off = c.nav.position - centre;
        let phase = figure.nearest(off.x(), off.y());
        let flight = Self {
            figure,
            centre,
            speed_mps,
            nose: asked.nose.into(),
            initial_yaw_rad: c.nav.yaw_rad(),
            left: asked.rounds.map(|rounds| rounds.abs() * TAU),
            phase,
            stage: Stage::There,
        };
        let goal = Goal {
            position: flight.place(phase),
            heading: Some(flight.yaw_rad(phase)),
            speed_mps: None,
        };
        c.navigator
            .set_goal(goal, c.nav)
            .map_err(|e| refusal_of(&e))?;
        Ok(flight)
    }

    fn place(&self, phase: f64) -> In<Ned> {
        let ([n, e], _) = self.figure.at(phase);
        self.centre + In::new(n, e, 0.0)
    }

    /// Velocity at a phase, and how fast the phase grows there.
    fn velocity(&self, phase: f64) -> (In<Ned>, f64) {
        let (_, [n, e]) = self.figure.at(phase);
        let rate = self.speed_mps / libm::hypot(n, e).max(1e-6);
        (In::new(n * rate, e * rate, 0.0), rate)
    }

    fn yaw_rad(&self, phase: f64) -> f64 {
        match self.nose {
            Nose::Initial => self.initial_yaw_rad,
            Nose::Centre => {
                let ([n, e], _) = self.figure.at(phase);
                libm::atan2(-e, -n)
            }
            Nose::Tangent => {
                let (v, _) = self.velocity(phase);
                libm::atan2(v.y(), v.x())
            }
        }
    }

    /// One tick.
    pub fn step(&mut self, c: &mut Cockpit<'_>) -> Progress {
        match &mut self.stage {
            Stage::There => {
                let start = self.place(self.phase);
                let off = start - c.nav.position;
                let is_slow = c.nav.velocity.norm_xy() < 0.15;
                let turned = wrap_pi(self.yaw_rad(self.phase) - c.nav.yaw_rad()).abs();
                if off.norm() < AT_START_M && is_slow && turned < 0.35 {
                    self.join(c);
                }
                Progress::Fly(c.navigator.step(c.now, c.nav).setpoint)
            }
            Stage::Join { curve, time_s } => {
                *time_s += c.dt_s;
                let (t, ahead) = (*time_s, *time_s + LEAD_S);
                let is_over = t >= curve.time_s;
                let at = curve.at(t);
                let later = if ahead < curve.time_s {
                    ned(curve.at(ahead).velocity)
                } else {
                    self.velocity(self.phase).0
                };
                let place = ned(at.position);
                if is_over {
                    self.stage = Stage::Round;
                }
                let yaw_rad = self.yaw_rad(self.phase);
                Progress::Fly(self.track(c, place, later, yaw_rad))
            }
            Stage::Round => self.round(c),
        }
    }

    /// From where it is, at rest, onto the figure at its speed.
    fn join(&mut self, c: &Cockpit<'_>) {
        let (_, rate) = self.velocity(self.phase);
        let phase = self.phase + 0.5 * JOIN_S * rate;
        let (v, _) = self.velocity(phase);
        let (later, _) = self.velocity(phase + 1e-3);
        let accel = (later - v) * (rate / 1e-3);
        let vector = |p: In<Ned>| *p.vector();
        let from = Motion {
            position: vector(c.nav.position),
            ..Motion::default()
        };
        let to = Motion {
            position: vector(self.place(phase)),
            velocity: vector(v),
            acceleration: vector(accel),
        };
        self.phase = phase;
        self.stage = Stage::Join {
            curve: Piece {
                from,
                to,
                time_s: JOIN_S,
            },
            time_s: 0.0,
        };
    }

    fn round(&mut self, c: &mut Cockpit<'_>) -> Progress {
        let place = self.place(self.phase);
        let off_m = (place - c.nav.position).norm_xy();
        let (_, rate) = self.velocity(self.phase);
        // It waits for who is held back.
        let step = rate * c.dt_s * (1.0 - off_m / WAIT_M).clamp(0.0, 1.0);
        self.phase += step;
        if let Some(left) = &mut self.left {
            *left -= step;
            if *left <= 0.0 {
                return Progress::Done {
                    position: self.place(self.phase),
                    yaw_rad: self.yaw_rad(self.phase),
                };
            }
        }
        let (later, _) = self.velocity(self.phase + rate * LEAD_S);
        let yaw_rad = self.yaw_rad(self.phase + rate * LEAD_S);
        Progress::Fly(self.track(c, self.place(self.phase), later, yaw_rad))
    }

    fn track(
        &self,
        c: &mut Cockpit<'_>,
        place: In<Ned>,
        velocity: In<Ned>,
        yaw_rad: f64,
    ) -> Setpoint {
        let pull = (place - c.nav.position).with_z(0.0) * PULL_PER_S;
        let wanted = (velocity + pull)
            .limited_xy(1.3 * self.speed_mps + 0.2)
            .with_z(0.0);
        Setpoint::Velocity {
            velocity: c.navigator.protect(c.now, c.nav, wanted),
            down_m: Some(place.z()),
            heading: Heading::Yaw(wrap_pi(yaw_rad)),
        }
    }
}

fn ned(v: nalgebra::Vector3<f64>) -> In<Ned> {
    In::from_vector(v)
}
