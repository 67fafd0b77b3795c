"""On the vehicle: `kestrel doctor`, the signs of life for systemd, the package and its service."""

import os
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import kestrel_harness
from kestrel_harness import Skipped, out_folder
from rooms import Room
from test_sensors import Rehearsal

PACKAGING = Path(__file__).resolve().parents[2] / "packaging"


class FakeController:
    """`kestrel msp serve`: a flight controller on TCP."""

    def __init__(self, *arguments):
        self.port = kestrel_harness.free_port(socket.SOCK_STREAM)
        self.command = [kestrel_harness.binary(), "msp", "serve", f"tcpserver://127.0.0.1:{self.port}", *arguments]

    def __enter__(self):
        self.process = subprocess.Popen(self.command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 20.0
        while time.monotonic() < deadline:
            # A look into the table of sockets: a connection would be the one client it takes.
            listening = Path("/proc/net/tcp").read_text()
            if re.search(rf"0100007F:{self.port:04X} 00000000:0000 0A", listening):
                return self
            time.sleep(0.05)
        raise AssertionError("kestrel msp serve does not listen")

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()


def test_doctor_says_what_is_missing_and_what_to_do():
    """A port that is not there is MISSING with advice and exit code 1; a folder that cannot be written too."""
    folder = Path(tempfile.mkdtemp(prefix="doctor-", dir=out_folder()))
    done = kestrel_harness.run("doctor", "--fc", "serial:///dev/ttyNONE0?baudrate=115200", "--state-dir", folder / "state")
    text = done.stdout
    assert done.returncode == 1, text + done.stderr
    assert re.search(r"^MISSING +serial port +/dev/ttyNONE0 is not there", text, re.M), text
    assert "-> is the cable in" in text and "settings not read" in text, text
    for line in text.splitlines():
        if line.startswith(("MISSING", "poor")):
            following = text.splitlines()[text.splitlines().index(line) + 1]
            assert following.strip().startswith("->"), f"no advice below: {line}"
    (folder / "file").write_text("")
    done = kestrel_harness.run("doctor", "--state-dir", folder / "file" / "below")
    assert done.returncode == 1 and re.search(r"^MISSING +disk +cannot make", done.stdout, re.M), done.stdout
    done = kestrel_harness.run("doctor", "--sensor", "no_such:///dev/null")
    assert done.returncode == 2 and "no sensor `no_such`" in done.stderr, done.stderr
    shutil.rmtree(folder)


def test_doctor_reads_the_settings_of_a_controller():
    """As delivered a controller lacks what `fc provision` sets; provisioned it lacks nothing."""
    folder = Path(tempfile.mkdtemp(prefix="doctor-", dir=out_folder()))
    with FakeController() as controller:
        fc = f"tcpclient://127.0.0.1:{controller.port}"
        before = kestrel_harness.run("doctor", "--fc", fc, "--state-dir", folder)
        check = kestrel_harness.run("fc", "check", "--fc", fc)
    assert ("MISSING" in check.stdout) == (before.returncode == 1), check.stdout + before.stdout
    assert re.search(r"controller +", before.stdout), before.stdout
    if before.returncode == 1:
        assert "kestrel fc provision" in before.stdout or "by hand" in before.stdout, before.stdout
    shutil.rmtree(folder)


def test_systemd_is_told_that_the_program_is_ready_and_lives():
    """READY=1 at the start, WATCHDOG=1 while both loops go round, silence when the process stands still."""
    folder = Path(tempfile.mkdtemp(prefix="notify-", dir=out_folder()))
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(str(folder / "notify"))
    listener.settimeout(20.0)
    environment = {**os.environ, "NOTIFY_SOCKET": str(folder / "notify"), "WATCHDOG_USEC": "800000"}
    room = Room.export("office")
    command = [kestrel_harness.binary(), "fly", "--wait", "--headless", "--map", room.plan, "--state-dir", folder / "state"]
    command += ["--fc", f"tcpclient://127.0.0.1:{kestrel_harness.free_port(socket.SOCK_STREAM)}"]
    command += ["--mavlink", f"udpserver://127.0.0.1:{kestrel_harness.free_port()}"]
    program = subprocess.Popen([str(word) for word in command], env=environment, stdout=subprocess.DEVNULL)
    try:
        assert listener.recv(64) == b"READY=1"
        assert [listener.recv(64) for _ in range(3)] == [b"WATCHDOG=1"] * 3
        program.send_signal(signal.SIGINT)
        assert program.wait(20.0) == 0
    finally:
        program.kill()
        program.wait()
        listener.close()
    shutil.rmtree(folder)


def test_the_package_is_built_and_its_service_is_closed():
    """`packaging/build-deb.sh`: program, service, rules, configuration; the service's exposure by systemd's own measure."""
    if not shutil.which("dpkg-deb"):
        raise Skipped("no dpkg-deb")
    folder = Path(tempfile.mkdtemp(prefix="package-", dir=out_folder()))
    subprocess.run([PACKAGING / "build-deb.sh", kestrel_harness.binary(), folder], check=True, capture_output=True)
    (package,) = folder.glob("kestrel_*.deb")
    listed = subprocess.run(["dpkg-deb", "--contents", package], check=True, capture_output=True, text=True).stdout
    for path in ("usr/bin/kestrel", "systemd/system/kestrel.service", "udev/rules.d/60-kestrel.rules", "etc/kestrel/fly.conf"):
        assert path in listed, f"{path} is not in the package:\n{listed}"
    megabytes = package.stat().st_size / 1e6
    shutil.rmtree(folder)
    if not shutil.which("systemd-analyze"):
        return f"package of {megabytes:.1f} MB; SKIPPED the service: no systemd-analyze"
    said = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", PACKAGING / "kestrel.service"], capture_output=True, text=True
    ).stdout
    exposure = float(re.search(r"exposure level for kestrel.service: ([0-9.]+)", said).group(1))
    assert exposure <= 2.5, said
    return f"package of {megabytes:.1f} MB, exposure {exposure}"


def test_the_second_ctrl_c_stops_the_motors():
    """In the air the first one lands; the second one stops the motors where it is, and the program ends."""
    with Rehearsal("ld06://{folder}/lidar", "msp://{folder}/flow", seed=6) as rehearsal:
        rehearsal.station.wait_ready(60.0)
        rehearsal.station.take_off(1.0)
        rehearsal.flying.send_signal(signal.SIGINT)
        time.sleep(0.3)
        assert rehearsal.flying.poll() is None, "the first one ended it in the air"
        began = time.monotonic()
        rehearsal.flying.send_signal(signal.SIGINT)
        assert rehearsal.flying.wait(5.0) == 0
        took = time.monotonic() - began
        said = rehearsal.log()
    assert "Stopping: landing first" in said and "Motors stopped" in said, said
    assert took < 2.0, f"{took:.1f} s"
    return f"over after {took:.2f} s"


def test_the_arm_binary_flies_the_demo_to_the_same_bit():
    """The static binary for 64-bit ARM under qemu: what it prints and draws of `demo` is what this machine's prints and draws."""
    qemu = shutil.which("qemu-aarch64") or shutil.which("qemu-aarch64-static")
    built = sorted((PACKAGING.parent / "target" / "aarch64-unknown-linux-gnu").glob("*/kestrel"), key=lambda p: p.stat().st_mtime)
    if not (qemu and built):
        raise Skipped("packaging/release.sh arm64 has not been run, or there is no qemu-aarch64 (apt-get install qemu-user)")
    seen = []
    for command in ([kestrel_harness.binary()], [qemu, str(built[-1])]):
        folder = Path(tempfile.mkdtemp(prefix="demo-", dir=out_folder()))
        done = subprocess.run([*command, "demo", "--seed", "2"], cwd=folder, capture_output=True, text=True, timeout=240)
        assert done.returncode == 0, done.stdout + done.stderr
        seen.append((done.stdout, (folder / "flight.svg").read_bytes()))
    assert seen[0] == seen[1], "they fly differently"
    return f"{built[-1].parent.name}: the same to the bit, {len(seen[0][1])} bytes of picture"
