//! One sensor after the other becomes part of the suite; the first that cannot be, or cannot be beside another, ends it.

use super::device::{Device, Named, SerialDriver};
use super::feed::MavlinkFeed;
use super::{DRIVERS, SuiteError};
use crate::sensor::circle::{COLUMNS, Mount};
use crate::sensor::gps::{fake::Fake, gpsd};
use crate::sensor::hc_sr04;
use crate::sensor::ld06::{self, Ld06};
use crate::sensor::msp_module::{self, MspModule};
use crate::sensor::options::{Options, SensorSpec};
use crate::sensor::rplidar::{self, Rplidar};
use crate::sensor::tof_ring::{self, TofRing};
use core::time::Duration;
use estimator::utm::SouthernOffset;
use vehicle::sample::MAX_BEAMS;
use vehicle::{RangerConfig, RangerKind, RingConfig, RingError};

/// What a sensor is asked for where only one may answer.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
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
pub(super) struct Builder<'a> {
    pub(super) read_ring: &'a dyn Fn(&str) -> Result<RingConfig, RingError>,
    pub(super) rangers: Vec<RangerConfig>,
    pub(super) columns: Vec<(String, usize)>,
    pub(super) lines: Vec<(String, String)>,
    pub(super) roles: Vec<(Role, String)>,
    pub(super) devices: Vec<Named>,
    pub(super) mavlink: Option<MavlinkFeed>,
}

impl Builder<'_> {
    pub(super) fn sensor(&mut self, spec: &SensorSpec) -> Result<(), SuiteError> {
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

    pub(super) fn open(&mut self, spec: &SensorSpec, device: Device) {
        self.devices.push(Named {
            name: spec.to_string(),
            device,
        });
    }

    pub(super) fn take(&mut self, role: Role, spec: &SensorSpec) -> Result<(), SuiteError> {
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
    pub(super) fn add(
        &mut self,
        spec: &SensorSpec,
        rangers: Vec<RangerConfig>,
    ) -> Result<u8, SuiteError> {
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
    pub(super) fn table(
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
}
