//! A place of the wire, as commands, mission items and set points give it, in the world.

use super::Context;
use super::convert::GeoAnchor;
use mavlink_dialect::mission_item::{Frame, Point};
use vehicle::{In, Ned};

/// NED about home, m; what was not given is none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Place {
    /// North.
    pub(super) north_m: Option<f64>,
    /// East.
    pub(super) east_m: Option<f64>,
    /// Down.
    pub(super) down_m: Option<f64>,
}

/// Metres of the local unit of the INT forms (MISSION_ITEM_INT.x: metres times 1e4).
const LOCAL_UNIT_M: f64 = 1e-4;

impl Place {
    /// The place of a point; none if its frame is not one of places.
    #[must_use]
    pub(super) fn from_point(point: &Point, ctx: &Context<'_>) -> Option<Self> {
        let geo = GeoAnchor::from_params(&ctx.settings.ground);
        let z = point.z_m.map(f64::from);
        let global = |down_m: Option<f64>| Self {
            north_m: point.x.map(|lat_e7| geo.north_of(lat_e7)),
            east_m: point.y.map(|lon_e7| geo.east_of(lon_e7)),
            down_m,
        };
        match point.frame? {
            Frame::Global => Some(global(z.map(|amsl| geo.down_of_amsl(amsl)))),
            Frame::GlobalRelative => Some(global(
                z.map(|up| geo.down_of_relative(up, &ctx.snapshot.home)),
            )),
            Frame::Local => Some(Self {
                north_m: point.x.map(|x| f64::from(x) * LOCAL_UNIT_M),
                east_m: point.y.map(|y| f64::from(y) * LOCAL_UNIT_M),
                down_m: z,
            }),
            Frame::Mission => None,
        }
    }

    /// The place if all of it was given.
    #[must_use]
    pub(super) fn whole(&self) -> Option<In<Ned>> {
        Some(In::new(self.north_m?, self.east_m?, self.down_m?))
    }
}
