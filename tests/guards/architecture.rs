//! The invariants of ARCHITECTURE.md that a test can hold.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Every Rust file below a folder with its text.
fn sources(folder: &str) -> Vec<(String, String)> {
    fn walk(at: &Path, out: &mut Vec<(String, String)>) {
        for entry in std::fs::read_dir(at).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                walk(&path, out);
            } else if path.extension().is_some_and(|e| e == "rs") {
                out.push((
                    path.display().to_string(),
                    std::fs::read_to_string(&path).unwrap(),
                ));
            }
        }
    }
    let mut out = Vec::new();
    walk(&root().join(folder), &mut out);
    assert!(!out.is_empty(), "{folder} has no sources");
    out
}

fn code(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter(|l| !l.trim_start().starts_with("//"))
}

#[test]
fn dependencies_point_one_way() {
    let out = Command::new(env!("CARGO"))
        .args([
            "metadata",
            "--format-version",
            "1",
            "--no-deps",
            "--offline",
        ])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(
        out.status.success(),
        "{}",
        String::from_utf8_lossy(&out.stderr)
    );
    let metadata: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let mut normal: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for package in metadata["packages"].as_array().unwrap() {
        let names = package["dependencies"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|d| d["kind"].is_null())
            .map(|d| d["name"].as_str().unwrap().to_owned())
            .collect();
        normal.insert(package["name"].as_str().unwrap().to_owned(), names);
    }
    let ours = [
        "vehicle",
        "msp",
        "mavlink-dialect",
        "estimator",
        "planner",
        "control",
        "sim",
        "bridge",
    ];
    let allowed: [(&str, &[&str]); 7] = [
        ("vehicle", &[]),
        ("msp", &[]),
        ("mavlink-dialect", &[]),
        ("estimator", &["vehicle"]),
        ("planner", &["vehicle"]),
        ("control", &["vehicle"]),
        ("sim", &["vehicle", "msp"]),
    ];
    for (name, may) in allowed {
        for dependency in &normal[name] {
            assert!(
                !ours.contains(&dependency.as_str()) || may.contains(&dependency.as_str()),
                "{name} uses {dependency}"
            );
            assert!(!dependency.starts_with("tokio"), "{name} uses {dependency}");
        }
        if ["estimator", "planner", "control"].contains(&name) {
            assert!(
                !normal[name].iter().any(|d| d == "mavlink" || d == "msp"),
                "{name} knows a protocol"
            );
        }
    }
}

#[test]
fn only_the_shell_names_tokio_and_only_the_clock_reads_time() {
    for (path, text) in sources("bridge/src") {
        let shell = path.contains("/io/")
            || path.contains("/cmd/")
            || path.contains("/web/")
            || path.ends_with("main.rs");
        for line in code(&text) {
            assert!(shell || !line.contains("tokio"), "{path}: {line}");
            let reads_time = line.contains("Instant::now") || line.contains("SystemTime::now");
            // Socket peers are forgotten by tokio's own clock, which drives nothing but the socket.
            assert!(
                !reads_time || path.ends_with("io/clock.rs") || path.contains("io/net/"),
                "{path}: {line}"
            );
        }
    }
    for folder in [
        "vehicle/src",
        "msp/src",
        "mavlink-dialect/src",
        "estimator/src",
        "planner/src",
        "control/src",
        "sim/src",
    ] {
        for (path, text) in sources(folder) {
            let text = text.split("#[cfg(test)]").next().unwrap().to_owned();
            if path.ends_with("tests.rs") {
                continue;
            }
            for line in code(&text) {
                for forbidden in [
                    "Instant::now",
                    "SystemTime",
                    "std::net",
                    "std::thread",
                    "std::fs",
                    "HashMap",
                    "HashSet",
                ] {
                    assert!(!line.contains(forbidden), "{path}: {line}");
                }
            }
        }
    }
}

#[test]
fn flight_and_ground_meet_only_at_the_door() {
    for (path, text) in sources("bridge/src/autopilot") {
        let is_ground = path.contains("autopilot/ground");
        for line in code(&text) {
            assert!(
                is_ground || !line.contains("mavlink"),
                "{path} knows MAVLink: {line}"
            );
            assert!(
                is_ground || !line.contains("crate::gcs"),
                "{path} knows the ground: {line}"
            );
            assert!(
                !is_ground || !line.contains("super::flight::") && !line.contains("estimator::"),
                "{path} knows Flight: {line}"
            );
        }
    }
    for (path, text) in sources("bridge/src/gcs") {
        for line in code(&text).filter(|l| l.contains("autopilot::")) {
            let may = ["door", "mode", "ground", "params", "io"]
                .iter()
                .any(|m| line.contains(&format!("autopilot::{m}")));
            assert!(may, "{path} reaches past the door: {line}");
        }
    }
}

#[test]
fn the_truth_of_the_simulator_is_read_only_to_write_it_down() {
    for (path, text) in sources("bridge/src") {
        let may = path.ends_with("io/truth.rs") || path.ends_with("cmd/demo.rs");
        for line in code(&text) {
            assert!(may || !line.contains(".truth("), "{path}: {line}");
            // The camera sees the truth too; only people see the camera's picture.
            let may = path.ends_with("cmd/session.rs") || path.ends_with("cmd/video.rs");
            assert!(may || !line.contains(".shot("), "{path}: {line}");
        }
    }
    // What the autopilot can be told, name by name: nothing of it is a true pose, velocity or wall.
    let io = std::fs::read_to_string(root().join("bridge/src/autopilot/io.rs")).unwrap();
    let body = io
        .split("pub enum Input {")
        .nth(1)
        .unwrap()
        .split("\n}")
        .next()
        .unwrap();
    let variants: Vec<&str> = code(body)
        .map(str::trim)
        .filter(|l| !l.is_empty())
        .map(|l| l.split(['(', ',']).next().unwrap())
        .collect();
    assert_eq!(
        variants,
        [
            "Fc",
            "FcOpened",
            "Ranger",
            "DownRange",
            "Flow",
            "Asked",
            "JobDone",
            "Wake",
            "FcClosed",
            "Gnss",
            "Pose",
            "Host"
        ]
    );
}

#[test]
fn only_the_supervisor_clears_sticks_and_only_the_arbiter_orders() {
    for (path, text) in sources("bridge/src") {
        for line in code(&text) {
            let makes = line
                .split(|c: char| !c.is_alphanumeric() && c != '(')
                .any(|w| w.starts_with("Cleared("));
            assert!(!makes || path.ends_with("supervisor.rs"), "{path}: {line}");
        }
    }
}

/// How many paths a line names between back ticks; each must exist.
fn places_that_exist(page: &str, line: &str) -> usize {
    let mut seen = 0;
    for path in line
        .split('`')
        .skip(1)
        .step_by(2)
        .filter(|p| p.contains('/'))
    {
        seen += 1;
        assert!(root().join(path).exists(), "{page} names {path}");
    }
    seen
}

#[test]
fn every_place_named_in_where_is_it_exists() {
    let text = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let section = text.split("## Where is it?").nth(1).expect("the table");
    let mut seen = 0;
    for line in section
        .lines()
        .take_while(|l| !l.starts_with("## "))
        .filter(|l| l.starts_with('|'))
    {
        seen += places_that_exist("ARCHITECTURE.md", line);
    }
    assert!(seen > 8, "{seen} places");
}

/// Longer than this a file holds more than one idea, or says in ARCHITECTURE.md why not.
const LONG: usize = 600;

#[test]
fn long_files_are_defended_and_the_defended_are_long() {
    let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let (_, section) = page.split_once("## Long files").unwrap();
    let section = section.split("\n## ").next().unwrap();
    let defended: Vec<&str> = section
        .lines()
        .filter_map(|l| l.strip_prefix("| `")?.split('`').next())
        .collect();
    let mut long = Vec::new();
    for folder in [
        "bridge",
        "control",
        "estimator",
        "mavlink-dialect",
        "msp",
        "planner",
        "sim",
        "tests",
        "vehicle",
    ] {
        for (path, text) in sources(folder) {
            if text.lines().count() > LONG {
                let (_, name) = path.split_once("/../").unwrap();
                long.push(name.to_owned());
            }
        }
    }
    long.sort();
    assert_eq!(
        long, defended,
        "files of more than {LONG} lines, and those that ARCHITECTURE.md defends"
    );
}

#[test]
fn every_place_named_in_the_page_of_the_theses_exists() {
    let text = std::fs::read_to_string(root().join("docs/theses.md")).unwrap();
    let mut seen = 0;
    for line in text.lines().filter(|l| l.starts_with('|')) {
        seen += places_that_exist("docs/theses.md", line);
    }
    assert!(seen > 97, "{seen} places");
}

#[test]
fn the_parameter_page_is_what_the_program_prints() {
    let page = std::fs::read_to_string(root().join("docs/parameters.md")).unwrap();
    for row in bridge::settings::Settings::default().rows() {
        assert!(
            page.contains(&format!("| `{}` | `{}` |", row.meta.id, row.meta.key)),
            "{}: run `kestrel params --markdown > docs/parameters.md`",
            row.meta.id
        );
    }
}
