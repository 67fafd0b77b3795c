//! The simulator: steps of one millisecond of virtual time, outputs in order of delivery.

use crate::camera::{LENS_AHEAD_M, MOVERS, Mover, Scenery, Shot};
use crate::config::{SimConfig, SimError, check};
use crate::craft::{Craft, Shared};
use crate::fc::Radio;
use crate::fc::uart::BURST;
use crate::firmware::Felt;
use crate::imu_board::Environment;
use crate::room::{Room, RoomFacts};
use crate::sensor::MagneticField;
use crate::world::World;
use arrayvec::ArrayVec;
use core::time::Duration;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vehicle::{
    DownRange, FloorPlan, FlowSample, Frd, In, MapAnchor, MapPose, Ned, RangerReading, Rot,
    Segment, Timestamp,
};

/// Step of the simulation.
pub const STEP: Duration = Duration::from_millis(1);
/// Something a vehicle delivers to its companion computer. `at` is when it was measured (complete, for bytes); it is handed over
/// later by the latency of the sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum SimOutput {
    /// From the down-looking ranger.
    DownRange(DownRange),
    /// From the flight controller's UART.
    FcBytes {
        /// When the last byte was complete.
        at: Timestamp,
        /// The bytes.
        bytes: ArrayVec<u8, BURST>,
    },
    /// From the optical flow sensor.
    Flow(FlowSample),
    /// From one ranger of the ring.
    Ranger(RangerReading),
    /// From the line of a lidar of its own.
    Laser {
        /// Which.
        laser: u8,
        /// The bytes.
        bytes: ArrayVec<u8, BURST>,
    },
}

/// Something that can be broken and mended in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fault {
    /// The UART of the flight controller is unplugged: no byte passes either way.
    FcSilent,
    /// The optical flow sensor is silent.
    FlowSilent,
    /// The down-looking ranger is silent.
    DownSilent,
    /// One ranger of the ring is silent.
    RangerSilent(u8),
    /// One ranger of the ring goes on saying what it said last.
    RangerStuck(u8),
    /// One motor, 0 to 3, gives no thrust.
    MotorDead(u8),
    /// Noise on the UART: of each 0.12 s of the flight controller's bytes only 15 ms arrive.
    FcNoisy,
    /// A worn connector: of each 40 ms of the flight controller's bytes 20 ms arrive.
    FcLossy,
    /// The flight controller is busy with something else: it carries out 40 messages a second.
    FcBusy,
    /// The flight controller tells a roll that is 15 degrees off (it flies by the true one).
    AttitudeAskew,
    /// The line of a lidar of its own is silent.
    LaserSilent(u8),
}

impl Fault {
    pub(crate) fn swallows(self, output: &SimOutput) -> bool {
        match (self, output) {
            (Self::FlowSilent, SimOutput::Flow(_))
            | (Self::DownSilent, SimOutput::DownRange(_)) => true,
            (Self::RangerSilent(i), SimOutput::Ranger(reading)) => reading.ranger == i,
            _ => false,
        }
    }
}

/// How a vehicle really is. No sensor, no noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// When.
    pub at: Timestamp,
    /// Body centre, m about the plan's home; on the floor z is minus the landed height.
    pub position: In<Ned>,
    /// m/s.
    pub velocity: In<Ned>,
    /// Attitude.
    pub attitude: Rot<Frd, Ned>,
    /// Angular rate, rad/s.
    pub rates_radps: In<Frd>,
    /// Touching a wall, a person, another vehicle or the ceiling now, or within the last 0.3 s.
    pub in_contact: bool,
    /// How many times it has touched; meeting the floor faster than 1 m/s counts too.
    pub contacts: u32,
    /// Standing on the floor.
    pub on_floor: bool,
    /// Motors under way by the flight controller's arming.
    pub armed: bool,
    /// Battery voltage, V.
    pub voltage_v: f64,
    /// Charge left, 0..=1.
    pub charge: f64,
}

/// A room with vehicles and people in it, on virtual time.
///
/// ```
/// use sim::{Room, SimConfig, SimOutput, Simulator};
/// use vehicle::{RingConfig, Timestamp};
///
/// let ring = RingConfig::built_in("tof32")?;
/// let mut sim = Simulator::new(SimConfig::new(Room::named("office")?, ring, 1))?;
/// let mut scans = 0;
/// sim.advance(Timestamp::from_ms(1000), &mut |_vehicle, output| {
///     scans += usize::from(matches!(output, SimOutput::Ranger(_)));
/// });
/// assert_eq!(scans, 4 * 15); // four sensors, 15 Hz; delivered 30 ms after they fire
/// assert!(!sim.truth(0).armed);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Simulator {
    now: Timestamp,
    world: World,
    crafts: Vec<Craft>,
    room: Room,
    anchor: MapAnchor,
}

impl Simulator {
    /// Everything in place at time zero.
    ///
    /// # Errors
    /// [`SimError`] says what is wrong with which vehicle or person.
    pub fn new(config: SimConfig) -> Result<Self, SimError> {
        check(&config)?;
        let anchor = config.room.anchor();
        let field = MagneticField::new(config.room.segments(), &anchor, config.seed);
        let crafts: Vec<Craft> = config
            .vehicles
            .iter()
            .enumerate()
            .map(|(i, vehicle)| {
                let airframe = config.airframe;
                Craft::new(
                    vehicle,
                    airframe,
                    config.turbulence_n,
                    config.seed,
                    i,
                    &anchor,
                    &field,
                )
            })
            .collect();
        let world = World::new(
            config.room.walls().clone(),
            config.room.opaque().cloned(),
            config.people,
            crafts.len(),
        );
        let mut sim = Self {
            now: Timestamp::ZERO,
            world,
            crafts,
            room: config.room,
            anchor,
        };
        sim.place_vehicles();
        Ok(sim)
    }

    /// Runs to `until` in steps of 1 ms (a remainder below 1 ms stays for the next call) and hands over what vehicles deliver
    /// meanwhile, in order of delivery. Advance by single steps where the time of delivery matters.
    pub fn advance(&mut self, until: Timestamp, out: &mut impl FnMut(usize, SimOutput)) {
        while self.now + STEP <= until {
            self.step(out);
        }
    }

    fn step(&mut self, out: &mut impl FnMut(usize, SimOutput)) {
        self.now += STEP;
        self.world.move_people(self.now);
        for (index, craft) in self.crafts.iter_mut().enumerate() {
            let shared = Shared {
                world: &self.world,
                anchor: &self.anchor,
                index,
            };
            craft.fly(self.now, &shared);
        }
        self.place_vehicles();
        for (index, craft) in self.crafts.iter_mut().enumerate() {
            let shared = Shared {
                world: &self.world,
                anchor: &self.anchor,
                index,
            };
            craft.sense(self.now, &shared, out);
        }
    }

    fn place_vehicles(&mut self) {
        for (index, craft) in self.crafts.iter().enumerate() {
            let at = self.anchor.to_map(craft.quad.position());
            let radius_m = craft.quad.airframe().radius_m;
            self.world.move_vehicle(index, at, radius_m);
        }
    }

    /// The companion computer of a vehicle writes to its flight controller's UART, now.
    ///
    /// # Panics
    /// If there is no such vehicle; so do all methods that take one.
    pub fn write_fc(&mut self, vehicle: usize, bytes: &[u8]) {
        self.crafts[vehicle].write_fc(self.now, bytes);
    }

    /// Triggers a ranger of the ring, now: what it measures; none if it is silent or there is no such.
    ///
    /// # Panics
    /// If there is no such vehicle.
    pub fn trigger(&mut self, vehicle: usize, ranger: u8) -> Option<RangerReading> {
        let shared = Shared {
            world: &self.world,
            anchor: &self.anchor,
            index: vehicle,
        };
        self.crafts[vehicle].trigger(self.now, ranger, &shared)
    }

    /// The companion computer writes to the line of a lidar, now.
    ///
    /// # Panics
    /// If there is no such vehicle.
    pub fn write_laser(&mut self, vehicle: usize, laser: usize, bytes: &[u8]) {
        self.crafts[vehicle].write_laser(self.now, laser, bytes);
    }

    /// What the sensors of a flight controller outside feel now; none for the fake one, which has its own.
    ///
    /// # Panics
    /// If there is no such vehicle.
    #[must_use]
    pub fn felt(&self, vehicle: usize) -> Option<Felt> {
        self.crafts[vehicle].fc.felt().copied()
    }

    /// Commands of motors 1 to 4 from a flight controller outside, 0..=1; they hold until the next. The fake one takes none.
    ///
    /// # Panics
    /// If there is no such vehicle.
    pub fn command_motors(&mut self, vehicle: usize, commands: [f64; 4]) {
        self.crafts[vehicle].fc.command(commands);
    }

    /// Speeds that the motors of a vehicle without flight controller are told to turn at, rad/s: front, left, rear, right.
    ///
    /// # Panics
    /// If there is no such vehicle.
    pub fn turn_motors(&mut self, vehicle: usize, speeds_radps: [f64; 4]) {
        if let Some((_, speeds)) = &mut self.crafts[vehicle].motors {
            *speeds = speeds_radps;
        }
    }

    /// What the chips of an inertial unit on a vehicle without flight controller feel; none with one.
    ///
    /// # Panics
    /// If there is no such vehicle.
    #[must_use]
    pub fn environment(&self, vehicle: usize) -> Option<Environment> {
        let (body, _) = self.crafts[vehicle].motors.as_ref()?;
        Some(body.environment())
    }

    /// Breaks or mends something.
    ///
    /// # Panics
    /// If there is no such vehicle.
    pub fn set_fault(&mut self, vehicle: usize, fault: Fault, active: bool) {
        self.crafts[vehicle].set_fault(fault, active);
    }

    /// Something stands in the room from now on that was not there before (segments on the plan, m).
    pub fn raise(&mut self, obstacles: &[Segment]) {
        self.world.raise(obstacles);
        for craft in &mut self.crafts {
            craft.contact.look_again();
        }
    }

    /// Carries a vehicle elsewhere (the kidnapped robot): same height, at rest, without any sensor noticing the way.
    ///
    /// # Panics
    /// If there is no such vehicle.
    pub fn carry_to(&mut self, vehicle: usize, pose: MapPose) {
        self.crafts[vehicle].carry_to(pose, &self.anchor);
        self.place_vehicles();
    }

    /// What the pilot's transmitter sends to a vehicle from now on; none = switched off or out of reach.
    ///
    /// # Panics
    /// If there is no such vehicle.
    pub fn set_radio(&mut self, vehicle: usize, radio: Option<Radio>) {
        self.crafts[vehicle].fc.set_radio(radio);
    }

    /// Roll, pitch (nose **down**), yaw, throttle as they reach the flight controller's loops, us: whoever sent them. For
    /// judging who flies.
    ///
    /// # Panics
    /// If there is no such vehicle.
    #[must_use]
    pub fn used_sticks_us(&self, vehicle: usize) -> [u16; 4] {
        self.crafts[vehicle].fc.used_sticks_us()
    }

    /// Swaps the battery for one with this charge, 0..=1.
    ///
    /// # Panics
    /// If there is no such vehicle.
    pub fn set_charge(&mut self, vehicle: usize, charge: f64) {
        self.crafts[vehicle].quad.set_charge(charge);
    }

    /// How a vehicle really is.
    ///
    /// # Panics
    /// If there is no such vehicle.
    #[must_use]
    pub fn truth(&self, vehicle: usize) -> Truth {
        let craft = &self.crafts[vehicle];
        let quad = &craft.quad;
        Truth {
            at: self.now,
            position: quad.position(),
            velocity: quad.velocity(),
            attitude: quad.attitude(),
            rates_radps: quad.rates(),
            in_contact: craft.contact.in_contact(),
            contacts: craft.contact.episodes(),
            on_floor: quad.is_on_floor(),
            armed: match &craft.motors {
                Some((_, speeds)) => speeds.iter().any(|w| *w > 0.0),
                None => craft.fc.is_armed(),
            },
            voltage_v: quad.battery().voltage_v(),
            charge: quad.battery().remaining(),
        }
    }

    /// What the camera of a vehicle sees from where it is: pose and who else is there. [`Camera`](crate::camera::Camera) draws it.
    ///
    /// # Panics
    /// If there is no such vehicle.
    #[must_use]
    pub fn shot(&self, vehicle: usize) -> Shot {
        let quad = &self.crafts[vehicle].quad;
        let frd_to_ned = quad.attitude();
        let axis = |x, y, z| {
            self.anchor
                .vector_to_map(frd_to_ned * In::<Frd>::new(x, y, z))
        };
        let axes = [
            axis(1.0, 0.0, 0.0),
            axis(0.0, 1.0, 0.0),
            axis(0.0, 0.0, 1.0),
        ];
        let movers = self.world.seen_movers(vehicle).take(MOVERS);
        Shot {
            at: self.now,
            eye: self.anchor.to_map(quad.position()) + axes[0] * LENS_AHEAD_M,
            axes,
            movers: movers
                .map(|(is_person, disc)| Mover {
                    centre: disc.centre,
                    radius_m: disc.radius_m,
                    heights_m: disc.heights_m,
                    is_person,
                })
                .collect(),
        }
    }

    /// The room as cameras see it, with everything raised so far.
    #[must_use]
    pub fn scenery(&self) -> Scenery {
        self.room.scenery(self.world.visible_walls())
    }

    /// Virtual time.
    #[must_use]
    pub const fn now(&self) -> Timestamp {
        self.now
    }

    /// Number of vehicles.
    #[must_use]
    pub const fn vehicles(&self) -> usize {
        self.crafts.len()
    }

    /// The plan that the bridge may have.
    #[must_use]
    pub fn floor_plan(&self) -> Arc<FloorPlan> {
        Arc::clone(self.room.floor_plan())
    }

    /// How the plan lies in the world.
    #[must_use]
    pub const fn anchor(&self) -> MapAnchor {
        self.anchor
    }

    /// The room, for drawing.
    #[must_use]
    pub const fn room(&self) -> &Room {
        &self.room
    }

    /// Places and doors in plan and world coordinates: what `rooms.json` holds.
    #[must_use]
    pub fn facts(&self) -> RoomFacts {
        self.room.facts()
    }

    /// Where people are, plan metres; their radius is [`PERSON_RADIUS_M`](crate::PERSON_RADIUS_M).
    pub fn people(&self) -> impl Iterator<Item = [f64; 2]> {
        self.world.people()
    }
}
