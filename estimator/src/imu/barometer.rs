//! Pressure to height (international standard atmosphere, troposphere).

/// Scale height of the formula, m.
const SCALE_M: f64 = 44_330.0;
/// The exponent of the formula, 1 / 5.255.
const EXPONENT: f64 = 1.0 / 5.255;
/// Pressure at sea level, Pa: the reference when nothing was calibrated.
pub const SEA_LEVEL_PA: f64 = 101_325.0;

/// Height above the level where the pressure is `reference_pa`, m.
#[must_use]
pub fn altitude_m(pressure_pa: f64, reference_pa: f64) -> f64 {
    SCALE_M * (1.0 - libm::pow(pressure_pa / reference_pa, EXPONENT))
}

/// The reference for which `pressure_pa` means `altitude_m`, Pa.
///
/// uQuad raises to 5.255; the inverse of the exponent above is the same to the last bit but one.
#[must_use]
pub fn reference_pa(pressure_pa: f64, altitude_m: f64) -> f64 {
    pressure_pa / libm::pow(1.0 - altitude_m / SCALE_M, 1.0 / EXPONENT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_start_at_100_m_reads_100_m() {
        let p0 = reference_pa(100_200.0, 100.0);
        assert!((altitude_m(100_200.0, p0) - 100.0).abs() < 1e-9);
        assert!(
            altitude_m(100_100.0, p0) > 100.0,
            "less pressure, more height"
        );
    }

    #[test]
    fn the_exponent_is_that_of_the_program() {
        assert!((EXPONENT - 0.190_294_957_183_635).abs() < 1e-15);
    }
}
