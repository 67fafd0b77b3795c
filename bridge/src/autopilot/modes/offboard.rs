//! Offboard: follow set points streamed by a ground program, through avoidance unless KST_OFFB_AVOID is 0.

use super::{Air, Cockpit, Wish};
use crate::autopilot::door::{OffboardFrame, OffboardSetpoint, Refusal};
use planner::navigator::Goal;
use vehicle::setpoint::Lift;
use vehicle::{Heading, In, Ned, Setpoint, Timestamp};

/// A moving position target is followed by a new route only when it moved this far, m.
const NEW_ROUTE_M: f64 = 0.05;
/// Nearer than this a position target is hovered at without a route, m.
const NEAR_M: f64 = 0.6;
/// Fastest off-board velocity, m/s.
const MAX_SPEED_MPS: f64 = 1.5;

/// Mode Offboard.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Offboard {
    routed_to: Option<In<Ned>>,
    /// Target of relative positions, fixed when the set point first came.
    anchored: Option<(OffboardSetpoint, In<Ned>, f64)>,
    hold_down_m: Option<f64>,
}

/// The newest set point of the stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Streamed {
    /// What.
    pub setpoint: OffboardSetpoint,
    /// When it came.
    pub at: Timestamp,
}

impl OffboardSetpoint {
    /// Refuses what is not a number or controls nothing.
    ///
    /// # Errors
    /// [`Refusal::BadNumber`].
    pub fn check(&self) -> Result<(), Refusal> {
        let ok = match self {
            Self::Motion {
                position,
                velocity,
                yaw_rad,
                yaw_rate_radps,
                ..
            } => {
                position
                    .iter()
                    .chain(velocity)
                    .chain([yaw_rad, yaw_rate_radps])
                    .flatten()
                    .all(|v| v.is_finite())
                    && position
                        .iter()
                        .chain(velocity)
                        .chain([yaw_rad, yaw_rate_radps])
                        .any(Option::is_some)
            }
            Self::Attitude {
                roll_rad,
                pitch_rad,
                yaw_rad,
                yaw_rate_radps,
                thrust,
            } => {
                [*roll_rad, *pitch_rad, *thrust]
                    .iter()
                    .all(|v| v.is_finite())
                    && [yaw_rad, yaw_rate_radps]
                        .into_iter()
                        .flatten()
                        .all(|v| v.is_finite())
                    && (0.0..=1.0).contains(thrust)
            }
        };
        if ok { Ok(()) } else { Err(Refusal::BadNumber) }
    }
}

impl Offboard {
    /// One tick.
    pub fn step(&mut self, c: &mut Cockpit<'_>, streamed: &Streamed) -> Wish {
        let setpoint = match streamed.setpoint {
            OffboardSetpoint::Attitude {
                roll_rad,
                pitch_rad,
                yaw_rad,
                yaw_rate_radps,
                thrust,
            } => {
                let heading =
                    yaw_rad.map_or(Heading::Rate(yaw_rate_radps.unwrap_or(0.0)), Heading::Yaw);
                Setpoint::Attitude {
                    roll_rad,
                    pitch_rad,
                    heading,
                    lift: Lift::Thrust(thrust),
                }
            }
            OffboardSetpoint::Motion { .. } if c.air == Air::Ground => return Wish::Rest,
            OffboardSetpoint::Motion {
                frame,
                position,
                velocity,
                yaw_rad,
                yaw_rate_radps,
            } => self.motion(
                c,
                streamed.setpoint,
                frame,
                position,
                velocity,
                yaw_rad,
                yaw_rate_radps,
            ),
        };
        match c.air {
            Air::Flying => Wish::Fly(setpoint),
            Air::Ground | Air::SpoolUp => Wish::LiftOff(setpoint),
        }
    }

    #[expect(clippy::too_many_arguments, reason = "the fields of one set point")]
    fn motion(
        &mut self,
        c: &mut Cockpit<'_>,
        whole: OffboardSetpoint,
        frame: OffboardFrame,
        position: [Option<f64>; 3],
        velocity: [Option<f64>; 3],
        yaw_rad: Option<f64>,
        yaw_rate_radps: Option<f64>,
    ) -> Setpoint {
        // Relative targets are fixed where the vehicle was when this set point first came; repeats do not move them.
        let (origin, origin_yaw) = match self.anchored {
            Some((known, origin, yaw)) if known == whole => (origin, yaw),
            _ => {
                let fresh = (c.nav.position, c.nav.yaw_rad());
                self.anchored = Some((whole, fresh.0, fresh.1));
                fresh
            }
        };
        let turn = |x: f64, y: f64, yaw: f64| {
            let (s, k) = (libm::sin(yaw), libm::cos(yaw));
            (x * k - y * s, x * s + y * k)
        };
        let heading = match (yaw_rad, yaw_rate_radps) {
            (Some(yaw), _) if frame == OffboardFrame::Body => Heading::Yaw(origin_yaw + yaw),
            (Some(yaw), _) => Heading::Yaw(yaw),
            (None, Some(rate)) => Heading::Rate(rate),
            (None, None) => Heading::Yaw(origin_yaw),
        };
        let target_down_m = position[2].map(|z| match frame {
            OffboardFrame::Local => z,
            OffboardFrame::LocalOffset | OffboardFrame::Body => origin.z() + z,
        });
        // An axis that nothing is said about stays where it was; nothing but a heading: turn on the spot.
        let place = match (position[0], position[1], velocity[0], velocity[1]) {
            (None, None, None, None) if velocity[2].is_none() => Some((None, None)),
            (None, None, ..) => None,
            (x, y, ..) => Some((x, y)),
        };
        if let Some((x, y)) = place {
            let (x, y) = match frame {
                OffboardFrame::Local => (x.unwrap_or(origin.x()), y.unwrap_or(origin.y())),
                OffboardFrame::LocalOffset | OffboardFrame::Body => {
                    (x.unwrap_or(0.0), y.unwrap_or(0.0))
                }
            };
            let (x, y) = match frame {
                OffboardFrame::Local => (x, y),
                OffboardFrame::LocalOffset => (origin.x() + x, origin.y() + y),
                OffboardFrame::Body => {
                    let (dx, dy) = turn(x, y, origin_yaw);
                    (origin.x() + dx, origin.y() + dy)
                }
            };
            let down_m = c.clamped_down_m(target_down_m.unwrap_or_else(|| origin.z()));
            let setpoint = self.go(c, In::new(x, y, down_m), heading);
            // The navigator knows headings, not rates.
            return match (heading, setpoint) {
                (Heading::Rate(_), Setpoint::Hover { position, .. }) => {
                    Setpoint::Hover { position, heading }
                }
                (
                    Heading::Rate(_),
                    Setpoint::Velocity {
                        velocity, down_m, ..
                    },
                ) => Setpoint::Velocity {
                    velocity,
                    down_m,
                    heading,
                },
                (_, setpoint) => setpoint,
            };
        }
        self.routed_to = None;
        c.navigator.forget_goal();
        let [vx, vy, vz] = velocity.map(|v| v.unwrap_or(0.0));
        let (vx, vy) = if frame == OffboardFrame::Body {
            turn(vx, vy, c.nav.yaw_rad())
        } else {
            (vx, vy)
        };
        let asked = In::new(vx, vy, 0.0).limited_xy(MAX_SPEED_MPS);
        let allowed = if c.params.offboard_avoid {
            c.navigator.protect(c.now, c.nav, asked)
        } else {
            asked
        };
        let down_m = match target_down_m {
            Some(z) => Some(c.clamped_down_m(z)),
            None if vz == 0.0 => {
                let here = c.clamped_down_m(c.nav.position.z());
                Some(*self.hold_down_m.get_or_insert(here))
            }
            None => {
                self.hold_down_m = None;
                let leaves_range = (vz < 0.0 && c.nav.position.z() < -c.params.ceiling_m)
                    || (vz > 0.0 && c.nav.position.z() > -super::MIN_HEIGHT_M);
                leaves_range.then(|| c.clamped_down_m(c.nav.position.z()))
            }
        };
        Setpoint::Velocity {
            velocity: allowed.with_z(vz.clamp(-1.0, 1.0)),
            down_m,
            heading,
        }
    }

    fn go(&mut self, c: &mut Cockpit<'_>, position: In<Ned>, heading: Heading) -> Setpoint {
        self.hold_down_m = None;
        let yaw = match heading {
            Heading::Yaw(yaw) => Some(yaw),
            Heading::Rate(_) => None,
        };
        if !c.params.offboard_avoid && c.nav.health.position {
            // Who has switched avoidance off flies straight, and answers for the way.
            self.routed_to = None;
            return Setpoint::Hover { position, heading };
        }
        let near = (position - c.nav.position).norm_xy() < NEAR_M;
        let moved = self
            .routed_to
            .is_none_or(|to| (to - position).norm() > NEW_ROUTE_M);
        if near {
            c.navigator.hold(position, yaw, c.nav);
            self.routed_to = Some(position);
        } else if moved {
            let goal = Goal {
                position,
                heading: yaw,
                speed_mps: None,
            };
            match c.navigator.set_goal(goal, c.nav) {
                Ok(()) => self.routed_to = Some(position),
                Err(why) => {
                    if self
                        .routed_to
                        .is_none_or(|to| (to - position).norm() > NEW_ROUTE_M)
                    {
                        c.notice(crate::autopilot::door::Notice::Refused(super::refusal_of(
                            &why,
                        )));
                    }
                    self.routed_to = Some(position);
                    let here = c.stopping_point();
                    c.navigator.hold(here, yaw, c.nav);
                }
            }
        }
        c.navigator.step(c.now, c.nav).setpoint
    }
}
