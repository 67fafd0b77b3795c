//! Everything that sets or starts something, and batches of questions.

use super::{FlightController, MODE_SLOTS, answers};
use crate::quad::Quad;
use msp::command;
use msp::message::multiple::{MultipleRequest, push_reply};
use msp::message::{FeatureConfig, Reboot, SetArmingDisabled, SetModeRange, SetMotor, SetRawRc};
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

    /// Betaflight 4.6 ends the list early at a question it does not know.
    fn ask_several(&mut self, request: &Request, quad: &Quad, payload: &mut Vec<u8>) -> bool {
        let Ok(batch) = request.parse::<MultipleRequest>() else {
            return false;
        };
        let mut one = core::mem::take(&mut self.batch);
        for question in &batch.commands {
            one.clear();
            if !self.answer(u16::from(*question), quad, &mut one) {
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
        let done = match request.command {
            command::SET_RAW_RC => self.set_raw_rc(now, request),
            command::SET_MOTOR => self.set_motor(request),
            command::SET_ARMING_DISABLED => self.set_arming_disabled(request),
            command::SET_MODE_RANGE => self.set_mode_range(request),
            command::SET_FEATURE_CONFIG => self.set_features(request),
            // Saving stops a real controller for a moment; it refuses while armed.
            command::EEPROM_WRITE => !self.arming.is_armed(),
            // Acknowledged but ignored when armed.
            command::ACC_CALIBRATION => true,
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
        let fits = rc.channels_us.len() <= super::receiver::CHANNELS;
        if fits {
            self.receiver.take(now, &rc.channels_us);
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
        let slot = usize::from(order.slot);
        let known = slot < MODE_SLOTS && answers::is_known_box(order.range.permanent_id);
        if known {
            self.mode_ranges[slot] = order.range;
        }
        known
    }

    fn set_features(&mut self, request: &Request) -> bool {
        let Ok(config) = request.parse::<FeatureConfig>() else {
            return false;
        };
        self.features = config.features;
        true
    }
}
