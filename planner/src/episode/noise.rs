//! Seeded noise of the rangers: SplitMix64 (Steele, Lea, Flood 2014), Box and Muller 1958.

#[derive(Clone, Debug)]
pub(super) struct Noise {
    state: u64,
}

impl Noise {
    pub(super) const fn new(seed: u64) -> Self {
        // Neighbouring seeds must not give shifted copies of one stream.
        Self {
            state: seed.wrapping_mul(0xD134_2543_DE82_EF95),
        }
    }

    /// Uniform in 0..1.
    pub(super) fn unit(&mut self) -> f64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    pub(super) fn gauss(&mut self, sigma: f64) -> f64 {
        // 1 - unit() lies in (0, 1]: the logarithm is finite.
        let r = libm::sqrt(-2.0 * libm::log(1.0 - self.unit()));
        sigma * r * libm::cos(core::f64::consts::TAU * self.unit())
    }
}
