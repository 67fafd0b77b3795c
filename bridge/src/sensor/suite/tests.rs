//! Suites that are, and those that cannot be.

use super::*;

fn suite(urls: &[&str]) -> Result<Suite, String> {
    let specs: Vec<SensorSpec> = urls.iter().map(|u| u.parse().unwrap()).collect();
    Suite::new(&specs, &RingConfig::built_in).map_err(|e| e.to_string())
}

const PINS8: &str = "pins=1/2,3/4,5/6,7/8,9/10,11/12,13/14,15/16";

#[test]
fn each_driver_by_its_name() {
    let s = suite(&[
        "ld06:///dev/a?yaw_deg=180&z_m=-0.05",
        "msp:///dev/b",
        "gpsd:",
    ])
    .unwrap();
    assert_eq!((s.ring.rangers.len(), s.devices.len()), (10, 3));
    assert!(
        matches!(&s.devices[2].device, Device::Gpsd { address, .. } if address == "127.0.0.1:2947")
    );
    let s = suite(&[
        "tof_ring:///dev/a",
        &format!("hc_sr04:///dev/gpiochip0?{PINS8}"),
    ])
    .unwrap();
    assert_eq!(s.ring.rangers.len(), 12);
    assert!((s.ring.rangers[4].rate_hz - 4.03).abs() < 0.05);
    let s = suite(&["mavlink:?distance=0,2,4,6&down=on&flow=on&vision=own&from=1/196"]).unwrap();
    let feed = s.mavlink.unwrap();
    assert_eq!(feed.distance, [(0, 0), (2, 1), (4, 2), (6, 3)]);
    assert_eq!((feed.from, feed.vision), (Some([1, 196]), Vision::Own));
    assert_eq!(suite(&[]).unwrap().ring.rangers.len(), 0);
}

#[test]
fn what_cannot_be_together_is_refused_with_both_names_and_the_rule() {
    for (urls, names, rule) in [
        (
            vec!["ld06:///dev/a", "rplidar:///dev/a"],
            ["ld06:///dev/a", "rplidar:///dev/a"],
            "one reader",
        ),
        (
            vec!["ld06:///dev/a", "tof_ring:///dev/b"],
            [
                "ld06:///dev/a (60 columns)",
                "tof_ring:///dev/b (32 columns)",
            ],
            "64 beams",
        ),
        (
            vec!["gpsd:", "gps_fake:"],
            ["gpsd", "gps_fake"],
            "one source of satellite fixes",
        ),
        (
            vec!["msp:///dev/a", "mavlink:?down=on"],
            ["msp:///dev/a", "mavlink"],
            "one sensor looks down",
        ),
        (
            vec!["msp:///dev/a", "mavlink:?flow=on"],
            ["msp:///dev/a", "mavlink"],
            "one optical flow",
        ),
        (
            vec!["mavlink:?flow=on", "mavlink:?down=on"],
            ["mavlink", "mavlink"],
            "once",
        ),
        (
            vec!["tof_ring:///dev/a?rangers=sonar8"],
            ["tof_ring", "ranger `0deg` of `sonar8`"],
            "kind tof",
        ),
        (
            vec!["hc_sr04:///dev/gpiochip0?pins=1/2"],
            ["pins (1)", "rangers (8)"],
            "one pair",
        ),
        (
            vec!["hc_sr04:///dev/gpiochip0?pins=1/2,3/4,5/6,7/8,9/10,11/12,13/14,15/2"],
            ["`0deg`", "`315deg`"],
            "one use",
        ),
    ] {
        let said = suite(&urls).unwrap_err();
        assert!(
            names.iter().all(|n| said.contains(n)) && said.contains(rule),
            "{said}"
        );
    }
}

#[test]
fn what_cannot_be_at_all_is_refused_by_name() {
    let said = |url: &str| suite(&[url]).unwrap_err();
    assert!(said("ldo6:///dev/a").contains("there are ld06, rplidar"));
    assert!(said("ld06:").contains("name its serial port"));
    assert!(said("ld06:///dev/a?blind_deg=-180/179").contains("leaves none"));
    assert!(said("ld06:///dev/a?yaw=9").contains("no option `yaw`"));
    assert!(said("ld06:///dev/a?baudrate=0").contains("from 1200 to"));
    assert!(said("mavlink:").contains("name what to take"));
    assert!(said("mavlink:?distance=9").contains("0 to 7"));
    assert!(said("gps_fake:?values=lots").contains("zeros or random"));
    assert!(said("tof_ring:///dev/a?rangers=tof64").contains("tof32, sonar8"));
    assert!(said(&format!("hc_sr04:///dev/gpiochip0?{PINS8}&slot_ms=20")).contains("from 40 to"));
}
