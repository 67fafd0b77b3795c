//! Modes, places to go to, home.

use super::*;

#[test]
fn every_mode_is_set_by_each_of_the_four_forms() {
    for mode in Mode::ALL {
        let Px4Mode { main, sub } = crate::gcs::convert::mode_to_px4(mode);
        let packed = Px4Mode { main, sub }.custom_mode();
        let ask = Came::Asked(Request::SetMode(mode));
        for base in [1.0, 129.0, 29.0] {
            assert_eq!(
                came(&first(176, &[base, f32::from(main), f32::from(sub)])),
                ask,
                "(a) {mode:?}"
            );
        }
        assert_eq!(
            came(&first(176, &[1.0, packed as f32])),
            ask,
            "(c) {mode:?}"
        );
        let mut desk = Desk::new();
        let set_mode = raw::SET_MODE_DATA {
            target_system: 1,
            base_mode: 1,
            custom_mode: packed,
        };
        desk.send(A, &Message::Raw(M::SET_MODE(set_mode)));
        assert_eq!(desk.out.asked()[0].request, Request::SetMode(mode), "(b)");
        assert!(desk.acks().is_empty(), "SET_MODE has no ACK");
    }
    for (standard, mode) in [
        (1, Mode::Position),
        (4, Mode::Altitude),
        (5, Mode::Return),
        (6, Mode::Mission),
        (7, Mode::Land),
        (8, Mode::Takeoff),
    ] {
        assert_eq!(
            came(&first(262, &[standard as f32])),
            Came::Asked(Request::SetMode(mode)),
            "(d)"
        );
    }
}

#[test]
fn modes_we_do_not_fly_are_unsupported() {
    for message in [
        first(176, &[1.0, 5.0, 0.0]),
        first(176, &[1.0, 4.0, 99.0]),
        first(176, &[1.0, NAN]),
        first(176, &[NAN, 4.0, 3.0]),
        first(176, &[1.0, 4.0, -3.0]),
        first(176, &[0.0, 4.0, 3.0]),
        first(176, &[1.0, 1e30]),
        first(262, &[2.0]),
        first(262, &[NAN]),
    ] {
        assert_eq!(
            refused(&mut Desk::new(), &message, "not flown"),
            result::UNSUPPORTED,
            "{message:?}"
        );
    }
    let mut desk = Desk::new();
    desk.send(
        A,
        &Message::Raw(M::SET_MODE(raw::SET_MODE_DATA {
            target_system: 1,
            base_mode: 1,
            custom_mode: 0x0500_0000,
        })),
    );
    assert!(desk.out.asked().is_empty() && desk.out.said()[0].1.starts_with("Mode refused"));
}

#[test]
fn a_refused_set_mode_is_told_in_words() {
    let mut desk = Desk::new();
    desk.send(
        A,
        &Message::Raw(M::SET_MODE(raw::SET_MODE_DATA {
            target_system: 1,
            base_mode: 1,
            custom_mode: 6 << 16,
        })),
    );
    let asked = desk.out.asked().remove(0);
    let no = answer(&asked, Outcome::Refused(Refusal::NoOffboardStream));
    assert!(
        desk.service
            .answer(desk.now, &no, &desk.bench.ctx(), &mut desk.out)
    );
    assert_eq!(
        desk.out.said()[0].1,
        "Mode refused: send off-board set points first"
    );
}

#[test]
fn reposition_keeps_what_is_not_given_in_both_forms() {
    let desk = Desk::new();
    let geo = GeoAnchor::from_params(&desk.bench.settings.ground);
    let p = geo.to_global(In::new(2.0, -3.0, -1.5));
    let Came::Asked(Request::GoTo(to)) =
        came(&int(192, 5, [-1.0, 1.0, 0.0, NAN], p.lat_e7, p.lon_e7, 1.5))
    else {
        panic!("go-to")
    };
    assert!((to.north_m.unwrap() - 2.0).abs() < 0.006 && (to.east_m.unwrap() + 3.0).abs() < 0.006);
    assert_eq!(
        (to.down_m, to.yaw_rad, to.speed_mps),
        (Some(-1.5), None, None)
    );

    let keep = GoTo::default();
    let go = |to: GoTo| Came::Asked(Request::GoTo(to));
    assert_eq!(
        came(&long(192, [-1.0, 1.0, 0.0, NAN, NAN, NAN, NAN])),
        go(keep),
        "QGroundControl's pause"
    );
    assert_eq!(
        came(&int(192, 6, [NAN; 4], i32::MAX, i32::MAX, NAN)),
        go(keep)
    );
    let up = GoTo {
        down_m: Some(-2.0),
        ..keep
    };
    assert_eq!(
        came(&long(192, [-1.0, 1.0, 0.0, NAN, NAN, NAN, 2.0])),
        go(up),
        "change altitude"
    );
    let turned = GoTo {
        yaw_rad: Some(1.0),
        speed_mps: Some(0.5),
        ..keep
    };
    assert_eq!(
        came(&long(192, [0.5, 1.0, 0.0, 1.0, NAN, NAN, NAN])),
        go(turned),
        "change heading"
    );
    let local = GoTo {
        north_m: Some(1.5),
        east_m: Some(-0.25),
        down_m: Some(-1.0),
        ..keep
    };
    assert_eq!(
        came(&int(192, 1, [0.0, 1.0, 0.0, NAN], 15_000, -2_500, -1.0)),
        go(local),
        "local frame"
    );

    let mut high = Desk::new();
    high.bench.snapshot.home = In::new(0.0, 0.0, -0.5);
    high.bench.snapshot.nav.attitude = Rot::from_roll_pitch_yaw(0.0, 0.0, 3.0);
    let relative = GoTo {
        down_m: Some(-2.5),
        ..keep
    };
    assert_eq!(
        high.came(&int(192, 3, [NAN; 4], i32::MAX, i32::MAX, 2.0)),
        go(relative)
    );
    let Came::Asked(Request::GoTo(to)) = high.came(&long(192, [NAN, 3.0, NAN, 1.0, NAN, NAN, NAN]))
    else {
        panic!()
    };
    assert!(
        (to.yaw_rad.unwrap() - (4.0 - core::f64::consts::TAU)).abs() < 1e-6,
        "a turn of 1 rad to the right"
    );
}

#[test]
fn reposition_that_cannot_be_flown_is_refused() {
    for (message, result) in [
        (
            int(192, 2, [NAN; 4], 0, 0, 0.0),
            result::UNSUPPORTED_MAV_FRAME,
        ),
        (
            int(192, 99, [NAN; 4], 0, 0, 0.0),
            result::UNSUPPORTED_MAV_FRAME,
        ),
        (int(192, 0, [NAN; 4], 910_000_000, 0, 1.0), result::DENIED),
        (int(192, 0, [NAN; 4], 0, 0, f32::INFINITY), result::DENIED),
        (
            long(192, [NAN, NAN, NAN, f32::INFINITY, NAN, NAN, NAN]),
            result::DENIED,
        ),
        (
            long(192, [NAN, NAN, NAN, NAN, f32::INFINITY, NAN, NAN]),
            result::DENIED,
        ),
    ] {
        assert_eq!(came(&message), Came::Acked(result), "{message:?}");
    }
    let mut desk = Desk::new();
    desk.bench.snapshot.mode.mode = Mode::Position;
    let keep = long(192, [NAN, 0.0, NAN, NAN, NAN, NAN, NAN]);
    assert_eq!(
        refused(&mut desk, &keep, "mode Position is flown"),
        result::TEMPORARILY_REJECTED
    );
    assert!(matches!(
        desk.came(&long(192, [NAN, 1.0, NAN, NAN, NAN, NAN, NAN])),
        Came::Asked(_)
    ));
}

#[test]
fn home_and_origin_are_set_at_a_whole_place() {
    let desk = Desk::new();
    let geo = GeoAnchor::from_params(&desk.bench.settings.ground);
    let p = geo.to_global(In::new(1.0, 1.0, 0.0));
    let Came::Asked(Request::SetHome(Some(home))) =
        came(&int(179, 0, [0.0; 4], p.lat_e7, p.lon_e7, 0.0))
    else {
        panic!("home")
    };
    assert!((home - In::new(1.0, 1.0, 0.0)).norm() < 0.01);
    assert_eq!(
        came(&int(179, 0, [0.0; 4], i32::MAX, p.lon_e7, 0.0)),
        Came::Acked(result::DENIED)
    );

    let mut desk = Desk::new();
    desk.send(A, &int(611, 0, [0.0; 4], 10_000_000, 20_000_000, 5.0));
    assert_eq!(
        (desk.out.asked().len(), desk.acks()),
        (3, vec![(255, 611, result::ACCEPTED)]),
        "three parameters"
    );
    desk.bench.snapshot.is_armed = true;
    assert_eq!(
        refused(
            &mut desk,
            &int(611, 0, [0.0; 4], 10_000_000, 20_000_000, 5.0),
            "disarm first"
        ),
        result::DENIED
    );
}
