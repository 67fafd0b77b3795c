//! Smoothing of the raw counts: `y[n] = c0 x[n] + c1 x[n-1] + ...` on every channel, temperature and pressure too.

use super::frame::{Counts, RawFrame};
use super::ring::{FrameRing, RING_LEN};
use arrayvec::ArrayVec;

/// uQuad's coefficients, newest frame first (equation 1.3).
pub const UQUAD_COEFFICIENTS: [f64; 6] = [0.2, 0.2, 0.2, 0.2, 0.1, 0.1];

/// Why coefficients are refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FirError {
    /// None at all.
    Empty,
    /// As many as the ring holds, or more: it must be longer than the filter.
    LongerThanRing {
        /// How many there are.
        got: usize,
    },
    /// One is not finite.
    NotFinite {
        /// Which.
        index: usize,
    },
    /// They do not add up to one: every calibration would be wrong by that factor.
    Gain {
        /// What they add up to.
        sum: f64,
    },
}

impl core::fmt::Display for FirError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Empty => f.write_str("filter length is 0: it needs at least one coefficient"),
            Self::LongerThanRing { got } => write!(
                f,
                "filter length is {got}, ring length is {RING_LEN}: the ring must be longer than the filter"
            ),
            Self::NotFinite { index } => write!(f, "filter coefficient {index} is not a number"),
            Self::Gain { sum } => {
                write!(
                    f,
                    "the filter coefficients add up to {sum}, they must add up to 1"
                )
            }
        }
    }
}

impl core::error::Error for FirError {}

/// Finite impulse response filter over the ring.
#[derive(Clone, Debug, PartialEq)]
pub struct Fir {
    coefficients: ArrayVec<f64, RING_LEN>,
}

impl Default for Fir {
    fn default() -> Self {
        Self {
            coefficients: UQUAD_COEFFICIENTS.into_iter().collect(),
        }
    }
}

impl Fir {
    /// With any coefficients, newest frame first.
    ///
    /// # Errors
    ///
    /// When they are none, not shorter than the ring, not finite, or do not add up to one.
    pub fn new(coefficients: &[f64]) -> Result<Self, FirError> {
        if coefficients.is_empty() {
            return Err(FirError::Empty);
        }
        if coefficients.len() >= RING_LEN {
            return Err(FirError::LongerThanRing {
                got: coefficients.len(),
            });
        }
        if let Some(index) = coefficients.iter().position(|c| !c.is_finite()) {
            return Err(FirError::NotFinite { index });
        }
        let sum: f64 = coefficients.iter().sum();
        if (sum - 1.0).abs() > 1e-6 {
            return Err(FirError::Gain { sum });
        }
        Ok(Self {
            coefficients: coefficients.iter().copied().collect(),
        })
    }

    /// The newest frame as it is.
    #[must_use]
    pub fn identity() -> Self {
        Self {
            coefficients: core::iter::once(1.0).collect(),
        }
    }

    /// The mean of the last `n` frames.
    ///
    /// # Errors
    ///
    /// When `n` is 0 or not shorter than the ring.
    pub fn mean(n: usize) -> Result<Self, FirError> {
        if n >= RING_LEN {
            return Err(FirError::LongerThanRing { got: n });
        }
        let coefficients = [1.0 / n.max(1) as f64; RING_LEN];
        Self::new(&coefficients[..n])
    }

    /// Frames needed before there is an output.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.coefficients.len()
    }

    /// Never: a filter has at least one coefficient.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.coefficients.is_empty()
    }

    /// The newest output; none before there are enough frames.
    #[must_use]
    pub fn output(&self, ring: &FrameRing) -> Option<Counts> {
        if ring.len() < self.coefficients.len() {
            return None;
        }
        Some(self.weigh(ring.newest_first()))
    }

    fn weigh<'a>(&self, newest_first: impl Iterator<Item = &'a RawFrame>) -> Counts {
        let mut sum = Counts::default();
        for (frame, &weight) in newest_first.zip(&self.coefficients) {
            sum.add_scaled(&Counts::from(frame), weight);
        }
        sum
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;

    fn ring(values: &[i16]) -> FrameRing {
        let mut ring = FrameRing::default();
        for &v in values {
            ring.push(RawFrame {
                accel: [v, 0, 0],
                pressure_pa: 100_000 + v as u32,
                ..RawFrame::default()
            });
        }
        ring
    }

    #[test]
    fn nothing_before_six_frames_then_the_weights_newest_first() {
        let fir = Fir::default();
        assert_eq!(fir.output(&ring(&[1, 2, 3, 4, 5])), None);
        let out = fir.output(&ring(&[100, 200, 1, 2, 3, 4])).unwrap();
        let expected = 0.2 * (4.0 + 3.0 + 2.0 + 1.0) + 0.1 * (200.0 + 100.0);
        assert!((out.accel.x - expected).abs() < 1e-12);
        assert!((out.pressure_pa - 100_000.0 - expected).abs() < 1e-9);
    }

    #[test]
    fn identity_and_mean_are_what_they_say() {
        let r = ring(&[1, 2, 3, 10]);
        assert_eq!(Fir::identity().output(&r).unwrap().accel.x, 10.0);
        assert!((Fir::mean(4).unwrap().output(&r).unwrap().accel.x - 4.0).abs() < 1e-12);
    }

    #[test]
    fn impossible_filters_are_refused_by_name() {
        assert_eq!(Fir::new(&[]), Err(FirError::Empty));
        assert_eq!(Fir::mean(32), Err(FirError::LongerThanRing { got: 32 }));
        assert_eq!(
            Fir::mean(usize::MAX),
            Err(FirError::LongerThanRing { got: usize::MAX })
        );
        assert!(Fir::mean(31).is_ok());
        assert_eq!(
            Fir::new(&[0.5, f64::NAN]),
            Err(FirError::NotFinite { index: 1 })
        );
        assert_eq!(Fir::new(&[0.5, 0.6]), Err(FirError::Gain { sum: 1.1 }));
        let text = FirError::LongerThanRing { got: 32 }.to_string();
        assert!(text.contains("filter") && text.contains("ring") && text.contains("longer"));
    }
}
