#!/usr/bin/env bash
# Static release builds and their Debian packages: packaging/release.sh [amd64] [arm64]   (default: both)
# A static binary runs on any Linux of its machine. arm64 is cross-compiled: apt-get install gcc-aarch64-linux-gnu libc6-dev-arm64-cross
#   KESTREL_PROFILE=ci    another cargo profile than release
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
cd "$here/.."
profile=${KESTREL_PROFILE:-release}
[ $# -gt 0 ] || set -- amd64 arm64
for machine in "$@"; do
    case $machine in
    amd64) target=x86_64-unknown-linux-gnu cc=cc ;;
    arm64) target=aarch64-unknown-linux-gnu cc=aarch64-linux-gnu-gcc ;;
    *) echo "amd64 or arm64, not $machine"; exit 2 ;;
    esac
    if [ "$cc" != cc ] && ! command -v $cc >/dev/null; then
        echo "SKIPPED $machine: no $cc (apt-get install gcc-aarch64-linux-gnu libc6-dev-arm64-cross)"
        continue
    fi
    rustup target list --installed | grep -qx $target || rustup target add $target
    name=${target//-/_}
    export "CC_$name=$cc" "CARGO_TARGET_${name^^}_LINKER=$cc" "CARGO_TARGET_${name^^}_RUSTFLAGS=-C target-feature=+crt-static"
    # Warnings of the linker about getaddrinfo: names of hosts need the system's glibc of the same version; addresses do not.
    cargo build --locked --profile "$profile" --target $target -p bridge --bin kestrel
    binary=target/$target/$profile/kestrel
    file "$binary" 2>/dev/null || true
    packaging/build-deb.sh "$binary" target
done
