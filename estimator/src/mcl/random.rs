//! A small, portable random source: same seed, same particles, on any machine.

/// xorshift64* (Vigna 2014); one multiplication a draw.
#[derive(Clone, Debug, PartialEq)]
pub struct Random(u64);

impl Random {
    /// Any seed will do; neighbouring seeds give unrelated streams.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        // splitmix64 (Steele 2014), so that small seeds do not start with runs of zeros.
        let mut z = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        Self((z ^ (z >> 31)) | 1)
    }

    /// 64 random bits.
    #[inline]
    pub fn bits(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    /// Uniform in 0..1.
    #[inline]
    pub fn uniform(&mut self) -> f32 {
        (self.bits() >> 40) as f32 * (1.0 / 16_777_216.0)
    }

    /// Standard normal to 3.4 sigma: the sum of four 16-bit fields of one draw (Irwin-Hall).
    #[inline]
    pub fn gaussian(&mut self) -> f32 {
        let b = self.bits();
        let field = |shift: u32| (b >> shift) as u32 & 0xFFFF;
        let sum = field(0) + field(16) + field(32) + field(48);
        // Four uniforms of 65536 steps: mean 2 * 65535, variance 65536^2 / 3.
        (sum as i32 as f32 - 131_070.0) * (1.732_050_8 / 65_536.0)
    }
}

/// Sine and cosine to 2e-6 by a polynomial on +-45 degrees: `libm` costs more than all the rest of a particle's motion.
#[inline]
#[must_use]
pub(crate) fn sin_cos(angle: f32) -> (f32, f32) {
    use core::f32::consts::{FRAC_2_PI, FRAC_PI_2};
    const MAGIC: f32 = 12_582_912.0;
    let shifted = angle * FRAC_2_PI + MAGIC;
    let quarter_bits = shifted.to_bits();
    let quarter = shifted - MAGIC;
    let r = angle - quarter * FRAC_PI_2;
    let r2 = r * r;
    let s = r * (1.0 + r2 * (-1.0 / 6.0 + r2 * (1.0 / 120.0 - r2 * (1.0 / 5040.0))));
    let c = 1.0 + r2 * (-0.5 + r2 * (1.0 / 24.0 + r2 * (-1.0 / 720.0 + r2 * (1.0 / 40320.0))));
    // Selects instead of branches: loops over particles become vector instructions.
    let turns = quarter_bits & 3;
    let (a, b) = if turns & 1 == 0 { (s, c) } else { (c, s) };
    let sine_sign = (turns & 2) << 30;
    let cosine_sign = (turns.wrapping_add(1) & 2) << 30;
    (
        f32::from_bits(a.to_bits() ^ sine_sign),
        f32::from_bits(b.to_bits() ^ cosine_sign),
    )
}

/// exp(v) for v <= 0 to 2e-7 of its value; nothing (0, not a denormal number) below -80 and for NaN. A polynomial, so that
/// loops over particles become vector instructions.
#[inline]
#[must_use]
pub(crate) fn exp_below_zero(v: f32) -> f32 {
    use core::f32::consts::LOG2_E;
    // ln 2 in two parts, the first exact in few bits (Cody and Waite 1980).
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    const MAGIC: f32 = 12_582_912.0;
    let is_something = v > -80.0;
    let v = if is_something { v } else { -80.0 };
    let shifted = v * LOG2_E + MAGIC;
    let whole = shifted - MAGIC;
    // -0.35..=0.35
    let r = (v - whole * LN_2[0]) - whole * LN_2[1];
    let p = 1.0
        + r * (1.0
            + r * (0.5
                + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0))))));
    // The lowest bits of `shifted` hold the exponent.
    let scale = f32::from_bits((shifted.to_bits() << 23).wrapping_add(0x3F80_0000));
    if is_something { p * scale } else { 0.0 }
}

/// The same direction in about -pi..=pi.
#[inline]
#[must_use]
pub(crate) fn wrap(angle: f32) -> f32 {
    use core::f32::consts::TAU;
    angle - TAU * round(angle * (1.0 / TAU))
}

/// Nearest whole number, for |v| < 2^22: adding and removing 1.5 * 2^23 leaves no fraction bits.
#[inline]
fn round(v: f32) -> f32 {
    const MAGIC: f32 = 12_582_912.0;
    (v + MAGIC) - MAGIC
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussian_has_mean_zero_and_variance_one() {
        let mut random = Random::new(7);
        let n = 100_000;
        let draws: Vec<f64> = (0..n).map(|_| f64::from(random.gaussian())).collect();
        let mean = draws.iter().sum::<f64>() / f64::from(n);
        let variance = draws.iter().map(|d| d * d).sum::<f64>() / f64::from(n) - mean * mean;
        assert!(
            mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02,
            "{mean} {variance}"
        );
    }

    #[test]
    fn the_polynomial_exponential_agrees_with_the_library() {
        for k in 0..80_000 {
            let v = -0.001 * k as f32;
            let (fast, exact) = (exp_below_zero(v), libm::expf(v));
            assert!((fast - exact).abs() <= 1e-6 * exact, "{v}: {fast} {exact}");
        }
        assert_eq!(exp_below_zero(-81.0).to_bits(), 0);
        assert_eq!(exp_below_zero(f32::NAN).to_bits(), 0);
        assert_eq!(exp_below_zero(f32::NEG_INFINITY).to_bits(), 0);
    }

    #[test]
    fn the_polynomial_sine_agrees_with_the_library() {
        for k in -4000..4000 {
            let a = k as f32 * 0.002;
            let (s, c) = sin_cos(a);
            assert!(
                (s - libm::sinf(a)).abs() < 2e-6 && (c - libm::cosf(a)).abs() < 2e-6,
                "{a}"
            );
        }
    }
}
