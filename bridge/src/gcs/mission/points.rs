//! Fence and rally points: lists beside the mission, with the same protocol, each with an id and a file of its own.
//!
//! | List | Items | Checked when complete |
//! | --- | --- | --- |
//! | fence (type 1) | vertices of polygons to stay in (5001) or out of (5002), circles (5003, 5004) | each polygon has all its vertices, at least 3; home is inside |
//! | rally (type 2) | points (5100) | the vehicle fits there |
//!
//! A list is stored when it is complete; until then, and if anything fails, the old one stays. What the fence does is in
//! `gcs/fence.rs`; Return flies to home or to a rally point, whichever way is shorter.

use super::readers::Readers;
use super::upload::{Step, Upload};
use super::wire::{ack, ask_for};
use super::{ACK_AGAIN, Farewell, Stored, Walls, document};
use crate::autopilot::door::Severity;
use crate::gcs::fence::{self, FENCE_CIRCLES, FENCE_VERTICES};
use crate::gcs::place::Place;
use crate::gcs::{Context, Destination, Document, Outbox, Peer};
use mavlink_dialect::Address;
use mavlink_dialect::mission_item::{
    Frame, ItemFault, MissionItem, Point, mission_result, mission_type,
};
use mavlink_dialect::raw::{self, MavMessage as M};
use std::sync::Arc;
use vehicle::{In, Timestamp};

/// Most items of a fence or of rally points.
pub const POINTS_CAPACITY: u16 = 256;

/// Files of the two lists.
pub const FENCE_DOCUMENT: &str = "fence.json";
/// See [`FENCE_DOCUMENT`].
pub const RALLY_DOCUMENT: &str = "rally.json";

/// MAV_CMD_NAV_RALLY_POINT.
const RALLY_POINT: u16 = 5100;

/// What a list is checked against.
pub(super) struct Survey<'a> {
    /// Walls; none leaves places unchecked.
    pub(super) walls: Option<&'a mut Walls>,
    /// Home and the geo-anchor.
    pub(super) ctx: &'a Context<'a>,
}

/// One of the two lists.
#[derive(Debug)]
pub(super) struct PointList {
    kind: u8,
    stored: Arc<Stored>,
    upload: Option<Upload>,
    farewell: Option<Farewell>,
    readers: Readers,
}

impl PointList {
    /// An empty list of a MAV_MISSION_TYPE.
    pub(super) fn new(kind: u8) -> Self {
        Self {
            kind,
            stored: Arc::default(),
            upload: None,
            farewell: None,
            readers: Readers::default(),
        }
    }

    /// Fingerprint of the items, 0 for none.
    pub(super) fn id(&self) -> u32 {
        self.stored.id
    }

    pub(super) fn items(&self) -> &[MissionItem] {
        &self.stored.items
    }

    /// File of this list.
    pub(super) const fn document(&self) -> &'static str {
        if self.kind == mission_type::FENCE {
            FENCE_DOCUMENT
        } else {
            RALLY_DOCUMENT
        }
    }

    const fn name(&self) -> &'static str {
        if self.kind == mission_type::FENCE {
            "Fence"
        } else {
            "Rally points"
        }
    }

    /// Takes the document of an earlier run.
    pub(super) fn restore(&mut self, bytes: &[u8], site: &mut Survey<'_>, out: &mut Outbox) {
        let items = match document::parse(bytes) {
            Ok(items) => items,
            Err(why) => {
                let text = format!("{}: stored list cannot be read: {why}", self.name());
                return out.text(Severity::Warning, text);
            }
        };
        match self.check(&items, site) {
            Ok(()) => self.stored = Arc::new(Stored::new(items)),
            Err((seq, why)) => {
                let text = format!("{}: stored list dropped: item {seq}: {why}", self.name());
                out.text(Severity::Warning, text);
            }
        }
    }

    /// Takes a message of this mission type.
    pub(super) fn handle(
        &mut self,
        now: Timestamp,
        from: Peer,
        message: &M,
        site: &mut Survey<'_>,
        out: &mut Outbox,
    ) {
        if !matches!(message, M::MISSION_ITEM_INT(_) | M::MISSION_ITEM(_)) {
            self.farewell = self
                .farewell
                .take()
                .filter(|f| f.client.address != from.address);
        }
        match message {
            M::MISSION_COUNT(m) => self.count(now, from, m.count, out),
            M::MISSION_ITEM_INT(m) => self.item(now, from, MissionItem::from_int(m), site, out),
            M::MISSION_ITEM(m) => self.item(now, from, MissionItem::from_float(m), site, out),
            M::MISSION_REQUEST_LIST(_) => self.list(now, from, out),
            M::MISSION_REQUEST_INT(m) => {
                if let Some(item) = self.requested(now, from, m.seq, out) {
                    let reply = item.to_int(from.address.system, from.address.component);
                    let reply = raw::MISSION_ITEM_INT_DATA {
                        mission_type: self.kind,
                        ..reply
                    };
                    out.send_raw(Destination::All, M::MISSION_ITEM_INT(reply));
                }
            }
            M::MISSION_REQUEST(m) => {
                if let Some(item) = self.requested(now, from, m.seq, out) {
                    let reply = item.to_float(from.address.system, from.address.component);
                    let reply = raw::MISSION_ITEM_DATA {
                        mission_type: self.kind,
                        ..reply
                    };
                    out.send_raw(Destination::All, M::MISSION_ITEM(reply));
                }
            }
            M::MISSION_CLEAR_ALL(_) => self.count(now, from, 0, out),
            M::MISSION_WRITE_PARTIAL_LIST(_) | M::MISSION_REQUEST_PARTIAL_LIST(_) => {
                ack(from, mission_result::UNSUPPORTED, self.kind, 0, out);
            }
            M::MISSION_ACK(m) if m.mavtype != mission_result::ACCEPTED => {
                let is_it = |u: &Upload| u.client.address == from.address;
                self.upload = self.upload.take().filter(|u| !is_it(u));
            }
            _ => {}
        }
    }

    /// Takes the time.
    pub(super) fn tick(&mut self, now: Timestamp, out: &mut Outbox) {
        if let Some(upload) = &mut self.upload {
            match upload.tick(now) {
                Step::Ask(seq) => ask_for(upload.client, seq, self.kind, out),
                Step::GaveUp => {
                    let (got, count) = (upload.expected(), upload.count);
                    let text = format!("{} upload abandoned at item {got} of {count}", self.name());
                    out.text(Severity::Warning, text);
                    self.upload = None;
                }
                Step::Wait | Step::Complete | Step::OutOfRange => {}
            }
        }
        if let Some(f) = &mut self.farewell
            && ACK_AGAIN
                .get(f.repeats)
                .is_some_and(|after| now.since(f.at) >= *after)
        {
            ack(f.client, f.result, self.kind, f.id, out);
            f.repeats += 1;
        }
        self.readers.tick(now);
    }

    /// Forgets every item.
    pub(super) fn clear(&mut self, out: &mut Outbox) {
        self.upload = None;
        if self.stored.id != 0 {
            self.store(Vec::new(), out);
        }
    }

    fn count(&mut self, now: Timestamp, from: Peer, count: u16, out: &mut Outbox) {
        let is_taken = |u: &Upload| u.client.address != from.address;
        if self.upload.as_ref().is_some_and(is_taken) {
            return ack(from, mission_result::DENIED, self.kind, 0, out);
        }
        if count > POINTS_CAPACITY {
            let text = format!(
                "{} of {count} items refused: at most {POINTS_CAPACITY} fit",
                self.name()
            );
            out.text(Severity::Warning, text);
            return ack(from, mission_result::NO_SPACE, self.kind, 0, out);
        }
        if count == 0 {
            self.clear(out);
            return ack(from, mission_result::ACCEPTED, self.kind, 0, out);
        }
        self.upload = Some(Upload::new(now, from, count));
        ask_for(from, 0, self.kind, out);
    }

    fn item(
        &mut self,
        now: Timestamp,
        from: Peer,
        item: MissionItem,
        site: &mut Survey<'_>,
        out: &mut Outbox,
    ) {
        let is_it = |u: &&mut Upload| u.client.address == from.address;
        let Some(upload) = self.upload.as_mut().filter(is_it) else {
            if let Some(f) = &self.farewell
                && f.client.address == from.address
                && f.last_seq == item.seq
            {
                ack(from, f.result, self.kind, f.id, out);
            }
            return;
        };
        upload.client = from;
        if item.seq == upload.expected()
            && let Err(fault) = check_item(self.kind, &item)
        {
            return self.refuse(
                now,
                from,
                item.seq,
                fault.mission_result(),
                &fault.to_string(),
                out,
            );
        }
        match upload.item(now, item) {
            Step::Ask(seq) => ask_for(from, seq, self.kind, out),
            Step::Complete => {
                let items = self.upload.take().map(|u| u.items).unwrap_or_default();
                match self.check(&items, site) {
                    Ok(()) => {
                        let last_seq = item.seq;
                        self.store(items, out);
                        self.farewell(now, from, mission_result::ACCEPTED, last_seq, out);
                    }
                    Err((seq, why)) => {
                        self.refuse(now, from, seq, mission_result::INVALID_PARAM1, &why, out)
                    }
                }
            }
            Step::OutOfRange => {
                let why = format!("only {} items were announced", upload.count);
                self.refuse(
                    now,
                    from,
                    item.seq,
                    mission_result::INVALID_SEQUENCE,
                    &why,
                    out,
                );
            }
            Step::Wait | Step::GaveUp => {}
        }
    }

    /// The whole list: items and what only shows when all are here.
    fn check(&self, items: &[MissionItem], site: &mut Survey<'_>) -> Result<(), (u16, String)> {
        for (item, seq) in items.iter().zip(0..) {
            check_item(self.kind, item).map_err(|fault| (seq, fault.to_string()))?;
        }
        if self.kind == mission_type::FENCE {
            fence::check_with_home(items, site.ctx)?;
        } else if let Some(walls) = &mut site.walls {
            let router = walls.router(&site.ctx.settings.planner);
            for (item, seq) in items.iter().zip(0..) {
                let point = Point::from_wire(item.frame, item.x, item.y, item.z);
                let place = Place::from_point(&point, site.ctx).unwrap_or_default();
                let (north_m, east_m) = (place.north_m, place.east_m);
                let at = In::new(north_m.unwrap_or(0.0), east_m.unwrap_or(0.0), 0.0);
                router
                    .check_place(site.ctx.anchor.to_map(at))
                    .map_err(|e| (seq, e.to_string()))?;
            }
        }
        Ok(())
    }

    fn store(&mut self, items: Vec<MissionItem>, out: &mut Outbox) {
        self.stored = Arc::new(Stored::new(items));
        out.documents.push_back(Document {
            name: self.document(),
            bytes: document::write(&self.stored.items),
        });
        let text = match (self.stored.count(), self.kind) {
            (0, _) => format!("{} cleared", self.name()),
            (n, mission_type::FENCE) => format!("Fence of {n} items stored"),
            (n, _) => format!("{n} rally points stored: Return takes the nearest, or home"),
        };
        out.text(Severity::Info, text);
    }

    fn refuse(
        &mut self,
        now: Timestamp,
        from: Peer,
        seq: u16,
        result: u8,
        why: &str,
        out: &mut Outbox,
    ) {
        let text = format!("{} refused: item {seq}: {why}", self.name());
        out.text(Severity::Warning, text);
        self.upload = None;
        self.farewell(now, from, result, seq, out);
    }

    fn farewell(
        &mut self,
        now: Timestamp,
        client: Peer,
        result: u8,
        last_seq: u16,
        out: &mut Outbox,
    ) {
        let id = if result == mission_result::ACCEPTED {
            self.stored.id
        } else {
            0
        };
        ack(client, result, self.kind, id, out);
        self.farewell = Some(Farewell {
            client,
            result,
            id,
            last_seq,
            at: now,
            repeats: 0,
        });
    }

    fn list(&mut self, now: Timestamp, from: Peer, out: &mut Outbox) {
        self.readers.begin(now, from.address, &self.stored);
        let Address { system, component } = from.address;
        let reply = raw::MISSION_COUNT_DATA {
            count: self.stored.count(),
            target_system: system,
            target_component: component,
            mission_type: self.kind,
            opaque_id: self.stored.id,
        };
        out.send_raw(Destination::All, M::MISSION_COUNT(reply));
    }

    fn requested(
        &mut self,
        now: Timestamp,
        from: Peer,
        seq: u16,
        out: &mut Outbox,
    ) -> Option<MissionItem> {
        let item = self.readers.item(now, from.address, seq, &self.stored);
        if item.is_none() {
            ack(from, mission_result::INVALID_SEQUENCE, self.kind, 0, out);
        }
        item
    }
}

/// One item, as it arrives.
fn check_item(kind: u8, item: &MissionItem) -> Result<(), ItemFault> {
    /// Largest circle, m.
    const MAX_RADIUS_M: f32 = 1e4;
    let is_circle = FENCE_CIRCLES.contains(&item.command);
    let is_ours = match kind {
        mission_type::FENCE => is_circle || FENCE_VERTICES.contains(&item.command),
        _ => item.command == RALLY_POINT,
    };
    if !is_ours {
        return Err(ItemFault::Command(item.command));
    }
    let point = Point::from_wire(item.frame, item.x, item.y, item.z);
    if !matches!(
        point.frame,
        Some(Frame::Global | Frame::GlobalRelative | Frame::Local)
    ) {
        return Err(ItemFault::Frame(item.frame));
    }
    if let Some(n) = point.invalid_param() {
        return Err(ItemFault::Param(n));
    }
    match (point.x, point.y) {
        (None, _) => Err(ItemFault::Param(5)),
        (_, None) => Err(ItemFault::Param(6)),
        // Written so that NaN is refused too.
        _ if is_circle && !(item.params[0] > 0.0 && item.params[0] <= MAX_RADIUS_M) => {
            Err(ItemFault::Param(1))
        }
        _ => Ok(()),
    }
}
