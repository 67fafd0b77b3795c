//! The measured sampling period: clamped for the filter, counted for the pilot.
//!
//! | Event | Counts | Said |
//! | --- | --- | --- |
//! | outside 8..=12 ms | 1, the nearer bound is used | the first and every tenth |
//! | gap above 1 s | 5 | always |
//! | ten counted | | stop: the sensor is not what the filter believes |
//!
//! uQuad never forgot an error of this kind: a long flight would end by itself. Here a second without error takes one back.

use core::fmt;

/// Nominal period, s.
pub const NOMINAL_S: f64 = 0.01;
/// Accepted periods, s.
pub const RANGE_S: (f64, f64) = (0.008, 0.012);
/// A gap, s.
const GAP_S: f64 = 1.0;
/// Errors that a gap counts.
const GAP_ERRORS: u32 = 5;
/// Errors at which to stop.
const STOP_AT: u32 = 10;
/// Good periods that take one error back.
const FORGIVEN_AFTER: u32 = 100;

/// What was wrong with a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PeriodFault {
    /// Outside the accepted range.
    OutOfRange {
        /// Measured, s.
        measured_s: f64,
        /// Errors counted, this one included.
        errors: u32,
    },
    /// Nothing for more than a second.
    Gap {
        /// Measured, s.
        measured_s: f64,
        /// Errors counted, this one included.
        errors: u32,
    },
}

impl fmt::Display for PeriodFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (what, measured_s, errors) = match self {
            Self::OutOfRange { measured_s, errors } => ("sampling period", measured_s, errors),
            Self::Gap { measured_s, errors } => ("gap", measured_s, errors),
        };
        write!(
            f,
            "{what} of {:.1} ms instead of {:.0}-{:.0} ms ({errors} of {STOP_AT} errors)",
            measured_s * 1e3,
            RANGE_S.0 * 1e3,
            RANGE_S.1 * 1e3
        )
    }
}

/// What to do with a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judged {
    /// Period to use, s.
    pub used_s: f64,
    /// What was wrong.
    pub fault: Option<PeriodFault>,
    /// Worth a line in the log: the first and every tenth error, and every gap.
    pub is_worth_saying: bool,
}

/// Watches the sampling period.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SamplingPeriod {
    errors: u32,
    total: u32,
    good_in_a_row: u32,
}

impl SamplingPeriod {
    /// Judges one measured period.
    pub fn judge(&mut self, measured_s: f64) -> Judged {
        let used_s = if measured_s.is_finite() {
            measured_s.clamp(RANGE_S.0, RANGE_S.1)
        } else {
            NOMINAL_S
        };
        if (RANGE_S.0..=RANGE_S.1).contains(&measured_s) {
            self.good_in_a_row += 1;
            if self.good_in_a_row >= FORGIVEN_AFTER {
                self.good_in_a_row = 0;
                self.errors = self.errors.saturating_sub(1);
            }
            return Judged {
                used_s,
                fault: None,
                is_worth_saying: false,
            };
        }
        self.good_in_a_row = 0;
        self.total = self.total.saturating_add(1);
        let is_gap = measured_s > GAP_S;
        let weight = if is_gap { GAP_ERRORS } else { 1 };
        self.errors = self.errors.saturating_add(weight);
        let errors = self.errors;
        let fault = if is_gap {
            PeriodFault::Gap { measured_s, errors }
        } else {
            PeriodFault::OutOfRange { measured_s, errors }
        };
        Judged {
            used_s,
            fault: Some(fault),
            is_worth_saying: is_gap || self.total == 1 || self.total.is_multiple_of(10),
        }
    }

    /// True when ten errors are counted.
    #[must_use]
    pub const fn must_stop(&self) -> bool {
        self.errors >= STOP_AT
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;

    #[test]
    fn fifteen_ms_are_clamped_to_twelve_and_ten_of_them_stop() {
        let mut period = SamplingPeriod::default();
        for n in 1..=10 {
            assert!(!period.must_stop());
            let judged = period.judge(0.015);
            assert_eq!(judged.used_s, 0.012);
            assert_eq!(judged.is_worth_saying, n == 1 || n == 10);
        }
        assert!(period.must_stop());
    }

    #[test]
    fn two_gaps_of_a_second_stop() {
        let mut period = SamplingPeriod::default();
        let judged = period.judge(1.2);
        assert!(matches!(
            judged.fault,
            Some(PeriodFault::Gap { errors: 5, .. })
        ));
        assert!(!period.must_stop());
        period.judge(1.2);
        assert!(period.must_stop());
    }

    #[test]
    fn errors_are_forgiven_one_a_second_and_nan_is_one() {
        let mut period = SamplingPeriod::default();
        assert_eq!(period.judge(f64::NAN).used_s, NOMINAL_S);
        for _ in 0..8 {
            period.judge(0.001);
        }
        for _ in 0..100 {
            assert!(period.judge(0.01).fault.is_none());
        }
        period.judge(0.02);
        assert!(!period.must_stop(), "nine counted, one forgiven, one more");
    }
}
