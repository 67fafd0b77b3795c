//! Mission items: the wire form that is stored and given back bit for bit, and what an item says, or the reason why not.
//!
//! A place is two i32 and a f32 whose meaning the frame gives:
//!
//! | frame | x, y | z |
//! | --- | --- | --- |
//! | 0 GLOBAL, 5 GLOBAL_INT | latitude, longitude, 1e-7 degrees | m above mean sea level |
//! | 3 GLOBAL_RELATIVE_ALT, 6 its INT form | the same | m above home |
//! | 1 LOCAL_NED | north, east about home, 1e-4 m | m down |
//! | 2 MISSION | not a place | |
//!
//! Source: MAVLink guide, "Mission Protocol" and MAV_FRAME; `INT32_MAX` and NaN are "not given".
//!
//! ```
//! use mavlink_dialect::mission_item::{Action, ItemFault, MissionItem, mission_result};
//! let land = MissionItem { command: 21, frame: 3, z: f32::NAN, ..Default::default() };
//! assert!(matches!(land.action(), Ok(Action::Land { at: None, .. })));
//! let odd = MissionItem { command: 4242, ..Default::default() };
//! assert_eq!(odd.action(), Err(ItemFault::Command(4242)));
//! assert_eq!(ItemFault::Command(4242).mission_result(), mission_result::UNSUPPORTED);
//! ```

mod point;

pub use self::point::{Frame, Point};

use crate::command::{cmd, degrees_to_e7, given, name};
use crate::raw;
use thiserror::Error;

/// Codes of MAV_MISSION_RESULT, as MISSION_ACK carries them.
pub mod mission_result {
    /// Taken.
    pub const ACCEPTED: u8 = 0;
    /// Refused without a better reason.
    pub const ERROR: u8 = 1;
    /// The frame of an item is not known or does not fit its command.
    pub const UNSUPPORTED_FRAME: u8 = 2;
    /// The command of an item, or the whole operation, is not known.
    pub const UNSUPPORTED: u8 = 3;
    /// More items than fit.
    pub const NO_SPACE: u8 = 4;
    /// A parameter has a value that cannot be flown.
    pub const INVALID: u8 = 5;
    /// Parameter 1; parameters 2 to 7 follow it.
    pub const INVALID_PARAM1: u8 = 6;
    /// Parameter 5, x, latitude.
    pub const INVALID_PARAM5_X: u8 = 10;
    /// Parameter 7, z, altitude.
    pub const INVALID_PARAM7: u8 = 12;
    /// An item out of the announced range.
    pub const INVALID_SEQUENCE: u8 = 13;
    /// Not for this station, or not now.
    pub const DENIED: u8 = 14;
}

/// MAV_MISSION_TYPE.
pub mod mission_type {
    /// The mission itself.
    pub const MISSION: u8 = 0;
    /// Fence.
    pub const FENCE: u8 = 1;
    /// Rally points.
    pub const RALLY: u8 = 2;
    /// All of them, in MISSION_CLEAR_ALL.
    pub const ALL: u8 = 255;
}

/// An item as it came, without target and mission type. The default is all zeros.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MissionItem {
    /// Place in the plan.
    pub seq: u16,
    /// MAV_FRAME.
    pub frame: u8,
    /// MAV_CMD.
    pub command: u16,
    /// As the station set it.
    pub current: u8,
    /// As the station set it.
    pub autocontinue: u8,
    /// Parameters 1 to 4.
    pub params: [f32; 4],
    /// Parameter 5.
    pub x: i32,
    /// Parameter 6.
    pub y: i32,
    /// Parameter 7.
    pub z: f32,
}

/// Why an item cannot be taken. `Display` is the sentence for the pilot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ItemFault {
    /// The command is not one we fly.
    #[error("command {} is not supported", described(*.0))]
    Command(u16),
    /// The frame is not known or does not fit the command.
    #[error("frame {0} is not supported here")]
    Frame(u8),
    /// Parameter `0` (1..=7) cannot be used.
    #[error("parameter {0} cannot be used")]
    Param(u8),
}

fn described(number: u16) -> String {
    match name(number) {
        Some(name) => format!("{number} ({name})"),
        None => number.to_string(),
    }
}

impl ItemFault {
    /// Code for MISSION_ACK.
    #[must_use]
    pub const fn mission_result(&self) -> u8 {
        match self {
            Self::Command(_) => mission_result::UNSUPPORTED,
            Self::Frame(_) => mission_result::UNSUPPORTED_FRAME,
            Self::Param(n @ 1..=7) => mission_result::INVALID_PARAM1 + *n - 1,
            Self::Param(_) => mission_result::INVALID,
        }
    }
}

/// What an item says, in wire units: degrees for headings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Pass a place; x, y, z are given.
    Waypoint {
        /// Where.
        at: Point,
        /// Stay, s.
        hold_s: f32,
        /// Near enough, m; 0 = the parameter's.
        acceptance_m: f32,
        /// Heading, degrees; none = along the way.
        yaw_deg: Option<f32>,
    },
    /// Climb; only z of the point counts and is given.
    Takeoff {
        /// How high.
        at: Point,
        /// Heading, degrees.
        yaw_deg: Option<f32>,
    },
    /// Come down.
    Land {
        /// Where, if not here; x and y are given.
        at: Option<Point>,
        /// Heading, degrees.
        yaw_deg: Option<f32>,
    },
    /// Fly home and land.
    Return,
    /// Hover; for ever if the time is none.
    Loiter {
        /// Where, if not here; x, y, z are given.
        at: Option<Point>,
        /// How long, s.
        seconds: Option<f32>,
        /// Heading, degrees.
        yaw_deg: Option<f32>,
    },
    /// Wait, s.
    Delay(f32),
    /// Wait before the next action, s.
    ConditionDelay(f32),
    /// Turn.
    Yaw {
        /// Degrees: from north, or by how much.
        deg: f32,
        /// By how much.
        is_relative: bool,
        /// 1 clockwise, -1 counter-clockwise, 0 the shorter way.
        direction: i8,
    },
    /// Cruise speed, m/s.
    Speed(f32),
    /// Continue elsewhere.
    Jump {
        /// At this item.
        to: u16,
        /// So many times, -1 for ever.
        count: i32,
    },
    /// Taken and stored, nothing to fly: camera, gimbal, region of interest.
    Ignored,
}

impl MissionItem {
    /// From MISSION_ITEM_INT.
    #[must_use]
    pub const fn from_int(m: &raw::MISSION_ITEM_INT_DATA) -> Self {
        Self {
            seq: m.seq,
            frame: m.frame,
            command: m.command,
            current: m.current,
            autocontinue: m.autocontinue,
            params: [m.param1, m.param2, m.param3, m.param4],
            x: m.x,
            y: m.y,
            z: m.z,
        }
    }

    /// From MISSION_ITEM, the float form of old stations: degrees or metres become the integers of the INT form.
    #[must_use]
    pub fn from_float(m: &raw::MISSION_ITEM_DATA) -> Self {
        let int = |v: f32| match Frame::from_wire(m.frame) {
            Some(Frame::Global | Frame::GlobalRelative) => degrees_to_e7(v).unwrap_or(i32::MAX),
            // Casting saturates, so infinite becomes a place that no plan has.
            _ => given(v).map_or(i32::MAX, |v| (f64::from(v) * 1e4).round() as i32),
        };
        Self {
            seq: m.seq,
            frame: m.frame,
            command: m.command,
            current: m.current,
            autocontinue: m.autocontinue,
            params: [m.param1, m.param2, m.param3, m.param4],
            x: int(m.x),
            y: int(m.y),
            z: m.z,
        }
    }

    /// As MISSION_ITEM_INT for a station.
    #[must_use]
    pub const fn to_int(
        &self,
        target_system: u8,
        target_component: u8,
    ) -> raw::MISSION_ITEM_INT_DATA {
        let [param1, param2, param3, param4] = self.params;
        raw::MISSION_ITEM_INT_DATA {
            param1,
            param2,
            param3,
            param4,
            x: self.x,
            y: self.y,
            z: self.z,
            seq: self.seq,
            command: self.command,
            target_system,
            target_component,
            frame: self.frame,
            current: self.current,
            autocontinue: self.autocontinue,
            mission_type: mission_type::MISSION,
        }
    }

    /// As MISSION_ITEM for an old station that asked with MISSION_REQUEST.
    #[must_use]
    pub fn to_float(&self, target_system: u8, target_component: u8) -> raw::MISSION_ITEM_DATA {
        let scale = match Frame::from_wire(self.frame) {
            Some(Frame::Global | Frame::GlobalRelative) => 1e-7,
            _ => 1e-4,
        };
        let float = |v: i32| {
            if v == i32::MAX {
                f32::NAN
            } else {
                (f64::from(v) * scale) as f32
            }
        };
        let [param1, param2, param3, param4] = self.params;
        raw::MISSION_ITEM_DATA {
            param1,
            param2,
            param3,
            param4,
            x: float(self.x),
            y: float(self.y),
            z: self.z,
            seq: self.seq,
            command: self.command,
            target_system,
            target_component,
            frame: self.frame,
            current: self.current,
            autocontinue: self.autocontinue,
            mission_type: mission_type::MISSION,
        }
    }

    /// The bytes that make one plan differ from another: all but `current`, little-endian.
    #[must_use]
    pub fn bytes(&self) -> [u8; 34] {
        let mut out = [0; 34];
        let [seq0, seq1] = self.seq.to_le_bytes();
        let [cmd0, cmd1] = self.command.to_le_bytes();
        out[..6].copy_from_slice(&[seq0, seq1, cmd0, cmd1, self.frame, self.autocontinue]);
        let [p1, p2, p3, p4] = self.params.map(f32::to_le_bytes);
        let words = [
            p1,
            p2,
            p3,
            p4,
            self.x.to_le_bytes(),
            self.y.to_le_bytes(),
            self.z.to_le_bytes(),
        ];
        for (to, word) in out[6..].chunks_exact_mut(4).zip(words) {
            to.copy_from_slice(&word);
        }
        out
    }

    /// What the item says.
    ///
    /// # Errors
    /// [`ItemFault`] names the command, frame or parameter that cannot be flown.
    pub fn action(&self) -> Result<Action, ItemFault> {
        let [p1, p2, p3, p4] = self.params;
        match self.command {
            cmd::NAV_WAYPOINT => Ok(Action::Waypoint {
                at: self.whole_point()?,
                hold_s: not_negative(1, p1)?,
                acceptance_m: not_negative(2, p2)?,
                yaw_deg: heading(p4)?,
            }),
            cmd::NAV_TAKEOFF => {
                let at = self.point()?;
                at.z_m.ok_or(ItemFault::Param(7))?;
                Ok(Action::Takeoff {
                    at,
                    yaw_deg: heading(p4)?,
                })
            }
            cmd::NAV_LAND => {
                let at = self.point_or_here()?;
                Ok(Action::Land {
                    at: at.filter(|at| at.x.is_some() && at.y.is_some()),
                    yaw_deg: heading(p4)?,
                })
            }
            cmd::NAV_RETURN_TO_LAUNCH => Ok(Action::Return),
            cmd::NAV_LOITER_UNLIM | cmd::NAV_LOITER_TIME => Ok(Action::Loiter {
                at: match self.point_or_here()? {
                    Some(_) => Some(self.whole_point()?),
                    None => None,
                },
                seconds: if self.command == cmd::NAV_LOITER_TIME {
                    Some(not_negative(1, p1)?)
                } else {
                    None
                },
                yaw_deg: heading(p4)?,
            }),
            // -1 would be a time of day in parameters 2 to 4.
            cmd::NAV_DELAY => Ok(Action::Delay(seconds(p1)?)),
            cmd::CONDITION_DELAY => Ok(Action::ConditionDelay(seconds(p1)?)),
            cmd::CONDITION_YAW => Ok(Action::Yaw {
                deg: finite(1, p1)?,
                direction: match given(p3) {
                    Some(d) if d > 0.0 => 1,
                    Some(d) if d < 0.0 => -1,
                    _ => 0,
                },
                is_relative: given(p4).is_some_and(|v| v > 0.5),
            }),
            // -1: "no change", which is nothing to do.
            cmd::DO_CHANGE_SPEED => match given(p2) {
                Some(v) if v > 0.0 && v.is_finite() => Ok(Action::Speed(v)),
                Some(v) if (v + 1.0).abs() < 1e-3 => Ok(Action::Ignored),
                _ => Err(ItemFault::Param(2)),
            },
            cmd::DO_JUMP => {
                let to = finite(1, p1)?;
                let count = finite(2, p2)?;
                if !(-0.5..=65_535.0).contains(&to) {
                    Err(ItemFault::Param(1))
                } else if !(-1.0..=1e9).contains(&count) {
                    Err(ItemFault::Param(2))
                } else {
                    Ok(Action::Jump {
                        to: to.round() as u16,
                        count: count.round() as i32,
                    })
                }
            }
            cmd::DO_SET_ROI
            | cmd::DO_SET_ROI_LOCATION
            | cmd::DO_SET_ROI_NONE
            | cmd::DO_DIGICAM_CONTROL
            | cmd::DO_MOUNT_CONTROL
            | cmd::DO_SET_CAM_TRIGG_DIST
            | cmd::SET_CAMERA_MODE
            | cmd::DO_GIMBAL_MANAGER_PITCHYAW
            | cmd::DO_GIMBAL_MANAGER_CONFIGURE
            | cmd::IMAGE_START_CAPTURE
            | cmd::IMAGE_STOP_CAPTURE
            | cmd::VIDEO_START_CAPTURE
            | cmd::VIDEO_STOP_CAPTURE => Ok(Action::Ignored),
            other => Err(ItemFault::Command(other)),
        }
    }

    /// A place in a frame of places, whatever of it is given.
    fn point(&self) -> Result<Point, ItemFault> {
        let point = Point::from_wire(self.frame, self.x, self.y, self.z);
        match point.frame {
            Some(Frame::Global | Frame::GlobalRelative | Frame::Local) => {}
            Some(Frame::Mission) | None => return Err(ItemFault::Frame(self.frame)),
        }
        match point.invalid_param() {
            Some(n) => Err(ItemFault::Param(n)),
            None => Ok(point),
        }
    }

    /// A place of which everything is given.
    fn whole_point(&self) -> Result<Point, ItemFault> {
        let point = self.point()?;
        let missing = |is_missing: bool, n: u8| {
            if is_missing {
                Err(ItemFault::Param(n))
            } else {
                Ok(())
            }
        };
        missing(point.x.is_none(), 5)?;
        missing(point.y.is_none(), 6)?;
        missing(point.z_m.is_none(), 7)?;
        Ok(point)
    }

    /// A place, or none where the item means "here": frame MISSION, x and y not given, or latitude and longitude 0.
    fn point_or_here(&self) -> Result<Option<Point>, ItemFault> {
        if Frame::from_wire(self.frame) == Some(Frame::Mission) {
            return Ok(None);
        }
        let point = self.point()?;
        let is_null_island =
            point.frame != Some(Frame::Local) && (point.x, point.y) == (Some(0), Some(0));
        Ok((!is_null_island && (point.x.is_some() || point.y.is_some())).then_some(point))
    }
}

/// Not given is 0; so is less, as stations fill in -1.
fn not_negative(n: u8, value: f32) -> Result<f32, ItemFault> {
    match given(value) {
        Some(v) if v.is_infinite() => Err(ItemFault::Param(n)),
        Some(v) => Ok(v.max(0.0)),
        None => Ok(0.0),
    }
}

fn finite(n: u8, value: f32) -> Result<f32, ItemFault> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(ItemFault::Param(n))
    }
}

fn seconds(value: f32) -> Result<f32, ItemFault> {
    if value.is_finite() && value >= 0.0 {
        Ok(value)
    } else {
        Err(ItemFault::Param(1))
    }
}

fn heading(value: f32) -> Result<Option<f32>, ItemFault> {
    if value.is_infinite() {
        Err(ItemFault::Param(4))
    } else {
        Ok(given(value))
    }
}

#[cfg(test)]
mod tests;
