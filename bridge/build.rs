//! How `kestrel` is linked.

use std::env::var;
use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    // Forty thousand relocations, read at every start, would stay in memory as a megabyte; packed they are thirty kilobytes. The linker
    // of other machines than this one does not write them yet.
    let is = |key: &str, value: &str| var(key).is_ok_and(|v| v == value);
    let is_here = is("CARGO_CFG_TARGET_ARCH", "x86_64")
        && is("CARGO_CFG_TARGET_OS", "linux")
        && is("CARGO_CFG_TARGET_ENV", "gnu")
        && var("HOST").ok() == var("TARGET").ok();
    if is_here && glibc().is_some_and(|version| version >= [2, 36]) {
        println!("cargo:rustc-link-arg-bins=-Wl,-z,pack-relative-relocs");
    }
}

/// Version of this machine's glibc: from 2.36 on (Debian 12) it reads them, an older one refuses the program.
fn glibc() -> Option<[u32; 2]> {
    let told = Command::new("getconf")
        .arg("GNU_LIBC_VERSION")
        .output()
        .ok()?;
    let text = String::from_utf8(told.stdout).ok()?;
    let (major, minor) = text.trim().strip_prefix("glibc ")?.split_once('.')?;
    let minor = minor.split('.').next()?;
    Some([major.parse().ok()?, minor.parse().ok()?])
}
