//! Whole flights on drivers: simulated devices make bytes and edges, the drivers of `kestrel fly` make them samples, the brain flies
//! on those alone. Virtual time; nothing of the simulator's own ring reaches the vehicle.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test fails where it stands and prints its figures"
)]

use bridge::autopilot::door::{Asked, Request, RequestId, Station};
use bridge::autopilot::flight::{Flight, FlightConfig, Start};
use bridge::autopilot::io::{FcBytes, Input, Output};
use bridge::autopilot::mode::{Because, Mode};
use bridge::sensor::options::SensorSpec;
use bridge::sensor::suite::{Device, Suite};
use bridge::sensor::{Sample, hc_sr04};
use bridge::settings::Settings;
use sim::device::{hc_sr04 as echo, msp_module, tof_ring};
use sim::{Fault, LaserConfig, LaserMount, Room, SimConfig, SimOutput, Simulator, VehicleConfig};
use std::sync::Arc;
use std::time::Duration;
use vehicle::{Airframe, RingConfig, Timestamp};

/// A vehicle whose senses are drivers.
struct Craft {
    sim: Simulator,
    flight: Flight,
    now: Timestamp,
    devices: Vec<Device>,
    /// Edges of echo lines on their way: time, sensor, rising.
    edges: Vec<(Timestamp, u8, bool)>,
    flow_at: Option<Timestamp>,
    counts: [u8; 16],
    samples: usize,
    scans: usize,
    modes: Vec<(Mode, Because)>,
    /// From here on the ring says the same for ever.
    frozen: Option<Vec<u8>>,
}

impl Craft {
    fn new(sensors: &[&str], ring: Option<&str>, lasers: Vec<LaserConfig>) -> Self {
        let specs: Vec<SensorSpec> = sensors.iter().map(|s| s.parse().unwrap()).collect();
        let suite = Suite::new(&specs, &RingConfig::built_in).unwrap();
        let room = Room::named("office").unwrap();
        let sim_ring = ring.map_or_else(
            || RingConfig {
                name: "none".to_owned(),
                rangers: Vec::new(),
            },
            |name| RingConfig::built_in(name).unwrap(),
        );
        let devices: Vec<Device> = suite.devices.into_iter().map(|d| d.device).collect();
        let vehicle = VehicleConfig {
            lasers,
            ring_waits: devices.iter().any(|d| matches!(d, Device::Gpio { .. })),
            ..VehicleConfig::new(room.home(), sim_ring)
        };
        let plan = Arc::clone(room.floor_plan());
        let home = room.home();
        let sim = Simulator::new(SimConfig {
            vehicles: vec![vehicle],
            ..SimConfig::new(room, RingConfig::built_in("tof32").unwrap(), 7)
        })
        .unwrap();
        let flight = Flight::new(
            Timestamp::ZERO,
            FlightConfig {
                plan,
                ring: suite.ring,
                airframe: Airframe::default(),
                start: Start::Known(home),
                settings: Settings::default(),
                seed: 7,
            },
        );
        let mut craft = Self {
            sim,
            flight,
            now: Timestamp::ZERO,
            devices,
            edges: Vec::new(),
            flow_at: None,
            counts: [0; 16],
            samples: 0,
            scans: 0,
            modes: Vec::new(),
            frozen: None,
        };
        craft.input(Input::FcOpened);
        craft
    }

    fn input(&mut self, input: Input) {
        self.flight.handle(self.now, input);
        while let Some(output) = self.flight.poll() {
            match output {
                Output::Fc(bytes) => self.sim.write_fc(0, &bytes),
                Output::Event(bridge::autopilot::door::Event::Mode(state)) => {
                    self.modes.push((state.mode, state.because));
                }
                Output::Event(_) | Output::Answer(_) | Output::Job(_) => {}
            }
        }
    }

    /// Bytes of a device's line to its driver, what that says back to the device, and its samples to the brain.
    fn line(&mut self, device: usize, bytes: &[u8]) {
        let mut samples = Vec::new();
        let Device::Serial { driver, .. } = &mut self.devices[device] else {
            return;
        };
        let mut said: Vec<[u8; 2]> = driver.poll(self.now).into_iter().collect();
        said.extend(driver.bytes(self.now, bytes, &mut |s| samples.push(s)));
        for word in said {
            self.sim.write_laser(0, 0, &word);
        }
        self.give(samples);
    }

    fn give(&mut self, samples: Vec<Sample>) {
        for sample in samples {
            self.samples += 1;
            self.scans += usize::from(matches!(sample, Sample::Ranger(_)));
            self.input(sample.into());
        }
    }

    /// Fires sonars whose turn it is, and hands over edges whose time has come.
    fn gpio(&mut self) {
        let mut readings = Vec::new();
        let now = self.now;
        for device in &mut self.devices {
            let Device::Gpio { ring, .. } = device else {
                continue;
            };
            let firing: Vec<u8> = ring
                .poll(now, &mut |r| readings.push(r))
                .map(<[u8]>::to_vec)
                .unwrap_or_default();
            for sensor in firing {
                ring.fired(sensor, now);
                if let Some(reading) = self.sim.trigger(0, sensor) {
                    let [rise, fall] = echo::edges(now, &reading);
                    self.edges.push((rise, sensor, true));
                    self.edges.push((fall, sensor, false));
                }
            }
            self.edges.sort();
            let due = self.edges.partition_point(|(at, ..)| *at <= now);
            for (at, sensor, is_rising) in self.edges.drain(..due) {
                ring.edge(at, sensor, is_rising, &mut |r| readings.push(r));
            }
        }
        self.give(readings.into_iter().map(Sample::Ranger).collect());
    }

    /// The number of the device whose driver reads this line.
    fn reader(&self, is_it: fn(&bridge::sensor::suite::SerialDriver) -> bool) -> Option<usize> {
        self.devices
            .iter()
            .position(|d| matches!(d, Device::Serial { driver, .. } if is_it(driver)))
    }

    fn step(&mut self) {
        use bridge::sensor::suite::SerialDriver as D;
        self.now += sim::STEP;
        let mut outputs = Vec::new();
        self.sim.advance(self.now, &mut |_, o| outputs.push(o));
        let lidar = self.reader(|d| matches!(d, D::Ld06(_) | D::Rplidar(_)));
        let tof = self.reader(|d| matches!(d, D::TofRing(_)));
        let module = self.reader(|d| matches!(d, D::Msp(_)));
        if let Some(lidar) = lidar {
            // Drivers are asked every so often whether they have something to say.
            self.line(lidar, &[]);
        }
        for output in outputs {
            let mut bytes = Vec::new();
            match output {
                SimOutput::FcBytes { bytes, .. } => {
                    for chunk in bytes.chunks(FcBytes::new_const().capacity()) {
                        self.input(Input::Fc(chunk.iter().copied().collect()));
                    }
                }
                SimOutput::Laser { bytes, .. } => self.line(lidar.unwrap(), &bytes),
                SimOutput::Ranger(reading) => {
                    let count = &mut self.counts[usize::from(reading.ranger)];
                    *count = count.wrapping_add(1);
                    let age_us = self.now.since(reading.at).as_micros() as u64;
                    let (sensor, count) = (reading.ranger, *count);
                    tof_ring::frame(&reading, sensor, count, age_us, &mut bytes);
                    if let Some(tof) = tof {
                        match self.frozen.clone() {
                            // The bytes of one measurement, again and again, the count too.
                            Some(same) => self.line(tof, &same),
                            None => self.line(tof, &bytes),
                        }
                    }
                }
                SimOutput::DownRange(range) => {
                    msp_module::range(&range, &mut bytes);
                    if let Some(module) = module {
                        self.line(module, &bytes);
                    }
                }
                SimOutput::Flow(flow) => {
                    if let Some(before) = self.flow_at.replace(flow.at) {
                        msp_module::flow(&flow, flow.at.seconds_since(before), &mut bytes);
                        if let Some(module) = module {
                            self.line(module, &bytes);
                        }
                    }
                }
            }
        }
        self.gpio();
        if self.flight.deadline() <= self.now {
            self.input(Input::Wake);
        }
    }

    fn run_s(&mut self, seconds: f64) {
        let until = self.now + Duration::from_secs_f64(seconds);
        while self.now < until {
            self.step();
        }
    }

    fn ask(&mut self, request: Request) {
        self.input(Input::Asked(Asked {
            id: RequestId(1),
            station: Station {
                system: 255,
                component: 190,
            },
            request,
        }));
    }

    /// Takes off and holds; mean and largest distance of estimate and truth, and how far it strayed from home, m.
    fn hold(&mut self, seconds: f64) -> [f64; 3] {
        self.run_s(12.0);
        assert_eq!(
            self.flight.snapshot().arm_blocked_by,
            None,
            "{} samples",
            self.samples
        );
        let home = self.sim.truth(0).position;
        self.ask(Request::Arm { force: false });
        self.run_s(1.0);
        self.ask(Request::Takeoff {
            height_m: Some(1.0),
        });
        self.run_s(6.0);
        let (mut sum, mut most, mut strayed, mut n) = (0.0, 0.0f64, 0.0f64, 0.0);
        let until = self.now + Duration::from_secs_f64(seconds);
        while self.now < until {
            self.step();
            let truth = self.sim.truth(0);
            let error = (self.flight.estimator().state().position - truth.position).norm();
            assert!(
                truth.contacts == 0 && truth.position.z() < -0.5,
                "{truth:?}"
            );
            sum += error;
            most = most.max(error);
            strayed = strayed.max((truth.position - home).norm_xy());
            n += 1.0;
        }
        [sum / n, most, strayed]
    }
}

const MOUNT: LaserMount = LaserMount {
    offset_m: [0.0, 0.0, -0.05],
    yaw_deg: -120.0,
    is_upside_down: true,
};

#[test]
fn packets_of_a_lidar_upside_down_and_turned_fly() {
    let mut craft = Craft::new(
        &[
            "ld06:///dev/lidar?yaw_deg=-120&upside_down=on&z_m=-0.05",
            "msp:///dev/flow",
        ],
        None,
        vec![LaserConfig::Ld06(MOUNT)],
    );
    let [mean, most, strayed] = craft.hold(20.0);
    println!("ld06: estimate off by {mean:.3} m mean, {most:.3} m at most; strayed {strayed:.3} m");
    assert!(
        mean < 0.05 && most < 0.15 && strayed < 0.3,
        "{mean} {most} {strayed}"
    );
}

#[test]
fn a_lidar_that_must_be_asked_flies() {
    let mount = LaserMount::default();
    let mut craft = Craft::new(
        &["rplidar:///dev/lidar", "msp:///dev/flow"],
        None,
        vec![LaserConfig::Rplidar(mount)],
    );
    let [mean, most, strayed] = craft.hold(20.0);
    println!(
        "rplidar: estimate off by {mean:.3} m mean, {most:.3} m at most; strayed {strayed:.3} m"
    );
    assert!(
        mean < 0.05 && most < 0.15 && strayed < 0.3,
        "{mean} {most} {strayed}"
    );
}

#[test]
fn frames_of_a_ring_of_depth_sensors_fly() {
    let mut craft = Craft::new(
        &["tof_ring:///dev/tof", "msp:///dev/flow"],
        Some("tof32"),
        Vec::new(),
    );
    let [mean, most, strayed] = craft.hold(20.0);
    println!(
        "tof_ring: estimate off by {mean:.3} m mean, {most:.3} m at most; strayed {strayed:.3} m"
    );
    assert!(
        mean < 0.05 && most < 0.15 && strayed < 0.3,
        "{mean} {most} {strayed}"
    );
}

#[test]
fn echoes_of_eight_sonars_fired_in_turn_fly() {
    let pins = "pins=1/2,3/4,5/6,7/8,9/10,11/12,13/14,15/16";
    let mut craft = Craft::new(
        &[
            &format!("hc_sr04:///dev/gpiochip0?{pins}"),
            "msp:///dev/flow",
        ],
        Some("sonar8"),
        Vec::new(),
    );
    let [mean, most, strayed] = craft.hold(20.0);
    let Device::Gpio { ring, .. } = &craft.devices[0] else {
        unreachable!()
    };
    let counters: hc_sr04::Counters = ring.counters();
    println!(
        "hc_sr04: estimate off by {mean:.3} m mean, {most:.3} m at most; strayed {strayed:.3} m; {counters:?}"
    );
    assert!(
        mean < 0.10 && most < 0.35 && strayed < 0.5,
        "{mean} {most} {strayed}"
    );
    assert_eq!((counters.dead, counters.stray), (0, 0));
    assert!((3.8..4.3).contains(&ring.rate_hz()));
}

/// Seconds until the failsafe of silent rangers acts after something, in hover.
fn lands_after(craft: &mut Craft, happen: impl FnOnce(&mut Craft)) -> f64 {
    craft.hold(2.0);
    craft.modes.clear();
    let began = craft.now;
    happen(craft);
    let mut acted = None;
    while craft.now.since(began) < Duration::from_secs(40) && craft.flight.snapshot().is_armed {
        craft.step();
        if acted.is_none()
            && craft
                .modes
                .iter()
                .any(|(_, b)| *b == Because::RangersSilent)
        {
            acted = Some(craft.now.seconds_since(began));
        }
    }
    // The controller hears of it with the next frames.
    craft.run_s(0.5);
    let truth = craft.sim.truth(0);
    assert!(
        truth.on_floor && !truth.armed && truth.contacts == 0,
        "{truth:?}"
    );
    acted.unwrap_or_else(|| panic!("never acted: {:?}", craft.modes))
}

#[test]
fn a_lidar_that_falls_silent_and_a_ring_that_freezes_land_the_vehicle_by_the_same_failsafe() {
    let sensors = ["ld06:///dev/lidar", "msp:///dev/flow"];
    let lasers = vec![LaserConfig::Ld06(LaserMount::default())];
    let mut silent = Craft::new(&sensors, None, lasers);
    let silent_s = lands_after(&mut silent, |c| {
        c.sim.set_fault(0, Fault::LaserSilent(0), true)
    });
    let mut stuck = Craft::new(
        &["tof_ring:///dev/tof", "msp:///dev/flow"],
        Some("tof32"),
        Vec::new(),
    );
    let stuck_s = lands_after(&mut stuck, |c| {
        let mut same = Vec::new();
        let reading = vehicle::RangerReading {
            at: c.now,
            ranger: 0,
            columns_mm: [Some(1000); 8].into_iter().collect(),
        };
        tof_ring::frame(&reading, 0, 9, 0, &mut same);
        c.frozen = Some(same);
    });
    println!(
        "rangers silent acted {silent_s:.2} s after the lidar fell silent, {stuck_s:.2} s after the ring froze"
    );
    assert!(silent_s < 3.0 && stuck_s < 3.5, "{silent_s} {stuck_s}");
}
