//! The parameter service.

use super::*;

#[test]
fn the_parameter_list_is_whole_dense_and_paced() {
    let mut bench = Bench::with_link();
    let count = bench.ground.settings().count();
    bench.say(request_list());
    bench.run_for(250);
    let early = bench.values(A).len();
    assert!(
        (40..=60).contains(&early),
        "200 a second: {early} in 250 ms"
    );
    bench.run_for(5 * count as u64);
    let values = bench.values(A);
    assert_eq!(
        values
            .iter()
            .map(|v| usize::from(v.param_index))
            .collect::<Vec<_>>(),
        (0..count).collect::<Vec<_>>()
    );
    assert!(values.iter().all(|v| usize::from(v.param_count) == count));
    assert!(
        values
            .iter()
            .any(|v| v.param_id.to_str() == Ok("MIS_TAKEOFF_ALT"))
    );
}

#[test]
fn an_impatient_client_that_repeats_its_request_gets_every_parameter() {
    let mut bench = Bench::with_link();
    let count = bench.ground.settings().count();
    for _ in 0..6 {
        bench.say(request_list());
        bench.run_for(200);
    }
    bench.run_for(5 * count as u64);
    let mut seen: Vec<_> = bench.values(A).iter().map(|v| v.param_index).collect();
    seen.sort_unstable();
    seen.dedup();
    assert_eq!(seen.len(), count);
}

#[test]
fn a_parameter_set_while_listing_is_kept_echoed_and_sent_to_the_vehicle() {
    let mut bench = Bench::with_link();
    bench.link_up(B);
    bench.say(request_list());
    bench.run_for(100);
    let before = bench.values(A).len();
    bench.say(set("MIS_TAKEOFF_ALT", 1.5, 9));
    assert_eq!(bench.values(A).len(), before + 1);
    assert_eq!(bench.values(B).len(), 1, "an echo for everybody");
    assert!((bench.values(B)[0].param_value - 1.5).abs() < 1e-9);
    let index = bench.ground.settings().index_of("MIS_TAKEOFF_ALT").unwrap();
    let asked = bench.requests.last().unwrap();
    assert_eq!(
        asked.request,
        Request::SetParam {
            index: index as u16,
            value: ParamValue::Float(1.5)
        }
    );
    assert_eq!(
        asked.station,
        Station {
            system: 255,
            component: 190
        }
    );
    let document = bench.documents.last().unwrap();
    assert_eq!(document.name, "parameters.toml");
    assert_eq!(
        String::from_utf8_lossy(&document.bytes),
        "[autopilot]\ntakeoff_height_m = 1.5\n"
    );
    bench.run_for(5_000);
    let indices: Vec<_> = bench
        .values(A)
        .iter()
        .map(|v| usize::from(v.param_index))
        .collect();
    assert_eq!(indices.len(), bench.ground.settings().count() + 1);
}

#[test]
fn integers_are_set_by_bits_and_by_value() {
    let mut bench = Bench::with_link();
    bench.say(set("SYS_AUTOSTART", f32::from_bits(4002), 6));
    assert_eq!(bench.ground.settings().ground.autostart, 4002);
    bench.say(set("SYS_AUTOSTART", 4003.0, 9));
    assert_eq!(bench.ground.settings().ground.autostart, 4003);
    assert_eq!(
        bench.values(A).last().map(|v| v.param_value.to_bits()),
        Some(4003)
    );
}

#[test]
fn a_wrong_value_is_refused_with_the_old_one_and_the_reason() {
    let mut bench = Bench::with_link();
    for (value, kind) in [
        (f32::NAN, 9),
        (f32::INFINITY, 9),
        (99.0, 9),
        (f32::from_bits(0x7FFF_FFFF), 6),
        (1.0, 10),
    ] {
        bench.values(A).clear();
        bench.say(set("MIS_TAKEOFF_ALT", value, kind));
        let echo = bench.values(A).last().cloned().unwrap();
        assert!((echo.param_value - 1.0).abs() < 1e-9, "{value} as {kind}");
        bench.run_for(2_500);
    }
    assert_eq!(bench.values(A).len(), 5);
    assert!(bench.requests.is_empty() && bench.documents.is_empty());
    assert!(
        bench
            .texts(A)
            .contains(&"MIS_TAKEOFF_ALT = NaN is outside 0.3..=10".to_owned()),
        "{:?}",
        bench.texts(A)
    );
    bench.say(set("NO_SUCH", 1.0, 9));
    assert_eq!(
        bench.values(A).len(),
        5,
        "an unknown name has no value to echo"
    );
    assert!(
        bench
            .texts(A)
            .contains(&"no parameter named NO_SUCH".to_owned())
    );
}

#[test]
fn parameters_are_read_by_index_and_by_name() {
    let mut bench = Bench::with_link();
    let read = |param_index, name: &str| {
        Std::PARAM_REQUEST_READ(standard::PARAM_REQUEST_READ_DATA {
            param_index,
            target_system: 1,
            target_component: 1,
            param_id: name.into(),
        })
    };
    bench.say(read(3, ""));
    bench.say(read(-1, "MAV_SYS_ID"));
    bench.say(read(30_000, ""));
    bench.say(read(-1, "NO_SUCH"));
    let got: Vec<_> = bench
        .values(A)
        .iter()
        .map(|v| (v.param_index, v.param_value.to_bits()))
        .collect();
    assert_eq!(got.len(), 2);
    assert_eq!(got[0].0, 3);
    assert_eq!(got[1].1, 1);
}
