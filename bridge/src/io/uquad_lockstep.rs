//! uQuad in the simulator: world, inertial unit, motor driver and speed controllers, the aircraft and its `Ground`, in one thread and on virtual
//! time, a millisecond at a time. Bytes all the way round: the board's frames in, the driver's messages out.

use super::lockstep::{Due, Outgoing, our_address};
use super::truth::{Row, TruthFile};
use crate::autopilot::door::{Asked, HostReport, Request, RequestId, Snapshot, Station};
use crate::autopilot::flight::Start;
use crate::autopilot::ground::{Ground, GroundConfig};
use crate::autopilot::io::FcBytes;
use crate::gcs::disk::{DiskReply, Ticket};
use crate::gcs::{Document, LinkId};
use crate::motor::{Driver, DriverConfig};
use crate::settings::Settings;
use crate::uquad::UquadConfig;
use crate::uquad::flight::{UquadFlight, UquadFlightConfig, UquadInput, UquadOutput, airframe};
use crate::uquad::laws;
use control::lqr::Weights;
use control::setpoint_list::SetpointList;
use estimator::SearchRequest;
use estimator::imu::Calibration;
use sim::imu_board::{Bench, Received};
use sim::{EscBus, SimConfig, SimError, SimOutput, Simulator};
use std::collections::VecDeque;
use std::io;
use std::time::Duration;
use thiserror::Error;
use vehicle::{Pace, Timestamp};

/// A search comes back after this much virtual time; gains after [`DESIGN_DELAY`].
const JOB_DELAY: Duration = Duration::from_millis(500);
/// About what a BeagleBone needs for a Riccati equation with sixteen states.
const DESIGN_DELAY: Duration = Duration::from_millis(20);
/// Rows of the truth file a second.
const TRUTH_HZ: f64 = 50.0;
/// Time in the program's own kernel buffers: a serial port hands over what has come each 2 ms.
const PORT_MS: u64 = 2;

/// What it is made from.
#[derive(Clone, Debug)]
pub struct UquadLockstepConfig {
    /// World; its vehicle becomes the craft of the law.
    pub sim: SimConfig,
    /// Where it believes to start.
    pub start: Start,
    /// Parameters.
    pub settings: Settings,
    /// Stored mission and the like.
    pub documents: Vec<Document>,
    /// Law and filter.
    pub uquad: UquadConfig,
    /// Weights of gains that follow the heading; none = the gains are fixed.
    pub weights: Option<Weights>,
    /// Set points flown in place of a mission.
    pub list: Option<SetpointList>,
    /// Fly without a position source: no rangers, 8 states.
    pub has_place: bool,
}

/// Why it cannot start.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum UquadSimError {
    /// The world.
    #[error(transparent)]
    World(#[from] SimError),
    /// The aircraft.
    #[error(transparent)]
    Aircraft(#[from] crate::uquad::UquadError),
}

/// The calibration file of the simulated chips: 256 counts per g, 14.375 per deg/s, 1300 per gauss.
///
/// # Panics
/// Never: it is a constant.
#[must_use]
pub fn simulated_calibration() -> Calibration {
    let rows = |k: f64| format!("{k} 0 0 0 {k} 0 0 0 {k} 0 0 0 ");
    let text = [
        9.80665 / 256.0,
        (1.0 / 14.375_f64).to_radians(),
        1.0 / 1300.0,
    ]
    .map(rows)
    .concat();
    Calibration::parse(&text).expect("twelve numbers for each of three sensors")
}

/// The simulated aircraft with its brain.
pub struct UquadLockstep {
    /// The world.
    pub simulator: Simulator,
    /// The brain.
    pub flight: UquadFlight,
    /// Its MAVLink side.
    pub ground: Ground,
    /// The speed controllers.
    pub bus: EscBus,
    rangers: usize,
    board: Bench,
    driver: Driver,
    now: Timestamp,
    received: Vec<Received>,
    on_line: VecDeque<u8>,
    inputs: VecDeque<UquadInput>,
    jobs: VecDeque<(Timestamp, SearchRequest)>,
    designs: VecDeque<(Timestamp, laws::DesignRequest)>,
    outgoing: VecDeque<Outgoing>,
    truth: Option<TruthFile>,
    truth_pace: Pace,
    ticks_seen: u64,
    line_is_cut_until: Timestamp,
    design_delay: Duration,
    /// First failure of a file being written.
    pub write_error: Option<io::Error>,
}

impl UquadLockstep {
    /// On the floor at time zero.
    ///
    /// # Errors
    /// [`UquadSimError`].
    pub fn new(config: UquadLockstepConfig) -> Result<Self, UquadSimError> {
        let UquadLockstepConfig {
            mut sim,
            start,
            settings,
            documents,
            uquad,
            weights,
            list,
            has_place,
        } = config;
        let now = Timestamp::ZERO;
        let craft = uquad.filter.craft;
        sim.airframe = airframe(&craft);
        let ring = sim
            .vehicles
            .first()
            .ok_or(SimError::NoVehicle)?
            .ring
            .clone();
        let rangers = ring.rangers.len();
        for vehicle in &mut sim.vehicles {
            // The true craft may differ from what the law believes: a test sets it.
            vehicle.motor_craft.get_or_insert(craft);
            vehicle.outside_fc = true;
        }
        let plan = std::sync::Arc::clone(sim.room.floor_plan());
        let seed = sim.seed;
        let frame = sim.airframe;
        let simulator = Simulator::new(sim)?;
        let mut ground = Ground::new(GroundConfig {
            us: our_address(&settings),
            settings: settings.clone(),
            anchor: plan.anchor(),
            plan: std::sync::Arc::clone(&plan),
            airframe: frame,
            boot_utc_us: super::clock::VIRTUAL_BOOT_UTC_US,
            documents,
        });
        let flight = UquadFlight::new(
            now,
            UquadFlightConfig {
                plan,
                ring: has_place.then_some(ring),
                start,
                settings,
                seed,
                calibration: simulated_calibration(),
                uquad,
                weights,
                list,
            },
        )?;
        // Nobody shall take it for ready before it has spoken.
        ground.snapshot(now, flight.snapshot());
        Ok(Self {
            simulator,
            flight,
            ground,
            bus: EscBus::default(),
            rangers,
            board: Bench::new(seed, false),
            driver: Driver::new(DriverConfig::default()),
            now,
            received: Vec::new(),
            on_line: VecDeque::new(),
            inputs: VecDeque::new(),
            jobs: VecDeque::new(),
            designs: VecDeque::new(),
            outgoing: VecDeque::new(),
            truth: None,
            truth_pace: Pace::hz(TRUTH_HZ),
            ticks_seen: 0,
            line_is_cut_until: Timestamp::ZERO,
            design_delay: DESIGN_DELAY,
            write_error: None,
        })
    }

    /// Writes truth beside estimate from now on.
    pub fn write_truth(&mut self, file: TruthFile) {
        self.truth = Some(file);
    }

    /// For tests of failsafes: the bytes of the inertial unit are lost for a time.
    pub fn cut_line(&mut self, duration: Duration) {
        self.line_is_cut_until = self.now + duration;
    }

    /// For tests of the loop beside it: gains take this long to be made.
    pub const fn delay_gains(&mut self, duration: Duration) {
        self.design_delay = duration;
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
        self.ground.receive(self.now, link, bytes, is_datagram);
        self.drain_ground();
    }

    /// The disk answered.
    pub fn disk(&mut self, ticket: Ticket, reply: &DiskReply) {
        self.ground.disk(self.now, ticket, reply);
        self.drain_ground();
    }

    /// Asks the vehicle to come down and end.
    pub fn shut_down(&mut self) {
        self.ask(Request::ShutDown);
    }

    /// Tells how the computer is.
    pub fn host(&mut self, report: HostReport) {
        self.feed(UquadInput::Host(report));
    }

    /// A request of this program itself.
    pub fn ask(&mut self, request: Request) {
        let asked = Asked {
            id: RequestId(0),
            station: Station::default(),
            request,
        };
        self.feed(UquadInput::Asked(asked));
    }

    /// The next thing for the shell, if any.
    pub fn poll(&mut self) -> Option<Outgoing> {
        self.outgoing.pop_front()
    }

    /// Lets virtual time pass.
    pub fn advance(&mut self, until: Timestamp) {
        while self.now < until {
            self.step();
        }
    }

    fn step(&mut self) {
        let now = self.now + sim::STEP;
        self.now = now;
        self.bus.advance(now.us());
        self.simulator.turn_motors(0, self.bus.speeds_radps());
        let inputs = &mut self.inputs;
        self.simulator.advance(now, &mut |vehicle, output| {
            if vehicle == 0 {
                inputs.extend(input_of(output));
            }
        });
        self.listen(now);
        if let Some((_, job)) = self.jobs.pop_front_if(|(at, _)| *at <= now) {
            let found = estimator::search(&job);
            self.inputs.push_back(UquadInput::JobDone(found));
        }
        if let Some((_, request)) = self.designs.pop_front_if(|(at, _)| *at <= now) {
            let made = laws::make(&request);
            self.inputs.push_back(UquadInput::Designed(made));
        }
        while let Some(input) = self.inputs.pop_front() {
            self.feed(input);
        }
        self.feed(UquadInput::Wake);
        self.driver.poll(now, &mut self.bus);
        let ticks = self.flight.snapshot().flight_loop.ticks;
        if ticks != self.ticks_seen {
            self.ticks_seen = ticks;
            self.ground.snapshot(now, self.flight.snapshot());
        }
        if self.ground.deadline() <= now {
            self.ground.tick(now);
        }
        self.drain_ground();
        if self.truth_pace.is_due(now)
            && let Some(truth) = &mut self.truth
        {
            let row = Row::take(now, &self.simulator, 0, self.flight.snapshot());
            if let Err(e) = truth.write(&row) {
                self.write_error.get_or_insert(e);
            }
        }
    }

    /// The board samples and sends; what the port has is handed over.
    fn listen(&mut self, now: Timestamp) {
        if let Some(environment) = self.simulator.environment(0) {
            self.board.feel(environment);
        }
        self.received.clear();
        self.board.advance(now.us(), &mut self.received);
        if now >= self.line_is_cut_until {
            self.on_line.extend(self.received.iter().map(|r| r.byte));
        }
        if now.us().is_multiple_of(PORT_MS * 1000) && !self.on_line.is_empty() {
            let most = FcBytes::new_const().capacity();
            let taken = self.on_line.len().min(most);
            let bytes: FcBytes = self.on_line.drain(..taken).collect();
            self.inputs.push_back(UquadInput::Imu(bytes));
        }
    }

    fn feed(&mut self, input: UquadInput) {
        self.flight.handle(self.now, input);
        while let Some(output) = self.flight.poll() {
            match output {
                UquadOutput::Motors(message) => {
                    // The driver is a process of its own: its answer comes with the next millisecond.
                    let ack = self.driver.handle(self.now, &message);
                    self.inputs.extend(ack.map(UquadInput::Ack));
                }
                UquadOutput::Answer(answer) => self.ground.answer(self.now, &answer),
                UquadOutput::Event(event) => self.ground.event(self.now, &event),
                UquadOutput::Job(job) => self.jobs.push_back((self.now + JOB_DELAY, job)),
                UquadOutput::Design(request) => {
                    self.designs
                        .push_back((self.now + self.design_delay, request));
                }
            }
        }
    }

    fn drain_ground(&mut self) {
        while let Some(output) = self.ground.poll() {
            match Due::of(output, &mut self.simulator, self.rangers) {
                Due::Ask(asked) => self.feed(UquadInput::Asked(asked)),
                Due::Answer(answer) => self.ground.answer(self.now, &answer),
                Due::Out(out) => self.outgoing.push_back(out),
            }
        }
    }

    /// Writes what is buffered.
    pub fn flush(&mut self) {
        if let Some(truth) = &mut self.truth
            && let Err(e) = truth.flush()
        {
            self.write_error.get_or_insert(e);
        }
    }
}

fn input_of(output: SimOutput) -> Option<UquadInput> {
    match output {
        SimOutput::FcBytes { .. } | SimOutput::Laser { .. } => None,
        SimOutput::Ranger(reading) => Some(UquadInput::Ranger(reading)),
        SimOutput::DownRange(sample) => Some(UquadInput::DownRange(sample)),
        SimOutput::Flow(sample) => Some(UquadInput::Flow(sample)),
    }
}
