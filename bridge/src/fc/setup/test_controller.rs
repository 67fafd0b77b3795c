//! A controller in memory for the tests of setting one up: it keeps what it is told.

use crate::fc::conversation::{AskError, Controller, Outcome};
use msp::command;
use msp::message::{
    ApiVersion, BoxIds, FcVariant, FcVersion, FeatureConfig, ModeRange, ModeRanges, Motor, Reboot,
    Reply, Status, StatusEx, StatusExTail, StatusHead, StatusTail,
};
use std::collections::BTreeMap;

/// Settings now and as saved.
#[derive(Clone, Debug)]
pub(crate) struct TestController {
    pub(crate) now: BTreeMap<u16, Vec<u8>>,
    pub(crate) saved: BTreeMap<u16, Vec<u8>>,
    pub(crate) is_armed: bool,
    /// Refuses these.
    pub(crate) refuses: Vec<u16>,
    /// Acknowledges orders without obeying.
    pub(crate) is_deaf: bool,
    pub(crate) heard: Vec<(u16, Vec<u8>)>,
}

fn payload(reply: impl Into<Reply>) -> Vec<u8> {
    let mut out = Vec::new();
    let reply: Reply = reply.into();
    reply.emit(&mut out);
    out
}

impl TestController {
    /// Betaflight 4.6 with a serial receiver and no switch.
    pub(crate) fn betaflight() -> Self {
        let slots = [ModeRange::default(); 20].into_iter().collect();
        let mut rx_fail = Vec::new();
        for channel in 0..8 {
            let us: u16 = if channel == 3 { 875 } else { 1500 };
            rx_fail.push(u8::from(channel > 3));
            rx_fail.extend_from_slice(&us.to_le_bytes());
        }
        let settings = BTreeMap::from([
            (
                command::FEATURE_CONFIG,
                payload(FeatureConfig {
                    features: 1 << 3 | 1 << 10 | 1 << 22,
                }),
            ),
            (command::MODE_RANGES, payload(ModeRanges { slots })),
            (super::survey::RXFAIL_CONFIG, rx_fail),
        ]);
        Self {
            now: settings.clone(),
            saved: settings,
            is_armed: false,
            refuses: Vec::new(),
            is_deaf: false,
            heard: Vec::new(),
        }
    }

    fn answer(&self, command: u16) -> Option<Vec<u8>> {
        let head = StatusHead {
            cycle_time_us: 125,
            sensors: 1,
            mode_flags: u32::from(self.is_armed),
            ..StatusHead::default()
        };
        let tail = StatusTail {
            arming_disable_count: 29,
            config_state: Some(0),
            ..StatusTail::default()
        };
        Some(match command {
            command::API_VERSION => payload(ApiVersion {
                protocol: 0,
                major: 1,
                minor: 47,
            }),
            command::FC_VARIANT => payload(FcVariant { variant: *b"BTFL" }),
            command::FC_VERSION => payload(FcVersion {
                major: 4,
                minor: 6,
                patch: 0,
                text: None,
            }),
            command::BOXIDS => payload(BoxIds {
                ids: [0, 1, 3, 36].into_iter().collect(),
            }),
            command::STATUS_EX => payload(StatusEx {
                head,
                load_pct: 1,
                tail: StatusExTail::Betaflight {
                    pid_profile_count: 4,
                    rate_profile: 0,
                    tail,
                },
            }),
            command::STATUS => payload(Status {
                head,
                load_pct: Some(1),
                gyro_cycle_us: Some(0),
                tail: Some(tail),
            }),
            command::MOTOR => payload(Motor {
                motors_us: [1000, 1000, 1000, 1000, 0, 0, 0, 0],
            }),
            command::UID => vec![1; 12],
            other => self.now.get(&other)?.clone(),
        })
    }

    fn obey(&mut self, command: u16, order: &[u8]) {
        let mut set = |message: u16, at: usize, bytes: &[u8]| {
            if let Some(place) = self
                .now
                .get_mut(&message)
                .and_then(|p| p.get_mut(at..at + bytes.len()))
            {
                place.copy_from_slice(bytes);
            }
        };
        match command {
            command::SET_FEATURE_CONFIG => set(command::FEATURE_CONFIG, 0, order),
            command::SET_MODE_RANGE => set(
                command::MODE_RANGES,
                4 * usize::from(order[0]),
                &order[1..5],
            ),
            super::survey::SET_RXFAIL_CONFIG => set(
                super::survey::RXFAIL_CONFIG,
                3 * usize::from(order[0]),
                &order[1..4],
            ),
            command::EEPROM_WRITE => self.saved = self.now.clone(),
            _ => {}
        }
    }
}

impl Controller for TestController {
    fn ask(&mut self, command: u16, order: &[u8]) -> Outcome {
        self.heard.push((command, order.to_vec()));
        if self.refuses.contains(&command) || (command == command::EEPROM_WRITE && self.is_armed) {
            return Err(AskError::Refused(command));
        }
        if command == command::REBOOT {
            return Ok(payload(Reboot { mode: Some(0) }));
        }
        if let Some(answer) = self.answer(command) {
            return Ok(answer);
        }
        if matches!(
            command,
            command::SET_FEATURE_CONFIG
                | command::SET_MODE_RANGE
                | super::survey::SET_RXFAIL_CONFIG
                | command::EEPROM_WRITE
                | command::SET_MOTOR
        ) {
            if !self.is_deaf {
                self.obey(command, order);
            }
            return Ok(Vec::new());
        }
        Err(AskError::Refused(command))
    }

    fn come_back(&mut self) -> Result<(), AskError> {
        self.now = self.saved.clone();
        Ok(())
    }
}
