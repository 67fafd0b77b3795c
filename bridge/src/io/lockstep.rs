//! Simulator, `Flight` and `Ground` stepped in one thread, in fixed order, a millisecond at a time.
//!
//! The same struct flies in real time behind sockets, in virtual time inside tests, and as fast as it can in `demo`:
//! what differs is only who calls [`advance`](Lockstep::advance) and what happens to the bytes for the ground.

use super::firmware::Outside;
use super::inject::inject;
use super::truth::{Row, TruthFile};
use crate::autopilot::door::{Answer, Asked, HostReport, Request, RequestId, Snapshot, Station};
use crate::autopilot::flight::{Flight, FlightConfig, Start};
use crate::autopilot::ground::{Ground, GroundConfig, GroundOutput};
use crate::autopilot::io::{FcBytes, Input, Output};
use crate::autopilot::keeper::Keeper;
use crate::gcs::disk::{DiskJob, DiskReply, Ticket};
use crate::gcs::{Document, LinkId};
use crate::log::record::LogSink;
use crate::log::{Emitted, FlightRecord, GroundRecord, Header, Part};
use crate::settings::Settings;
use crate::station::GroundStation;
use estimator::SearchRequest;
use mavlink_dialect::{Address, FrameBytes};
use sim::{SimConfig, SimError, SimOutput, Simulator};
use std::collections::VecDeque;
use std::io;
use std::time::Duration;
use vehicle::{Pace, Timestamp};

/// A job comes back after this much virtual time: about what a Raspberry Pi needs for a search.
const JOB_DELAY: Duration = Duration::from_millis(500);
/// Rows of the truth file a second.
const TRUTH_HZ: f64 = 50.0;

/// What a lockstep flight is made from.
#[derive(Clone, Debug)]
pub struct LockstepConfig {
    /// World and vehicle.
    pub sim: SimConfig,
    /// Where the vehicle believes to start.
    pub start: Start,
    /// Parameters.
    pub settings: Settings,
    /// Stored mission and the like, read before start.
    pub documents: Vec<Document>,
}

impl LockstepConfig {
    /// What `Flight` is made from.
    ///
    /// # Errors
    /// There is no vehicle.
    pub fn flight(&self) -> Result<FlightConfig, SimError> {
        let vehicle = self.sim.vehicles.first().ok_or(SimError::NoVehicle)?;
        Ok(FlightConfig {
            plan: std::sync::Arc::clone(self.sim.room.floor_plan()),
            ring: vehicle.ring.clone(),
            airframe: self.sim.airframe,
            start: self.start,
            settings: self.settings.clone(),
            seed: self.sim.seed,
        })
    }

    /// Head of the log of this flight; `source` says what flew.
    ///
    /// # Errors
    /// There is no vehicle.
    pub fn header(&self, source: &str) -> Result<Header, SimError> {
        let boot = super::clock::VIRTUAL_BOOT_UTC_US;
        Ok(Header::new(Timestamp::ZERO, &self.flight()?, source, boot))
    }
}

/// What leaves the lockstep.
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "a box would allocate for every frame sent"
)]
pub enum Outgoing {
    /// A frame for a link.
    Frame(LinkId, FrameBytes),
    /// A document to keep.
    Keep(Document),
    /// A job for the disk; [`Lockstep::disk`] takes the answer.
    Disk(Ticket, DiskJob),
}

/// Where an output of a simulated vehicle's `Ground` goes.
pub(super) enum Due {
    /// To the brain.
    Ask(Asked),
    /// Back to `Ground`: the simulator did it.
    Answer(Answer),
    /// To the shell.
    Out(Outgoing),
}

impl Due {
    /// A failure that a station asks for is the simulator's to have, not the brain's to know.
    pub(super) fn of(output: GroundOutput, simulator: &mut Simulator, rangers: usize) -> Self {
        match output {
            GroundOutput::Send { link, bytes } => Self::Out(Outgoing::Frame(link, bytes)),
            GroundOutput::Request(Asked {
                id,
                station,
                request: Request::Inject(failure),
            }) => Self::Answer(Answer {
                id,
                station,
                outcome: inject(simulator, rangers, failure),
            }),
            GroundOutput::Request(asked) => Self::Ask(asked),
            GroundOutput::Keep(document) => Self::Out(Outgoing::Keep(document)),
            GroundOutput::Disk(ticket, job) => Self::Out(Outgoing::Disk(ticket, job)),
        }
    }
}

/// A simulated vehicle with its brain.
pub struct Lockstep {
    /// The world.
    pub simulator: Simulator,
    /// The vehicle's brain.
    pub flight: Flight,
    /// Its MAVLink side.
    pub ground: Ground,
    rangers: usize,
    now: Timestamp,
    jobs: VecDeque<(Timestamp, SearchRequest)>,
    inputs: VecDeque<Input>,
    outgoing: VecDeque<Outgoing>,
    truth: Option<TruthFile>,
    truth_pace: Pace,
    log: Option<Box<dyn LogSink>>,
    texts_logged: u64,
    kept: Option<Vec<(Timestamp, Input)>>,
    /// The real firmware instead of the fake controller.
    firmware: Option<Outside>,
    spent: Option<Spent>,
    ticks_seen: u64,
    held_until: Timestamp,
    is_held: bool,
    planned_hold: Option<(Timestamp, Duration)>,
    frozen_until: Timestamp,
    keeper: Keeper,
    /// First failure of a file being written; flying goes on.
    pub write_error: Option<io::Error>,
}

/// Processor time of the thread of the lockstep, by what it went into, ns.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spent {
    /// World, fake controller and sensors.
    pub simulator_ns: u64,
    /// The flight loop: estimate, localization, planner, control.
    pub flight_ns: u64,
    /// MAVLink services and telemetry.
    pub ground_ns: u64,
    /// Global searches of the place, a thread of their own on a vehicle.
    pub search_ns: u64,
    since_ns: u64,
}

impl Spent {
    fn begin(&mut self) {
        self.since_ns = super::clock::thread_cpu_ns();
    }

    fn lap(&mut self, of: impl FnOnce(&mut Self) -> &mut u64) {
        let now = super::clock::thread_cpu_ns();
        let lap = now - self.since_ns;
        *of(self) += lap;
        self.since_ns = now;
    }
}

impl Lockstep {
    /// At time zero, vehicle on the floor.
    ///
    /// # Errors
    /// [`SimError`]: the vehicle would start in a wall, a ring is wrong ...
    pub fn new(config: LockstepConfig) -> Result<Self, SimError> {
        Self::with_log(config, None)
    }

    /// [`Self::new`], with everything recorded from the first input on.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_log(
        config: LockstepConfig,
        log: Option<Box<dyn LogSink>>,
    ) -> Result<Self, SimError> {
        let now = Timestamp::ZERO;
        let flight_config = config.flight()?;
        let LockstepConfig {
            sim,
            settings,
            documents,
            ..
        } = config;
        let plan = std::sync::Arc::clone(&flight_config.plan);
        let airframe = sim.airframe;
        let simulator = Simulator::new(sim)?;
        let ground = Ground::new(GroundConfig {
            us: our_address(&settings),
            settings,
            anchor: plan.anchor(),
            plan,
            airframe,
            boot_utc_us: super::clock::VIRTUAL_BOOT_UTC_US,
            documents,
        });
        let rangers = flight_config.ring.rangers.len();
        let flight = Flight::new(now, flight_config);
        let mut this = Self {
            simulator,
            flight,
            ground,
            rangers,
            now,
            jobs: VecDeque::new(),
            inputs: VecDeque::new(),
            outgoing: VecDeque::new(),
            truth: None,
            truth_pace: Pace::hz(TRUTH_HZ),
            log,
            texts_logged: 0,
            kept: None,
            firmware: None,
            spent: None,
            ticks_seen: 0,
            held_until: Timestamp::ZERO,
            is_held: false,
            planned_hold: None,
            frozen_until: Timestamp::ZERO,
            keeper: Keeper::default(),
            write_error: None,
        };
        this.feed(Input::FcOpened);
        Ok(this)
    }

    /// Writes truth beside estimate from now on.
    pub fn write_truth(&mut self, file: TruthFile) {
        self.truth = Some(file);
    }

    /// Keeps every input of `Flight` in memory from now on, for whoever wants to fly it again.
    pub fn keep_inputs(&mut self) {
        self.kept.get_or_insert_default();
    }

    /// The inputs kept so far.
    pub fn take_inputs(&mut self) -> Vec<(Timestamp, Input)> {
        self.kept.take().unwrap_or_default()
    }

    /// From now on this firmware flies the vehicle, whose controller must be outside
    /// ([`sim::VehicleConfig::outside_fc`]). It runs on the wall clock, so time must pass at its pace.
    pub fn fly_by(&mut self, firmware: Outside) {
        self.firmware = Some(firmware);
    }

    /// The real firmware, if it flies.
    pub const fn firmware(&mut self) -> Option<&mut Outside> {
        self.firmware.as_mut()
    }

    /// Virtual time.
    #[must_use]
    pub const fn now(&self) -> Timestamp {
        self.now
    }

    /// The newest snapshot.
    #[must_use]
    pub const fn snapshot(&self) -> &Snapshot {
        self.flight.snapshot()
    }

    /// A link of the shell is there.
    pub fn link_up(&mut self, link: LinkId) {
        self.ground.link_up(self.now, link);
        self.drain_ground();
    }

    /// A link of the shell is gone.
    pub fn link_down(&mut self, link: LinkId) {
        self.ground.link_down(link);
        self.drain_ground();
    }

    /// Bytes of a link.
    pub fn receive(&mut self, link: LinkId, bytes: &[u8], is_datagram: bool) {
        if let Some(log) = &mut self.log {
            log.ground(GroundRecord::Received {
                at: self.now,
                link,
                bytes: bytes.to_vec(),
                is_datagram,
            });
        }
        self.ground.receive(self.now, link, bytes, is_datagram);
        self.drain_ground();
    }

    /// The disk answered.
    pub fn disk(&mut self, ticket: Ticket, reply: &DiskReply) {
        self.ground.disk(self.now, ticket, reply);
        self.drain_ground();
    }

    /// How the computer is, for tests of failsafes.
    pub fn host(&mut self, report: HostReport) {
        self.feed(Input::Host(report));
    }

    /// Asks the vehicle to come down and end.
    pub fn shut_down(&mut self) {
        self.ask(Request::ShutDown);
    }

    /// A request of this program itself; its answer goes to nobody.
    pub fn ask(&mut self, request: Request) {
        let asked = Asked {
            id: RequestId(0),
            station: Station::default(),
            request,
        };
        self.feed(Input::Asked(asked));
    }

    /// For tests of failsafes: the flight thread does not get to run for this long while the world goes on. What arrives meanwhile
    /// waits, as it does in the kernel and in the rings.
    pub fn hold_flight(&mut self, duration: Duration) {
        self.held_until = self.now + duration;
        self.is_held = true;
    }

    /// [`Self::hold_flight`] at a time to come.
    pub const fn hold_flight_at(&mut self, at: Timestamp, duration: Duration) {
        self.planned_hold = Some((at, duration));
    }

    /// For tests of failsafes: the whole program is frozen for this long (a stopped process, a stalled host), its keeper too.
    pub fn freeze(&mut self, duration: Duration) {
        self.hold_flight(duration);
        self.frozen_until = self.held_until;
    }

    /// The next thing for the shell, if any.
    pub fn poll(&mut self) -> Option<Outgoing> {
        self.outgoing.pop_front()
    }

    /// Lets virtual time pass. It stops early while the real firmware does not keep up: [`now`](Self::now) tells.
    pub fn advance(&mut self, until: Timestamp) {
        while self.now < until {
            if self.firmware.as_mut().is_some_and(|f| !f.keeps_up()) {
                return;
            }
            self.step();
        }
    }

    /// Lets virtual time pass and a scripted station at this link, the only one that is served, hear and say what it has to.
    pub fn advance_with(&mut self, until: Timestamp, link: LinkId, station: &mut GroundStation) {
        self.advance(until);
        while let Some(out) = self.poll() {
            if let Outgoing::Frame(to, frame) = out
                && to == link
            {
                station.receive(&frame);
            }
        }
        station.tick(until);
        self.hand_over(link, station);
    }

    /// What a scripted station has sent arrives now.
    pub fn hand_over(&mut self, link: LinkId, station: &mut GroundStation) {
        while let Some(frame) = station.poll() {
            self.receive(link, &frame, true);
        }
    }

    fn step(&mut self) {
        let now = self.now + sim::STEP;
        self.now = now;
        if let Some((at, duration)) = self.planned_hold
            && now >= at
        {
            self.planned_hold = None;
            self.hold_flight(duration);
        }
        if let Some(spent) = &mut self.spent {
            spent.begin();
        }
        let inputs = &mut self.inputs;
        self.simulator.advance(now, &mut |vehicle, output| {
            if vehicle == 0 {
                push_inputs(inputs, output);
            }
        });
        self.lap(|s| &mut s.simulator_ns);
        if let Some(firmware) = &mut self.firmware {
            firmware.exchange(now, &mut self.simulator, &mut self.inputs);
        }
        if let Some((_, job)) = self.jobs.pop_front_if(|(at, _)| *at <= now) {
            self.inputs
                .push_back(Input::JobDone(estimator::search(&job)));
            self.lap(|s| &mut s.search_ns);
        }
        if now >= self.frozen_until
            && let Some(frame) = self.keeper.poll(now)
        {
            match &mut self.firmware {
                Some(firmware) => firmware.write(frame),
                None => self.simulator.write_fc(0, frame),
            }
        }
        if now >= self.held_until {
            if core::mem::take(&mut self.is_held) {
                // What waited in the kernel comes as the flight thread takes it: bytes of the line before anything else.
                let waiting = self.inputs.make_contiguous();
                waiting.sort_by_key(|input| !matches!(input, Input::Fc(_)));
            }
            while let Some(input) = self.inputs.pop_front() {
                self.feed(input);
            }
            if self.flight.deadline() <= now {
                self.feed(Input::Wake);
            }
        }
        self.lap(|s| &mut s.flight_ns);
        let ticks = self.flight.snapshot().flight_loop.ticks;
        if ticks != self.ticks_seen {
            self.ticks_seen = ticks;
            self.keeper.refresh(now, self.flight.standby());
            self.ground.snapshot(now, self.flight.snapshot());
            if let Some(log) = &mut self.log {
                let snapshot = Box::new(self.flight.snapshot().clone());
                log.ground(GroundRecord::Snapshot(snapshot));
            }
        }
        if self.ground.deadline() <= now {
            self.ground.tick(now);
        }
        self.drain_ground();
        self.lap(|s| &mut s.ground_ns);
        if self.truth_pace.is_due(now)
            && let Some(truth) = &mut self.truth
        {
            let row = Row::take(now, &self.simulator, 0, self.flight.snapshot());
            keep_first(&mut self.write_error, truth.write(&row));
        }
    }

    fn lap(&mut self, of: impl FnOnce(&mut Spent) -> &mut u64) {
        if let Some(spent) = &mut self.spent {
            spent.lap(of);
        }
    }

    /// From now on it is counted what processor time goes where.
    pub fn count_time(&mut self) {
        self.spent.get_or_insert_default();
    }

    /// Where processor time went, if it is counted.
    #[must_use]
    pub const fn spent(&self) -> Option<Spent> {
        self.spent
    }

    /// Gives `Flight` an input and carries out what it wants.
    fn feed(&mut self, input: Input) {
        if self.now < self.held_until {
            self.inputs.push_back(input);
            return;
        }
        let at = self.now;
        self.log(|| FlightRecord::Input {
            at,
            input: input.clone(),
        });
        let ticks = self.flight.snapshot().flight_loop.ticks;
        if let Some(kept) = &mut self.kept {
            kept.push((self.now, input.clone()));
        }
        self.flight.handle(self.now, input);
        while let Some(output) = self.flight.poll() {
            self.log(|| FlightRecord::Output {
                at,
                output: Emitted::from(&output),
            });
            match output {
                Output::Fc(bytes) => match &mut self.firmware {
                    Some(firmware) => firmware.write(&bytes),
                    None => self.simulator.write_fc(0, &bytes),
                },
                Output::Answer(answer) => self.ground.answer(self.now, &answer),
                Output::Event(event) => self.ground.event(self.now, &event),
                Output::Job(job) => self.jobs.push_back((self.now + JOB_DELAY, job)),
            }
        }
        if self.log.is_some() && self.flight.snapshot().flight_loop.ticks != ticks {
            let digests = Part::digests(self.flight.snapshot());
            self.log(|| FlightRecord::Tick { at, digests });
        }
    }

    fn log(&mut self, record: impl FnOnce() -> FlightRecord) {
        if let Some(log) = &mut self.log {
            log.flight(record());
        }
    }

    fn log_ground(&mut self, link: LinkId, frame: &FrameBytes) {
        if let Some(log) = &mut self.log {
            log.ground(GroundRecord::Sent {
                at: self.now,
                link,
                frame: frame.clone(),
            });
        }
    }

    /// What was told to the pilots since the last time.
    fn log_texts(&mut self) {
        let Some(log) = &mut self.log else { return };
        for told in self.ground.texts_since(&mut self.texts_logged) {
            log.ground(GroundRecord::Text {
                at: told.at,
                severity: told.severity,
                text: told.text.clone(),
            });
        }
    }

    fn drain_ground(&mut self) {
        while let Some(output) = self.ground.poll() {
            match Due::of(output, &mut self.simulator, self.rangers) {
                Due::Ask(asked) => self.feed(Input::Asked(asked)),
                Due::Answer(answer) => self.ground.answer(self.now, &answer),
                Due::Out(out) => {
                    if let Outgoing::Frame(link, frame) = &out {
                        self.log_ground(*link, frame);
                    }
                    self.outgoing.push_back(out);
                }
            }
        }
        self.log_texts();
    }

    /// Writes what is buffered.
    pub fn flush(&mut self) {
        if let Some(truth) = &mut self.truth {
            keep_first(&mut self.write_error, truth.flush());
        }
    }
}

/// System id of the parameter, autopilot component.
#[must_use]
pub fn our_address(settings: &Settings) -> Address {
    Address {
        system: settings.ground.system_id.clamp(1, 250) as u8,
        component: 1,
    }
}

fn keep_first(slot: &mut Option<io::Error>, result: io::Result<()>) {
    if let Err(e) = result {
        slot.get_or_insert(e);
    }
}

fn push_inputs(inputs: &mut VecDeque<Input>, output: SimOutput) {
    match output {
        SimOutput::FcBytes { bytes, .. } => {
            for chunk in bytes.chunks(FcBytes::new_const().capacity()) {
                inputs.push_back(Input::Fc(chunk.iter().copied().collect()));
            }
        }
        SimOutput::Ranger(reading) => inputs.push_back(Input::Ranger(reading)),
        SimOutput::DownRange(sample) => inputs.push_back(Input::DownRange(sample)),
        SimOutput::Flow(sample) => inputs.push_back(Input::Flow(sample)),
        // Lines of devices: whoever simulates those reads them with their drivers.
        SimOutput::Laser { .. } => {}
    }
}
