#!/usr/bin/env bash
# Makes a Debian package of a built binary: packaging/build-deb.sh [BINARY [FOLDER]]
# Default: target/release/kestrel of this workspace, the package in target/. Needs dpkg-deb.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
binary=${1:-$here/../target/release/kestrel}
out=${2:-$here/../target}
[ -x "$binary" ] || { echo "no binary $binary: cargo build --release"; exit 1; }
version=$(sed -nE 's/^version = "(.*)"/\1/p' "$here/../Cargo.toml" | head -n 1)
# What it runs on is in its ELF header: e_machine at 18.
case $(od -An -tu2 -j18 -N2 "$binary" | tr -d ' ') in
62) architecture=amd64 ;;
183) architecture=arm64 ;;
40) architecture=armhf ;;
*) echo "$binary is for a machine this script does not know"; exit 1 ;;
esac
# Packed relocations (bridge/build.rs) are read by glibc from 2.36 on.
libc=libc6
if readelf -V "$binary" 2>/dev/null | grep -q GLIBC_ABI_DT_RELR; then libc="libc6 (>= 2.36)"; fi
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
chmod 755 "$root"
install -Dm755 "$binary" "$root/usr/bin/kestrel"
install -Dm644 "$here/kestrel.service" "$root/lib/systemd/system/kestrel.service"
install -Dm644 "$here/60-kestrel.rules" "$root/lib/udev/rules.d/60-kestrel.rules"
install -Dm640 "$here/fly.conf" "$root/etc/kestrel/fly.conf"
for page in "$here"/../docs/*.md "$here"/../LICENSE-*; do
    install -Dm644 "$page" "$root/usr/share/doc/kestrel/$(basename "$page")"
done
mkdir -p "$root/DEBIAN"
echo /etc/kestrel/fly.conf >"$root/DEBIAN/conffiles"
cat >"$root/DEBIAN/control" <<CONTROL
Package: kestrel
Version: $version
Section: misc
Priority: optional
Architecture: $architecture
Maintainer: Kestrel <kestrel@localhost>
Depends: $libc
Recommends: systemd
Description: autopilot bridge for indoor quadcopters
 MSP flight controller on one side, MAVLink ground stations on the other, localization on a floor plan and obstacle avoidance
 between them. Not started by itself: edit /etc/kestrel/fly.conf, ask kestrel fc check, then systemctl enable --now kestrel.
CONTROL
cat >"$root/DEBIAN/postinst" <<'POSTINST'
#!/bin/sh
set -e
if [ -d /run/systemd/system ]; then
    systemctl daemon-reload || true
    udevadm control --reload || true
    # Never in flight: an upgrade takes effect when somebody restarts the service on the ground.
fi
POSTINST
cat >"$root/DEBIAN/prerm" <<'PRERM'
#!/bin/sh
set -e
if [ "$1" = remove ] && [ -d /run/systemd/system ]; then
    systemctl disable --now kestrel || true
fi
PRERM
chmod 755 "$root/DEBIAN/postinst" "$root/DEBIAN/prerm"
package="$out/kestrel_${version}_$architecture.deb"
dpkg-deb --root-owner-group --build "$root" "$package" >/dev/null
echo "$package"
