//! A place on the wire: two i32 and a f32 whose meaning the frame gives.

use crate::command::given;

/// What the coordinates of a place mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// 0 or 5: latitude, longitude, metres above mean sea level.
    Global,
    /// 3 or 6: latitude, longitude, metres above home.
    GlobalRelative,
    /// 1: north, east, down about home.
    Local,
    /// 2: no place.
    Mission,
}

impl Frame {
    /// From MAV_FRAME; none if we do not know what to make of it.
    #[must_use]
    pub const fn from_wire(frame: u8) -> Option<Self> {
        match frame {
            0 | 5 => Some(Self::Global),
            3 | 6 => Some(Self::GlobalRelative),
            1 => Some(Self::Local),
            2 => Some(Self::Mission),
            _ => None,
        }
    }
}

/// A place as the wire gives it; what is not given is none. `Command` and `MissionItem` share it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// What x, y, z mean; none if the frame is not known to us.
    pub frame: Option<Frame>,
    /// Latitude, 1e-7 degrees, or north, 1e-4 m.
    pub x: Option<i32>,
    /// Longitude, 1e-7 degrees, or east, 1e-4 m.
    pub y: Option<i32>,
    /// m; up or down by the frame.
    pub z_m: Option<f32>,
}

impl Point {
    /// From the fields of an INT form.
    #[must_use]
    pub fn from_wire(frame: u8, x: i32, y: i32, z: f32) -> Self {
        let int = |v: i32| (v != i32::MAX).then_some(v);
        Self {
            frame: Frame::from_wire(frame),
            x: int(x),
            y: int(y),
            z_m: given(z),
        }
    }

    /// The number of the first parameter (5, 6 or 7) that cannot be a coordinate of this frame; what is not given can be.
    #[must_use]
    pub fn invalid_param(&self) -> Option<u8> {
        let is_global = matches!(self.frame, Some(Frame::Global | Frame::GlobalRelative));
        let beyond =
            |v: Option<i32>, limit: u32| is_global && v.is_some_and(|v| v.unsigned_abs() > limit);
        if beyond(self.x, 900_000_000) || self.x == Some(i32::MIN) {
            Some(5)
        } else if beyond(self.y, 1_800_000_000) || self.y == Some(i32::MIN) {
            Some(6)
        } else if self.z_m.is_some_and(f32::is_infinite) {
            Some(7)
        } else {
            None
        }
    }
}
