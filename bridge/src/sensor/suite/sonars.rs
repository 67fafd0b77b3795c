//! Ultrasonic rangers on GPIO lines: a pair of lines each, fired one after the other.

use super::SuiteError;
use super::builder::Builder;
use super::device::Device;
use crate::sensor::hc_sr04;
use crate::sensor::options::{Options, SensorSpec};
use core::time::Duration;
use vehicle::{RangerKind, RingConfig};

impl Builder<'_> {
    /// A ring of them.
    pub(super) fn sonars(
        &mut self,
        spec: &SensorSpec,
        options: &mut Options<'_>,
    ) -> Result<(), SuiteError> {
        let mut rangers = self.table(spec, options, "sonar8", RangerKind::Sonar)?;
        let pairs = options.pairs("pins")?;
        let shortest_ms = hc_sr04::SHORTEST_SLOT.as_secs_f64() * 1e3;
        let slot_ms = options.number(
            "slot_ms",
            1e3 * hc_sr04::SLOT.as_secs_f64(),
            shortest_ms..=1000.0,
        )?;
        let celsius = options.number("celsius", 20.0, -40.0..=60.0)?;
        if pairs.len() != rangers.len() {
            return Err(SuiteError::Together {
                one: format!("{spec} pins ({})", pairs.len()),
                other: format!("its rangers ({})", rangers.len()),
                rule: "each ranger of the table has one pair trigger/echo, in the same order"
                    .to_owned(),
            });
        }
        let is_line = |v: f64| (0.0..=511.0).contains(&v) && (v - v.trunc()).abs() < 1e-9;
        let mut pins: Vec<[u32; 2]> = Vec::new();
        for (pair, ranger) in pairs.iter().zip(&rangers) {
            if !pair.iter().all(|v| is_line(*v)) {
                return Err(options
                    .wrong(
                        "pins",
                        &format!("{}/{}", pair[0], pair[1]),
                        "whole line numbers from 0 to 511",
                    )
                    .into());
            }
            let pair = pair.map(|v| v as u32);
            let same = pins
                .iter()
                .position(|p| p.iter().any(|line| pair.contains(line)));
            if pair[0] == pair[1] || same.is_some() {
                return Err(SuiteError::Together {
                    one: same.map_or_else(
                        || format!("the trigger of `{}`", ranger.name),
                        |i| format!("`{}`", rangers[i].name),
                    ),
                    other: if same.is_some() {
                        format!("`{}`", ranger.name)
                    } else {
                        "its echo".to_owned()
                    },
                    rule: "a GPIO line has one use".to_owned(),
                });
            }
            pins.push(pair);
        }
        let chip = spec.place.clone();
        let config = RingConfig {
            name: spec.to_string(),
            rangers: rangers.clone(),
        };
        let slot = Duration::from_secs_f64(1e-3 * slot_ms);
        let ring = hc_sr04::Ring::new(&config, self.rangers.len() as u8, slot, celsius);
        for r in &mut rangers {
            r.rate_hz = ring.rate_hz();
        }
        self.add(spec, rangers)?;
        self.open(spec, Device::Gpio { chip, pins, ring });
        Ok(())
    }
}
