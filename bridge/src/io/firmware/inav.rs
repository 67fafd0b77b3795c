//! INAV in the loop: one MSP port is flown by, another takes the simulated sensors and tells the motors.
//!
//! Somebody else has started it, so it is looked for again when it is gone. It answers each state; while it has not, because
//! the machine has taken the processor from it, the world waits, but not for one that is dead.

use super::super::clock::Clock;
use super::super::endpoint::Endpoint;
use super::super::line::Line;
use crate::autopilot::io::{FcBytes, Input};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::AsFd as _;
use sim::Simulator;
use sim::firmware::Felt;
use sim::firmware::inav::{self, Link, Told};
use std::collections::VecDeque;
use std::io;
use std::time::Duration;
use vehicle::{Pace, Timestamp};

/// Lines that are closed are tried this often, Hz.
const LOOK_HZ: f64 = 2.0;
/// The world goes on for so long without an answer.
const PATIENCE: Duration = Duration::from_millis(4);
/// It does not wait for longer than this.
const LONGEST: Duration = Duration::from_millis(90);
/// Longest sleep while it waits.
const NAP: Duration = Duration::from_millis(2);

/// The lines to a running INAV. Dropping it ends the simulation.
#[derive(Debug)]
pub struct InavLine {
    fc: Endpoint,
    sensors: Endpoint,
    /// After its line has opened nothing is simulated for so long.
    settle: Duration,
    flying: Option<Line>,
    simulating: Option<(Line, Link)>,
    look: Pace,
    wall: Clock,
    newest: Option<[f64; 4]>,
    felt: Option<Felt>,
    was_open: bool,
    news: VecDeque<String>,
}

impl InavLine {
    /// The ports of an INAV; they open when the simulation runs.
    #[must_use]
    pub fn new(fc: Endpoint, sensors: Endpoint, settle: Duration) -> Self {
        Self {
            fc,
            sensors,
            settle,
            flying: None,
            simulating: None,
            look: Pace::hz(LOOK_HZ),
            wall: Clock::start(1.0),
            newest: None,
            felt: None,
            was_open: false,
            news: VecDeque::new(),
        }
    }

    /// After each step of the simulation: the newest motor commands in, the state out, bytes of the port it is flown by to
    /// the inputs.
    pub fn exchange(
        &mut self,
        now: Timestamp,
        simulator: &mut Simulator,
        inputs: &mut VecDeque<Input>,
    ) {
        self.hear();
        if let Some(commands) = self.newest.take() {
            simulator.command_motors(0, commands);
        }
        self.felt = simulator.felt(0);
        self.tell_state();
        if self.simulating.is_none() && self.was_open {
            // Without a controller no motor turns.
            simulator.command_motors(0, [0.0; 4]);
            self.was_open = false;
            self.tell_once("the firmware's sensor port is closed".to_owned());
        }
        if self.look.is_due(now) {
            self.open(inputs);
        }
        self.read_flying(inputs);
    }

    /// Whether the world may go on. If not, it has napped already: look after the rest of the program and come again.
    pub fn keeps_up(&mut self) -> bool {
        self.hear();
        if !self.waits() {
            return true;
        }
        if let Some((line, _)) = &self.simulating {
            let nap = Timespec {
                tv_sec: 0,
                tv_nsec: i64::from(NAP.subsec_nanos()),
            };
            let mut fds = [PollFd::from_borrowed_fd(line.as_fd(), PollFlags::IN)];
            let _ = poll(&mut fds, Some(&nap));
        }
        self.hear();
        !self.waits()
    }

    fn waits(&self) -> bool {
        let link = self.simulating.as_ref().map(|(_, link)| link);
        link.and_then(|link| link.waits(self.wall.now()))
            .is_some_and(|waited| (PATIENCE..=LONGEST).contains(&waited))
    }

    fn open(&mut self, inputs: &mut VecDeque<Input>) {
        if self.simulating.is_none()
            && let Ok(line) = Line::open(&self.sensors)
        {
            let link = Link::new(self.wall.now() + self.settle);
            self.simulating = Some((line, link));
            self.was_open = true;
        }
        if self.flying.is_none()
            && let Ok(line) = Line::open(&self.fc)
        {
            self.flying = Some(line);
            inputs.push_back(Input::FcOpened);
        }
    }

    fn tell_state(&mut self) {
        let (Some(felt), Some((line, link))) = (&self.felt, &mut self.simulating) else {
            return;
        };
        link.tell(self.wall.now(), felt);
        if let Some(bytes) = link.poll_transmit()
            && line.write(&bytes).is_err()
        {
            self.simulating = None;
        }
    }

    fn hear(&mut self) {
        let mut buffer = [0; 1024];
        for _ in 0..16 {
            let Some((line, link)) = &mut self.simulating else {
                return;
            };
            let told = match line.read(&mut buffer) {
                Ok(0) => {
                    self.simulating = None;
                    return;
                }
                Ok(n) => link.handle(&buffer[..n]),
                Err(e) if e.kind() == io::ErrorKind::Interrupted => None,
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => return,
                Err(_) => {
                    self.simulating = None;
                    return;
                }
            };
            match told {
                Some(Told::Motors(commands)) => self.newest = Some(commands),
                Some(Told::Refused) => self.tell_once(
                    "the firmware refuses MSP_SIMULATOR: its build has none, or another version of it"
                        .to_owned(),
                ),
                None => {}
            }
        }
    }

    fn read_flying(&mut self, inputs: &mut VecDeque<Input>) {
        let mut buffer = [0; 256];
        for _ in 0..16 {
            let Some(line) = &mut self.flying else { return };
            match line.read(&mut buffer) {
                Ok(0) => self.lose_flying(inputs),
                Ok(n) => {
                    let bytes: FcBytes = buffer[..n].iter().copied().collect();
                    inputs.push_back(Input::Fc(bytes));
                }
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => return,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => self.lose_flying(inputs),
            }
        }
    }

    fn lose_flying(&mut self, inputs: &mut VecDeque<Input>) {
        self.flying = None;
        inputs.push_back(Input::FcClosed);
        self.tell_once("the firmware's port is closed: trying again until it is there".to_owned());
    }

    /// The companion computer writes to the port it flies by.
    pub fn write(&mut self, bytes: &[u8]) {
        // One that is gone is seen at the next reading.
        let _ = self.flying.as_mut().map(|line| line.write(bytes));
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

impl Drop for InavLine {
    fn drop(&mut self) {
        // Its own sensors again; one that is gone needs no word.
        if let Some((line, _)) = &mut self.simulating {
            let _ = line.write(&inav::end());
        }
    }
}
