//! Four lithium-polymer cells: voltage sags with charge and load, and thrust with voltage.

use super::STEP_S;

/// Cells in series.
pub(crate) const CELLS: u8 = 4;
/// Capacity, mAh.
pub(crate) const CAPACITY_MAH: f64 = 1500.0;
/// Open-circuit voltage of a cell by remaining charge.
const OPEN_CIRCUIT_V: [(f64, f64); 9] = [
    (0.0, 3.20),
    (0.03, 3.45),
    (0.1, 3.60),
    (0.2, 3.70),
    (0.4, 3.78),
    (0.6, 3.85),
    (0.8, 3.98),
    (0.9, 4.06),
    (1.0, 4.20),
];
/// Internal resistance of the pack with its leads, ohm.
const RESISTANCE_OHM: f64 = 0.035;
/// Companion computer, flight controller and sensors, A.
const ELECTRONICS_A: f64 = 0.6;
/// All motors at full speed, A: the cube law gives 6 A in hover at 57 %.
const MOTORS_A: f64 = 32.0;
/// Voltage at which full command gives full thrust: full pack, hover load, V.
const REFERENCE_V: f64 = 16.55;
/// Thrust goes with voltage to this power: 17 % lost between a full pack and one at 10 %.
const THRUST_EXPONENT: f64 = 1.2;
/// Voltage follows load with this lag, s; also the time between updates, in steps.
const LAG_S: f64 = 0.05;
const EVERY: u32 = 10;

/// State of charge, voltage and current.
#[derive(Clone, Debug)]
pub(crate) struct Battery {
    used_mah: f64,
    used_at_start_mah: f64,
    voltage_v: f64,
    current_a: f64,
    top_speed: f64,
    steps: u32,
}

impl Battery {
    /// A pack with this share of its charge left.
    pub(crate) fn new(charge: f64) -> Self {
        let mut battery = Self {
            used_mah: 0.0,
            used_at_start_mah: 0.0,
            voltage_v: 0.0,
            current_a: ELECTRONICS_A,
            top_speed: 1.0,
            steps: 0,
        };
        battery.set_charge(charge);
        battery.used_at_start_mah = battery.used_mah;
        battery
    }

    pub(crate) fn set_charge(&mut self, charge: f64) {
        self.used_mah = (1.0 - charge.clamp(0.0, 1.0)) * CAPACITY_MAH;
        self.voltage_v = self.rest_voltage_v() - self.current_a * RESISTANCE_OHM;
        self.refresh_top_speed();
    }

    pub(crate) fn step(&mut self, speed: [f64; 4]) {
        self.steps += 1;
        if !self.steps.is_multiple_of(EVERY) {
            return;
        }
        let dt_s = STEP_S * f64::from(EVERY);
        let cubes: f64 = speed.iter().map(|w| w * w * w).sum();
        self.current_a = ELECTRONICS_A + 0.25 * MOTORS_A * cubes;
        self.used_mah = (self.used_mah + self.current_a * dt_s / 3.6).min(CAPACITY_MAH);
        let settled_v = self.rest_voltage_v() - self.current_a * RESISTANCE_OHM;
        self.voltage_v += (settled_v - self.voltage_v) * (dt_s / (LAG_S + dt_s));
        self.refresh_top_speed();
    }

    fn refresh_top_speed(&mut self) {
        // Thrust is speed squared, so speed gets half the exponent.
        self.top_speed = libm::pow(self.voltage_v / REFERENCE_V, 0.5 * THRUST_EXPONENT);
    }

    fn rest_voltage_v(&self) -> f64 {
        let charge = self.remaining();
        let above = OPEN_CIRCUIT_V.iter().position(|(c, _)| *c >= charge);
        let i = above.unwrap_or(OPEN_CIRCUIT_V.len() - 1).max(1);
        let ((c0, v0), (c1, v1)) = (OPEN_CIRCUIT_V[i - 1], OPEN_CIRCUIT_V[i]);
        f64::from(CELLS) * (v0 + (v1 - v0) * (charge - c0) / (c1 - c0))
    }

    /// Motor speed that full command gives, 1 = on a full pack.
    pub(crate) const fn top_speed(&self) -> f64 {
        self.top_speed
    }

    /// Charge left, 0..=1.
    pub(crate) fn remaining(&self) -> f64 {
        1.0 - self.used_mah / CAPACITY_MAH
    }

    pub(crate) const fn voltage_v(&self) -> f64 {
        self.voltage_v
    }

    pub(crate) const fn current_a(&self) -> f64 {
        self.current_a
    }

    /// What a flight controller that counts since start-up has counted.
    pub(crate) fn counted_mah(&self) -> f64 {
        (self.used_mah - self.used_at_start_mah).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pack_loses_15_to_20_percent_of_thrust_down_to_a_tenth_of_its_charge() {
        let thrust = |charge| {
            let mut battery = Battery::new(charge);
            (0..500).for_each(|_| battery.step([0.57; 4]));
            battery.top_speed() * battery.top_speed()
        };
        let (full, low) = (thrust(1.0), thrust(0.1));
        assert!((full - 1.0).abs() < 0.02, "{full}");
        let lost = 1.0 - low / full;
        assert!((0.15..0.20).contains(&lost), "{lost}");
    }

    #[test]
    fn voltage_sags_under_load() {
        let voltage = |speed| {
            let mut battery = Battery::new(0.8);
            (0..500).for_each(|_| battery.step([speed; 4]));
            battery.voltage_v()
        };
        let sag = voltage(0.0) - voltage(1.0);
        assert!((sag - MOTORS_A * RESISTANCE_OHM).abs() < 0.02, "{sag}");
    }

    #[test]
    fn hover_empties_the_pack_in_10_to_16_minutes() {
        let mut battery = Battery::new(1.0);
        (0..60_000).for_each(|_| battery.step([0.572; 4]));
        let minutes = 1.0 / (1.0 - battery.remaining());
        assert!((10.0..16.0).contains(&minutes), "{minutes}");
        assert!((battery.counted_mah() - battery.used_mah).abs() < 1e-9);
    }
}
