//! The MAVLink parameter service, and the parameters of the ground side itself.
//!
//! | Message | Behaviour |
//! | --- | --- |
//! | PARAM_REQUEST_LIST 21 | all values to the asking link, 200 a second (1,000 inside this machine); a repeat starts over without losing the rest |
//! | PARAM_REQUEST_READ 20 | one value by index or by name; an unknown one gets PARAM_ERROR |
//! | PARAM_SET 23 | checked, kept, sent to the vehicle, echoed to everybody; a refused one gets PARAM_ERROR, the old value, and why |
//!
//! Integers travel bytewise in the float field (MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE). A REAL32 set of an
//! integer parameter is taken by value, because plain pymavlink scripts send REAL32 for everything.

use super::fence::FenceAction;
use super::operator::ControlPolicy;
use super::{Context, Destination, Document, LinkId, Outbox, Peer};
use crate::autopilot::door::{Request, Severity};
use crate::settings::{Origin, Row, Settings};
use arrayvec::ArrayVec;
use core::time::Duration;
use mavlink_dialect::standard::{
    MavMessage, MavParamError, MavParamType, PARAM_ERROR_DATA, PARAM_VALUE_DATA,
};
use mavlink_dialect::{Message, raw};
use vehicle::{ParamError, ParamValue, Timestamp};

vehicle::param_choice! {
    /// Which autopilot HEARTBEAT names (MAV_AUTOPILOT).
    pub enum Identity {
        /// None in particular: parameters and missions work, QGroundControl offers no flight buttons.
        Generic = 0, "generic";
        /// PX4, whose mode numbers and conventions we follow.
        Px4 = 12, "px4";
    }
}

vehicle::params! {
    /// Identity and behaviour towards the ground.
    pub struct GroundParams {
        /// MAVLink system id. Takes effect at the next start.
        system_id: int "MAV_SYS_ID" = 1, "1", 1..=250;
        /// Autopilot named in HEARTBEAT; every ordinary station offers its buttons to `px4`.
        identity: choice<Identity> "KST_IDENTITY" = Identity::Px4;
        /// Latitude of home (1e-7 degrees), the geo-anchor of the floor plan (default: PX4's simulated home, Zurich).
        lat0_e7: int "KST_LAT0" = 473_977_420, "1e-7 deg", -850_000_000..=850_000_000;
        /// Longitude of home (1e-7 degrees).
        lon0_e7: int "KST_LON0" = 85_455_940, "1e-7 deg", -1_800_000_000..=1_800_000_000;
        /// Altitude of home's floor above mean sea level; 0 makes every client's convention for altitude agree.
        alt0_m: float "KST_ALT0" = 0.0, "m", -500.0..=9000.0;
        /// Report a satellite fix (GPS_RAW_INT fix type 3, 10 satellites) while localized, for clients that wait for one.
        gps_emulation: bool "KST_GPS_EMU" = false;
        /// Action before the vehicle leaves the fence (none without a fence).
        fence_action: choice<FenceAction> "GF_ACTION" = FenceAction::Hold;
        /// Who may command while nobody has asked for control (REQUEST_OPERATOR_CONTROL): every pilot, or nobody.
        control_policy: choice<ControlPolicy> "CTRL_POLICY" = ControlPolicy::Open;
        /// Cells of the battery where the flight controller does not tell; 0 unknown.
        battery_cells: int "BAT1_N_CELLS" = 0, "1", 0..=16;
        /// Size of a part of a flight log; then the next part begins. Takes effect at the next start.
        log_part_mb: int "LOG_PART_MB" = 100, "MB", 1..=2_000;
        /// Size of all flight logs; the oldest make room. Takes effect at the next start.
        log_total_mb: int "LOG_TOTAL_MB" = 2_000, "MB", 10..=1_000_000;
        /// Read by set-up pages of ground stations; no effect (PX4: airframe, 4001 generic quadcopter).
        autostart: int "SYS_AUTOSTART" = 4001, "1", 0..=9_999_999;
        /// Read by set-up pages of ground stations; no effect (PX4: reset parameters at start).
        autoconfig: int "SYS_AUTOCONFIG" = 0, "1", 0..=2;
        /// Read by ground stations; no effect (PX4: hardware in the loop).
        hitl: int "SYS_HITL" = 0, "1", -1..=2;
        /// Read by set-up pages of ground stations; no effect (PX4: source of manual input, 1 MAVLink only).
        rc_in_mode: int "COM_RC_IN_MODE" = 1, "1", 0..=4;
        /// Read by set-up pages of ground stations; no effect (PX4: action when manual input is lost).
        rc_loss_action: int "NAV_RCL_ACT" = 1, "1", 0..=6;
        /// Read by set-up pages of ground stations; no effect (PX4: mode of radio switch position 1, -1 none).
        flight_mode_1: int "COM_FLTMODE1" = -1, "1", -1..=15;
        /// Read by set-up pages of ground stations; no effect.
        flight_mode_2: int "COM_FLTMODE2" = -1, "1", -1..=15;
        /// Read by set-up pages of ground stations; no effect.
        flight_mode_3: int "COM_FLTMODE3" = -1, "1", -1..=15;
        /// Read by set-up pages of ground stations; no effect.
        flight_mode_4: int "COM_FLTMODE4" = -1, "1", -1..=15;
        /// Read by set-up pages of ground stations; no effect.
        flight_mode_5: int "COM_FLTMODE5" = -1, "1", -1..=15;
        /// Read by set-up pages of ground stations; no effect.
        flight_mode_6: int "COM_FLTMODE6" = -1, "1", -1..=15;
    }
}

/// File of the parameters set over MAVLink.
pub const DOCUMENT: &str = "parameters.toml";

/// Time between two values of a list, per link (200 a second), and on a link inside this machine (1,000 a second).
const LIST_PERIOD: Duration = Duration::from_millis(5);
const NEAR_LIST_PERIOD: Duration = Duration::from_millis(1);
/// Values sent at once at most when ticks come late.
const LIST_BURST: u32 = 8;
/// Lists under way at once at most; one more replaces the oldest.
const MAX_LISTINGS: usize = super::MAX_LINKS;

/// One list under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Listing {
    link: LinkId,
    /// Index to send next.
    next: usize,
    /// Values still to send.
    left: usize,
    /// When the next one is due.
    due: Timestamp,
    /// Time between two.
    period: Duration,
}

/// The parameter service. It owns no parameter: values live in [`Settings`].
///
/// A set that passes the check becomes [`Request::SetParam`]; whoever carries requests to the vehicle calls
/// [`ParamService::apply`] with it, so that every way to set a parameter (PARAM_SET, key console, origin) ends the same.
#[derive(Debug, Default)]
pub struct ParamService {
    listings: ArrayVec<Listing, MAX_LISTINGS>,
    /// Links inside this machine.
    near: ArrayVec<LinkId, { super::MAX_LINKS }>,
}

impl ParamService {
    /// No list under way.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a message addressed to us.
    pub fn handle(
        &mut self,
        now: Timestamp,
        from: Peer,
        message: &Message,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        match message {
            Message::Standard(MavMessage::PARAM_REQUEST_LIST(_)) => {
                self.start_list(now, from.link, ctx.settings)
            }
            Message::Standard(MavMessage::PARAM_REQUEST_READ(m)) => {
                let row = match usize::try_from(m.param_index) {
                    Ok(index) => ctx.settings.row(index),
                    // -1: by name. `_HASH_CHECK` is such a name that nobody needs answered.
                    Err(_) => m
                        .param_id
                        .to_str()
                        .ok()
                        .and_then(|name| row_of(ctx.settings, name)),
                };
                match (row, m.param_id.to_str()) {
                    (Some(row), _) => out.send(
                        Destination::Link(from.link),
                        param_value(&row, ctx.settings.count()),
                    ),
                    // PX4's fingerprint of all parameters: silence says that there is none.
                    (None, Ok("_HASH_CHECK")) => {}
                    (None, name) => {
                        let error = MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST;
                        send_error(from, name.unwrap_or(""), m.param_index, error, out);
                    }
                }
            }
            Message::Raw(raw::MavMessage::PARAM_SET(m)) => set(from, m, ctx.settings, out),
            _ => {}
        }
    }

    /// Sends what is due of the lists under way.
    pub fn tick(&mut self, now: Timestamp, ctx: &Context<'_>, out: &mut Outbox) {
        let count = ctx.settings.count();
        for listing in &mut self.listings {
            let mut burst = 0;
            while listing.left > 0 && listing.due <= now && burst < LIST_BURST {
                if let Some(row) = ctx.settings.row(listing.next) {
                    out.send(Destination::Link(listing.link), param_value(&row, count));
                }
                listing.next = (listing.next + 1) % count.max(1);
                listing.left -= 1;
                listing.due += listing.period;
                burst += 1;
            }
            if listing.due <= now {
                listing.due = now + listing.period;
            }
        }
        self.listings.retain(|l| l.left > 0);
    }

    /// When [`ParamService::tick`] has something to do.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp> {
        self.listings.iter().map(|l| l.due).min()
    }

    /// Forgets a link.
    pub fn link_down(&mut self, link: LinkId) {
        self.listings.retain(|l| l.link != link);
        self.near.retain(|l| *l != link);
    }

    /// A link came up that does not leave this machine: lists go faster there.
    pub fn near_link_up(&mut self, link: LinkId) {
        let _ = self.near.try_push(link);
    }

    /// Takes a checked parameter on its way to the vehicle: writes it, tells everybody, keeps the document.
    ///
    /// # Errors
    /// The value fails the check of its row; nothing changed.
    pub fn apply(
        settings: &mut Settings,
        index: usize,
        value: ParamValue,
        out: &mut Outbox,
    ) -> Result<ParamValue, ParamError> {
        let value = settings.set(index, value, Origin::Mavlink)?;
        if let Some(row) = settings.row(index) {
            out.send(Destination::All, param_value(&row, settings.count()));
        }
        out.documents.push_back(Document {
            name: DOCUMENT,
            bytes: settings.stored_toml().into_bytes(),
        });
        Ok(value)
    }

    /// A repeat while a list is under way sends what is left and then what came before: an impatient client gets a
    /// whole list too.
    fn start_list(&mut self, now: Timestamp, link: LinkId, settings: &Settings) {
        let count = settings.count();
        if let Some(listing) = self.listings.iter_mut().find(|l| l.link == link) {
            listing.left = count;
            return;
        }
        if self.listings.is_full() {
            self.listings.remove(0);
        }
        self.listings.push(Listing {
            link,
            next: 0,
            left: count,
            due: now,
            period: if self.near.contains(&link) {
                NEAR_LIST_PERIOD
            } else {
                LIST_PERIOD
            },
        });
    }
}

/// A row by MAVLink name.
fn row_of<'a>(settings: &'a Settings, name: &str) -> Option<Row<'a>> {
    settings.rows().find(|r| r.meta.id == name)
}

/// PARAM_ERROR on the asker's link: older dialects do not know it.
fn send_error(from: Peer, name: &str, index: i16, error: MavParamError, out: &mut Outbox) {
    let message = PARAM_ERROR_DATA {
        param_index: index,
        target_system: from.address.system,
        target_component: from.address.component,
        param_id: name.into(),
        error,
    };
    out.send(
        Destination::Link(from.link),
        MavMessage::PARAM_ERROR(message),
    );
}

/// The value as it is, for a PARAM_SET that is refused whole.
pub(super) fn echo(from: Peer, m: &raw::PARAM_SET_DATA, ctx: &Context<'_>, out: &mut Outbox) {
    let row = m.param_id.to_str().ok();
    if let Some(row) = row.and_then(|name| row_of(ctx.settings, name)) {
        let error = MavParamError::MAV_PARAM_ERROR_PERMISSION_DENIED;
        send_error(from, row.meta.id, -1, error, out);
        out.send(Destination::All, param_value(&row, ctx.settings.count()));
    }
}

/// PARAM_SET.
fn set(from: Peer, m: &raw::PARAM_SET_DATA, settings: &Settings, out: &mut Outbox) {
    let Ok(name) = m.param_id.to_str() else {
        return;
    };
    let Some(row) = row_of(settings, name) else {
        out.text(Severity::Warning, format!("no parameter named {name}"));
        let error = MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST;
        return send_error(from, name, -1, error, out);
    };
    let checked = match decode(m.param_value, m.param_type) {
        Some(value) => row.meta.check(value).map_err(|e| e.to_string()),
        None => Err(format!("{name}: type {} cannot be set", m.param_type)),
    };
    match checked {
        Ok(value) => {
            // Flat indices fit: PARAM_VALUE carries them as u16 too.
            out.ask(
                from,
                Request::SetParam {
                    index: row.index as u16,
                    value,
                },
            );
        }
        Err(reason) => {
            // First: MAVSDK takes an old value for a lost set.
            let error = match m.param_type {
                1..=6 | 9 => MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE,
                _ => MavParamError::MAV_PARAM_ERROR_TYPE_UNSUPPORTED,
            };
            send_error(from, name, -1, error, out);
            out.send(Destination::All, param_value(&row, settings.count()));
            out.text(Severity::Warning, reason);
        }
    }
}

/// A value of the wire, by MAV_PARAM_TYPE; none for types that need more than 32 bits or do not fit an i32.
fn decode(value: f32, param_type: u8) -> Option<ParamValue> {
    let bits = value.to_bits();
    Some(match param_type {
        1 => ParamValue::Int(i32::from(bits as u8)),
        2 => ParamValue::Int(i32::from(bits as i8)),
        3 => ParamValue::Int(i32::from(bits as u16)),
        4 => ParamValue::Int(i32::from(bits as i16)),
        5 => ParamValue::Int(i32::try_from(bits).ok()?),
        6 => ParamValue::Int(bits as i32),
        9 => ParamValue::Float(value),
        _ => return None,
    })
}

/// PARAM_VALUE of a row.
#[must_use]
pub fn param_value(row: &Row<'_>, count: usize) -> MavMessage {
    let (value, kind) = match row.value {
        ParamValue::Float(v) => (v, MavParamType::MAV_PARAM_TYPE_REAL32),
        ParamValue::Int(v) => (f32::from_bits(v as u32), MavParamType::MAV_PARAM_TYPE_INT32),
    };
    MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
        param_value: value,
        param_count: count as u16,
        param_index: row.index as u16,
        param_id: row.meta.id.into(),
        param_type: kind,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_integer_keeps_its_bits_and_a_float_of_an_integer_its_value() {
        assert_eq!(decode(f32::from_bits(4001), 6), Some(ParamValue::Int(4001)));
        assert_eq!(
            decode(f32::from_bits(-1_i32 as u32), 6),
            Some(ParamValue::Int(-1))
        );
        assert_eq!(decode(3.0, 9), Some(ParamValue::Float(3.0)));
        assert_eq!(
            decode(f32::from_bits(0xFFFF_FF80), 2),
            Some(ParamValue::Int(-128))
        );
        assert_eq!(decode(f32::from_bits(u32::MAX), 5), None);
        assert_eq!(decode(1.0, 10), None);
    }

    #[test]
    fn values_of_the_list_are_read_back_from_the_wire() {
        let settings = Settings::default();
        for row in settings.rows() {
            let MavMessage::PARAM_VALUE(m) = param_value(&row, settings.count()) else {
                panic!("PARAM_VALUE")
            };
            assert_eq!(
                decode(m.param_value, m.param_type as u8),
                Some(row.value),
                "{}",
                row.meta.id
            );
            assert_eq!(m.param_id.to_str(), Ok(row.meta.id));
        }
    }
}
