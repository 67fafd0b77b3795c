//! Fence and rally points: lists of their own.

use super::*;

/// An item of a fence or a rally point, in the global frame as stations send them.
fn point(seq: u16, command: u16, param1: f32, lat_e7: i32) -> MissionItem {
    MissionItem {
        seq,
        frame: 5,
        command,
        params: [param1, 0.0, 0.0, 0.0],
        x: 473_977_420 + lat_e7,
        y: 85_455_940 + lat_e7 % 7,
        ..Default::default()
    }
}

/// Sends a list of points as a station does; the result of the last ACK.
fn upload_points(v: &mut Vehicle, from: Peer, kind: u8, items: &[MissionItem]) -> Option<u8> {
    v.take(from, count_of(items.len() as u16, kind));
    let mut result = None;
    loop {
        let said = v.said();
        let mut asked = None;
        for m in said {
            match m {
                M::MISSION_REQUEST_INT(r) if r.mission_type == kind => asked = Some(r.seq),
                M::MISSION_ACK(a) if a.mission_type == kind => result = Some(a.mavtype),
                other => panic!("{other:?}"),
            }
        }
        let Some(seq) = asked else { return result };
        let mut item = items[usize::from(seq)].to_int(1, 1);
        item.mission_type = kind;
        v.take(from, M::MISSION_ITEM_INT(item));
    }
}

/// Reads a list back as a station does.
fn download_points(v: &mut Vehicle, from: Peer, kind: u8) -> (Vec<MissionItem>, u32) {
    v.take(from, list(kind));
    let said = v.said();
    let [M::MISSION_COUNT(head)] = &said[..] else {
        panic!("{said:?}")
    };
    assert_eq!(head.mission_type, kind);
    let mut items = Vec::new();
    for seq in 0..head.count {
        v.take(
            from,
            M::MISSION_REQUEST_INT(raw::MISSION_REQUEST_INT_DATA {
                seq,
                mission_type: kind,
                ..Default::default()
            }),
        );
        let said = v.said();
        let [M::MISSION_ITEM_INT(item)] = &said[..] else {
            panic!("{said:?}")
        };
        assert_eq!(item.mission_type, kind);
        items.push(MissionItem::from_int(item));
    }
    (items, head.opaque_id)
}

fn a_fence() -> Vec<MissionItem> {
    // A sliver to stay out of beside home, and a circle about home to stay in.
    let corner = |seq: u16| point(seq, 5002, 4.0, i32::from(seq) * 1_000 + 500);
    let mut items: Vec<_> = (0..4).map(corner).collect();
    items.push(point(4, 5003, 0.5, 10));
    items
}

#[test]
fn mission_fence_and_rally_points_are_lists_of_their_own() {
    let mut v = Vehicle::new(None);
    let rally = [point(0, 5100, 0.0, 3), point(1, 5100, 0.0, 5)];
    assert_eq!(v.upload(A, &route(3)), 0);
    v.said();
    assert_eq!(
        upload_points(&mut v, A, mission_type::FENCE, &a_fence()),
        Some(0)
    );
    assert_eq!(
        upload_points(&mut v, B, mission_type::RALLY, &rally),
        Some(0)
    );
    let (fence_back, fence_id) = download_points(&mut v, B, mission_type::FENCE);
    let (rally_back, rally_id) = download_points(&mut v, A, mission_type::RALLY);
    assert_eq!(bytes(&fence_back), bytes(&a_fence()));
    assert_eq!(bytes(&rally_back), bytes(&rally));
    let ids = v.service.plan_ids();
    assert_eq!((ids.fence, ids.rally), (fence_id, rally_id));
    assert!(ids.mission != 0 && fence_id != 0 && rally_id != 0 && fence_id != rally_id);
    // What is stored is read again after a restart.
    let mut again = Vehicle::new(None);
    let documents: Vec<_> = v.out.documents.drain(..).collect();
    for document in &documents {
        let ctx = again.bench.ctx();
        again
            .service
            .restore_document(Timestamp::ZERO, document, &ctx, &mut again.out);
    }
    assert_eq!(again.service.plan_ids().fence, fence_id);
    assert_eq!(again.service.plan_ids().rally, rally_id);
    // Clearing one leaves the others; clearing all leaves none.
    v.take(A, clear(mission_type::FENCE));
    assert_eq!(v.acks(), [(245, 0)]);
    let ids = v.service.plan_ids();
    assert_eq!((ids.fence, ids.rally), (0, rally_id));
    assert_ne!(ids.mission, 0);
    v.take(A, clear(mission_type::ALL));
    v.tick(10);
    assert_eq!(v.service.plan_ids(), PlanIds::default());
    v.take(A, list(9));
    assert!(v.acks().contains(&(245, mission_result::UNSUPPORTED)));
}

#[test]
fn a_fence_that_cannot_be_is_refused_and_the_old_one_stays() {
    let mut v = Vehicle::new(None);
    assert_eq!(
        upload_points(&mut v, A, mission_type::FENCE, &a_fence()),
        Some(0)
    );
    let id = v.service.plan_ids().fence;
    let cases: [(Vec<MissionItem>, u8); 6] = [
        (a_fence()[..3].to_vec(), mission_result::INVALID_PARAM1),
        (vec![point(0, 5003, 0.0, 0)], mission_result::INVALID_PARAM1),
        (
            vec![point(0, 5003, f32::NAN, 0)],
            mission_result::INVALID_PARAM1,
        ),
        (vec![point(0, 16, 0.0, 0)], mission_result::UNSUPPORTED),
        (vec![point(0, 5100, 0.0, 0)], mission_result::UNSUPPORTED),
        (
            vec![MissionItem {
                frame: 2,
                ..point(0, 5003, 1.0, 0)
            }],
            mission_result::UNSUPPORTED_FRAME,
        ),
    ];
    for (items, result) in cases {
        assert_eq!(
            upload_points(&mut v, A, mission_type::FENCE, &items),
            Some(result),
            "{items:?}"
        );
    }
    v.take(A, count_of(POINTS_CAPACITY + 1, mission_type::FENCE));
    assert_eq!(v.acks(), [(245, mission_result::NO_SPACE)]);
    // Two stations at once, and one that falls silent.
    v.take(A, count_of(5, mission_type::FENCE));
    v.said();
    v.take(B, count_of(5, mission_type::FENCE));
    assert_eq!(v.acks(), [(250, mission_result::DENIED)]);
    for _ in 0..100 {
        v.tick(100);
    }
    assert_eq!(v.service.plan_ids().fence, id);
    v.said();
    assert_eq!(
        upload_points(
            &mut v,
            B,
            mission_type::FENCE,
            &a_fence()[4..]
                .iter()
                .map(|i| MissionItem { seq: 0, ..*i })
                .collect::<Vec<_>>()
        ),
        Some(0)
    );
    assert_ne!(v.service.plan_ids().fence, id);
}
