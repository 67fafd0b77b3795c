//! Potential fields, SNSI's first planner: attraction to the goal, repulsion from obstacles (Khatib 1986).
//!
//! The thesis keeps the forces without the factor 2 of the exact gradient; so does this. Its known faults are shown by the
//! tests: it stands still in a U and swings in a corridor.

use nalgebra::Vector2;

/// Gains and reach, as the program has them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PotentialField {
    /// Attraction (eps).
    pub attraction: f64,
    /// Repulsion (eta).
    pub repulsion: f64,
    /// Obstacles farther away do not repel (rho).
    pub reach: f64,
}

/// Value at an obstacle itself.
pub const AT_OBSTACLE: f64 = 90.0;

impl Default for PotentialField {
    fn default() -> Self {
        Self {
            attraction: 1.0 / 16.0,
            repulsion: 5.0,
            reach: 1.0,
        }
    }
}

impl PotentialField {
    /// `U_att = eps d^2`.
    #[must_use]
    pub fn attractive(&self, at: Vector2<f64>, goal: Vector2<f64>) -> f64 {
        self.attraction * (at - goal).norm_squared()
    }

    /// `U_rep = eta (1/d - 1/rho)^2` within reach.
    #[must_use]
    pub fn repulsive(&self, at: Vector2<f64>, obstacle: Vector2<f64>) -> f64 {
        let d = (at - obstacle).norm();
        if d <= 0.0 {
            AT_OBSTACLE
        } else if d <= self.reach {
            let excess = 1.0 / d - 1.0 / self.reach;
            self.repulsion * excess * excess
        } else {
            0.0
        }
    }

    /// The force at a place: where to, and how strongly.
    #[must_use]
    pub fn force(
        &self,
        at: Vector2<f64>,
        goal: Vector2<f64>,
        obstacles: impl IntoIterator<Item = Vector2<f64>>,
    ) -> Vector2<f64> {
        let mut force = (at - goal) * -self.attraction;
        for o in obstacles {
            let from = at - o;
            let d = from.norm();
            if d > 0.0 && d <= self.reach {
                force += from * (self.repulsion * (1.0 / d - 1.0 / self.reach) / (d * d * d));
            }
        }
        force
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attraction_at_10_12_is_15_and_a_quarter() {
        let u = PotentialField::default().attractive(Vector2::new(10.0, 12.0), Vector2::zeros());
        assert!((u - 15.25).abs() < 1e-12);
    }

    #[test]
    fn forces_are_half_the_slope_of_the_potential() {
        let f = PotentialField {
            reach: 5.0,
            ..PotentialField::default()
        };
        let (at, goal, o) = (
            Vector2::new(1.0, 2.0),
            Vector2::new(-3.0, 0.5),
            Vector2::new(2.0, 1.2),
        );
        let u = |p: Vector2<f64>| f.attractive(p, goal) + f.repulsive(p, o);
        let h = 1e-6;
        let slope = Vector2::new(
            (u(at + Vector2::x() * h) - u(at - Vector2::x() * h)) / (2.0 * h),
            (u(at + Vector2::y() * h) - u(at - Vector2::y() * h)) / (2.0 * h),
        );
        assert!((f.force(at, goal, [o]) * 2.0 + slope).norm() < 1e-6);
    }

    #[test]
    fn in_a_u_it_stands_still_away_from_the_goal() {
        let f = PotentialField {
            reach: 1.0,
            repulsion: 0.05,
            ..PotentialField::default()
        };
        let mut walls = Vec::new();
        for k in -10..=10 {
            walls.push(Vector2::new(3.0, 0.1 * f64::from(k)));
            for side in [-1.0, 1.0] {
                walls.push(Vector2::new(2.0 + 0.1 * f64::from(k), side));
            }
        }
        let goal = Vector2::new(8.0, 0.0);
        let mut at = Vector2::new(0.0, 0.0);
        for _ in 0..20_000 {
            let force = f.force(at, goal, walls.iter().copied());
            at += force * (0.01 / force.norm().max(1.0));
        }
        assert!((at - goal).norm() > 4.5, "trapped at {at}");
        assert!(f.force(at, goal, walls.iter().copied()).norm() < 0.05);
    }
}
