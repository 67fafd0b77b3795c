//! Every refusal and every failsafe that a pilot can be told has its row in docs/troubleshooting.md, with what to do about it.
//!
//! The messages are taken from the source that prints them, so that a new one is asked for here by itself.

#![allow(clippy::unwrap_used, reason = "a test fails where it stands")]

use std::path::Path;

fn read(path: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)).unwrap()
}

/// String literals of a block of source, from where it begins to the next line that begins with a brace.
fn literals(source: &str, begins: &str) -> Vec<String> {
    let block = source
        .split(begins)
        .nth(1)
        .unwrap_or_else(|| panic!("no {begins}"));
    let block = block.split("\n}").next().unwrap();
    let code: String = block
        .lines()
        .filter(|l| !l.trim_start().starts_with("//"))
        .collect();
    let found: Vec<String> = code
        .split('"')
        .skip(1)
        .step_by(2)
        .map(str::to_owned)
        .collect();
    assert!(found.len() > 8, "{begins}: {found:?}");
    found
}

/// Rows of the page's tables: what is said, and what to do.
fn rows() -> Vec<(String, String)> {
    let page = read("docs/troubleshooting.md");
    page.lines()
        .filter_map(|line| {
            let cells: Vec<&str> = line.strip_prefix("| ")?.split(" | ").collect();
            let (first, last) = (cells.first()?, cells.last()?);
            Some(((*first).to_owned(), last.trim_end_matches(" |").to_owned()))
        })
        .collect()
}

/// The longest piece of a message that is the same whatever numbers and names are put into it.
fn fixed(format: &str) -> &str {
    let outside = format.split(['{', '}']).step_by(2);
    let longest = outside.max_by_key(|p| p.len()).unwrap_or_default();
    longest.trim_matches(|c: char| !c.is_alphanumeric())
}

fn assert_explained(messages: &[String]) {
    let rows = rows();
    let missing: Vec<&String> = messages
        .iter()
        .filter(|message| {
            let words = fixed(message);
            // In back ticks, so that words of a longer sentence do not stand for it.
            !rows.iter().any(|(said, todo)| {
                todo.len() > 5
                    && said
                        .split('`')
                        .skip(1)
                        .step_by(2)
                        .any(|quoted| quoted.contains(words))
            })
        })
        .collect();
    assert!(
        missing.is_empty(),
        "docs/troubleshooting.md has no row that says what to do about: {missing:?}"
    );
}

#[test]
fn every_refusal_has_its_row_with_what_to_do_about_it() {
    let source = read("bridge/src/autopilot/door/refusal.rs");
    assert_explained(&literals(&source, "impl fmt::Display for Refusal"));
}

#[test]
fn every_failsafe_is_told_by_a_reason_that_has_its_row() {
    let source = read("bridge/src/autopilot/door/refusal.rs");
    let mut reasons = literals(&source, "impl Because {");
    // No failsafes.
    reasons.retain(|r| !["asked for", "finished"].contains(&r.as_str()));
    assert_explained(&reasons);
    let page = bridge::autopilot::failsafe_page::page();
    assert!(page.contains("Failsafe: ...: Mode"), "how it is told");
}
