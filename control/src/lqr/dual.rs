//! Dual numbers: a value and its slope along one direction. A function written for [`Real`] differentiates itself, so that
//! equations and Jacobian cannot disagree.

use core::ops::{Add, Div, Mul, Neg, Sub};

/// What equations of motion are written in: `f64`, or a [`Dual`].
pub trait Real:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
    + Neg<Output = Self>
{
    /// Sine and cosine.
    #[must_use]
    fn sin_cos(self) -> (Self, Self);
}

impl Real for f64 {
    fn sin_cos(self) -> (Self, Self) {
        (libm::sin(self), libm::cos(self))
    }
}

/// A value with its derivative along one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual {
    /// The value.
    pub value: f64,
    /// Its derivative.
    pub slope: f64,
}

impl Add for Dual {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self {
            value: self.value + o.value,
            slope: self.slope + o.slope,
        }
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        self + -o
    }
}

impl Neg for Dual {
    type Output = Self;
    fn neg(self) -> Self {
        self * -1.0
    }
}

impl Mul for Dual {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self {
            value: self.value * o.value,
            slope: self.slope * o.value + self.value * o.slope,
        }
    }
}

impl Div for Dual {
    type Output = Self;
    fn div(self, o: Self) -> Self {
        let value = self.value / o.value;
        Self {
            value,
            slope: (self.slope - value * o.slope) / o.value,
        }
    }
}

impl Mul<f64> for Dual {
    type Output = Self;
    fn mul(self, o: f64) -> Self {
        Self {
            value: self.value * o,
            slope: self.slope * o,
        }
    }
}

impl Div<f64> for Dual {
    type Output = Self;
    fn div(self, o: f64) -> Self {
        Self {
            value: self.value / o,
            slope: self.slope / o,
        }
    }
}

impl Real for Dual {
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = Real::sin_cos(self.value);
        let sin = Self {
            value: s,
            slope: c * self.slope,
        };
        let cos = Self {
            value: c,
            slope: -s * self.slope,
        };
        (sin, cos)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_follow_the_rules_of_calculus() {
        let x = Dual {
            value: 0.7,
            slope: 1.0,
        };
        let (s, c) = Real::sin_cos(x);
        let tan = s / c;
        assert!((tan.value - libm::tan(0.7)).abs() < 1e-15);
        assert!((tan.slope - (1.0 + tan.value * tan.value)).abs() < 1e-14);
        let cubic = x * x * x * 2.0 - x / 4.0;
        assert!((cubic.slope - (6.0 * 0.49 - 0.25)).abs() < 1e-14);
    }
}
