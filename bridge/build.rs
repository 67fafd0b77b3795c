//! How `kestrel` is linked.

use std::env::var;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    // Forty thousand relocations, read at every start, would stay in memory as a megabyte; packed they are thirty kilobytes.
    // glibc has read them since 2.36 (Debian 12). The linker of other machines does not write them yet.
    let is = |key: &str, value: &str| var(key).is_ok_and(|v| v == value);
    if is("CARGO_CFG_TARGET_ARCH", "x86_64")
        && is("CARGO_CFG_TARGET_OS", "linux")
        && is("CARGO_CFG_TARGET_ENV", "gnu")
    {
        println!("cargo:rustc-link-arg-bins=-Wl,-z,pack-relative-relocs");
    }
}
