//! What is built in comes from the registry, unchanged, under licences that `deny.toml` allows.
//!
//! Holes that became known after a version was fixed need the list of advisories, which is on the network: `cargo deny check`.

#![allow(clippy::unwrap_used, reason = "a test fails where it stands")]

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

const REGISTRY: &str = "registry+https://github.com/rust-lang/crates.io-index";

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap()
}

/// `key = "value"` of a table of the lock file.
fn value<'a>(table: &'a str, key: &str) -> Option<&'a str> {
    let start = format!("{key} = \"");
    let line = table.lines().find(|l| l.starts_with(&start))?;
    Some(line[start.len()..].trim_end_matches('"'))
}

#[test]
fn every_crate_is_ours_or_from_the_registry_with_its_checksum() {
    let lock = read("Cargo.lock");
    let mut foreign = 0;
    for table in lock.split("[[package]]").skip(1) {
        let name = value(table, "name").unwrap();
        let Some(source) = value(table, "source") else {
            assert!(
                root().join(name).is_dir() || name == "flight-tests",
                "{name} is whose?"
            );
            continue;
        };
        assert_eq!(source, REGISTRY, "{name}");
        assert!(
            value(table, "checksum").is_some_and(|sum| sum.len() == 64),
            "{name}"
        );
        foreign += 1;
    }
    assert!(foreign > 100, "{foreign} crates of others");
}

/// Whether an SPDX expression leaves us a choice that is allowed.
fn is_allowed(expression: &str, allowed: &[String]) -> bool {
    let text = expression.replace('/', " OR ");
    let text = text.trim();
    if let Some((a, b)) = split(text, " OR ") {
        return is_allowed(a, allowed) || is_allowed(b, allowed);
    }
    if let Some((a, b)) = split(text, " AND ") {
        return is_allowed(a, allowed) && is_allowed(b, allowed);
    }
    match text.strip_prefix('(').and_then(|t| t.strip_suffix(')')) {
        Some(inner) => is_allowed(inner, allowed),
        None => allowed.iter().any(|a| a == text),
    }
}

/// At the first of these words outside brackets.
fn split<'a>(text: &'a str, word: &str) -> Option<(&'a str, &'a str)> {
    text.match_indices(word).find_map(|(at, _)| {
        let before = &text[..at];
        let is_outside = before.matches('(').count() == before.matches(')').count();
        is_outside.then(|| (before, &text[at + word.len()..]))
    })
}

#[test]
fn every_licence_is_one_that_deny_toml_allows() {
    let deny = read("deny.toml");
    let (_, list) = deny.split_once("allow = [").unwrap();
    let (list, _) = list.split_once(']').unwrap();
    let allowed: Vec<String> = list
        .split('"')
        .skip(1)
        .step_by(2)
        .map(str::to_owned)
        .collect();
    // Of this machine: what other systems need was never fetched, and the network is not asked.
    let rustc = Command::new("rustc").arg("-vV").output().unwrap();
    let rustc = String::from_utf8(rustc.stdout).unwrap();
    let host = rustc
        .lines()
        .find_map(|l| l.strip_prefix("host: "))
        .unwrap();
    let told = Command::new(env!("CARGO"))
        .args(["metadata", "--locked", "--offline", "--format-version", "1"])
        .args(["--filter-platform", host])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(
        told.status.success(),
        "{}",
        String::from_utf8_lossy(&told.stderr)
    );
    let metadata: Value = serde_json::from_slice(&told.stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    for package in packages {
        let (name, licence) = (&package["name"], package["license"].as_str());
        let licence = licence.unwrap_or_else(|| panic!("{name} has no licence"));
        assert!(is_allowed(licence, &allowed), "{name}: {licence}");
    }
    assert!(packages.len() > 100);
}

#[test]
fn a_licence_is_judged_by_the_choice_it_leaves() {
    let allowed = ["MIT".to_owned(), "ISC".to_owned()];
    for good in [
        "MIT",
        "GPL-3.0-only OR MIT",
        "MIT/X",
        "(MIT OR X) AND ISC",
        "X OR (ISC AND MIT)",
    ] {
        assert!(is_allowed(good, &allowed), "{good}");
    }
    for bad in ["X", "MIT AND X", "(MIT OR ISC) AND X", ""] {
        assert!(!is_allowed(bad, &allowed), "{bad}");
    }
}
