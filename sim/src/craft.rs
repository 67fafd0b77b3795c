//! One vehicle: body, flight controller, sensors, and the samples that are on their way.

use crate::config::VehicleConfig;
use crate::controller::Controller;
use crate::device::Laser;
use crate::fc::uart::BURST;
use crate::motor_craft::MotorCraft;
use crate::quad::Quad;
use crate::quad::contact::Contact;
use crate::sensor::{
    DOWN_LATENCY, DownRanger, FLOW_LATENCY, FlowCamera, MagneticField, Ranger, View,
};
use crate::simulator::{Fault, SimOutput};
use crate::world::World;
use arrayvec::ArrayVec;
use core::time::Duration;
use std::collections::VecDeque;
use std::sync::Arc;
use vehicle::sample::MAX_COLUMNS;
use vehicle::{Airframe, In, MapAnchor, MapPose, RangerReading, Timestamp};

/// Samples on their way at most; a ring has 64 rangers at most and the longest latency is 38 ms.
const IN_TRANSIT: usize = 512;

/// A vehicle of the simulation.
#[derive(Clone, Debug)]
pub(crate) struct Craft {
    pub(crate) quad: Quad,
    pub(crate) fc: Controller,
    pub(crate) contact: Contact,
    /// The body in place of the quad's own, with the speeds it is commanded, rad/s.
    pub(crate) motors: Option<(MotorCraft, [f64; 4])>,
    rangers: Vec<Ranger>,
    ring_waits: bool,
    lasers: Vec<Laser>,
    /// Where lidars put their bytes.
    line: Vec<u8>,
    down: Option<DownRanger>,
    flow: Option<FlowCamera>,
    faults: Vec<Fault>,
    /// What each ranger said last.
    stuck: Vec<Option<ArrayVec<Option<u16>, MAX_COLUMNS>>>,
    /// By time of delivery.
    in_transit: VecDeque<(Timestamp, SimOutput)>,
}

/// What all vehicles share.
pub(crate) struct Shared<'a> {
    pub(crate) world: &'a World,
    pub(crate) anchor: &'a MapAnchor,
    pub(crate) index: usize,
}

impl Craft {
    pub(crate) fn new(
        config: &VehicleConfig,
        airframe: Airframe,
        turbulence_n: f64,
        seed: u64,
        index: usize,
        anchor: &MapAnchor,
        field: &Arc<MagneticField>,
    ) -> Self {
        let at = anchor.to_ned(In::new(config.start.x_m, config.start.y_m, 0.0));
        let yaw_rad = anchor.yaw_to_ned(config.start.yaw_rad);
        let charge = config.charge;
        let quad = Quad::new(airframe, at, yaw_rad, charge, turbulence_n, seed, index);
        let rangers = (0u8..).zip(&config.ring.rangers);
        Self {
            fc: Controller::new(config, seed, index, &quad, field),
            contact: Contact::new(&quad),
            motors: config.motor_craft.map(|frame| {
                let mut body = MotorCraft::landed(frame, -yaw_rad);
                body.put(&quad);
                (body, [0.0; 4])
            }),
            rangers: rangers
                .map(|(i, ranger)| Ranger::new(ranger, i, seed, index))
                .collect(),
            ring_waits: config.ring_waits,
            lasers: (0..)
                .zip(&config.lasers)
                .map(|(i, laser)| Laser::new(*laser, seed, index, i))
                .collect(),
            line: Vec::new(),
            down: config.down_range.then(|| DownRanger::new(seed, index)),
            flow: config.flow.then(|| FlowCamera::new(seed, index)),
            faults: Vec::new(),
            stuck: vec![None; config.ring.rangers.len()],
            in_transit: VecDeque::with_capacity(IN_TRANSIT),
            quad,
        }
    }

    /// One millisecond of flight.
    pub(crate) fn fly(&mut self, now: Timestamp, shared: &Shared<'_>) {
        let mut motors = self.fc.step(now, &self.quad);
        for (i, motor) in motors.iter_mut().enumerate() {
            if self.faults.contains(&Fault::MotorDead(i as u8)) {
                *motor = 0.0;
            }
        }
        let bump = match &mut self.motors {
            None => self.quad.step(motors),
            Some((body, speeds)) => self.quad.follow(body, *speeds),
        };
        let Shared {
            world,
            anchor,
            index,
        } = shared;
        let before = (self.quad.position(), self.quad.velocity());
        self.contact
            .resolve(&mut self.quad, bump, world, *index, anchor);
        if let Some((body, _)) = &mut self.motors
            && before != (self.quad.position(), self.quad.velocity())
        {
            // Walls and people have pushed it.
            body.put(&self.quad);
        }
    }

    /// Fires what is due and hands over what has arrived.
    pub(crate) fn sense(
        &mut self,
        now: Timestamp,
        shared: &Shared<'_>,
        out: &mut impl FnMut(usize, SimOutput),
    ) {
        if !self.ring_waits {
            self.fire_rangers(now, shared);
        }
        self.turn_lasers(now, shared, out);
        if let Some(down) = &mut self.down
            && down.is_due(now)
        {
            let sample = down.measure(now, &self.quad);
            self.post(now, DOWN_LATENCY, SimOutput::DownRange(sample));
        }
        if let Some(flow) = &mut self.flow
            && flow.is_due(now)
        {
            let sample = flow.measure(now, &self.quad);
            self.post(now, FLOW_LATENCY, SimOutput::Flow(sample));
        }
        while let Some(burst) = self.fc.deliver(now) {
            let ms = now.us() / 1_000;
            let is_noise = self.faults.contains(&Fault::FcNoisy) && ms % 120 >= 15
                || self.faults.contains(&Fault::FcLossy) && ms % 40 >= 20;
            if !self.faults.contains(&Fault::FcSilent) && !is_noise {
                let (at, bytes) = (burst.at, burst.bytes);
                out(shared.index, SimOutput::FcBytes { at, bytes });
            }
        }
        while self.in_transit.front().is_some_and(|(due, _)| *due <= now) {
            if let Some((_, output)) = self.in_transit.pop_front()
                && !self.faults.iter().any(|fault| fault.swallows(&output))
            {
                out(shared.index, output);
            }
        }
    }

    fn fire_rangers(&mut self, now: Timestamp, shared: &Shared<'_>) {
        let mut view = None;
        for i in 0..self.rangers.len() {
            if !self.rangers[i].is_due(now) {
                continue;
            }
            let view = view.get_or_insert_with(|| {
                View::new(shared.world, shared.index, &self.quad, shared.anchor)
            });
            let (mut reading, latency) = self.rangers[i].fire(now, view);
            self.hold_stuck(&mut reading);
            let output = SimOutput::Ranger(reading);
            post(&mut self.in_transit, now + latency, output);
        }
    }

    /// What is stuck says what it said last.
    fn hold_stuck(&mut self, reading: &mut RangerReading) {
        let is_stuck = self.faults.contains(&Fault::RangerStuck(reading.ranger));
        let Some(last) = self.stuck.get_mut(usize::from(reading.ranger)) else {
            return;
        };
        match last {
            Some(columns) if is_stuck => reading.columns_mm.clone_from(columns),
            last => *last = Some(reading.columns_mm.clone()),
        }
    }

    /// Bytes of lidars leave as they are measured.
    fn turn_lasers(
        &mut self,
        now: Timestamp,
        shared: &Shared<'_>,
        out: &mut impl FnMut(usize, SimOutput),
    ) {
        if self.lasers.is_empty() {
            return;
        }
        let view = View::new(shared.world, shared.index, &self.quad, shared.anchor);
        for (laser, device) in (0u8..).zip(&mut self.lasers) {
            self.line.clear();
            device.step(now, &view, &mut self.line);
            if self.faults.contains(&Fault::LaserSilent(laser)) {
                continue;
            }
            for bytes in self.line.chunks(BURST) {
                let bytes = bytes.iter().copied().collect();
                out(shared.index, SimOutput::Laser { laser, bytes });
            }
        }
    }

    /// Fires a ranger of the ring now.
    pub(crate) fn trigger(
        &mut self,
        now: Timestamp,
        ranger: u8,
        shared: &Shared<'_>,
    ) -> Option<RangerReading> {
        if self.faults.contains(&Fault::RangerSilent(ranger)) {
            return None;
        }
        let view = View::new(shared.world, shared.index, &self.quad, shared.anchor);
        let ranger = self.rangers.get_mut(usize::from(ranger))?;
        let mut reading = ranger.fire(now, &view).0;
        self.hold_stuck(&mut reading);
        Some(reading)
    }

    pub(crate) fn write_laser(&mut self, now: Timestamp, laser: usize, bytes: &[u8]) {
        if let Some(laser) = self.lasers.get_mut(laser) {
            laser.write(now, bytes);
        }
    }

    fn post(&mut self, now: Timestamp, latency: Duration, output: SimOutput) {
        post(&mut self.in_transit, now + latency, output);
    }

    pub(crate) fn write_fc(&mut self, now: Timestamp, bytes: &[u8]) {
        if !self.faults.contains(&Fault::FcSilent) {
            self.fc.write(now, bytes);
        }
    }

    pub(crate) fn set_fault(&mut self, fault: Fault, active: bool) {
        self.faults.retain(|f| *f != fault);
        if active {
            self.faults.push(fault);
        }
        match fault {
            Fault::FcBusy => self.fc.be_busy(active),
            Fault::AttitudeAskew => self.fc.tell_askew(active),
            _ => {}
        }
    }

    /// Carries it elsewhere at the same height, at rest.
    pub(crate) fn carry_to(&mut self, pose: MapPose, anchor: &MapAnchor) {
        let at = anchor.to_ned(In::new(pose.x_m, pose.y_m, self.quad.height_m()));
        let yaw_rad = anchor.yaw_to_ned(pose.yaw_rad);
        self.quad.stop_at(at);
        self.quad.set_yaw(yaw_rad);
        self.fc.carried(yaw_rad);
        self.contact.moved(&self.quad);
        if let Some((body, _)) = &mut self.motors {
            body.put(&self.quad);
        }
    }
}

/// Files an output by its time of delivery, after those due at the same time.
fn post(queue: &mut VecDeque<(Timestamp, SimOutput)>, due: Timestamp, output: SimOutput) {
    let place = queue.partition_point(|(other, _)| *other <= due);
    queue.insert(place, (due, output));
}
