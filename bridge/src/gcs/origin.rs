//! SET_GPS_GLOBAL_ORIGIN: moves the geo-anchor of the floor plan and echoes it as GPS_GLOBAL_ORIGIN.
//!
//! The anchor is three parameters (KST_LAT0, KST_LON0, KST_ALT0), so a new origin outlives the flight. While armed it
//! stays where it is: every global way point would move with it.

#![expect(
    deprecated,
    reason = "MAV_CMD_DO_SET_GLOBAL_ORIGIN takes its place, stations still send the message"
)]

use super::convert::{GeoAnchor, GeoPoint, to_i32};
use super::{Context, Destination, Outbox, Peer};
use crate::autopilot::door::{Request, Severity};
use mavlink_dialect::Message;
use mavlink_dialect::standard::{GPS_GLOBAL_ORIGIN_DATA, MavMessage};
use vehicle::{ParamValue, Timestamp};

/// Takes SET_GPS_GLOBAL_ORIGIN; anything else is left alone.
pub fn handle(now: Timestamp, from: Peer, message: &Message, ctx: &Context<'_>, out: &mut Outbox) {
    let Message::Standard(MavMessage::SET_GPS_GLOBAL_ORIGIN(m)) = message else {
        return;
    };
    let wanted = GeoPoint {
        lat_e7: m.latitude,
        lon_e7: m.longitude,
        alt_m: f64::from(m.altitude) * 1e-3,
    };
    if let Err(why) = move_to(now, from, wanted, ctx, out) {
        out.text(Severity::Warning, why);
        out.send(
            Destination::All,
            origin_message(now, GeoAnchor::from_params(&ctx.settings.ground).origin()),
        );
    }
}

/// Moves the origin and tells everybody; also for MAV_CMD_DO_SET_GLOBAL_ORIGIN.
///
/// # Errors
/// The sentence for the pilot; nothing was moved.
pub fn move_to(
    now: Timestamp,
    from: Peer,
    wanted: GeoPoint,
    ctx: &Context<'_>,
    out: &mut Outbox,
) -> Result<(), String> {
    if ctx.snapshot.is_armed {
        return Err("origin not moved: disarm first".to_owned());
    }
    let checked = |name: &'static str, value: ParamValue| -> Result<Request, String> {
        let row = ctx
            .settings
            .index_of(name)
            .and_then(|index| ctx.settings.row(index));
        let row = row.ok_or_else(|| format!("no parameter named {name}"))?;
        let value = row.meta.check(value).map_err(|e| e.to_string())?;
        Ok(Request::SetParam {
            index: row.index as u16,
            value,
        })
    };
    let requests = [
        checked("KST_LAT0", ParamValue::Int(wanted.lat_e7))?,
        checked("KST_LON0", ParamValue::Int(wanted.lon_e7))?,
        checked("KST_ALT0", ParamValue::Float(wanted.alt_m as f32))?,
    ];
    for request in requests {
        out.ask(from, request);
    }
    out.send(Destination::All, origin_message(now, wanted));
    Ok(())
}

/// GPS_GLOBAL_ORIGIN.
#[must_use]
pub fn origin_message(now: Timestamp, origin: GeoPoint) -> MavMessage {
    MavMessage::GPS_GLOBAL_ORIGIN(GPS_GLOBAL_ORIGIN_DATA {
        latitude: origin.lat_e7,
        longitude: origin.lon_e7,
        altitude: to_i32(origin.alt_m * 1e3),
        time_usec: now.us(),
    })
}
