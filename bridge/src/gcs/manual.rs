//! Sticks of a pilot at a ground station: MANUAL_CONTROL and RC_CHANNELS_OVERRIDE.
//!
//! | Field | Range | Meaning |
//! | --- | --- | --- |
//! | MANUAL_CONTROL x, y, r | -1000..=1000 | forward, right, clockwise; `INT16_MAX` = axis not used |
//! | z | -1000..=1000, below 0 counts as 0 | 500 = hold height; thrust itself in Stabilized |
//! | RC_CHANNELS_OVERRIDE 1..4 | 800..=2200 us | roll, pitch, throttle, yaw; 0 and 65535 = not overridden |
//!
//! A message with a number out of range is garbage as a whole and moves nothing. Which station steers, in which modes sticks
//! count and what happens when they fall silent is decided in the vehicle; its refusals are not repeated to the pilot at the
//! rate of a joystick, so nobody keeps them.

use super::{Context, Outbox, Peer};
use crate::autopilot::door::{ManualInput, Request, Severity};
use core::time::Duration;
use mavlink_dialect::{Message, raw, standard};
use vehicle::Timestamp;

/// Time between two complaints about garbage.
const COMPLAINT_PERIOD: Duration = Duration::from_secs(5);

/// Takes sticks. It keeps nothing but when it complained last.
#[derive(Debug, Default)]
pub struct ManualService {
    complained_at: Option<Timestamp>,
}

impl ManualService {
    /// No complaint yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a message for us.
    pub fn handle(
        &mut self,
        now: Timestamp,
        from: Peer,
        message: &Message,
        _ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let (name, request) = match message {
            Message::Raw(raw::MavMessage::MANUAL_CONTROL(m)) => {
                ("MANUAL_CONTROL", manual(m).map(Request::Manual))
            }
            Message::Standard(standard::MavMessage::RC_CHANNELS_OVERRIDE(m)) => (
                "RC_CHANNELS_OVERRIDE",
                rc_override(m).map(Request::RcOverride),
            ),
            _ => return,
        };
        if let Some(request) = request {
            out.ask(from, request);
        } else if self
            .complained_at
            .is_none_or(|at| now.since(at) >= COMPLAINT_PERIOD)
        {
            self.complained_at = Some(now);
            out.text(
                Severity::Warning,
                format!(
                    "{name} of system {} out of range: ignored",
                    from.address.system
                ),
            );
        }
    }
}

/// None if a number is out of range.
fn manual(m: &raw::MANUAL_CONTROL_DATA) -> Option<ManualInput> {
    Some(ManualInput {
        forward: axis(m.x)?,
        right: axis(m.y)?,
        yaw: axis(m.r)?,
        // MAVLink allows negative thrust, which no quadcopter has.
        throttle: axis(m.z)?.map(|z| z.max(0.0)),
    })
}

/// An axis as -1..=1, none if not used; none at all if out of range.
fn axis(value: i16) -> Option<Option<f64>> {
    match value {
        i16::MAX => Some(None),
        v if (-1000..=1000).contains(&v) => Some(Some(f64::from(v) / 1000.0)),
        _ => None,
    }
}

/// None if a pulse is none that a receiver makes.
fn rc_override(m: &standard::RC_CHANNELS_OVERRIDE_DATA) -> Option<[Option<u16>; 4]> {
    let mut channels = [None; 4];
    for (to, us) in channels
        .iter_mut()
        .zip([m.chan1_raw, m.chan2_raw, m.chan3_raw, m.chan4_raw])
    {
        *to = match us {
            0 | u16::MAX => None,
            // Flight controllers take what lies outside 1000..=2000 for a dead receiver.
            800..=2200 => Some(us.clamp(1000, 2000)),
            _ => return None,
        };
    }
    Some(channels)
}

#[cfg(test)]
mod tests {
    use super::super::bench::{Bench, station};
    use super::*;

    fn ask(message: impl Into<Message>) -> (Vec<Request>, usize) {
        let (bench, mut out) = (Bench::default(), Outbox::default());
        ManualService::new().handle(
            Timestamp::ZERO,
            station(255),
            &message.into(),
            &bench.ctx(),
            &mut out,
        );
        (
            out.asked().into_iter().map(|a| a.request).collect(),
            out.said().len(),
        )
    }

    fn sticks(x: i16, y: i16, z: i16, r: i16) -> raw::MavMessage {
        raw::MavMessage::MANUAL_CONTROL(raw::MANUAL_CONTROL_DATA {
            x,
            y,
            z,
            r,
            target: 1,
            ..Default::default()
        })
    }

    #[test]
    fn full_sticks_are_one_and_unused_axes_none() {
        let expect = ManualInput {
            forward: Some(1.0),
            right: Some(-1.0),
            yaw: None,
            throttle: Some(0.5),
        };
        assert_eq!(
            ask(sticks(1000, -1000, 500, i16::MAX)),
            (vec![Request::Manual(expect)], 0)
        );
        let down = ManualInput {
            forward: Some(0.0),
            right: Some(0.0),
            yaw: Some(0.0),
            throttle: Some(0.0),
        };
        assert_eq!(ask(sticks(0, 0, -700, 0)), (vec![Request::Manual(down)], 0));
    }

    #[test]
    fn one_wild_axis_spoils_the_message() {
        assert_eq!(ask(sticks(1001, 0, 500, 0)), (vec![], 1));
        assert_eq!(ask(sticks(0, i16::MIN, 500, 0)), (vec![], 1));
        assert_eq!(ask(sticks(0, 0, 20_000, 0)), (vec![], 1));
    }

    #[test]
    fn garbage_is_complained_about_every_five_seconds_at_most() {
        let (bench, mut out, mut service) =
            (Bench::default(), Outbox::default(), ManualService::new());
        for ms in 0..11_000 {
            let wild = Message::Raw(sticks(5000, 0, 0, 0));
            service.handle(
                Timestamp::from_ms(ms),
                station(255),
                &wild,
                &bench.ctx(),
                &mut out,
            );
        }
        assert_eq!(out.said().len(), 3);
    }

    #[test]
    fn overridden_channels_are_pulses_and_the_rest_none() {
        let rc = |c: [u16; 4]| {
            standard::MavMessage::RC_CHANNELS_OVERRIDE(standard::RC_CHANNELS_OVERRIDE_DATA {
                chan1_raw: c[0],
                chan2_raw: c[1],
                chan3_raw: c[2],
                chan4_raw: c[3],
                ..Default::default()
            })
        };
        assert_eq!(
            ask(rc([1500, 0, 950, u16::MAX])),
            (
                vec![Request::RcOverride([Some(1500), None, Some(1000), None])],
                0
            )
        );
        assert_eq!(ask(rc([1500, 3000, 1500, 1500])), (vec![], 1));
    }
}
