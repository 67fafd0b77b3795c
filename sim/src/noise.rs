//! Seeded randomness: one independent stream per purpose, so that adding a sensor changes no other sensor's numbers.

use rand_core::Rng;
use rand_pcg::Pcg32;

/// A stream of random numbers for one purpose of one vehicle.
#[derive(Clone, Debug)]
pub(crate) struct Noise {
    rng: Pcg32,
    /// Second value of the last Box-Muller pair.
    spare: Option<f64>,
}

impl Noise {
    /// The stream for `purpose` (any short text) of vehicle `vehicle` under `seed`.
    pub(crate) fn new(seed: u64, vehicle: usize, purpose: &str) -> Self {
        let mut key = mix(seed ^ mix(vehicle as u64 + 1));
        for byte in purpose.bytes() {
            key = mix(key ^ u64::from(byte));
        }
        Self {
            rng: Pcg32::new(mix(key), mix(key ^ 0x5555_5555_5555_5555)),
            spare: None,
        }
    }

    /// Uniform in 0..1.
    pub(crate) fn unit(&mut self) -> f64 {
        // 2^-32; never reaches 1.
        f64::from(self.rng.next_u32()) * (1.0 / 4_294_967_296.0)
    }

    /// Uniform in `low..high`.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// True with probability `p`.
    pub(crate) fn chance(&mut self, p: f64) -> bool {
        self.unit() < p
    }

    /// Gaussian with mean 0 (Box and Muller 1958).
    pub(crate) fn gauss(&mut self, sigma: f64) -> f64 {
        if let Some(z) = self.spare.take() {
            return z * sigma;
        }
        // 1 - unit() lies in (0, 1]: the logarithm is finite.
        let r = libm::sqrt(-2.0 * libm::log(1.0 - self.unit()));
        let (s, c) = libm::sincos(core::f64::consts::TAU * self.unit());
        self.spare = Some(r * s);
        r * c * sigma
    }
}

/// Slowly wandering value (Ornstein-Uhlenbeck): Gaussian with a given sigma, forgotten with a time constant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wander {
    value: f64,
    keep: f64,
    kick: f64,
}

impl Wander {
    /// Stationary from the first step: starts at a draw from its own distribution.
    pub(crate) fn new(noise: &mut Noise, sigma: f64, time_constant_s: f64, step_s: f64) -> Self {
        let keep = libm::exp(-step_s / time_constant_s);
        Self {
            value: noise.gauss(sigma),
            keep,
            kick: sigma * libm::sqrt(1.0 - keep * keep),
        }
    }

    pub(crate) fn step(&mut self, noise: &mut Noise) -> f64 {
        self.value = self.value * self.keep + noise.gauss(self.kick);
        self.value
    }

    pub(crate) const fn value(&self) -> f64 {
        self.value
    }
}

/// Finaliser of SplitMix64 (Steele, Lea, Flood 2014): neighbouring seeds give unrelated streams.
const fn mix(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussian_has_the_sigma_asked_for() {
        let mut noise = Noise::new(1, 0, "test");
        let n = 20_000;
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..n {
            let z = noise.gauss(2.0);
            sum += z;
            squares += z * z;
        }
        let mean = sum / f64::from(n);
        let sigma = (squares / f64::from(n) - mean * mean).sqrt();
        assert!(
            mean.abs() < 0.05 && (sigma - 2.0).abs() < 0.05,
            "{mean} {sigma}"
        );
    }

    #[test]
    fn streams_differ_by_seed_vehicle_and_purpose_and_repeat_otherwise() {
        let first = |seed, vehicle, purpose| Noise::new(seed, vehicle, purpose).unit();
        let reference = first(7, 0, "tof0");
        assert_eq!(reference.to_bits(), first(7, 0, "tof0").to_bits());
        for other in [
            first(8, 0, "tof0"),
            first(7, 1, "tof0"),
            first(7, 0, "tof1"),
        ] {
            assert!((other - reference).abs() > 1e-9);
        }
    }

    #[test]
    fn a_wander_keeps_its_sigma_over_time() {
        let mut noise = Noise::new(3, 0, "wander");
        let mut wander = Wander::new(&mut noise, 0.5, 1.0, 0.02);
        let n = 100_000;
        let squares: f64 = (0..n).map(|_| wander.step(&mut noise)).map(|v| v * v).sum();
        assert!(((squares / f64::from(n)).sqrt() - 0.5).abs() < 0.05);
    }
}
