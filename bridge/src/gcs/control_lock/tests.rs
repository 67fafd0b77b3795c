use super::super::bench::station;
use super::*;
use proptest::prelude::*;

fn ask(action: f32, takeover: f32) -> Message {
    Message::Raw(raw::MavMessage::COMMAND_LONG(raw::COMMAND_LONG_DATA {
        command: cmd::REQUEST_OPERATOR_CONTROL,
        param1: action,
        param2: takeover,
        param3: 10.0,
        ..Default::default()
    }))
}

fn command(command: u16) -> Message {
    Message::Raw(raw::MavMessage::COMMAND_LONG(raw::COMMAND_LONG_DATA {
        command,
        ..Default::default()
    }))
}

fn beat() -> Message {
    Message::Raw(raw::MavMessage::HEARTBEAT(raw::HEARTBEAT_DATA::default()))
}

fn sticks() -> Message {
    Message::Raw(raw::MavMessage::MANUAL_CONTROL(
        raw::MANUAL_CONTROL_DATA::default(),
    ))
}

/// The result in the last COMMAND_ACK.
fn answered(out: &Outbox) -> Option<u8> {
    out.messages.iter().rev().find_map(|o| match &o.message {
        Message::Raw(raw::MavMessage::COMMAND_ACK(a)) => Some(a.result),
        _ => None,
    })
}

fn owner(lock: &ControlLock) -> Option<u8> {
    lock.control().owner.map(|(_, system)| system)
}

#[test]
fn while_nobody_asks_everybody_flies_and_nothing_is_said() {
    let (mut lock, mut out) = (ControlLock::new(), Outbox::default());
    assert!(lock.admits(Timestamp::ZERO, station(255), &sticks(), &mut out));
    assert!(lock.admits(
        Timestamp::ZERO,
        station(254),
        &command(cmd::NAV_TAKEOFF),
        &mut out
    ));
    for s in 0..10 {
        lock.tick(Timestamp::from_ms(s * 1000), &mut out);
    }
    assert!(out.messages.is_empty());
}

#[test]
fn the_first_who_asks_has_control_and_others_are_told_so() {
    let (mut lock, mut out) = (ControlLock::new(), Outbox::default());
    let now = Timestamp::ZERO;
    assert!(!lock.admits(now, station(200), &ask(1.0, 0.0), &mut out));
    assert_eq!(
        (answered(&out), owner(&lock)),
        (Some(result::ACCEPTED), Some(200))
    );
    assert!(lock.admits(now, station(200), &sticks(), &mut out));
    assert!(!lock.admits(now, station(255), &command(cmd::NAV_TAKEOFF), &mut out));
    assert_eq!(answered(&out), Some(result::NOT_IN_CONTROL));
    assert!(!lock.admits(now, station(255), &sticks(), &mut out));
    assert_eq!(lock.refused(), 2);
}

#[test]
fn a_plan_of_somebody_else_is_denied_and_reading_it_is_not() {
    let (mut lock, mut out) = (ControlLock::new(), Outbox::default());
    lock.admits(Timestamp::ZERO, station(200), &ask(1.0, 0.0), &mut out);
    let count = Message::Raw(raw::MavMessage::MISSION_COUNT(raw::MISSION_COUNT_DATA {
        count: 3,
        mission_type: 1,
        ..Default::default()
    }));
    assert!(!lock.admits(Timestamp::ZERO, station(255), &count, &mut out));
    let denied = out.messages.iter().any(|o| {
        matches!(&o.message, Message::Raw(raw::MavMessage::MISSION_ACK(a)) if (a.mavtype, a.mission_type) == (14, 1))
    });
    assert!(denied);
    let list = raw::MavMessage::MISSION_REQUEST_LIST(raw::MISSION_REQUEST_LIST_DATA::default());
    assert!(lock.admits(Timestamp::ZERO, station(255), &Message::Raw(list), &mut out));
}

#[test]
fn stop_land_and_looking_work_for_everybody() {
    let (mut lock, mut out) = (ControlLock::new(), Outbox::default());
    lock.admits(Timestamp::ZERO, station(200), &ask(1.0, 0.0), &mut out);
    for c in [
        cmd::DO_PAUSE_CONTINUE,
        cmd::NAV_LAND,
        cmd::REQUEST_MESSAGE,
        cmd::RUN_PREARM_CHECKS,
    ] {
        assert!(
            lock.admits(Timestamp::ZERO, station(255), &command(c), &mut out),
            "{c}"
        );
    }
}

#[test]
fn an_owner_who_keeps_control_is_asked_and_hands_over_without_a_gap() {
    let (mut lock, mut out) = (ControlLock::new(), Outbox::default());
    let now = Timestamp::ZERO;
    lock.admits(now, station(200), &ask(1.0, 0.0), &mut out);
    let lease = lock.control().lease;
    lock.admits(now, station(201), &ask(1.0, 0.0), &mut out);
    assert_eq!(
        (answered(&out), owner(&lock), lock.control().asking),
        (Some(result::FAILED), Some(200), Some(201))
    );
    let forwarded = out.messages.iter().any(|o| {
        o.to == Destination::Link(station(200).link)
            && matches!(&o.message, Message::Raw(raw::MavMessage::COMMAND_LONG(m)) if (m.param4 - 201.0).abs() < 0.5)
    });
    assert!(forwarded, "the owner is asked by the same command");
    lock.admits(now, station(200), &ask(0.0, 0.0), &mut out);
    assert_eq!(owner(&lock), Some(201));
    assert!(lock.control().lease > lease);
}

#[test]
fn a_question_ends_after_ten_seconds() {
    let (mut lock, mut out) = (ControlLock::new(), Outbox::default());
    lock.admits(Timestamp::ZERO, station(200), &ask(1.0, 0.0), &mut out);
    lock.admits(Timestamp::ZERO, station(201), &ask(1.0, 0.0), &mut out);
    for s in 1..=10 {
        let now = Timestamp::from_ms(s * 1000);
        lock.admits(now, station(200), &beat(), &mut out);
        lock.tick(now, &mut out);
    }
    assert_eq!((owner(&lock), lock.control().asking), (Some(200), None));
    // Giving up now gives it to nobody.
    lock.admits(
        Timestamp::from_ms(10_500),
        station(200),
        &ask(0.0, 0.0),
        &mut out,
    );
    assert_eq!(owner(&lock), None);
}

#[test]
fn an_owner_silent_for_three_seconds_loses_control_and_his_sticks_are_centred() {
    let (mut lock, mut out) = (ControlLock::new(), Outbox::default());
    lock.admits(Timestamp::ZERO, station(200), &ask(1.0, 0.0), &mut out);
    lock.tick(Timestamp::from_ms(2_999), &mut out);
    assert_eq!(owner(&lock), Some(200));
    lock.tick(Timestamp::from_ms(3_000), &mut out);
    assert_eq!(owner(&lock), None);
    assert!(
        matches!(out.requests.back().map(|a| &a.request), Some(Request::Manual(m)) if m.forward == Some(0.0))
    );
}

#[test]
fn who_speaks_with_the_owners_number_from_another_link_is_somebody_else() {
    let (mut lock, mut out) = (ControlLock::new(), Outbox::default());
    lock.admits(Timestamp::ZERO, station(200), &ask(1.0, 0.0), &mut out);
    let forger = Peer {
        link: LinkId(77),
        ..station(200)
    };
    assert!(!lock.admits(Timestamp::ZERO, forger, &sticks(), &mut out));
    lock.admits(Timestamp::ZERO, forger, &ask(0.0, 0.0), &mut out);
    assert_eq!(owner(&lock), Some(200), "he cannot give it up either");
}

#[test]
fn the_status_is_told_every_second_and_on_change() {
    let (mut lock, mut out) = (ControlLock::new(), Outbox::default());
    lock.admits(Timestamp::ZERO, station(200), &ask(1.0, 1.0), &mut out);
    let mut told = Vec::new();
    for ms in (0..3_000).step_by(20) {
        let now = Timestamp::from_ms(ms);
        lock.admits(now, station(200), &beat(), &mut out);
        if ms == 1_500 {
            lock.admits(now, station(201), &ask(1.0, 0.0), &mut out);
        }
        lock.tick(now, &mut out);
        told.extend(out.messages.drain(..).filter_map(|o| match o.message {
            Message::Standard(standard::MavMessage::CONTROL_STATUS(s)) => {
                Some((ms, s.gcs_main, s.flags.bits()))
            }
            _ => None,
        }));
    }
    assert_eq!(
        told,
        [
            (0, 200, 3),
            (1_000, 200, 3),
            (1_500, 201, 1),
            (2_000, 201, 1)
        ]
    );
}

/// What anybody may do at any time.
#[derive(Clone, Copy, Debug)]
enum Act {
    Ask(u8, bool),
    GiveUp(u8),
    Beat(u8),
    Fly(u8),
    Stop(u8),
    LinkDown(u8),
    Wait(u16),
}

fn acts() -> impl Strategy<Value = Vec<Act>> {
    let who = 1u8..5;
    let act = prop_oneof![
        (who.clone(), any::<bool>()).prop_map(|(w, t)| Act::Ask(w, t)),
        who.clone().prop_map(Act::GiveUp),
        who.clone().prop_map(Act::Beat),
        who.clone().prop_map(Act::Fly),
        who.clone().prop_map(Act::Stop),
        who.prop_map(Act::LinkDown),
        (0u16..4_000).prop_map(Act::Wait),
    ];
    proptest::collection::vec(act, 1..200)
}

proptest! {
    /// Whatever anybody does: at most one owner, his frames pass and nobody else's, stopping works for all, ownership changes
    /// only with the lease, and only to who asked for it.
    #[test]
    fn at_most_one_station_flies_at_every_instant(acts in acts()) {
        let (mut lock, mut now) = (ControlLock::new(), Timestamp::ZERO);
        let mut wanted = [false; 5];
        for act in acts {
            let mut out = Outbox::default();
            let before = lock.control();
            match act {
                Act::Ask(w, takeover) => {
                    wanted[usize::from(w)] = true;
                    lock.admits(now, station(w), &ask(1.0, if takeover { 1.0 } else { 0.0 }), &mut out);
                    let got = owner(&lock) == Some(w);
                    let mine = before.owner.map(|(_, s)| s) == Some(w);
                    prop_assert_eq!(answered(&out) == Some(result::ACCEPTED), got || mine);
                }
                Act::GiveUp(w) => {
                    lock.admits(now, station(w), &ask(0.0, 0.0), &mut out);
                    prop_assert_ne!(owner(&lock), Some(w));
                }
                Act::Beat(w) => prop_assert!(lock.admits(now, station(w), &beat(), &mut out)),
                Act::Fly(w) => {
                    let may = lock.admits(now, station(w), &sticks(), &mut out);
                    prop_assert_eq!(may, owner(&lock).is_none_or(|o| o == w));
                }
                Act::Stop(w) => prop_assert!(lock.admits(now, station(w), &command(cmd::DO_PAUSE_CONTINUE), &mut out)),
                Act::LinkDown(w) => {
                    lock.link_down(station(w).link, &mut out);
                    prop_assert_ne!(owner(&lock), Some(w));
                }
                Act::Wait(ms) => {
                    now += Duration::from_millis(u64::from(ms));
                    lock.tick(now, &mut out);
                }
            }
            let flying = (1u8..5).filter(|w| {
                let mut out = Outbox::default();
                lock.owner.is_some() && lock.admits(now, station(*w), &sticks(), &mut out)
            }).count();
            prop_assert!(flying <= 1);
            let after = lock.control();
            if before.owner != after.owner {
                prop_assert!(after.lease > before.lease);
                if let Some((_, who)) = after.owner {
                    prop_assert!(wanted[usize::from(who)]);
                }
            }
        }
    }
}
