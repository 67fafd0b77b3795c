//! What a command line or configuration names, checked, as drivers and one ring.
//!
//! Each sensor brings its own rangers; together they are the ring that the flight is made with. What cannot be together
//! is refused here with both names and the rule, before anything is opened.

use super::Sample;
use super::circle::{COLUMNS, Mount};
use super::gps::{fake::Fake, gpsd};
use super::hc_sr04;
use super::ld06::{self, Ld06};
use super::msp_module::{self, MspModule};
use super::options::{OptionError, Options, SensorSpec};
use super::rplidar::{self, Rplidar};
use super::tof_ring::{self, TofRing};
use core::time::Duration;
use estimator::utm::SouthernOffset;
use thiserror::Error;
use vehicle::sample::MAX_BEAMS;
use vehicle::{RangerConfig, RangerKind, RangerReading, RingConfig, RingError, Timestamp};

/// Names of the drivers.
pub const DRIVERS: [&str; 9] = [
    "ld06", "rplidar", "tof_ring", "hc_sr04", "msp", "mavlink", "gpsd", "gps_log", "gps_fake",
];

/// Why a set of sensors is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SuiteError {
    /// No such driver.
    #[error("no sensor `{name}`{}; there are {}", nearest.as_ref().map(|n| format!("; did you mean `{n}`?")).unwrap_or_default(), DRIVERS.join(", "))]
    Driver {
        /// Asked for.
        name: String,
        /// Nearest known.
        nearest: Option<String>,
    },
    /// An option is wrong.
    #[error(transparent)]
    Option(#[from] OptionError),
    /// The table of rangers is wrong.
    #[error("{sensor}: {error}")]
    Ring {
        /// Which sensor.
        sensor: String,
        /// Why.
        error: RingError,
    },
    /// A sensor misses something.
    #[error("{sensor}: {what}")]
    Sensor {
        /// Which.
        sensor: String,
        /// What is missing.
        what: String,
    },
    /// Two that cannot be together.
    #[error("{one} and {other}: {rule}")]
    Together {
        /// First.
        one: String,
        /// Second.
        other: String,
        /// Why not.
        rule: String,
    },
}

/// A driver of a serial line.
#[derive(Clone, Debug)]
pub enum SerialDriver {
    /// LD06 class.
    Ld06(Ld06),
    /// RPLIDAR class.
    Rplidar(Rplidar),
    /// Time-of-flight ring.
    TofRing(TofRing),
    /// MSP module.
    Msp(MspModule),
}

impl SerialDriver {
    /// The line was opened (again).
    pub fn opened(&mut self, now: Timestamp) {
        if let Self::Rplidar(lidar) = self {
            lidar.opened(now);
        }
    }

    /// What is to be said now, if anything; call every some 10 ms.
    pub fn poll(&mut self, now: Timestamp) -> Option<[u8; 2]> {
        match self {
            Self::Rplidar(lidar) => lidar.poll(now),
            Self::Ld06(_) | Self::TofRing(_) | Self::Msp(_) => None,
        }
    }

    /// Takes bytes that were read at a time; tells what is to be said in answer.
    pub fn bytes(
        &mut self,
        at: Timestamp,
        bytes: &[u8],
        out: &mut impl FnMut(Sample),
    ) -> Option<[u8; 2]> {
        let mut ranger = |r: RangerReading| out(Sample::Ranger(r));
        match self {
            Self::Ld06(lidar) => lidar.bytes(at, bytes, &mut ranger),
            Self::Rplidar(lidar) => return lidar.bytes(at, bytes, &mut ranger),
            Self::TofRing(ring) => ring.bytes(at, bytes, &mut ranger),
            Self::Msp(module) => module.bytes(at, bytes, out),
        }
        None
    }

    /// Its motor runs while DTR is low.
    #[must_use]
    pub const fn needs_dtr_low(&self) -> bool {
        matches!(self, Self::Rplidar(_))
    }
}

/// A device to open.
#[derive(Clone, Debug)]
pub enum Device {
    /// On a serial line.
    Serial {
        /// Device file.
        path: String,
        /// Baud.
        baud: u32,
        /// Who understands it.
        driver: SerialDriver,
    },
    /// Ultrasonic rangers on GPIO lines.
    Gpio {
        /// Chip, like `/dev/gpiochip0`.
        chip: String,
        /// Trigger and echo line of each sensor.
        pins: Vec<[u32; 2]>,
        /// Who fires when.
        ring: hc_sr04::Ring,
    },
    /// gpsd.
    Gpsd {
        /// host:port.
        address: String,
        /// Of southern northings.
        south: SouthernOffset,
    },
    /// A GPS log; the shell reads it.
    GpsLog {
        /// File.
        path: String,
    },
    /// Invented fixes.
    GpsFake(Fake),
}

/// A device with its name.
#[derive(Clone, Debug)]
pub struct Named {
    /// As it was written.
    pub name: String,
    /// What to open.
    pub device: Device,
}

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

/// Everything the vehicle senses with.
#[derive(Clone, Debug)]
pub struct Suite {
    /// All rangers.
    pub ring: RingConfig,
    /// What to open.
    pub devices: Vec<Named>,
    /// What may come by MAVLink.
    pub mavlink: Option<MavlinkFeed>,
}

/// What a sensor is asked for where only one may answer.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    Down,
    Flow,
    Gps,
    Mavlink,
}

impl Role {
    const fn rule(self) -> &'static str {
        match self {
            Self::Down => {
                "one sensor looks down at a time: heights of two would be taken for steps of the floor"
            }
            Self::Flow => "one optical flow at a time",
            Self::Gps => "one source of satellite fixes at a time",
            Self::Mavlink => "name `mavlink` once, with all its options",
        }
    }
}

/// Gathers sensors into a suite.
struct Builder<'a> {
    read_ring: &'a dyn Fn(&str) -> Result<RingConfig, RingError>,
    rangers: Vec<RangerConfig>,
    columns: Vec<(String, usize)>,
    lines: Vec<(String, String)>,
    roles: Vec<(Role, String)>,
    devices: Vec<Named>,
    mavlink: Option<MavlinkFeed>,
}

impl Suite {
    /// A suite of sensors. `read_ring` reads the tables that `rangers=` names: built-in rings and files.
    ///
    /// # Errors
    /// The first sensor that cannot be, or the first two that cannot be together.
    pub fn new(
        specs: &[SensorSpec],
        read_ring: &dyn Fn(&str) -> Result<RingConfig, RingError>,
    ) -> Result<Self, SuiteError> {
        let mut builder = Builder {
            read_ring,
            rangers: Vec::new(),
            columns: Vec::new(),
            lines: Vec::new(),
            roles: Vec::new(),
            devices: Vec::new(),
            mavlink: None,
        };
        for spec in specs {
            builder.sensor(spec)?;
        }
        let ring = RingConfig {
            name: "sensors".to_owned(),
            rangers: builder.rangers,
        };
        ring.check().map_err(|error| SuiteError::Ring {
            sensor: "all sensors".to_owned(),
            error,
        })?;
        Ok(Self {
            ring,
            devices: builder.devices,
            mavlink: builder.mavlink,
        })
    }
}

impl Builder<'_> {
    fn sensor(&mut self, spec: &SensorSpec) -> Result<(), SuiteError> {
        let mut options = Options::of(spec);
        let example = match spec.driver.as_str() {
            "ld06" | "rplidar" | "tof_ring" | "msp" => Some(("serial port", "/dev/ttyUSB0")),
            "hc_sr04" => Some(("GPIO chip", "/dev/gpiochip0")),
            _ => None,
        };
        if let Some((what, example)) = example {
            let what = format!("its {what}, like {}://{example}", spec.driver);
            let path = self.place(spec, &what)?;
            self.line(spec, &path)?;
        }
        match spec.driver.as_str() {
            "ld06" => {
                let mount = self.mount(spec, &mut options, ld06::RANGE_M, ld06::RATE_HZ)?;
                let least = options.number("least_intensity", 15.0, 0.0..=255.0)? as u8;
                let first = self.add(spec, mount.rangers())?;
                self.serial(spec, &mut options, ld06::BAUD, |baud| {
                    SerialDriver::Ld06(Ld06::new(mount, first, baud, least))
                })?;
            }
            "rplidar" => {
                let mount = self.mount(spec, &mut options, rplidar::RANGE_M, rplidar::RATE_HZ)?;
                let first = self.add(spec, mount.rangers())?;
                self.serial(spec, &mut options, rplidar::BAUD, |baud| {
                    SerialDriver::Rplidar(Rplidar::new(mount, first, baud))
                })?;
            }
            "tof_ring" => {
                let rangers = self.table(spec, &mut options, "tof32", RangerKind::Tof)?;
                let columns: Vec<u8> = rangers.iter().map(|r| r.columns).collect();
                let first = self.add(spec, rangers)?;
                self.serial(spec, &mut options, tof_ring::BAUD, |baud| {
                    SerialDriver::TofRing(TofRing::new(first, &columns, baud))
                })?;
            }
            "msp" => {
                let mount = msp_module::Mount {
                    yaw_deg: options.number("yaw_deg", 0.0, -360.0..=360.0)?,
                    counts_per_deg: options.number(
                        "counts_per_deg",
                        msp_module::COUNTS_PER_DEG,
                        0.1..=10_000.0,
                    )?,
                };
                self.take(Role::Down, spec)?;
                self.take(Role::Flow, spec)?;
                self.serial(spec, &mut options, msp_module::BAUD, |baud| {
                    SerialDriver::Msp(MspModule::new(mount, baud))
                })?;
            }
            "hc_sr04" => self.sonars(spec, &mut options)?,
            "mavlink" => self.mavlink(spec, &mut options)?,
            "gpsd" => {
                self.take(Role::Gps, spec)?;
                let south = options.choice(
                    "utm",
                    SouthernOffset::Standard,
                    &[
                        ("standard", SouthernOffset::Standard),
                        ("uquad", SouthernOffset::Uquad),
                    ],
                )?;
                let address = match spec.place.as_str() {
                    "" => format!("127.0.0.1:{}", gpsd::PORT),
                    host if !host.contains(':') => format!("{host}:{}", gpsd::PORT),
                    address => address.to_owned(),
                };
                self.open(spec, Device::Gpsd { address, south });
            }
            "gps_log" => {
                self.take(Role::Gps, spec)?;
                let path =
                    self.place(spec, "the file to replay, like gps_log:///home/me/gps.log")?;
                self.open(spec, Device::GpsLog { path });
            }
            "gps_fake" => {
                self.take(Role::Gps, spec)?;
                let is_random =
                    options.choice("values", false, &[("zeros", false), ("random", true)])?;
                let seed = options.number("seed", 1.0, 0.0..=1e15)? as u64;
                self.open(spec, Device::GpsFake(Fake::new(is_random, seed)));
            }
            name => {
                return Err(SuiteError::Driver {
                    name: name.to_owned(),
                    nearest: crate::settings::nearest(name, DRIVERS.into_iter()).map(str::to_owned),
                });
            }
        }
        options.finish()?;
        Ok(())
    }

    fn place(&self, spec: &SensorSpec, what: &str) -> Result<String, SuiteError> {
        if spec.place.is_empty() {
            return Err(SuiteError::Sensor {
                sensor: spec.to_string(),
                what: format!("name {what}"),
            });
        }
        Ok(spec.place.clone())
    }

    fn open(&mut self, spec: &SensorSpec, device: Device) {
        self.devices.push(Named {
            name: spec.to_string(),
            device,
        });
    }

    fn take(&mut self, role: Role, spec: &SensorSpec) -> Result<(), SuiteError> {
        if let Some((_, one)) = self.roles.iter().find(|(r, _)| *r == role) {
            return Err(SuiteError::Together {
                one: one.clone(),
                other: spec.to_string(),
                rule: role.rule().to_owned(),
            });
        }
        self.roles.push((role, spec.to_string()));
        Ok(())
    }

    /// A file that two sensors cannot both have.
    fn line(&mut self, spec: &SensorSpec, path: &str) -> Result<(), SuiteError> {
        if let Some((_, one)) = self.lines.iter().find(|(p, _)| p == path) {
            return Err(SuiteError::Together {
                one: one.clone(),
                other: spec.to_string(),
                rule: format!("{path} has one reader: two would each get a part of the bytes"),
            });
        }
        self.lines.push((path.to_owned(), spec.to_string()));
        Ok(())
    }

    /// Adds rangers to the ring; returns the index of the first.
    fn add(&mut self, spec: &SensorSpec, rangers: Vec<RangerConfig>) -> Result<u8, SuiteError> {
        let columns: usize = rangers
            .iter()
            .filter(|r| !r.looks_down())
            .map(|r| usize::from(r.columns))
            .sum();
        let name = spec.to_string();
        if rangers.iter().any(RangerConfig::looks_down) {
            self.take(Role::Down, spec)?;
        }
        let all: usize = self.columns.iter().map(|(_, c)| c).sum();
        if let Some((one, before)) = self.columns.iter().max_by_key(|(_, c)| *c)
            && all + columns > MAX_BEAMS
        {
            return Err(SuiteError::Together {
                one: format!("{one} ({before} columns)"),
                other: format!("{name} ({columns} columns)"),
                rule: format!(
                    "a scan has {MAX_BEAMS} beams: leave some out (blind_deg, or a smaller table)"
                ),
            });
        }
        let first = self.rangers.len() as u8;
        self.rangers
            .extend(rangers.into_iter().map(|r| RangerConfig {
                source: name.clone(),
                ..r
            }));
        self.columns.push((name, columns));
        Ok(first)
    }

    fn serial(
        &mut self,
        spec: &SensorSpec,
        options: &mut Options<'_>,
        default_baud: u32,
        driver: impl FnOnce(u32) -> SerialDriver,
    ) -> Result<(), SuiteError> {
        let path = spec.place.clone();
        let baud =
            options.number("baudrate", f64::from(default_baud), 1200.0..=4_000_000.0)? as u32;
        self.open(
            spec,
            Device::Serial {
                path,
                baud,
                driver: driver(baud),
            },
        );
        Ok(())
    }

    fn mount(
        &self,
        spec: &SensorSpec,
        options: &mut Options<'_>,
        range_m: [f64; 2],
        rate_hz: f64,
    ) -> Result<Mount, SuiteError> {
        let mount = Mount {
            name: spec.driver.clone(),
            offset_m: [
                options.number("x_m", 0.0, -2.0..=2.0)?,
                options.number("y_m", 0.0, -2.0..=2.0)?,
                options.number("z_m", 0.0, -2.0..=2.0)?,
            ],
            yaw_deg: options.number("yaw_deg", 0.0, -360.0..=360.0)?,
            is_upside_down: options.flag("upside_down", false)?,
            range_m: [
                options.number("min_m", range_m[0], 0.0..=5.0)?,
                options.number("max_m", range_m[1], 0.5..=60.0)?,
            ],
            rate_hz: options.number("rate_hz", rate_hz, 1.0..=50.0)?,
            blind_deg: options.pairs("blind_deg")?,
            latency: Duration::from_secs_f64(
                1e-3 * options.number("latency_ms", 0.0, 0.0..=200.0)?,
            ),
        };
        if mount.rangers().is_empty() {
            return Err(SuiteError::Sensor {
                sensor: spec.to_string(),
                what: format!("blind_deg leaves none of its {COLUMNS} columns"),
            });
        }
        Ok(mount)
    }

    /// The rangers of a table, all of one kind.
    fn table(
        &self,
        spec: &SensorSpec,
        options: &mut Options<'_>,
        default: &str,
        kind: RangerKind,
    ) -> Result<Vec<RangerConfig>, SuiteError> {
        let name = options.text("rangers").unwrap_or(default);
        let ring = (self.read_ring)(name).map_err(|error| SuiteError::Ring {
            sensor: spec.to_string(),
            error,
        })?;
        if let Some(other) = ring.rangers.iter().find(|r| r.kind != kind) {
            return Err(SuiteError::Together {
                one: spec.to_string(),
                other: format!("ranger `{}` of `{name}`", other.name),
                rule: format!("this driver reads rangers of kind {kind:?} only").to_lowercase(),
            });
        }
        if ring.rangers.len() > hc_sr04::MAX_SENSORS {
            return Err(SuiteError::Sensor {
                sensor: spec.to_string(),
                what: format!(
                    "{} rangers, at most {}",
                    ring.rangers.len(),
                    hc_sr04::MAX_SENSORS
                ),
            });
        }
        Ok(ring.rangers)
    }

    fn sonars(&mut self, spec: &SensorSpec, options: &mut Options<'_>) -> Result<(), SuiteError> {
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

    fn mavlink(&mut self, spec: &SensorSpec, options: &mut Options<'_>) -> Result<(), SuiteError> {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn suite(urls: &[&str]) -> Result<Suite, String> {
        let specs: Vec<SensorSpec> = urls.iter().map(|u| u.parse().unwrap()).collect();
        Suite::new(&specs, &RingConfig::built_in).map_err(|e| e.to_string())
    }

    const PINS8: &str = "pins=1/2,3/4,5/6,7/8,9/10,11/12,13/14,15/16";

    #[test]
    fn each_driver_by_its_name() {
        let s = suite(&[
            "ld06:///dev/a?yaw_deg=180&z_m=-0.05",
            "msp:///dev/b",
            "gpsd:",
        ])
        .unwrap();
        assert_eq!((s.ring.rangers.len(), s.devices.len()), (10, 3));
        assert!(
            matches!(&s.devices[2].device, Device::Gpsd { address, .. } if address == "127.0.0.1:2947")
        );
        let s = suite(&[
            "tof_ring:///dev/a",
            &format!("hc_sr04:///dev/gpiochip0?{PINS8}"),
        ])
        .unwrap();
        assert_eq!(s.ring.rangers.len(), 12);
        assert!((s.ring.rangers[4].rate_hz - 4.03).abs() < 0.05);
        let s =
            suite(&["mavlink:?distance=0,2,4,6&down=on&flow=on&vision=own&from=1/196"]).unwrap();
        let feed = s.mavlink.unwrap();
        assert_eq!(feed.distance, [(0, 0), (2, 1), (4, 2), (6, 3)]);
        assert_eq!((feed.from, feed.vision), (Some([1, 196]), Vision::Own));
        assert_eq!(suite(&[]).unwrap().ring.rangers.len(), 0);
    }

    #[test]
    fn what_cannot_be_together_is_refused_with_both_names_and_the_rule() {
        for (urls, names, rule) in [
            (
                vec!["ld06:///dev/a", "rplidar:///dev/a"],
                ["ld06:///dev/a", "rplidar:///dev/a"],
                "one reader",
            ),
            (
                vec!["ld06:///dev/a", "tof_ring:///dev/b"],
                [
                    "ld06:///dev/a (60 columns)",
                    "tof_ring:///dev/b (32 columns)",
                ],
                "64 beams",
            ),
            (
                vec!["gpsd:", "gps_fake:"],
                ["gpsd", "gps_fake"],
                "one source of satellite fixes",
            ),
            (
                vec!["msp:///dev/a", "mavlink:?down=on"],
                ["msp:///dev/a", "mavlink"],
                "one sensor looks down",
            ),
            (
                vec!["msp:///dev/a", "mavlink:?flow=on"],
                ["msp:///dev/a", "mavlink"],
                "one optical flow",
            ),
            (
                vec!["mavlink:?flow=on", "mavlink:?down=on"],
                ["mavlink", "mavlink"],
                "once",
            ),
            (
                vec!["tof_ring:///dev/a?rangers=sonar8"],
                ["tof_ring", "ranger `0deg` of `sonar8`"],
                "kind tof",
            ),
            (
                vec!["hc_sr04:///dev/gpiochip0?pins=1/2"],
                ["pins (1)", "rangers (8)"],
                "one pair",
            ),
            (
                vec!["hc_sr04:///dev/gpiochip0?pins=1/2,3/4,5/6,7/8,9/10,11/12,13/14,15/2"],
                ["`0deg`", "`315deg`"],
                "one use",
            ),
        ] {
            let said = suite(&urls).unwrap_err();
            assert!(
                names.iter().all(|n| said.contains(n)) && said.contains(rule),
                "{said}"
            );
        }
    }

    #[test]
    fn what_cannot_be_at_all_is_refused_by_name() {
        let said = |url: &str| suite(&[url]).unwrap_err();
        assert!(said("ldo6:///dev/a").contains("there are ld06, rplidar"));
        assert!(said("ld06:").contains("name its serial port"));
        assert!(said("ld06:///dev/a?blind_deg=-180/179").contains("leaves none"));
        assert!(said("ld06:///dev/a?yaw=9").contains("no option `yaw`"));
        assert!(said("ld06:///dev/a?baudrate=0").contains("from 1200 to"));
        assert!(said("mavlink:").contains("name what to take"));
        assert!(said("mavlink:?distance=9").contains("0 to 7"));
        assert!(said("gps_fake:?values=lots").contains("zeros or random"));
        assert!(said("tof_ring:///dev/a?rangers=tof64").contains("tof32, sonar8"));
        assert!(
            said(&format!("hc_sr04:///dev/gpiochip0?{PINS8}&slot_ms=20")).contains("from 40 to")
        );
    }
}
