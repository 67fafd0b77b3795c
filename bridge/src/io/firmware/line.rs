//! States out, motors in, MSP by TCP: what the lockstep carries every millisecond.
//!
//! The firmware answers nearly every state with motor commands. When it does not, because the machine has taken the processor
//! from it, the world waits: a body that flew on by commands of a tenth of a second ago would tumble, and that would be the
//! machine's doing, not the firmware's. It does not wait for one that is dead (`patience`).

use super::super::clock::Clock;
use super::patience::Patience;
use super::pause::Pause;
use super::process::{Firmware, StartError, connect_uart};
use crate::autopilot::io::{FcBytes, Input};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use sim::Simulator;
use sim::firmware::Felt;
use sim::firmware::betaflight::{Dialect, MOTOR_PORT, STATE_PORT, motors, state_packet};
use std::collections::VecDeque;
use std::io::{self, Read as _, Write as _};
use std::net::{Ipv4Addr, TcpStream, UdpSocket};
use std::sync::Arc;
use std::time::Duration;
use vehicle::{Pace, Timestamp};

/// Looks at the process and at a closed UART this often, Hz.
const LOOK_HZ: f64 = 10.0;
/// Longest silence of motors before it counts as stuck, when states go out. About one start in twelve gets stuck: its
/// scheduler does not run, cycle time 0, boot grace for ever.
const STUCK: Duration = Duration::from_secs(3);
/// Times without states or motors that are worth a line: the firmware integrates on while it hears nothing new.
const LATE: Duration = Duration::from_millis(30);
/// Longest sleep while it waits; then the state is sent again.
const NAP: Duration = Duration::from_millis(2);

/// A running firmware and the lines to it.
#[derive(Debug)]
pub struct FirmwareLine {
    firmware: Firmware,
    dialect: Dialect,
    states: UdpSocket,
    motors: UdpSocket,
    uart: Option<TcpStream>,
    look: Pace,
    /// When motors came last, on the clock of the simulation.
    heard: Timestamp,
    wall: Clock,
    patience: Patience,
    pause: Arc<Pause>,
    newest: Option<[f64; 4]>,
    felt: Option<Felt>,
    news: VecDeque<String>,
}

impl FirmwareLine {
    /// Opens the sockets to a firmware that runs.
    ///
    /// # Errors
    /// [`StartError::PortTaken`]: another program takes its motors.
    pub fn open(firmware: Firmware, dialect: Dialect) -> Result<Self, StartError> {
        let motors = UdpSocket::bind((Ipv4Addr::LOCALHOST, MOTOR_PORT))
            .map_err(|_| StartError::PortTaken(MOTOR_PORT))?;
        motors.set_nonblocking(true)?;
        let states = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        states.connect((Ipv4Addr::LOCALHOST, STATE_PORT))?;
        states.set_nonblocking(true)?;
        Ok(Self {
            firmware,
            dialect,
            states,
            motors,
            uart: None,
            look: Pace::hz(LOOK_HZ),
            heard: Timestamp::ZERO,
            wall: Clock::start(1.0),
            patience: Patience::default(),
            pause: Pause::start()?,
            newest: None,
            felt: None,
            news: VecDeque::new(),
        })
    }

    /// After each step of the simulation: the newest motor commands in, the state out, bytes of the UART to the inputs.
    pub fn exchange(
        &mut self,
        now: Timestamp,
        simulator: &mut Simulator,
        inputs: &mut VecDeque<Input>,
    ) {
        self.hear();
        if let Some(commands) = self.newest.take() {
            simulator.command_motors(0, commands);
            self.heard = now;
        }
        self.felt = simulator.felt(0);
        self.tell_state();
        if self.look.is_due(now) {
            self.look_after(now, simulator, inputs);
        }
        self.read_uart(inputs);
    }

    /// Whether the world may go on. If not, it has napped already: look after the rest of the program and come again.
    pub fn keeps_up(&mut self) -> bool {
        self.hear();
        if !self.patience.waits(self.wall.now()) {
            return true;
        }
        let nap = Timespec {
            tv_sec: 0,
            tv_nsec: i64::from(NAP.subsec_nanos()),
        };
        let _ = poll(&mut [PollFd::new(&self.motors, PollFlags::IN)], Some(&nap));
        self.hear();
        let waits = self.patience.waits(self.wall.now());
        if waits {
            // The last one may have been lost.
            self.tell_state();
        }
        !waits
    }

    fn tell_state(&mut self) {
        if let Some(felt) = &self.felt {
            self.pause.told(self.firmware.group());
            // Nobody there while it restarts: the next one is a millisecond away.
            let _ = self.states.send(&state_packet(self.dialect, felt));
            self.patience.told(self.wall.now());
        }
    }

    /// Takes the newest motor commands.
    fn hear(&mut self) {
        let mut buffer = [0; 64];
        let mut newest = None;
        // Bounded: it sends at most one for each state.
        for _ in 0..64 {
            match self.motors.recv(&mut buffer) {
                Ok(n) => newest = motors(self.dialect, &buffer[..n]).ok().or(newest),
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => break,
            }
        }
        if newest.is_some() {
            self.newest = newest;
            self.patience.heard(self.wall.now());
            self.firmware.is_alive();
        }
    }

    fn look_after(
        &mut self,
        now: Timestamp,
        simulator: &mut Simulator,
        inputs: &mut VecDeque<Input>,
    ) {
        match self.firmware.restart_if_ended() {
            Ok(false) => {}
            Ok(true) => {
                // Without a controller no motor turns.
                simulator.command_motors(0, [0.0; 4]);
                self.uart = None;
                self.heard = now;
                self.news.push_back("the firmware restarted".to_owned());
            }
            Err(e) => {
                simulator.command_motors(0, [0.0; 4]);
                self.tell_once(e.to_string());
            }
        }
        let (gap, silence) = self.patience.take_longest();
        if gap > LATE || silence > LATE {
            self.news.push_back(format!(
                "the machine is busy: {} ms without a state, {} ms without motors, stopped {} times (at {:.2} s)",
                gap.as_millis(),
                silence.as_millis(),
                self.pause.stops(),
                now.s()
            ));
        }
        if now.since(self.heard) > STUCK {
            simulator.command_motors(0, [0.0; 4]);
            self.uart = None;
            self.heard = now;
            let text = match self.firmware.restart() {
                Ok(()) => format!(
                    "the firmware has sent no motor command for {} s: started again",
                    STUCK.as_secs()
                ),
                Err(e) => e.to_string(),
            };
            self.tell_once(text);
        }
        if self.uart.is_none()
            && let Ok(stream) = connect_uart()
        {
            self.uart = Some(stream);
            inputs.push_back(Input::FcOpened);
        }
    }

    fn read_uart(&mut self, inputs: &mut VecDeque<Input>) {
        let mut buffer = [0; 256];
        for _ in 0..16 {
            let Some(uart) = &mut self.uart else { return };
            match uart.read(&mut buffer) {
                Ok(0) => self.uart = None,
                Ok(n) => {
                    let bytes: FcBytes = buffer[..n].iter().copied().collect();
                    inputs.push_back(Input::Fc(bytes));
                }
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => return,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => self.uart = None,
            }
        }
    }

    /// The companion computer writes to the UART.
    pub fn write(&mut self, bytes: &[u8]) {
        // A full buffer means it does not read: what does not fit now is too old later.
        if let Some(uart) = &mut self.uart
            && let Err(e) = uart.write(bytes)
            && e.kind() != io::ErrorKind::WouldBlock
        {
            self.uart = None;
        }
    }

    /// The next thing worth a line on the terminal.
    pub fn poll_news(&mut self) -> Option<String> {
        self.news.pop_front()
    }

    fn tell_once(&mut self, text: String) {
        if self.news.back() != Some(&text) {
            self.news.push_back(text);
        }
    }
}
