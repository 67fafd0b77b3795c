//! Every threat of `docs/threats.md` has tests, and they exist.

#![allow(clippy::unwrap_used, reason = "a test fails where it stands")]

use std::path::{Path, PathBuf};

fn sources(at: &Path, out: &mut String) {
    for entry in std::fs::read_dir(at).unwrap().flatten() {
        let path: PathBuf = entry.path();
        let is_code = path.extension().is_some_and(|e| e == "rs" || e == "py");
        if path.is_dir() && !path.ends_with("target") {
            sources(&path, out);
        } else if is_code {
            out.push_str(&std::fs::read_to_string(&path).unwrap());
        }
    }
}

#[test]
fn every_threat_has_tests_that_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut code = String::new();
    for folder in [
        "bridge/src",
        "estimator/src",
        "mavlink-dialect/src",
        "msp/tests",
        "tests/console",
        "tests/flights",
        "tests/guards",
        "tests/python",
    ] {
        sources(&root.join(folder), &mut code);
    }
    let page = std::fs::read_to_string(root.join("docs/threats.md")).unwrap();
    let rows: Vec<&str> = page
        .lines()
        .filter(|l| l.starts_with("| ") && l.contains('`'))
        .collect();
    assert!(rows.len() >= 18, "{} threats", rows.len());
    for row in rows {
        let tests = row.rsplit(" | ").next().unwrap();
        let names: Vec<&str> = tests.split('`').skip(1).step_by(2).collect();
        assert!(!names.is_empty(), "no test: {row}");
        for name in names {
            let exists = ["fn ", "def "]
                .iter()
                .any(|kind| code.contains(&format!("{kind}{name}(")));
            assert!(exists, "no test `{name}` (threat {})", &row[2..4]);
        }
    }
}
