//! What may come by MAVLink: distances, obstacles, flow, poses of a camera.

use super::SuiteError;
use super::builder::{Builder, Role};
use crate::sensor::circle::Mount;
use crate::sensor::options::{Options, SensorSpec};
use core::time::Duration;
use vehicle::{RangerConfig, RangerKind};

/// What may come in by MAVLink.
#[derive(Clone, Debug, PartialEq)]
pub struct MavlinkFeed {
    /// Only from this system and component; none = from anyone who may speak on the links.
    pub from: Option<[u8; 2]>,
    /// Ranger of each MAV_SENSOR_ORIENTATION that DISTANCE_SENSOR is taken of.
    pub distance: Vec<(u8, u8)>,
    /// DISTANCE_SENSOR that looks down is a height.
    pub down: bool,
    /// OBSTACLE_DISTANCE: how the circle is mounted, and its first ranger.
    pub obstacle: Option<(Mount, u8)>,
    /// OPTICAL_FLOW_RAD.
    pub flow: bool,
    /// VISION_POSITION_ESTIMATE and ODOMETRY.
    pub vision: Vision,
    /// Time from measuring to the arrival of a message.
    pub latency: Duration,
}

/// What a pose from outside is relative to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Vision {
    /// Poses are not taken.
    #[default]
    Off,
    /// Our local NED.
    Local,
    /// A frame of its own.
    Own,
}

impl Builder<'_> {
    /// A feed, with everything it takes.
    pub(super) fn mavlink(
        &mut self,
        spec: &SensorSpec,
        options: &mut Options<'_>,
    ) -> Result<(), SuiteError> {
        self.take(Role::Mavlink, spec)?;
        let from = match options.pairs("from")?[..] {
            [] => None,
            [[system, component]]
                if (1.0..=255.0).contains(&system) && (0.0..=255.0).contains(&component) =>
            {
                Some([system as u8, component as u8])
            }
            _ => {
                return Err(options
                    .wrong(
                        "from",
                        options_text(spec, "from"),
                        "system/component like 1/196",
                    )
                    .into());
            }
        };
        let range_m = [
            options.number("min_m", 0.1, 0.0..=5.0)?,
            options.number("max_m", 12.0, 0.5..=60.0)?,
        ];
        let half_cone_deg = options.number("half_cone_deg", 1.5, 0.0..=60.0)?;
        let rate_hz = options.number("rate_hz", 10.0, 1.0..=100.0)?;
        let latency =
            Duration::from_secs_f64(1e-3 * options.number("latency_ms", 20.0, 0.0..=500.0)?);
        let mut distance = Vec::new();
        if let Some(text) = options.text("distance") {
            let wrong = || {
                options.wrong("distance", text, "MAV_SENSOR_ORIENTATION numbers 0 to 7 (clockwise from ahead, 45 degrees each), like 0,2,4,6")
            };
            let mut rangers = Vec::new();
            for word in text.split(',') {
                let orientation: u8 = word
                    .trim()
                    .parse()
                    .ok()
                    .filter(|o| *o < 8)
                    .ok_or_else(wrong)?;
                if distance.iter().any(|(o, _)| *o == orientation) {
                    return Err(wrong().into());
                }
                distance.push((orientation, rangers.len() as u8));
                rangers.push(RangerConfig {
                    name: format!("mavlink {orientation}"),
                    kind: RangerKind::Sonar,
                    bearing_deg: 45.0 * f64::from(orientation),
                    elevation_deg: 0.0,
                    offset_m: [0.0; 3],
                    columns: 1,
                    field_of_view_deg: 0.0,
                    half_cone_deg,
                    min_m: range_m[0],
                    max_m: range_m[1],
                    rate_hz,
                    // Each has its own time, so each is a scan of its own.
                    phase: f64::from(orientation) / 8.0,
                    source: String::new(),
                });
            }
            let first = self.add(spec, rangers)?;
            for (_, ranger) in &mut distance {
                *ranger += first;
            }
        }
        let obstacle = if options.flag("obstacle", false)? {
            let mount = Mount {
                yaw_deg: options.number("yaw_deg", 0.0, -360.0..=360.0)?,
                blind_deg: options.pairs("blind_deg")?,
                ..Mount::new("obstacle", range_m, rate_hz)
            };
            let rangers = mount.rangers();
            if rangers.is_empty() {
                return Err(SuiteError::Sensor {
                    sensor: spec.to_string(),
                    what: "blind_deg leaves nothing".to_owned(),
                });
            }
            let first = self.add(spec, rangers)?;
            Some((mount, first))
        } else {
            // Known, but without use.
            let _ = (options.text("yaw_deg"), options.text("blind_deg"));
            None
        };
        let down = options.flag("down", false)?;
        let flow = options.flag("flow", false)?;
        if down {
            self.take(Role::Down, spec)?;
        }
        if flow {
            self.take(Role::Flow, spec)?;
        }
        let vision = options.choice(
            "vision",
            Vision::Off,
            &[
                ("off", Vision::Off),
                ("local", Vision::Local),
                ("own", Vision::Own),
            ],
        )?;
        if distance.is_empty() && obstacle.is_none() && !down && !flow && vision == Vision::Off {
            return Err(SuiteError::Sensor {
                sensor: spec.to_string(),
                what:
                    "name what to take: distance=0,2,4,6 obstacle=on down=on flow=on vision=local"
                        .to_owned(),
            });
        }
        self.mavlink = Some(MavlinkFeed {
            from,
            distance,
            down,
            obstacle,
            flow,
            vision,
            latency,
        });
        Ok(())
    }
}

fn options_text<'a>(spec: &'a SensorSpec, key: &str) -> &'a str {
    spec.options
        .iter()
        .find(|(k, _)| k == key)
        .map_or("", |(_, v)| v)
}
