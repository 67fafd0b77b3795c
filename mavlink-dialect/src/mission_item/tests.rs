//! What items say, and that they survive the wire.

use super::*;
use crate::Message;
use mavlink::MavlinkVersion;
use proptest::prelude::*;

fn any_f32() -> impl Strategy<Value = f32> {
    any::<u32>().prop_map(f32::from_bits)
}

prop_compose! {
    fn any_item()(
        seq: u16, frame in prop_oneof![0u8..12, any::<u8>()],
        command in prop_oneof![Just(16u16), Just(17), Just(19), Just(20), Just(21), Just(22), Just(93), Just(112),
            Just(115), Just(177), Just(178), any::<u16>()],
        current: u8, autocontinue: u8, params in [any_f32(), any_f32(), any_f32(), any_f32()],
        x: i32, y: i32, z in any_f32(),
    ) -> MissionItem {
        MissionItem { seq, frame, command, current, autocontinue, params, x, y, z }
    }
}

fn waypoint() -> MissionItem {
    MissionItem {
        command: 16,
        frame: 6,
        x: 1,
        y: 2,
        z: 3.0,
        params: [0.0, 0.0, 0.0, f32::NAN],
        ..Default::default()
    }
}

#[test]
fn waypoints_need_a_frame_of_places_and_all_of_the_place() {
    assert!(matches!(
        waypoint().action(),
        Ok(Action::Waypoint { yaw_deg: None, .. })
    ));
    let fault = |item: MissionItem| item.action().unwrap_err();
    assert_eq!(
        fault(MissionItem {
            frame: 2,
            ..waypoint()
        }),
        ItemFault::Frame(2)
    );
    assert_eq!(
        fault(MissionItem {
            frame: 10,
            ..waypoint()
        }),
        ItemFault::Frame(10)
    );
    assert_eq!(
        fault(MissionItem {
            x: i32::MAX,
            ..waypoint()
        }),
        ItemFault::Param(5)
    );
    assert_eq!(
        fault(MissionItem {
            x: 910_000_000,
            ..waypoint()
        }),
        ItemFault::Param(5)
    );
    assert_eq!(
        fault(MissionItem {
            y: -1_900_000_000,
            ..waypoint()
        }),
        ItemFault::Param(6)
    );
    assert_eq!(
        fault(MissionItem {
            z: f32::NAN,
            ..waypoint()
        }),
        ItemFault::Param(7)
    );
    assert_eq!(
        ItemFault::Param(7).mission_result(),
        mission_result::INVALID_PARAM7
    );
    assert_eq!(
        ItemFault::Param(5).mission_result(),
        mission_result::INVALID_PARAM5_X
    );
}

#[test]
fn landing_at_latitude_and_longitude_zero_is_landing_here() {
    let item = MissionItem {
        command: 21,
        frame: 3,
        ..Default::default()
    };
    assert_eq!(
        item.action(),
        Ok(Action::Land {
            at: None,
            yaw_deg: Some(0.0)
        })
    );
    let local = MissionItem { frame: 1, ..item };
    assert!(
        matches!(local.action(), Ok(Action::Land { at: Some(_), .. })),
        "local zero is a place"
    );
}

#[test]
fn mission_plugins_may_send_camera_and_gimbal_items() {
    for command in [
        201, 195, 197, 203, 206, 530, 1000, 1001, 2000, 2001, 2500, 2501,
    ] {
        let item = MissionItem {
            command,
            frame: 2,
            params: [f32::NAN; 4],
            z: f32::NAN,
            ..Default::default()
        };
        assert_eq!(item.action(), Ok(Action::Ignored), "{command}");
    }
}

#[test]
fn faults_are_sentences() {
    assert_eq!(
        ItemFault::Command(209).to_string(),
        "command 209 (DO_MOTOR_TEST) is not supported"
    );
    assert_eq!(
        ItemFault::Command(4242).to_string(),
        "command 4242 is not supported"
    );
}

#[test]
fn an_old_station_reads_and_writes_the_same_place() {
    let item = MissionItem {
        frame: 1,
        x: 12_500,
        y: -5_000,
        ..waypoint()
    };
    let float = item.to_float(255, 190);
    assert_eq!((float.x, float.y), (1.25, -0.5));
    let back = MissionItem::from_float(&float);
    assert_eq!((back.x, back.y, back.z), (item.x, item.y, item.z));
}

proptest! {
    #[test]
    fn an_item_survives_the_wire_bit_for_bit(item in any_item()) {
        let sent = Message::Raw(raw::MavMessage::MISSION_ITEM_INT(item.to_int(1, 1)));
        let mut payload = [0; 255];
        let n = sent.write_payload(&mut payload);
        let Ok(Message::Raw(raw::MavMessage::MISSION_ITEM_INT(m))) =
            Message::parse(MavlinkVersion::V2, 73, &payload[..n]) else { panic!("parses") };
        let back = MissionItem::from_int(&m);
        prop_assert_eq!(back.bytes(), item.bytes());
        prop_assert_eq!(back.current, item.current);
    }

    #[test]
    fn whatever_an_item_holds_it_is_understood_or_refused(item in any_item()) {
        match item.action() {
            Ok(Action::Waypoint { at, hold_s, acceptance_m, yaw_deg }) => {
                prop_assert!(at.x.is_some() && at.y.is_some() && at.z_m.is_some_and(f32::is_finite));
                prop_assert!(hold_s >= 0.0 && acceptance_m >= 0.0);
                prop_assert!(yaw_deg.is_none_or(f32::is_finite));
            }
            Ok(_) => {}
            Err(fault) => prop_assert!((2..=12).contains(&fault.mission_result())),
        }
        let _ = MissionItem::from_float(&item.to_float(1, 1)).action();
    }
}
