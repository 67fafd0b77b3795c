//! Everything that sets or starts something, and batches of questions.

use super::FlightController;
use super::manner::{Batch, MULTIWII_SET_BOX, SET_RXFAIL_CONFIG};
use super::receiver::WithoutSignal;
use crate::quad::Quad;
use arrayvec::ArrayVec;
use msp::command;
use msp::message::multiple::{MultipleRequest, push_reply};
use msp::message::{
    FailsafeConfig, FeatureConfig, ModeRange, Name, Reboot, RxConfig, RxMap, SetArmingDisabled,
    SetModeRange, SetMotor, SetRawRc,
};
use msp::server::Request;
use vehicle::Timestamp;

/// What became of a request.
enum Outcome {
    Answered,
    Done,
    Refused,
}

impl FlightController {
    /// Handles one request and leaves the reply in the server's output.
    pub(super) fn carry_out(&mut self, now: Timestamp, request: &Request, quad: &Quad) {
        let mut payload = core::mem::take(&mut self.payload);
        payload.clear();
        let outcome = self
            .obey(now, request, &mut payload)
            .unwrap_or_else(|| self.ask(request, quad, &mut payload));
        match outcome {
            Outcome::Answered => self.server.reply(request, &payload),
            Outcome::Done => self.server.acknowledge(request),
            Outcome::Refused => self.server.refuse(request),
        }
        self.payload = payload;
    }

    fn ask(&mut self, request: &Request, quad: &Quad, payload: &mut Vec<u8>) -> Outcome {
        let known = if request.command == command::MULTIPLE_MSP {
            self.ask_several(request, quad, payload)
        } else {
            self.answer(request.command, quad, payload)
        };
        if known {
            Outcome::Answered
        } else {
            Outcome::Refused
        }
    }

    /// What happens at a question it does not know is a matter of manners.
    fn ask_several(&mut self, request: &Request, quad: &Quad, payload: &mut Vec<u8>) -> bool {
        let manner = self.table.batch;
        let Ok(batch) = request.parse::<MultipleRequest>() else {
            return false;
        };
        if manner == Batch::Unknown {
            return false;
        }
        let mut one = core::mem::take(&mut self.batch);
        for question in &batch.commands {
            one.clear();
            if !self.answer(u16::from(*question), quad, &mut one) {
                if manner == Batch::Refused {
                    self.batch = one;
                    return false;
                }
                break;
            }
            push_reply(&one, payload);
        }
        self.batch = one;
        !batch.commands.is_empty()
    }

    /// None for a request that is no order.
    fn obey(
        &mut self,
        now: Timestamp,
        request: &Request,
        payload: &mut Vec<u8>,
    ) -> Option<Outcome> {
        if !self.table.orders.contains(&request.command) {
            return None;
        }
        let done = match request.command {
            command::SET_RAW_RC => self.set_raw_rc(now, request),
            command::SET_MOTOR => self.set_motor(request),
            command::SET_ARMING_DISABLED => self.set_arming_disabled(request),
            command::SET_MODE_RANGE => self.set_mode_range(request),
            command::SET_FEATURE_CONFIG => self.set_features(request),
            command::SET_RX_CONFIG => self.set_rx_config(request),
            command::SET_RX_MAP => self.set_rx_map(request),
            command::SET_FAILSAFE_CONFIG => self.set_failsafe(request),
            command::SET_NAME => self.set_name(request),
            SET_RXFAIL_CONFIG => self.set_rxfail(request),
            MULTIWII_SET_BOX => self.set_switches(request),
            // Saving stops a real controller for a moment; it refuses while armed.
            command::EEPROM_WRITE => {
                let may = !self.arming.is_armed();
                if may {
                    self.save(now);
                }
                may
            }
            // Acknowledged but ignored when armed.
            command::ACC_CALIBRATION => {
                self.arming.calibrate(now);
                true
            }
            command::REBOOT => {
                if self.arming.is_armed() {
                    return Some(Outcome::Refused);
                }
                msp::Message::emit(&Reboot { mode: Some(0) }, payload);
                self.reboot(now);
                return Some(Outcome::Answered);
            }
            _ => return None,
        };
        Some(if done {
            Outcome::Done
        } else {
            Outcome::Refused
        })
    }

    fn set_raw_rc(&mut self, now: Timestamp, request: &Request) -> bool {
        let Ok(rc) = request.parse::<SetRawRc>() else {
            return false;
        };
        let fits = rc.channels_us.len() <= self.table.wire.most_channels;
        if fits {
            let order = self.settings.rc_order;
            self.receiver.take(now, &rc.channels_us, order);
        }
        fits
    }

    /// Obeyed only while disarmed; the values stay until changed.
    fn set_motor(&mut self, request: &Request) -> bool {
        let Ok(motors) = request.parse::<SetMotor>() else {
            return false;
        };
        if !self.arming.is_armed() {
            self.motor_test_us.copy_from_slice(&motors.motors_us[..4]);
        }
        true
    }

    fn set_arming_disabled(&mut self, request: &Request) -> bool {
        let Ok(order) = request.parse::<SetArmingDisabled>() else {
            return false;
        };
        self.arming.block_by_msp(order.disable != 0);
        true
    }

    fn set_mode_range(&mut self, request: &Request) -> bool {
        let Ok(order) = request.parse::<SetModeRange>() else {
            return false;
        };
        let known = self.table.has_box(order.range.permanent_id);
        let slots = &mut self.settings.mode_ranges;
        match slots.get_mut(usize::from(order.slot)) {
            Some(slot) if known => {
                *slot = order.range;
                true
            }
            _ => false,
        }
    }

    /// SET_BOX of MultiWii, as the answer to BOX.
    fn set_switches(&mut self, request: &Request) -> bool {
        const POSITIONS_US: [[u16; 2]; 3] = [[900, 1300], [1300, 1700], [1700, 2100]];
        if request.payload.len() != 2 * self.table.boxes.len() {
            return false;
        }
        let slots = &mut self.settings.mode_ranges;
        slots.fill(ModeRange::default());
        let mut free = slots.iter_mut();
        for ((id, _), word) in self.table.boxes.iter().zip(request.payload.chunks_exact(2)) {
            let word = u16::from_le_bytes([word[0], word[1]]);
            for bit in (0..12_u8).filter(|bit| word & 1 << bit != 0) {
                let [low_us, high_us] = POSITIONS_US[usize::from(bit % 3)];
                if let Some(slot) = free.next() {
                    *slot = ModeRange::from_us(*id, bit / 3, low_us, high_us);
                }
            }
        }
        true
    }

    fn set_features(&mut self, request: &Request) -> bool {
        let config = request.parse::<FeatureConfig>();
        config
            .map(|config| self.settings.features = config.features)
            .is_ok()
    }

    /// A shorter payload, of an older configurator, leaves the rest as it is.
    fn set_rx_config(&mut self, request: &Request) -> bool {
        let Ok(mut config) = request.parse::<RxConfig>() else {
            return false;
        };
        keep_rest(&mut config.rest, &self.settings.rx.rest);
        self.settings.rx = config;
        true
    }

    fn set_rx_map(&mut self, request: &Request) -> bool {
        let length = self.table.wire.rx_map_len;
        let map = request.parse::<RxMap>();
        map.is_ok_and(|map| map.map.len() == length && self.settings.set_rx_map(&map))
    }

    fn set_failsafe(&mut self, request: &Request) -> bool {
        let Ok(mut config) = request.parse::<FailsafeConfig>() else {
            return false;
        };
        keep_rest(&mut config.rest, &self.settings.failsafe.rest);
        self.settings.failsafe = config;
        true
    }

    /// Channel u8, mode u8, value u16.
    fn set_rxfail(&mut self, request: &Request) -> bool {
        let [channel, mode, low, high] = *request.payload.as_slice() else {
            return false;
        };
        let then = WithoutSignal::parse(mode, u16::from_le_bytes([low, high]));
        let slots = &mut self.settings.without_signal;
        match (slots.get_mut(usize::from(channel)), then) {
            (Some(slot), Some(then)) => {
                *slot = then;
                true
            }
            _ => false,
        }
    }

    fn set_name(&mut self, request: &Request) -> bool {
        let name = request.parse::<Name>();
        name.map(|name| self.settings.name = name.name).is_ok()
    }
}

/// What an older configurator did not send stays as it is; what a newer one sent beyond is ignored.
fn keep_rest<const N: usize>(sent: &mut ArrayVec<u8, N>, kept: &ArrayVec<u8, N>) {
    sent.truncate(kept.len());
    let n = sent.len();
    sent.extend(kept.iter().copied().skip(n));
}
