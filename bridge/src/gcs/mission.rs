//! The mission protocol: upload, download, clear, current item.
//!
//! | Message | Answer |
//! | --- | --- |
//! | MISSION_COUNT 44 | MISSION_REQUEST_INT 51 for each item (see `mission/upload.rs`), then MISSION_ACK 47; other stations meanwhile get DENIED |
//! | MISSION_REQUEST_LIST 43 | MISSION_COUNT with the plan's id |
//! | MISSION_REQUEST_INT 51, MISSION_REQUEST 40 | MISSION_ITEM_INT 73, MISSION_ITEM 39, from the list this station was told of |
//! | MISSION_CLEAR_ALL 45, MISSION_COUNT 0 | MISSION_ACK |
//! | MISSION_SET_CURRENT 41 | the vehicle is asked; a refusal becomes a text, a change shows in MISSION_CURRENT (telemetry) |
//! | MISSION_WRITE_PARTIAL_LIST 38, MISSION_REQUEST_PARTIAL_LIST 37 | MISSION_ACK UNSUPPORTED |
//!
//! A plan is stored when it is complete, every item can be flown ([`planner::mission::check`]) and the vehicle has taken
//! it; until then, and if anything fails, the old plan stays. Fence (type 1) and rally points (type 2) are lists of their
//! own (`mission/points.rs`). Items are given back bit for bit as they came. The lists outlive the program as documents:
//! `mission.json`, `fence.json`, `rally.json`.

mod document;
mod plan;
mod points;
mod readers;
#[cfg(test)]
mod tests;
mod upload;
mod walls;
mod wire;

pub use self::document::DOCUMENT;
pub use self::points::{FENCE_DOCUMENT, POINTS_CAPACITY, RALLY_DOCUMENT};
pub use self::walls::Walls;

use self::points::{PointList, Survey};
use self::readers::Readers;
use self::upload::{Step, Upload};
use self::wire::{ack, ask_for, fingerprint, is_mission_message, result_of, type_of};
use super::fence::{FenceAction, fence_of};
use super::telemetry::PlanIds;
use super::{Context, Destination, Document, LinkId, Outbox, Peer};
use crate::autopilot::door::{Answer, Event, Outcome, Request, RequestId, Severity};
use core::time::Duration;
use mavlink_dialect::mission_item::{MissionItem, mission_result, mission_type};
use mavlink_dialect::{Address, Message, raw, standard};
use planner::fence::Fence;
use planner::mission::{Plan, PlanRefusal};
use std::sync::Arc;
use vehicle::Timestamp;

/// Most items of a plan.
pub const CAPACITY: u16 = 512;

/// When the final MISSION_ACK of an upload is sent again, after the first time: it is the one message nobody asks for
/// twice, and without it the station takes the whole upload for failed.
const ACK_AGAIN: [Duration; 2] = [Duration::from_millis(300), Duration::from_millis(900)];
/// Time the vehicle has to take a plan.
const COMMIT_TIMEOUT: Duration = Duration::from_secs(2);

/// A plan as it came.
#[derive(Debug, Default)]
struct Stored {
    items: Vec<MissionItem>,
    /// Fingerprint of the items, 0 for no plan: `opaque_id` and MISSION_CURRENT.mission_id.
    id: u32,
}

impl Stored {
    fn new(items: Vec<MissionItem>) -> Self {
        let id = fingerprint(&items);
        Self { items, id }
    }

    fn count(&self) -> u16 {
        // Never more than CAPACITY.
        self.items.len() as u16
    }
}

/// What is being done to the stored plan.
#[derive(Debug)]
enum Change {
    /// Nothing.
    None,
    /// A station sends a new one.
    Receiving(Upload),
    /// The vehicle was asked to take the new one.
    Committing(Commit),
}

#[derive(Debug)]
struct Commit {
    request: RequestId,
    /// Who is waiting for the ACK; nobody when a stored plan is restored, or no longer.
    client: Option<Peer>,
    /// As the station named it, for the ACK: CLEAR_ALL may have said "all".
    mission_type: u8,
    items: Vec<MissionItem>,
    since: Timestamp,
}

/// A station that was sent the final ACK of an upload, and may not have got it: kept until it goes on, as the last item
/// may come again at any time.
#[derive(Debug)]
struct Farewell {
    client: Peer,
    result: u8,
    id: u32,
    last_seq: u16,
    at: Timestamp,
    repeats: usize,
}

/// The mission service. After each call the outbox holds what follows from it.
#[derive(Debug)]
pub struct MissionService {
    walls: Option<Walls>,
    stored: Arc<Stored>,
    change: Change,
    farewell: Option<Farewell>,
    readers: Readers,
    /// MISSION_SET_CURRENT under way: a refusal becomes a text.
    set_current: Option<RequestId>,
    fence: PointList,
    rally: PointList,
}

impl MissionService {
    /// No plan yet. Without walls places are not checked.
    #[must_use]
    pub fn new(walls: Option<Walls>) -> Self {
        Self {
            walls,
            stored: Arc::default(),
            change: Change::None,
            farewell: None,
            readers: Readers::default(),
            set_current: None,
            fence: PointList::new(mission_type::FENCE),
            rally: PointList::new(mission_type::RALLY),
        }
    }

    /// Fingerprints of the stored lists (`opaque_id`, MISSION_CURRENT.mission_id), 0 for an empty one.
    #[must_use]
    pub fn plan_ids(&self) -> PlanIds {
        PlanIds {
            mission: self.stored.id,
            fence: self.fence.id(),
            rally: self.rally.id(),
        }
    }

    /// The stored items.
    #[must_use]
    pub fn items(&self) -> &[MissionItem] {
        &self.stored.items
    }

    /// The stored fence.
    #[must_use]
    pub fn fence_items(&self) -> &[MissionItem] {
        self.fence.items()
    }

    /// The stored rally points.
    #[must_use]
    pub fn rally_items(&self) -> &[MissionItem] {
        self.rally.items()
    }

    /// Takes any document of an earlier run; one that is not ours is left alone.
    pub fn restore_document(
        &mut self,
        now: Timestamp,
        document: &Document,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        match document.name {
            DOCUMENT => self.restore(now, &document.bytes, ctx, out),
            FENCE_DOCUMENT | RALLY_DOCUMENT => {
                let walls = self.walls.as_mut();
                let mut survey = Survey { walls, ctx };
                let list = if document.name == FENCE_DOCUMENT {
                    &mut self.fence
                } else {
                    &mut self.rally
                };
                list.restore(&document.bytes, &mut survey, out);
            }
            _ => {}
        }
    }

    /// Takes the document of an earlier run: the plan is checked and offered to the vehicle as if it had been uploaded.
    pub fn restore(&mut self, now: Timestamp, bytes: &[u8], ctx: &Context<'_>, out: &mut Outbox) {
        let items = match document::parse(bytes) {
            Ok(items) if items.is_empty() => return,
            Ok(items) if items.len() <= usize::from(CAPACITY) => items,
            Ok(items) => {
                return out.text(
                    Severity::Warning,
                    format!("Stored mission of {} items dropped", items.len()),
                );
            }
            Err(why) => {
                return out.text(
                    Severity::Warning,
                    format!("Stored mission cannot be read: {why}"),
                );
            }
        };
        let refusal = match plan::plan(&items, ctx) {
            Err((seq, fault)) => Some((seq, fault.to_string())),
            Ok(plan) => match self.check(&plan, ctx) {
                Err(PlanRefusal { seq, fault }) => Some((seq, fault.to_string())),
                Ok(()) => {
                    self.commit(now, None, mission_type::MISSION, items, plan, ctx, out);
                    None
                }
            },
        };
        if let Some((seq, why)) = refusal {
            out.text(
                Severity::Warning,
                format!("Stored mission dropped: item {seq}: {why}"),
            );
        }
    }

    /// Takes a message for us.
    #[expect(deprecated, reason = "stations still send MISSION_SET_CURRENT")]
    pub fn handle(
        &mut self,
        now: Timestamp,
        from: Peer,
        message: &Message,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let raw = match message {
            Message::Standard(standard::MavMessage::MISSION_SET_CURRENT(m)) => {
                self.set_current = Some(out.ask(from, Request::SetMissionItem(m.seq)));
                return;
            }
            Message::Raw(raw) => raw,
            Message::Standard(_) => return,
        };
        use raw::MavMessage as M;
        let list = match type_of(raw) {
            Some(mission_type::FENCE) => Some(&mut self.fence),
            Some(mission_type::RALLY) => Some(&mut self.rally),
            _ => None,
        };
        if let Some(list) = list {
            let walls = self.walls.as_mut();
            let mut survey = Survey { walls, ctx };
            return list.handle(now, from, raw, &mut survey, out);
        }
        if !matches!(raw, M::MISSION_ITEM_INT(_) | M::MISSION_ITEM(_)) && is_mission_message(raw) {
            // Only items may still be on their way from an upload that is over: anything else shows that its ACK came.
            self.farewell = self
                .farewell
                .take()
                .filter(|f| f.client.address != from.address);
        }
        match raw {
            M::MISSION_COUNT(m) => self.count(now, from, m.count, m.mission_type, ctx, out),
            M::MISSION_ITEM_INT(m) if m.mission_type == mission_type::MISSION => {
                self.item(now, from, MissionItem::from_int(m), ctx, out);
            }
            M::MISSION_ITEM(m) if m.mission_type == mission_type::MISSION => {
                self.item(now, from, MissionItem::from_float(m), ctx, out);
            }
            M::MISSION_REQUEST_LIST(m) => self.list(now, from, m.mission_type, out),
            M::MISSION_REQUEST_INT(m) => {
                if let Some(item) = self.requested(now, from, m.seq, m.mission_type, out) {
                    let reply = item.to_int(from.address.system, from.address.component);
                    out.send_raw(Destination::All, M::MISSION_ITEM_INT(reply));
                }
            }
            M::MISSION_REQUEST(m) => {
                if let Some(item) = self.requested(now, from, m.seq, m.mission_type, out) {
                    let reply = item.to_float(from.address.system, from.address.component);
                    out.send_raw(Destination::All, M::MISSION_ITEM(reply));
                }
            }
            M::MISSION_CLEAR_ALL(m) => self.clear(now, from, m.mission_type, ctx, out),
            M::MISSION_ACK(m) if m.mavtype != mission_result::ACCEPTED => {
                if matches!(&self.change, Change::Receiving(up) if up.client.address == from.address)
                {
                    out.text(Severity::Notice, "Mission upload cancelled by the station");
                    self.change = Change::None;
                }
            }
            M::MISSION_WRITE_PARTIAL_LIST(m) => {
                out.text(
                    Severity::Warning,
                    "Mission: partial lists are not supported, send the whole plan",
                );
                ack(from, mission_result::UNSUPPORTED, m.mission_type, 0, out);
            }
            M::MISSION_REQUEST_PARTIAL_LIST(m) => {
                ack(from, mission_result::UNSUPPORTED, m.mission_type, 0, out)
            }
            _ => {}
        }
    }

    /// Takes the time: questions asked again, ACKs repeated, silent stations given up.
    pub fn tick(&mut self, now: Timestamp, _ctx: &Context<'_>, out: &mut Outbox) {
        match &mut self.change {
            Change::Receiving(upload) => match upload.tick(now) {
                Step::Ask(seq) => ask_for(upload.client, seq, mission_type::MISSION, out),
                Step::GaveUp => {
                    let (got, count) = (upload.expected(), upload.count);
                    out.text(
                        Severity::Warning,
                        format!("Mission upload abandoned at item {got} of {count}"),
                    );
                    self.change = Change::None;
                }
                Step::Wait | Step::Complete | Step::OutOfRange => {}
            },
            // The station is let go; the vehicle may still answer, and then the plan is what it flies.
            Change::Committing(commit) if now.since(commit.since) >= COMMIT_TIMEOUT => {
                if let Some(client) = commit.client.take() {
                    out.text(
                        Severity::Error,
                        "Mission not stored: the vehicle does not answer",
                    );
                    ack(client, mission_result::ERROR, commit.mission_type, 0, out);
                }
            }
            Change::Committing(_) | Change::None => {}
        }
        if let Some(f) = &mut self.farewell
            && ACK_AGAIN
                .get(f.repeats)
                .is_some_and(|after| now.since(f.at) >= *after)
        {
            ack(f.client, f.result, mission_type::MISSION, f.id, out);
            f.repeats += 1;
        }
        self.readers.tick(now);
        self.fence.tick(now, out);
        self.rally.tick(now, out);
    }

    /// Takes the vehicle's answer; true if it was ours.
    pub fn answer(
        &mut self,
        now: Timestamp,
        answer: &Answer,
        _ctx: &Context<'_>,
        out: &mut Outbox,
    ) -> bool {
        if self.set_current == Some(answer.id) {
            self.set_current = None;
            if let Outcome::Refused(why) = answer.outcome {
                out.text(Severity::Warning, format!("Mission item refused: {why}"));
            }
            return true;
        }
        match core::mem::replace(&mut self.change, Change::None) {
            Change::Committing(commit) if commit.request == answer.id => {
                self.committed(now, commit, answer.outcome, out)
            }
            other => {
                self.change = other;
                return false;
            }
        }
        true
    }

    /// Takes something that happened.
    pub fn event(&mut self, event: &Event, out: &mut Outbox) {
        if let Event::ItemReached(seq) = event {
            let reached = standard::MISSION_ITEM_REACHED_DATA { seq: *seq };
            out.send(
                Destination::All,
                standard::MavMessage::MISSION_ITEM_REACHED(reached),
            );
        }
    }

    fn count(
        &mut self,
        now: Timestamp,
        from: Peer,
        count: u16,
        mission_type: u8,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        if mission_type != mission_type::MISSION {
            return ack(from, mission_result::UNSUPPORTED, mission_type, 0, out);
        }
        if self.is_taken_by_another(from) {
            return ack(from, mission_result::DENIED, mission_type, 0, out);
        }
        if count == 0 {
            return self.clear(now, from, mission_type, ctx, out);
        }
        if count > CAPACITY {
            out.text(
                Severity::Warning,
                format!("Mission of {count} items refused: at most {CAPACITY} fit"),
            );
            return ack(from, mission_result::NO_SPACE, mission_type, 0, out);
        }
        // A repeated count begins anew: items of two plans must not mix.
        self.change = Change::Receiving(Upload::new(now, from, count));
        ask_for(from, 0, mission_type, out);
    }

    fn item(
        &mut self,
        now: Timestamp,
        from: Peer,
        item: MissionItem,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let upload = match &mut self.change {
            Change::Receiving(upload) if upload.client.address == from.address => upload,
            _ => {
                if let Some(f) = &self.farewell
                    && f.client.address == from.address
                    && f.last_seq == item.seq
                {
                    ack(from, f.result, mission_type::MISSION, f.id, out);
                }
                return;
            }
        };
        upload.client = from;
        if item.seq == upload.expected()
            && let Err(fault) = plan::plan_item(&item, ctx)
        {
            return self.refuse(now, from, item.seq, fault.mission_result(), &fault, out);
        }
        match upload.item(now, item) {
            Step::Ask(seq) => ask_for(from, seq, mission_type::MISSION, out),
            Step::Complete => self.complete(now, from, ctx, out),
            Step::OutOfRange => {
                let reason = format!("only {} items were announced", upload.count);
                self.refuse(
                    now,
                    from,
                    item.seq,
                    mission_result::INVALID_SEQUENCE,
                    &reason,
                    out,
                );
            }
            Step::Wait | Step::GaveUp => {}
        }
    }

    /// All items are here: check the whole, then ask the vehicle to take it.
    fn complete(&mut self, now: Timestamp, from: Peer, ctx: &Context<'_>, out: &mut Outbox) {
        let Change::Receiving(upload) = core::mem::replace(&mut self.change, Change::None) else {
            return;
        };
        match plan::plan(&upload.items, ctx) {
            Err((seq, fault)) => self.refuse(now, from, seq, fault.mission_result(), &fault, out),
            Ok(plan) => match self.check(&plan, ctx) {
                Err(PlanRefusal { seq, fault }) => {
                    self.refuse(now, from, seq, result_of(&fault), &fault, out)
                }
                Ok(()) => self.commit(
                    now,
                    Some(from),
                    mission_type::MISSION,
                    upload.items,
                    plan,
                    ctx,
                    out,
                ),
            },
        }
    }

    fn check(&mut self, plan: &Plan, ctx: &Context<'_>) -> Result<(), PlanRefusal> {
        let Some(walls) = &mut self.walls else {
            return Ok(());
        };
        let router = walls.router(&ctx.settings.planner);
        let is_kept = !matches!(
            ctx.settings.ground.fence_action,
            FenceAction::Disabled | FenceAction::Warn
        );
        let fence = if is_kept {
            fence_of(self.fence.items(), ctx)
        } else {
            Fence::default()
        };
        router.set_fence(&fence, &ctx.anchor);
        let ceiling_m = ctx.settings.autopilot.ceiling_m;
        planner::mission::check(plan, router, &ctx.anchor, ctx.snapshot.home, ceiling_m)
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "one call site per way a plan can come"
    )]
    fn commit(
        &mut self,
        now: Timestamp,
        client: Option<Peer>,
        mission_type: u8,
        items: Vec<MissionItem>,
        plan: Plan,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let from = client.unwrap_or(Peer {
            link: LinkId(0),
            address: ctx.us,
        });
        let request = out.ask(from, Request::SetPlan(Arc::new(plan)));
        self.change = Change::Committing(Commit {
            request,
            client,
            mission_type,
            items,
            since: now,
        });
    }

    fn committed(&mut self, now: Timestamp, commit: Commit, outcome: Outcome, out: &mut Outbox) {
        let Commit {
            client,
            mission_type,
            items,
            ..
        } = commit;
        let last_seq = items.last().map(|i| i.seq);
        let (result, id) = match outcome {
            Outcome::Refused(why) => {
                out.text(Severity::Warning, format!("Mission refused: {why}"));
                (mission_result::DENIED, 0)
            }
            Outcome::Accepted | Outcome::KeyTaken(_) => {
                self.stored = Arc::new(Stored::new(items));
                out.documents.push_back(Document {
                    name: DOCUMENT,
                    bytes: document::write(&self.stored.items),
                });
                out.text(
                    Severity::Info,
                    format!("Mission of {} items stored", self.stored.count()),
                );
                (mission_result::ACCEPTED, self.stored.id)
            }
        };
        let Some(client) = client else { return };
        ack(client, result, mission_type, id, out);
        self.farewell = last_seq.map(|last_seq| Farewell {
            client,
            result,
            id,
            last_seq,
            at: now,
            repeats: 0,
        });
    }

    /// Drops the upload with a reason; the old plan stays.
    fn refuse(
        &mut self,
        now: Timestamp,
        client: Peer,
        seq: u16,
        result: u8,
        why: &dyn core::fmt::Display,
        out: &mut Outbox,
    ) {
        out.text(
            Severity::Warning,
            format!("Mission refused: item {seq}: {why}"),
        );
        ack(client, result, mission_type::MISSION, 0, out);
        self.farewell = Some(Farewell {
            client,
            result,
            id: 0,
            last_seq: seq,
            at: now,
            repeats: 0,
        });
        self.change = Change::None;
    }

    fn clear(
        &mut self,
        now: Timestamp,
        from: Peer,
        mission_type: u8,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        match mission_type {
            mission_type::MISSION | mission_type::ALL => {}
            _ => return ack(from, mission_result::UNSUPPORTED, mission_type, 0, out),
        }
        if self.is_taken_by_another(from) {
            return ack(from, mission_result::DENIED, mission_type, 0, out);
        }
        if mission_type == mission_type::ALL {
            self.fence.clear(out);
            self.rally.clear(out);
        }
        self.commit(
            now,
            Some(from),
            mission_type,
            Vec::new(),
            Plan::default(),
            ctx,
            out,
        );
    }

    fn list(&mut self, now: Timestamp, from: Peer, mission_type: u8, out: &mut Outbox) {
        let (count, id) = match mission_type {
            mission_type::MISSION => {
                self.readers.begin(now, from.address, &self.stored);
                (self.stored.count(), self.stored.id)
            }
            _ => return ack(from, mission_result::UNSUPPORTED, mission_type, 0, out),
        };
        let Address { system, component } = from.address;
        let reply = raw::MISSION_COUNT_DATA {
            count,
            target_system: system,
            target_component: component,
            mission_type,
            opaque_id: id,
        };
        out.send_raw(Destination::All, raw::MavMessage::MISSION_COUNT(reply));
    }

    /// The item a station asks for; without it an ACK that says so is on its way.
    fn requested(
        &mut self,
        now: Timestamp,
        from: Peer,
        seq: u16,
        mission_type: u8,
        out: &mut Outbox,
    ) -> Option<MissionItem> {
        let item = if mission_type == mission_type::MISSION {
            self.readers.item(now, from.address, seq, &self.stored)
        } else {
            None
        };
        if item.is_none() {
            ack(from, mission_result::INVALID_SEQUENCE, mission_type, 0, out);
        }
        item
    }

    fn is_taken_by_another(&self, from: Peer) -> bool {
        match &self.change {
            Change::None => false,
            Change::Receiving(upload) => upload.client.address != from.address,
            Change::Committing(commit) => commit.client.is_some_and(|c| c.address != from.address),
        }
    }
}
