//! What the tests share: a synthetic world with its own ray caster.
#![allow(dead_code, reason = "each test binary uses a part")]
#![allow(unreachable_pub, reason = "shared between test binaries")]
#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "test code outside of test functions"
)]

pub mod broad;
pub mod recordings;
pub mod world;

use std::path::PathBuf;

/// A folder of recordings made by others, or none with a word why.
pub fn recorded(name: &str) -> Option<PathBuf> {
    let base = std::env::var_os("KESTREL_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let folder = base.join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    println!(
        "SKIPPED: no recordings at {} (set KESTREL_DATA)",
        folder.display()
    );
    None
}
