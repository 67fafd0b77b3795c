//! The flight controller's side of `Flight`: what it says, what it is told.

use super::{Air, Event, Flight, Notice, OUTPUTS, Output, Queued, control_params};
use crate::autopilot::arming::FcArmState;
use crate::autopilot::handover::Change;
use crate::autopilot::io::FcBytes;
use crate::autopilot::mode::{Because, Mode};
use crate::autopilot::supervisor::Cleared;
use crate::fc::convert::{Convert, REPLY_WIRE_TIME, arming_blocks, cycle_time_us, four_letters};
use crate::fc::{poll, rc_out};
use core::time::Duration;
use msp::firmware::{Firmware, Identity, box_id};
use msp::message::Reply;
use msp::{Direction, Framing, command, encode};
use vehicle::angle::wrap_pi;
use vehicle::{NavState, Sticks, Timestamp};

/// A gap in our own RC frames longer than this restarts the neutral phase: the receiver flags it after 0.15 s.
const RC_GAP: Duration = Duration::from_millis(120);
/// From question to answer at 100 messages a second with two waiting, and longer than that a busy controller does not take.
const USUAL_ROUND_TRIP: Duration = Duration::from_millis(20);
const LONGEST_ROUND_TRIP: Duration = Duration::from_millis(80);

/// When the controller took the sample of a reply: just before it went onto the wire, unless it lay in the kernel while we were held
/// up; then soon after it was asked for.
fn sampled_at(sent_us: u64, received: Timestamp) -> Timestamp {
    let asked = Timestamp::from_us(sent_us);
    if received.since(asked) > LONGEST_ROUND_TRIP {
        asked + USUAL_ROUND_TRIP
    } else {
        received - REPLY_WIRE_TIME
    }
}

/// What is known about the controller's present connection.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Link {
    replies_seen: u64,
    /// When it last said anything.
    pub(super) heard: Option<Timestamp>,
    /// Since when we have been able to hear without a break of our own.
    pub(super) listening_since: Timestamp,
    /// Four letters of a firmware that is watched only.
    pub(super) unknown_firmware: Option<[u8; 4]>,
    pub(super) is_stalled: bool,
    rc_sent_at: Option<Timestamp>,
}

impl Flight {
    /// Takes in what the flight controller said.
    pub(super) fn listen(&mut self, now: Timestamp) {
        use msp::client::Event as Said;
        while let Some(said) = self.client.poll_event() {
            match said {
                Said::Identified(identity) => self.identified(now, &identity),
                Said::Reply {
                    reply,
                    sent_us,
                    received_us,
                } => {
                    let received = Timestamp::from_us(received_us);
                    self.bench_answered(now, reply.command(), true);
                    self.reply(received, sampled_at(sent_us, received), &reply);
                }
                Said::Lost { noise_bytes, .. } => self.lose_controller(noise_bytes > 0),
                Said::Slow {
                    service_rate_hz,
                    cli_line,
                    ..
                } => self.emit(Output::Event(Event::Notice(Notice::FcSlow {
                    service_hz: service_rate_hz.round() as u16,
                    has_cli_line: cli_line.is_some(),
                }))),
                Said::Refused { command } | Said::Unanswered { command } => {
                    self.bench_answered(now, command, false);
                }
                Said::Restarted => {
                    self.emit(Output::Event(Event::Notice(Notice::FcRestarted)));
                }
                Said::Stalled => {
                    self.link.is_stalled = true;
                    self.emit(Output::Event(Event::Notice(Notice::FcStalled)));
                }
                Said::Changed(_) | Said::Recovered { .. } | Said::Malformed(_) => {}
            }
        }
        let replies = self.client.statistics().replies;
        if replies != self.link.replies_seen {
            self.link.replies_seen = replies;
            self.link.heard = Some(now);
        }
    }

    fn identified(&mut self, now: Timestamp, identity: &Identity) {
        self.convert = Some(Convert::new(identity.firmware));
        let params = control_params(&self.settings, Some(identity.firmware));
        self.controller.set_params(params);
        let version = [
            identity.version.major,
            identity.version.minor,
            identity.version.patch,
        ];
        let variant = four_letters(identity.firmware);
        self.link = Link {
            replies_seen: self.link.replies_seen,
            heard: Some(now),
            listening_since: self.link.listening_since,
            unknown_firmware: matches!(identity.firmware, Firmware::Other(_)).then_some(variant),
            ..Link::default()
        };
        let schedule = poll::schedule(identity, &self.settings.autopilot);
        self.client.set_schedule(now.us(), &schedule);
        // What it said before it was away is worth nothing.
        self.fc_arm = FcArmState::default();
        self.fc.is_connected = true;
        self.fc.variant = variant;
        self.fc.version = version;
        self.fc.api = [identity.api.major, identity.api.minor];
        self.fc.rssi = None;
        self.emit(Output::Event(Event::Notice(Notice::FcFound {
            variant,
            version,
        })));
        if self.link.unknown_firmware.is_some() {
            self.emit(Output::Event(Event::Notice(Notice::FcUnknown { variant })));
        }
    }

    pub(super) fn lose_controller(&mut self, noise: bool) {
        if self.fc.is_connected {
            self.emit(Output::Event(Event::Notice(Notice::FcLost { noise })));
        }
        self.fc.is_connected = false;
        self.fc_arm.neutral_since = None;
        self.snapshot.imu = None;
    }

    fn reply(&mut self, received: Timestamp, sampled: Timestamp, reply: &Reply) {
        let Some(convert) = &mut self.convert else {
            return;
        };
        match reply {
            Reply::Attitude(a) => {
                let mut sample = convert.attitude(sampled, a);
                let offset_rad = self.settings.autopilot.heading_offset_deg.to_radians();
                sample.heading_rad = wrap_pi(sample.heading_rad + offset_rad);
                self.estimator.attitude(&sample);
                self.sampled = Some(sampled);
                self.sample_came = true;
            }
            Reply::RawImu(raw) => {
                let at_rest = !self.arming.switch_is_high();
                if let Some(sample) = convert.imu(sampled, raw, at_rest) {
                    self.estimator.imu(&sample);
                    self.snapshot.imu = Some(sample);
                }
            }
            Reply::Altitude(a) => {
                let sample = convert.baro(sampled, a);
                self.estimator.baro(&sample);
                self.snapshot.baro = Some(sample);
            }
            Reply::BatteryState(b) => {
                self.snapshot.battery = Some(convert.battery(sampled, b));
            }
            Reply::Analog(a) => {
                self.fc.rssi = Some(convert.rssi(a.rssi));
                // A message of its own that tells the cells says more.
                if self.snapshot.battery.is_none_or(|b| b.cells == 0) {
                    self.snapshot.battery = Some(convert.battery_of_analog(sampled, a));
                }
            }
            Reply::InavAnalog(a) => {
                self.fc.rssi = Some(convert.rssi(a.rssi));
                self.snapshot.battery = Some(convert.battery_of_inav(sampled, a));
            }
            Reply::SonarAltitude(s) => {
                let cos_tilt = self.estimator.navigation().state().cos_tilt();
                let sample = convert.down_range(sampled, s, cos_tilt);
                self.down_range(&sample);
            }
            Reply::InavOpticalFlow(f) => {
                let sample = convert.flow(sampled, f);
                self.flow(&sample);
            }
            Reply::RawGps(g) => {
                let Some(identity) = self.client.identity() else {
                    return;
                };
                let raw = convert.gps(identity.firmware, g);
                if let Ok(fix) = self.gnss_start.relative(sampled, &raw) {
                    self.gnss(&fix);
                }
            }
            Reply::Rc(rc) => {
                if let Some(sticks) = rc_out::sticks_of_rc(&rc.channels_us) {
                    self.handover.heard_pilot(received, sticks);
                }
            }
            Reply::Status(_) | Reply::StatusEx(_) | Reply::InavStatus(_) => {
                self.status(received, reply)
            }
            _ => {}
        }
    }

    fn status(&mut self, received: Timestamp, reply: &Reply) {
        let Some(identity) = self.client.identity() else {
            return;
        };
        let is_armed = identity.is_box_active(box_id::ARM, reply).unwrap_or(false);
        let switch_is_on = identity
            .is_box_active(box_id::MSP_OVERRIDE, reply)
            .unwrap_or(false);
        let blocks = arming_blocks(identity.firmware, reply).unwrap_or_default();
        self.fc_arm = FcArmState {
            is_armed,
            blocks,
            at: Some(received),
            ..self.fc_arm
        };
        self.fc.blocks = blocks;
        if let Reply::StatusEx(s) = reply {
            self.fc.load_percent = f64::from(s.load_pct);
        }
        if cycle_time_us(reply) != Some(0) {
            self.link.is_stalled = false;
        }
        match self.handover.observe(switch_is_on) {
            Some(Change::TakenOver) => self.pilot_took_over(received),
            Some(Change::Offered) => {
                self.emit(Output::Event(Event::Notice(Notice::PilotOffers)));
            }
            None => {}
        }
    }

    fn pilot_took_over(&mut self, now: Timestamp) {
        self.emit(Output::Event(Event::Notice(Notice::PilotTookOver)));
        let nav: NavState = *self.estimator.state();
        self.with_cockpit(now, 0.0, &nav, |arbiter, c| {
            arbiter.enter(c, Mode::Stabilized, Because::PilotTookOver)
        });
    }

    /// Hands sticks to the link; none = nothing is sent, on purpose.
    pub(super) fn send_rc(&mut self, now: Timestamp, sticks: Option<&Cleared<Sticks>>) {
        let (Some(identity), Some(sticks)) = (self.client.identity(), sticks) else {
            self.client.clear_rc();
            self.fc_arm.neutral_since = None;
            return;
        };
        if self.link.unknown_firmware.is_some() {
            return;
        }
        let arm = self.arming.switch_is_high();
        let (wire, telemetry) = rc_out::channels(sticks, arm, &identity.rx_map);
        self.client.set_rc(now.us(), &wire);
        self.snapshot.rc_us = telemetry;
    }

    /// The frame that keeps the vehicle level while we are held up.
    pub(super) fn prepare_standby(&mut self, hover_throttle: f64) {
        self.standby = None;
        let Some(identity) = self.client.identity() else {
            return;
        };
        if self.air != Air::Flying || !self.arming.is_armed() || self.handover.has_radio() {
            return;
        }
        let level = self
            .supervisor
            .clear(Sticks::IDLE, true, false, hover_throttle);
        let (wire, _) = rc_out::channels(&level, true, &identity.rx_map);
        let payload: FcBytes = wire.iter().flat_map(|us| us.to_le_bytes()).collect();
        self.encoded.clear();
        let framing = Framing::V1;
        let request = Direction::Request;
        if encode(
            framing,
            request,
            command::SET_RAW_RC,
            &payload,
            &mut self.encoded,
        )
        .is_ok()
        {
            self.standby = FcBytes::try_from(self.encoded.as_slice()).ok();
        }
    }

    /// Takes what the link wants to write, and the time from sample to command.
    pub(super) fn transmit(&mut self, now: Timestamp) {
        let rc_before = self.client.statistics().rc_sent;
        while let Some(bytes) = self.client.poll_transmit(now.us()) {
            for chunk in bytes.chunks(FcBytes::new_const().capacity()) {
                let mut out = FcBytes::new();
                let _ = out.try_extend_from_slice(chunk);
                if self.outputs.len() < OUTPUTS {
                    self.outputs.push_back(Queued::Fc(out));
                }
            }
        }
        if self.client.statistics().rc_sent == rc_before {
            return;
        }
        if let Some(sampled) = self.sampled {
            self.latency.record(now.since(sampled));
        }
        let has_gap = self.link.rc_sent_at.is_none_or(|at| now.since(at) > RC_GAP);
        self.link.rc_sent_at = Some(now);
        let is_neutral = !self.arming.switch_is_high() && self.client.is_online();
        self.fc_arm.neutral_since = match self.fc_arm.neutral_since {
            Some(since) if is_neutral && !has_gap => Some(since),
            _ => is_neutral.then_some(now),
        };
    }
}
