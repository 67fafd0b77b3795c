//! INAV flown by MSP_SIMULATOR: the simulated body as its sensors, its motors by MSP_MOTOR.
//!
//! ```text
//! wait until it has settled -> state + question for the motors -> both answered -> the next state ...
//!                                            no answer for 0.1 s: the newest state again
//! ```
//!
//! One pair is under way at a time: a second would only queue up behind it in the firmware. The attitude goes as it is felt
//! instead of by INAV's own estimator, because indoors there is no heading for that one to hold on to. The stabilised outputs
//! in the answer stay 0 with a mixer of its own, so motors are asked for.
//!
//! | Field | From FRD, NED |
//! | --- | --- |
//! | roll, pitch, yaw, 0.1 deg | roll, **-pitch** (nose down +), heading 0..=3599 |
//! | acceleration, 0.001 g | (fx, -fy, -fz): level at rest (0, 0, 1000) |
//! | rate, 1/16 deg/s | (wx, -wy, -wz) |
//! | altitude, pressure | barometer; no GPS fix |
//!
//! A simulation that is switched on within about two seconds of the start can leave INAV calibrating for ever.

use super::{Felt, pressure_pa};
use arrayvec::ArrayVec;
use core::time::Duration;
use msp::message::simulator::{SimulatorRequest, VERSION, flag};
use msp::message::{Motor, SimulatorReply};
use msp::{Accept, Decoder, Direction, Framing, Message, command};
use vehicle::Timestamp;

/// After the line has opened nothing is simulated for so long.
pub const SETTLE: Duration = Duration::from_secs(5);
/// A state unanswered for so long is given up.
const ANSWER: Duration = Duration::from_millis(100);
/// Standard gravity, m/s2.
const G: f64 = 9.806_65;

/// A state as INAV takes it.
#[must_use]
pub fn state(felt: &Felt) -> SimulatorRequest {
    let (roll, pitch, yaw) = felt.attitude.roll_pitch_yaw();
    let flu = |v: &vehicle::In<vehicle::Frd>, scale: f64| {
        [
            whole(v.x() * scale),
            whole(-v.y() * scale),
            whole(-v.z() * scale),
        ]
    };
    let gyro_scale = 16.0 * core::f64::consts::PI.recip() * 180.0;
    SimulatorRequest {
        version: VERSION,
        flags: flag::ENABLE,
        altitude_cm: (felt.altitude_m * 100.0).round() as i32,
        roll_ddeg: whole(roll.to_degrees() * 10.0),
        pitch_ddeg: whole(-pitch.to_degrees() * 10.0),
        yaw_ddeg: whole(yaw.to_degrees() * 10.0).rem_euclid(3600),
        acc_mg: flu(&felt.specific_force_mps2, 1000.0 / G),
        gyro_16th_dps: flu(&felt.rates_radps, gyro_scale),
        pressure_pa: pressure_pa(felt.altitude_m).round() as u32,
        ..SimulatorRequest::default()
    }
}

/// The nearest whole number that the field holds; what is no number counts as 0.
fn whole(value: f64) -> i16 {
    value.round() as i16
}

/// The order that ends a simulation.
#[must_use]
pub fn end() -> Vec<u8> {
    let mut out = Vec::new();
    let request = SimulatorRequest {
        version: VERSION,
        ..SimulatorRequest::default()
    };
    push(&request, &mut out);
    out
}

fn push(message: &impl Message, out: &mut Vec<u8>) {
    let mut payload = Vec::with_capacity(64);
    message.emit(&mut payload);
    push_raw(command_of(message), &payload, out);
}

const fn command_of<M: Message>(_: &M) -> u16 {
    M::COMMAND
}

fn push_raw(command: u16, payload: &[u8], out: &mut Vec<u8>) {
    let framing = if command < 255 {
        Framing::V1
    } else {
        Framing::V2
    };
    // Neither is as long as a frame can be.
    let _ = msp::encode(framing, Direction::Request, command, payload, out);
}

/// What the firmware told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Told {
    /// Commands of motors 1 to 4, 0..=1.
    Motors([f64; 4]),
    /// It refuses to be simulated: another version of the message, or a build without it.
    Refused,
}

/// The protocol on an open line: after [`tell`](Self::tell) write what [`poll_transmit`](Self::poll_transmit) has.
#[derive(Debug)]
pub struct Link {
    decoder: Decoder,
    not_before: Timestamp,
    /// When the pair under way was sent.
    asked: Option<Timestamp>,
    has_motors: bool,
    has_state: bool,
    out: Vec<u8>,
    lost: u64,
}

impl Link {
    /// The line is open; nothing is simulated before a time, usually [`SETTLE`] after that.
    #[must_use]
    pub fn new(not_before: Timestamp) -> Self {
        Self {
            decoder: Decoder::new(Accept::Replies),
            not_before,
            asked: None,
            has_motors: false,
            has_state: false,
            out: Vec::with_capacity(128),
            lost: 0,
        }
    }

    /// The newest state. It is sent at once unless an answer is awaited.
    pub fn tell(&mut self, now: Timestamp, felt: &Felt) {
        if now < self.not_before {
            return;
        }
        if let Some(asked) = self.asked {
            if now.since(asked) < ANSWER {
                return;
            }
            // The rest of a cut answer must not swallow the next.
            self.decoder.clear();
            self.lost += 1;
        }
        self.asked = Some(now);
        (self.has_state, self.has_motors) = (false, false);
        self.out.clear();
        push(&state(felt), &mut self.out);
        push_raw(command::MOTOR, &[], &mut self.out);
    }

    /// Bytes to write, once.
    pub fn poll_transmit(&mut self) -> Option<Vec<u8>> {
        (!self.out.is_empty()).then(|| core::mem::take(&mut self.out))
    }

    /// Bytes from the firmware: the newest of what it told.
    pub fn handle(&mut self, mut bytes: &[u8]) -> Option<Told> {
        let mut told = None;
        while let Some(frame) = self.decoder.decode(&mut bytes) {
            match (frame.command, frame.direction) {
                (command::SIMULATOR, Direction::Error) => told = Some(Told::Refused),
                (command::SIMULATOR, _) => {
                    self.has_state |= SimulatorReply::parse(frame.payload).is_ok();
                }
                (command::MOTOR, Direction::Reply) => {
                    if let Ok(motor) = Motor::parse(frame.payload) {
                        told = Some(Told::Motors(commands(&motor)));
                        self.has_motors = true;
                    }
                }
                _ => {}
            }
        }
        if self.has_state && self.has_motors {
            self.asked = None;
        }
        told
    }

    /// How long the answer under way has been awaited.
    #[must_use]
    pub fn waits(&self, now: Timestamp) -> Option<Duration> {
        self.asked.map(|asked| now.since(asked))
    }

    /// States that were never answered.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }
}

/// Motors 1 to 4, 0..=1; one that is absent stands still.
fn commands(motor: &Motor) -> [f64; 4] {
    let of = |us: &u16| ((f64::from(*us) - 1000.0) / 1000.0).clamp(0.0, 1.0);
    let four: ArrayVec<f64, 4> = motor.motors_us.iter().take(4).map(of).collect();
    four.into_inner().unwrap_or([0.0; 4])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use vehicle::{In, Rot};

    const REST: [f64; 3] = [0.0, 0.0, -G];

    fn felt(roll: f64, pitch: f64, yaw: f64, force: [f64; 3], rates: [f64; 3]) -> Felt {
        let rad = f64::to_radians;
        Felt {
            rates_radps: In::new(rad(rates[0]), rad(rates[1]), rad(rates[2])),
            specific_force_mps2: In::new(force[0], force[1], force[2]),
            attitude: Rot::from_roll_pitch_yaw(rad(roll), rad(pitch), rad(yaw)),
            altitude_m: 1.25,
        }
    }

    fn level() -> Felt {
        felt(0.0, 0.0, 0.0, REST, [0.0; 3])
    }

    const fn ms(ms: u64) -> Timestamp {
        Timestamp::from_ms(ms)
    }

    #[test]
    fn level_at_rest_is_one_g_up_and_the_height_is_in_both_fields() {
        let state = state(&level());
        assert_eq!(state.acc_mg, [0, 0, 1000]);
        assert_eq!((state.altitude_cm, state.fix), (125, 0));
        assert!(
            (101_305..101_315).contains(&state.pressure_pa),
            "{}",
            state.pressure_pa
        );
        assert_eq!((state.version, state.flags), (2, flag::ENABLE));
    }

    #[test]
    fn nose_up_is_negative_pitch_and_clockwise_is_negative_z_rate() {
        let state = state(&felt(-12.3, 8.7, -90.0, REST, [30.0, 20.0, 45.0]));
        assert_eq!(
            (state.roll_ddeg, state.pitch_ddeg, state.yaw_ddeg),
            (-123, -87, 2700)
        );
        assert_eq!(state.gyro_16th_dps, [480, -320, -720]);
    }

    /// The firmware's side, built from the facts: answers in order, one frame each.
    #[derive(Default)]
    struct Inav {
        heard: Vec<SimulatorRequest>,
        motors_us: [u16; 8],
    }

    impl Inav {
        fn answer(&mut self, bytes: &[u8]) -> Vec<u8> {
            let mut decoder = Decoder::new(Accept::Requests);
            let (mut input, mut out) = (bytes, Vec::new());
            while let Some(frame) = decoder.decode(&mut input) {
                let mut payload = Vec::new();
                if frame.command == command::SIMULATOR {
                    let request = SimulatorRequest::parse(frame.payload).unwrap();
                    let reply = SimulatorReply {
                        roll: -500,
                        pitch: -500,
                        yaw: -500,
                        throttle: -500,
                        roll_ddeg: request.roll_ddeg,
                        pitch_ddeg: request.pitch_ddeg,
                        yaw_ddeg: request.yaw_ddeg,
                        ..SimulatorReply::default()
                    };
                    reply.emit(&mut payload);
                    self.heard.push(request);
                } else {
                    let motors_us = self.motors_us;
                    Motor { motors_us }.emit(&mut payload);
                }
                let reply = Direction::Reply;
                msp::encode(frame.framing, reply, frame.command, &payload, &mut out).unwrap();
            }
            out
        }
    }

    #[test]
    fn nothing_is_sent_before_it_has_settled() {
        let mut link = Link::new(ms(1000) + SETTLE);
        link.tell(ms(5999), &level());
        assert_eq!(link.poll_transmit(), None);
        link.tell(ms(6000), &level());
        assert!(link.poll_transmit().is_some());
    }

    #[test]
    fn each_state_is_answered_with_motors_before_the_next_goes() {
        let mut inav = Inav {
            motors_us: [1000, 1250, 2000, 1500, 0, 0, 0, 0],
            ..Inav::default()
        };
        let mut link = Link::new(Timestamp::ZERO);
        for k in 0..100 {
            let now = ms(6000 + k);
            link.tell(now, &level());
            let sent = link.poll_transmit().unwrap();
            link.tell(now, &level());
            assert_eq!(link.poll_transmit(), None, "one at a time");
            let told = link.handle(&inav.answer(&sent));
            assert_eq!(told, Some(Told::Motors([0.0, 0.25, 1.0, 0.5])));
            assert_eq!(link.waits(now), None);
        }
        assert_eq!((inav.heard.len(), link.lost()), (100, 0));
    }

    #[test]
    fn a_state_that_is_never_answered_gives_way_to_the_newest_after_a_tenth_of_a_second() {
        let mut link = Link::new(Timestamp::ZERO);
        link.tell(ms(6000), &level());
        link.poll_transmit();
        link.tell(ms(6099), &level());
        assert_eq!(link.poll_transmit(), None);
        link.tell(ms(6100), &level());
        assert!(link.poll_transmit().is_some());
        assert_eq!(link.lost(), 1);
    }

    #[test]
    fn a_build_that_cannot_be_simulated_says_so() {
        let mut link = Link::new(Timestamp::ZERO);
        link.tell(ms(6000), &level());
        let mut refusal = Vec::new();
        let error = Direction::Error;
        msp::encode(Framing::V2, error, command::SIMULATOR, &[], &mut refusal).unwrap();
        assert_eq!(link.handle(&refusal), Some(Told::Refused));
    }

    #[test]
    fn the_last_order_switches_the_simulation_off() {
        let mut inav = Inav::default();
        inav.answer(&end());
        assert_eq!(inav.heard[0].flags & flag::ENABLE, 0);
        assert_eq!(inav.heard[0].version, VERSION);
    }

    proptest! {
        #[test]
        fn whatever_comes_no_motor_leaves_its_range(
            motors_us in any::<[u16; 8]>(),
            noise in proptest::collection::vec(any::<u8>(), 0..100),
        ) {
            let mut inav = Inav { motors_us, ..Inav::default() };
            let mut link = Link::new(Timestamp::ZERO);
            link.handle(&noise);
            link.tell(ms(6000), &level());
            let sent = link.poll_transmit().unwrap();
            if let Some(Told::Motors(commands)) = link.handle(&inav.answer(&sent)) {
                prop_assert!(commands.iter().all(|c| (0.0..=1.0).contains(c)));
            }
        }

        #[test]
        fn whatever_is_felt_is_a_state_that_inav_reads(
            angles in any::<[f64; 3]>(), force in any::<[f64; 3]>(), rates in any::<[f64; 3]>(),
        ) {
            let state = state(&felt(angles[0], angles[1], angles[2], force, rates));
            let mut payload = Vec::new();
            state.emit(&mut payload);
            prop_assert_eq!(SimulatorRequest::parse(&payload), Ok(state));
        }
    }
}
