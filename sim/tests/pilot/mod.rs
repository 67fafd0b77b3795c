//! A scripted pilot with perfect sight: steers by the truth, speaks MSP bytes like any companion computer.
#![allow(dead_code, unreachable_pub, reason = "every test uses its own part")]

use msp::message::{Message, SetRawRc};
use msp::{Accept, Decoder, Direction, Framing, command, encode};
use sim::{Room, SimConfig, SimOutput, Simulator};
use vehicle::{In, Ned, RingConfig, Timestamp, angle};

/// Neutral sticks with the throttle down, arm switch low: A, E, T, R, Aux1, Aux2.
pub const IDLE: [u16; 6] = [1500, 1500, 1000, 1500, 1000, 1500];

pub struct Pilot {
    pub sim: Simulator,
    pub vehicle: usize,
    pub sticks_us: [u16; 6],
    /// RC frames go out while this is true.
    pub sends_rc: bool,
    pub outputs: Vec<SimOutput>,
    decoder: Decoder,
    pub replies: Vec<(Timestamp, Direction, u16, Vec<u8>)>,
}

pub fn office(ring: &str, seed: u64) -> SimConfig {
    let ring = RingConfig::built_in(ring).unwrap();
    SimConfig::new(Room::named("office").unwrap(), ring, seed)
}

impl Pilot {
    pub fn new(config: SimConfig) -> Self {
        Self {
            sim: Simulator::new(config).unwrap(),
            vehicle: 0,
            sticks_us: IDLE,
            sends_rc: true,
            outputs: Vec::new(),
            decoder: Decoder::new(Accept::Replies),
            replies: Vec::new(),
        }
    }

    pub fn send(&mut self, id: u16, payload: &[u8]) {
        let mut wire = Vec::new();
        let framing = if id < 255 { Framing::V1 } else { Framing::V2 };
        encode(framing, Direction::Request, id, payload, &mut wire).unwrap();
        self.sim.write_fc(self.vehicle, &wire);
    }

    /// Flies for a time, RC every 20 ms; before each frame `steer` may move the sticks.
    pub fn fly(&mut self, ms: u64, mut steer: impl FnMut(&mut Self)) {
        let end = self.sim.now().us() / 1000 + ms;
        while self.sim.now().us() / 1000 < end {
            let now_ms = self.sim.now().us() / 1000;
            if now_ms.is_multiple_of(20) {
                steer(self);
                if self.sends_rc {
                    let rc = SetRawRc {
                        channels_us: self.sticks_us.iter().copied().collect(),
                    };
                    let mut payload = Vec::new();
                    rc.emit(&mut payload);
                    self.send(command::SET_RAW_RC, &payload);
                }
            }
            self.step();
        }
    }

    /// One millisecond.
    pub fn step(&mut self) {
        let until = Timestamp::from_us(self.sim.now().us() + 1000);
        let (vehicle, outputs) = (self.vehicle, &mut self.outputs);
        let (decoder, replies) = (&mut self.decoder, &mut self.replies);
        self.sim.advance(until, &mut |v, output| {
            if v != vehicle {
                return;
            }
            if let SimOutput::FcBytes { at, bytes } = &output {
                let mut input = bytes.as_slice();
                while let Some(frame) = decoder.decode(&mut input) {
                    let payload = frame.payload.to_vec();
                    replies.push((*at, frame.direction, frame.command, payload));
                }
            }
            outputs.push(output);
        });
    }

    /// Asks and waits for the answer.
    pub fn ask<M: Message>(&mut self) -> M {
        self.ask_raw(M::COMMAND, &[])
            .map(|payload| M::parse(&payload).unwrap())
            .unwrap()
    }

    /// None when the controller refuses.
    pub fn ask_raw(&mut self, id: u16, payload: &[u8]) -> Option<Vec<u8>> {
        self.replies.clear();
        self.send(id, payload);
        for _ in 0..200 {
            self.step();
            let found = self.replies.iter().find(|r| r.2 == id);
            if let Some((_, direction, _, payload)) = found {
                return (*direction == Direction::Reply).then(|| payload.clone());
            }
        }
        panic!("no answer to command {id} within 200 ms");
    }

    pub fn blockers(&mut self) -> u32 {
        let status: msp::message::StatusEx = self.ask();
        status.betaflight().unwrap().arming_disable
    }

    pub fn set_arm_switch(&mut self, up: bool) {
        self.sticks_us[4] = if up { 2000 } else { 1000 };
    }

    /// Waits out the boot grace with RC on, then arms.
    pub fn arm(&mut self) {
        self.fly(5200, |_| {});
        self.set_arm_switch(true);
        self.fly(200, |_| {});
        assert!(self.sim.truth(self.vehicle).armed);
    }

    /// Sticks towards a place, with the heading held.
    pub fn steer_to(&mut self, place: In<Ned>, heading_rad: f64) {
        let truth = self.sim.truth(self.vehicle);
        let error = place - truth.position;
        let wanted = (error * 1.2).limited_xy(0.8);
        let accel = (wanted - truth.velocity) * 2.5;
        let yaw = truth.attitude.yaw();
        let (s, c) = (yaw.sin(), yaw.cos());
        let forward = c * accel.x() + s * accel.y();
        let right = -s * accel.x() + c * accel.y();
        // Pitch stick up is nose down is forward.
        self.sticks_us[0] = stick((right / 9.81).atan().to_degrees());
        self.sticks_us[1] = stick((forward / 9.81).atan().to_degrees());
        let turn = angle::shortest_turn(yaw, heading_rad).to_degrees() * 1.5;
        self.sticks_us[3] = inverse_rate(turn.clamp(-90.0, 90.0));
        let climb = (-error.z() * 1.5).clamp(-0.6, 0.8);
        let lift = 1.0 + 0.25 * (climb + truth.velocity.z());
        self.sticks_us[2] = (1565.0 + 520.0 * (lift - 1.0)).clamp(1060.0, 1900.0) as u16;
    }

    /// Arms, climbs to a height above home and settles there.
    pub fn take_off(&mut self, height_m: f64) {
        self.arm();
        let start = self.sim.truth(self.vehicle);
        let heading = start.attitude.yaw();
        let place = start.position.with_z(-height_m);
        self.fly(5000, |p| p.steer_to(place, heading));
    }
}

/// Stick for a tilt under Betaflight's curve with a 60 degree limit.
pub fn stick(tilt_deg: f64) -> u16 {
    inverse_rate(tilt_deg.clamp(-20.0, 20.0) / 60.0 * 670.0)
}

/// Stick whose ACTUAL rate (70 at the centre, 670 at the end) is this, deg/s.
pub fn inverse_rate(dps: f64) -> u16 {
    let x = (-70.0 + (4900.0 + 2400.0 * dps.abs()).sqrt()) / 1200.0;
    (1500.0 + 500.0 * x.copysign(dps)).round() as u16
}
