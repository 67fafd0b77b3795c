//! `docs/theses.md` says where each of the 97 functions is and which test shows it: the places and the tests exist, and the count at its
//! head is that of its rows.

#![allow(clippy::unwrap_used, reason = "a test fails where it stands")]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_default()
}

/// The words between back ticks.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

/// Number, place and test of each row.
fn rows(page: &str) -> Vec<(usize, &str, &str)> {
    page.lines()
        .filter_map(|line| {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            let number = cells.get(1)?.parse().ok()?;
            Some((number, *cells.get(3)?, *cells.get(4)?))
        })
        .collect()
}

/// Names of the Rust functions that carry `#[test]`, in the whole workspace.
fn rust_tests() -> BTreeSet<String> {
    fn walk(at: &Path, out: &mut BTreeSet<String>) {
        for entry in std::fs::read_dir(at).unwrap().flatten() {
            let path = entry.path();
            let is_hidden = entry.file_name().to_string_lossy().starts_with('.');
            if path.is_dir() {
                if !is_hidden && !path.ends_with("target") {
                    walk(&path, out);
                }
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = std::fs::read_to_string(&path).unwrap();
                let mut is_test = false;
                for line in text.lines().map(str::trim) {
                    if line == "#[test]" {
                        is_test = true;
                    } else if let Some(name) = line.strip_prefix("fn ").filter(|_| is_test) {
                        out.insert(name.split(['(', '<']).next().unwrap().to_owned());
                        is_test = false;
                    } else if line.ends_with('}') {
                        is_test = false;
                    }
                }
            }
        }
    }
    let mut out = BTreeSet::new();
    walk(&root(), &mut out);
    assert!(out.len() > 500, "{} tests", out.len());
    out
}

/// Looks like the name of a Rust test: words of small letters with low lines between them.
fn is_name(word: &str) -> bool {
    word.contains('_')
        && word
            .chars()
            .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
}

#[test]
fn every_test_named_in_the_page_of_the_theses_exists() {
    let page = read("docs/theses.md");
    let tests = rust_tests();
    let browser = read("tests/browser/console.mjs");
    let mut seen = 0;
    for (number, _, test) in rows(&page) {
        for word in quoted(test) {
            if let Some((file, function)) =
                word.strip_prefix("test_").and_then(|w| w.split_once('.'))
            {
                let text = read(&format!("tests/python/test_{file}.py"));
                let is_there = text.contains(&format!("\ndef {function}("));
                assert!(is_there, "row {number}: no {word}");
                seen += 1;
            } else if is_name(word) {
                assert!(tests.contains(word), "row {number}: no test {word}");
                seen += 1;
            }
        }
        // Tests of the browser, by the beginning of their names: "take control ...".
        for name in test.split('"').skip(1).step_by(2) {
            let Some(beginning) = name.split(" ...").next().filter(|_| name.contains(" ..."))
            else {
                continue;
            };
            assert!(browser.contains(beginning), "row {number}: no \"{name}\"");
            seen += 1;
        }
    }
    assert!(seen > 150, "{seen} tests named");
}

#[test]
fn the_count_at_the_head_of_the_page_is_that_of_its_rows() {
    let page = read("docs/theses.md");
    let rows = rows(&page);
    let numbers: Vec<usize> = rows.iter().map(|(n, ..)| *n).collect();
    assert_eq!(numbers, (1..=97).collect::<Vec<_>>(), "each row once");
    let (mut partly, mut unbuilt) = (0, 0);
    for (number, place, test) in &rows {
        partly += usize::from(test.starts_with("partly"));
        unbuilt += usize::from(test.starts_with("not built"));
        let is_named = quoted(place).any(|p| p.contains('/'));
        assert!(
            is_named || test.starts_with("not built"),
            "row {number} has no place"
        );
    }
    let shown = rows.len() - partly - unbuilt;
    let head = format!(
        "97 functions of the two theses that Kestrel grew from: {shown} shown by a test, {partly} partly, {unbuilt} not built."
    );
    assert!(page.contains(&head), "the page must say: {head}");
}
