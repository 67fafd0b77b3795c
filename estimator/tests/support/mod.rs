//! What the tests share: a synthetic world with its own ray caster.
#![allow(dead_code, reason = "each test binary uses a part")]
#![allow(unreachable_pub, reason = "shared between test binaries")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "test code outside of test functions"
)]

pub mod broad;
pub mod recordings;
pub mod world;
