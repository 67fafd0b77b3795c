//! The two planners that SNSI had, flown on the same way by the same vehicle as VFH+: to compare with.
//!
//! Both steer for the next corner of the way and know nothing of what VFH+ adds here: no way is planned anew around what
//! was seen, nothing is looked ahead over the vehicle's own answer, and the histogram counts for ever. What they run into
//! is theirs; with `VFH_GUARD` the vehicle still brakes before it touches.

use super::foresight::KEEP_M;
use super::{Goal, Navigator, SURE_WEIGHT, Steering, SteeringState, stand, xy};
use crate::potential::PotentialField;
use crate::vfh::config::VfhVariant;
use crate::vfh::thesis::{CELL_M, Ends, SPEED_MAX_DEG, Smoothing, Window, decide, smoothed};
use nalgebra::Vector2;
use vehicle::angle::{shortest_turn, wrap_pi};
use vehicle::{Heading, In, Map, NavState, Setpoint};

/// Cells a side of the window: two metres each way.
const SIDE: usize = 81;
/// Readings that the thesis' program takes, m.
const READ_M: core::ops::RangeInclusive<f64> = 0.05..=3.75;
/// Attraction at this distance is full speed, m.
const FULL_SPEED_M: f64 = 1.0;
/// Slower over ground the last piece, 1/s, but not slower than this, m/s.
const ARRIVE_PER_S: f64 = 1.2;
const CREEP_MPS: f64 = 0.12;

/// The thesis' window of counts, carried along by the vehicle.
#[derive(Clone, Debug)]
pub(super) struct Counts {
    window: Window,
    /// The vehicle's cell, rows down and columns right of the plan's origin; none before the first reading.
    cell: Option<[i32; 2]>,
}

impl Counts {
    pub(super) fn for_variant(variant: VfhVariant) -> Option<Box<Self>> {
        (variant == VfhVariant::Thesis).then(|| {
            Box::new(Self {
                window: Window::new(SIDE),
                cell: None,
            })
        })
    }

    pub(super) fn clear(&mut self) {
        self.window.clear();
        self.cell = None;
    }

    /// Takes the window to where the vehicle is.
    fn follow(&mut self, here: Vector2<f64>) {
        let cell = [-here.y, here.x].map(|v| libm::floor(v / CELL_M) as i32);
        if let Some([row, column]) = self.cell
            && [row, column] != cell
        {
            self.window
                .shift(cell[0].saturating_sub(row), cell[1].saturating_sub(column));
        }
        self.cell = Some(cell);
    }

    /// Counts a return that was seen from `here`.
    pub(super) fn add(&mut self, here: Vector2<f64>, to: Vector2<f64>) {
        self.follow(here);
        let offset = to - here;
        let distance_m = offset.norm();
        if READ_M.contains(&distance_m) {
            // Rows run down, so that clockwise is positive.
            let angle_deg = libm::atan2(-offset.y, offset.x).to_degrees();
            self.window.add(angle_deg, distance_m);
        }
    }
}

impl Navigator {
    /// Direction and speed of the variant, nothing else.
    pub(super) fn travel_classically(
        &mut self,
        nav: &NavState,
        here: In<Map>,
        goal: &Goal,
        left_m: f64,
    ) -> Steering {
        let corner = self.path.get(self.leg).or(self.path.last());
        let target = xy(*corner.unwrap_or(&here));
        let cruise = goal.speed_mps.unwrap_or(self.params.cruise_mps).max(0.05);
        let fastest = cruise.min((ARRIVE_PER_S * left_m).max(CREEP_MPS));
        let decided = if self.vfh.variant == VfhVariant::Thesis {
            self.by_histogram(nav, xy(here), target, fastest)
        } else {
            Some(self.by_potential(xy(here), target, fastest))
        };
        let Some((velocity, nose_rad)) = decided else {
            let mut s = stand(nav, goal.position.z(), nav.yaw_rad(), left_m);
            s.state = SteeringState::Blocked;
            return s;
        };
        let flown = if self.vfh.guard {
            self.held_back_by_all(velocity, self.radius_m + KEEP_M)
        } else {
            velocity
        };
        let to = target - xy(here);
        let bent = shortest_turn(nose_rad, libm::atan2(to.y, to.x)).abs() > 10_f64.to_radians();
        Steering {
            setpoint: Setpoint::Velocity {
                velocity: self.world_vector(flown),
                down_m: Some(goal.position.z()),
                heading: Heading::Yaw(wrap_pi(self.anchor.yaw_to_ned(nose_rad))),
            },
            distance_left_m: left_m,
            arrived: false,
            state: if bent {
                SteeringState::Avoiding
            } else {
                SteeringState::Clear
            },
        }
    }

    /// The thesis: turn to the valley's heading and meanwhile lean forward, the less the denser it is ahead of the nose.
    fn by_histogram(
        &mut self,
        nav: &NavState,
        here: Vector2<f64>,
        target: Vector2<f64>,
        fastest: f64,
    ) -> Option<(Vector2<f64>, f64)> {
        let counts = self.counts.as_mut()?;
        counts.follow(here);
        let h = smoothed(&counts.window.histogram(), Smoothing::Hann, Ends::Joined);
        let nose_rad = self.anchor.yaw_to_map(nav.yaw_rad());
        let to = target - here;
        let clockwise_deg = |rad: f64| -rad.to_degrees();
        let decision = decide(
            &h,
            self.vfh.thesis_threshold,
            clockwise_deg(libm::atan2(to.y, to.x)),
            clockwise_deg(nose_rad),
            Ends::Joined,
        )?;
        let speed = fastest * f64::from(decision.speed_deg) / SPEED_MAX_DEG;
        let ahead = Vector2::new(libm::cos(nose_rad), libm::sin(nose_rad));
        Some((
            ahead * speed,
            nose_rad - f64::from(decision.turn_deg).to_radians(),
        ))
    }

    /// Along the force, the nose ahead.
    fn by_potential(
        &self,
        here: Vector2<f64>,
        target: Vector2<f64>,
        fastest: f64,
    ) -> (Vector2<f64>, f64) {
        let field = PotentialField {
            attraction: self.vfh.potential_attraction,
            repulsion: self.vfh.potential_repulsion,
            reach: self.vfh.potential_reach_m,
        };
        let sure = self.surroundings.points().iter();
        let obstacles = sure
            .filter(|o| o.weight >= SURE_WEIGHT)
            .map(|o| here + o.offset);
        let force = field.force(here, target, obstacles);
        let size = force.norm();
        let to = target - here;
        let nose = if size > 1e-9 { force } else { to };
        let share = (size / (field.attraction * FULL_SPEED_M)).min(1.0);
        (
            force * (share * fastest / size.max(1e-9)),
            libm::atan2(nose.y, nose.x),
        )
    }
}
