//! A small ground station as a pure machine: what `kestrel demo` and the flight tests fly with.
//!
//! It knows the vehicle only by MAVLink, like every other station.

use mavlink_dialect::command::cmd;
use mavlink_dialect::{
    Address, Decoder, Encoder, Frame, FrameBytes, Message, MessageData, mode, raw, standard,
};
use std::collections::VecDeque;
use std::time::Duration;
use vehicle::{Pace, Timestamp};

/// Our address: what ground stations use.
pub const STATION: Address = Address {
    system: 255,
    component: 190,
};
/// An unanswered command is repeated after this.
const COMMAND_RETRY: Duration = Duration::from_millis(1_500);
/// An unanswered count of an upload is repeated after this.
const COUNT_RETRY: Duration = Duration::from_millis(500);

/// What the vehicle said last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Heard {
    /// Address of the autopilot, once its heartbeat came.
    pub vehicle: Option<Address>,
    /// HEARTBEAT.base_mode says so.
    pub is_armed: bool,
    /// HEARTBEAT.custom_mode.
    pub custom_mode: u32,
    /// SYS_STATUS says an arm would be accepted.
    pub is_armable: bool,
    /// EXTENDED_SYS_STATE.landed_state.
    pub landed_state: u8,
    /// LOCAL_POSITION_NED, m.
    pub position: Option<[f64; 3]>,
    /// LOCAL_POSITION_NED, m/s.
    pub velocity: [f64; 3],
    /// Items of MISSION_ITEM_REACHED, in order.
    pub reached: Vec<u16>,
    /// MISSION_CURRENT.mission_state is "complete".
    pub is_mission_complete: bool,
    /// STATUSTEXTs, in order.
    pub texts: Vec<String>,
    /// BATTERY_STATUS.time_remaining, s; 0 unknown.
    pub battery_left_s: i32,
    /// FENCE_STATUS: outside (1) or not, and how often; none before one came.
    pub fence: Option<(u8, u16)>,
}

/// How an asked-for thing ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
    /// MAV_RESULT of a command.
    Command(u16, u8),
    /// MAV_MISSION_RESULT of an upload.
    Upload(u8),
}

/// The station.
#[derive(Debug)]
pub struct GroundStation {
    encoder: Encoder,
    decoder: Decoder,
    outgoing: VecDeque<FrameBytes>,
    replies: VecDeque<Reply>,
    heard: Heard,
    heartbeat: Pace,
    command: Option<(raw::COMMAND_LONG_DATA, Timestamp)>,
    /// Sent in another form than COMMAND_LONG, not repeated.
    expected: Option<u16>,
    upload: Option<(Vec<raw::MISSION_ITEM_INT_DATA>, Timestamp, bool)>,
    is_silent: bool,
}

impl Default for GroundStation {
    fn default() -> Self {
        Self::new(STATION)
    }
}

impl GroundStation {
    /// A station that has heard nothing.
    #[must_use]
    pub fn new(address: Address) -> Self {
        Self {
            encoder: Encoder::new(address),
            decoder: Decoder::new(),
            outgoing: VecDeque::new(),
            replies: VecDeque::new(),
            heard: Heard::default(),
            heartbeat: Pace::hz(1.0),
            command: None,
            expected: None,
            upload: None,
            is_silent: false,
        }
    }

    /// What the vehicle said.
    #[must_use]
    pub const fn heard(&self) -> &Heard {
        &self.heard
    }

    /// The next frame to send, if any.
    pub fn poll(&mut self) -> Option<FrameBytes> {
        self.outgoing.pop_front()
    }

    /// The next answer, if any.
    pub fn reply(&mut self) -> Option<Reply> {
        self.replies.pop_front()
    }

    /// Sends any message.
    pub fn send<D: MessageData>(&mut self, message: &D) {
        let frame = self.encoder.encode(message);
        self.outgoing.push_back(frame);
    }

    /// Stops (or takes up again) everything it says by itself: a lost ground station.
    pub const fn be_silent(&mut self, is_silent: bool) {
        self.is_silent = is_silent;
    }

    /// Sends a command; repeated until answered.
    pub fn command(&mut self, now: Timestamp, command: u16, params: [f32; 7]) {
        let to = self.heard.vehicle.unwrap_or(Address {
            system: 1,
            component: 1,
        });
        let [param1, param2, param3, param4, param5, param6, param7] = params;
        let data = raw::COMMAND_LONG_DATA {
            target_system: to.system,
            target_component: to.component,
            command,
            confirmation: 0,
            param1,
            param2,
            param3,
            param4,
            param5,
            param6,
            param7,
        };
        self.send(&data);
        self.command = Some((data, now));
    }

    /// Waits for the answer to a command that was sent as it is, by [`Self::send`].
    pub const fn expect(&mut self, command: u16) {
        self.expected = Some(command);
    }

    /// Arms or disarms.
    pub fn arm(&mut self, now: Timestamp, arm: bool) {
        self.command(
            now,
            cmd::COMPONENT_ARM_DISARM,
            [f32::from(u8::from(arm)), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        );
    }

    /// Sets a mode as pymavlink does.
    pub fn set_mode(&mut self, now: Timestamp, px4: mode::Px4Mode) {
        let params = [
            f32::from(mode::FLAG_CUSTOM),
            f32::from(px4.main),
            f32::from(px4.sub),
            0.0,
            0.0,
            0.0,
            0.0,
        ];
        self.command(now, cmd::DO_SET_MODE, params);
    }

    /// Uploads a mission; sequence numbers and target are filled in.
    pub fn upload(&mut self, now: Timestamp, mut items: Vec<raw::MISSION_ITEM_INT_DATA>) {
        let to = self.heard.vehicle.unwrap_or(Address {
            system: 1,
            component: 1,
        });
        for (item, seq) in items.iter_mut().zip(0u16..) {
            (item.target_system, item.target_component, item.seq) = (to.system, to.component, seq);
        }
        self.upload = Some((items, now, false));
        self.send_count();
    }

    fn send_count(&mut self) {
        let Some((items, ..)) = &self.upload else {
            return;
        };
        let to = self.heard.vehicle.unwrap_or(Address {
            system: 1,
            component: 1,
        });
        let count = raw::MISSION_COUNT_DATA {
            target_system: to.system,
            target_component: to.component,
            count: items.len() as u16,
            mission_type: items.first().map_or(0, |i| i.mission_type),
            ..Default::default()
        };
        self.send(&count);
    }

    /// Bytes from the vehicle.
    pub fn receive(&mut self, bytes: &[u8]) {
        let mut frames = Vec::new();
        self.decoder.push(bytes, |f| frames.push(f));
        for frame in frames {
            self.hear(&frame);
        }
    }

    /// Time passes.
    pub fn tick(&mut self, now: Timestamp) {
        if self.is_silent {
            return;
        }
        if self.heartbeat.is_due(now) {
            self.send(&raw::HEARTBEAT_DATA {
                mavtype: 6,
                autopilot: 8,
                mavlink_version: 3,
                ..Default::default()
            });
        }
        if let Some((data, at)) = &mut self.command
            && now.since(*at) > COMMAND_RETRY
        {
            *at = now;
            data.confirmation = data.confirmation.wrapping_add(1);
            let again = data.clone();
            self.send(&again);
        }
        if let Some((_, at, false)) = &mut self.upload
            && now.since(*at) > COUNT_RETRY
        {
            *at = now;
            self.send_count();
        }
    }

    fn hear(&mut self, frame: &Frame) {
        use raw::MavMessage as R;
        use standard::MavMessage as S;
        match &frame.message {
            Message::Raw(R::HEARTBEAT(beat)) if frame.from.component == 1 => {
                self.heard.vehicle = Some(frame.from);
                self.heard.is_armed = beat.base_mode & mode::FLAG_ARMED != 0;
                self.heard.custom_mode = beat.custom_mode;
            }
            Message::Raw(R::COMMAND_ACK(ack)) => {
                const IN_PROGRESS: u8 = 5;
                let is_ours = self.expected == Some(ack.command)
                    || matches!(&self.command, Some((data, _)) if data.command == ack.command);
                if ack.result != IN_PROGRESS && is_ours {
                    (self.command, self.expected) = (None, None);
                    self.replies
                        .push_back(Reply::Command(ack.command, ack.result));
                }
            }
            Message::Raw(R::MISSION_REQUEST_INT(request)) => {
                let item = self.upload.as_mut().and_then(|(items, _, begun)| {
                    *begun = true;
                    items.get(usize::from(request.seq)).cloned()
                });
                if let Some(item) = item {
                    self.send(&item);
                }
            }
            Message::Raw(R::MISSION_ACK(ack)) => {
                // The ACK of a list sent before may be repeated meanwhile.
                let kind = |items: &[raw::MISSION_ITEM_INT_DATA]| {
                    items.first().map_or(0, |i| i.mission_type)
                };
                if self
                    .upload
                    .take_if(|(items, ..)| kind(items) == ack.mission_type)
                    .is_some()
                {
                    self.replies.push_back(Reply::Upload(ack.mavtype));
                }
            }
            Message::Raw(R::STATUSTEXT(text)) => {
                let words = text.text.to_str().unwrap_or_default();
                self.heard.texts.push(words.to_owned());
            }
            Message::Standard(S::SYS_STATUS(status)) => {
                self.heard.is_armable = status
                    .onboard_control_sensors_health
                    .contains(standard::MavSysStatusSensor::MAV_SYS_STATUS_PREARM_CHECK);
            }
            Message::Standard(S::EXTENDED_SYS_STATE(state)) => {
                self.heard.landed_state = state.landed_state as u8
            }
            Message::Standard(S::LOCAL_POSITION_NED(p)) => {
                self.heard.position = Some([f64::from(p.x), f64::from(p.y), f64::from(p.z)]);
                self.heard.velocity = [f64::from(p.vx), f64::from(p.vy), f64::from(p.vz)];
            }
            Message::Standard(S::MISSION_ITEM_REACHED(reached)) => {
                self.heard.reached.push(reached.seq)
            }
            Message::Standard(S::BATTERY_STATUS(battery)) => {
                self.heard.battery_left_s = battery.time_remaining;
            }
            Message::Standard(S::FENCE_STATUS(fence)) => {
                self.heard.fence = Some((fence.breach_status, fence.breach_count));
            }
            Message::Standard(S::MISSION_CURRENT(current)) => {
                self.heard.is_mission_complete = current.mission_state as u8 == 5;
            }
            _ => {}
        }
    }
}

/// A waypoint in the local frame: NED about home, m; yaw none = nose along the way.
#[must_use]
pub fn waypoint(
    north_m: f64,
    east_m: f64,
    down_m: f64,
    yaw_rad: Option<f64>,
) -> raw::MISSION_ITEM_INT_DATA {
    raw::MISSION_ITEM_INT_DATA {
        frame: 1,
        command: cmd::NAV_WAYPOINT,
        autocontinue: 1,
        x: (north_m * 1e4).round() as i32,
        y: (east_m * 1e4).round() as i32,
        z: down_m as f32,
        param4: yaw_rad.map_or(f32::NAN, |yaw| yaw.to_degrees() as f32),
        ..Default::default()
    }
}

/// A take-off to a height above home, m.
#[must_use]
pub fn take_off(height_m: f64) -> raw::MISSION_ITEM_INT_DATA {
    raw::MISSION_ITEM_INT_DATA {
        frame: 3,
        command: cmd::NAV_TAKEOFF,
        autocontinue: 1,
        z: height_m as f32,
        param4: f32::NAN,
        ..Default::default()
    }
}

/// Fly home and land.
#[must_use]
pub fn return_home() -> raw::MISSION_ITEM_INT_DATA {
    raw::MISSION_ITEM_INT_DATA {
        frame: 2,
        command: cmd::NAV_RETURN_TO_LAUNCH,
        autocontinue: 1,
        ..Default::default()
    }
}
