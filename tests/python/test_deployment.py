"""docs/deployment: the service unit starts what it says and lands on SIGTERM; SSH takes keys only and shows its banner."""

import contextlib
import re
import shlex
import shutil
import signal
import socket
import subprocess
import tempfile
from pathlib import Path

import kestrel_harness
from kestrel_harness import WORKSPACE, airspace, free_port, out_folder
from rooms import Room
from station import Station

FOLDER = WORKSPACE / "docs" / "deployment"


def unit():
    """Keys of the unit file, each with its values; continued lines joined."""
    text = (FOLDER / "kestrel.service").read_text().replace("\\\n", " ")
    keys = {}
    for line in text.splitlines():
        if "=" in line and not line.startswith("#"):
            key, _, value = line.partition("=")
            keys.setdefault(key, []).append(value.strip())
    return keys


def test_the_service_unit_starts_what_it_says():
    """systemd reads it without a word; its ExecStart, on simulated devices, comes up headless, and SIGTERM ends it with exit 0."""
    keys = unit()
    assert keys["KillSignal"] == ["SIGTERM"] and int(keys["TimeoutStopSec"][0]) > 30 and keys["User"] == ["kestrel"]
    checked = "systemd is not here"
    if shutil.which("systemd-analyze"):
        folder = Path(tempfile.mkdtemp(prefix="unit-", dir=out_folder()))
        text = (FOLDER / "kestrel.service").read_text().replace("/usr/local/bin/kestrel", kestrel_harness.binary())
        (folder / "kestrel.service").write_text(text)
        done = subprocess.run(["systemd-analyze", "verify", folder / "kestrel.service"], capture_output=True, text=True, timeout=60)
        ours = [line for line in done.stderr.splitlines() if "kestrel.service" in line]
        assert not ours, "\n".join(ours)
        checked = "systemd has nothing to say against it"

    folder = Path(tempfile.mkdtemp(prefix="service-", dir=out_folder()))
    fc, port = free_port(socket.SOCK_STREAM), free_port()
    command = shlex.split(keys["ExecStart"][0])
    assert "--wait" in command and "--headless" in command
    replaced = {
        "/usr/local/bin/kestrel": kestrel_harness.binary(),
        "serial:///dev/ttyAMA0?baudrate=115200": f"tcpclient://127.0.0.1:{fc}",
        "/etc/kestrel/plan.yaml": str(Room.export("office").plan),
        "ld06:///dev/ttyUSB0": f"ld06://{folder}/lidar",
        "msp:///dev/ttyUSB1": f"msp://{folder}/flow",
        "udpserver://0.0.0.0:14555": f"udpserver://127.0.0.1:{port}",
        "/var/lib/kestrel": str(folder / "state"),
    }
    assert set(replaced) <= set(command), set(replaced) - set(command)
    sensors = ["--sensor", replaced["ld06:///dev/ttyUSB0"], "--sensor", replaced["msp:///dev/ttyUSB1"]]
    rehearse = [kestrel_harness.binary(), "rehearse", "office", "--fc", f"tcpserver://127.0.0.1:{fc}", *sensors]
    with contextlib.ExitStack() as cleaning:
        cleaning.enter_context(airspace())
        world = subprocess.Popen(rehearse, stdout=subprocess.PIPE, text=True)
        cleaning.callback(world.kill)
        assert "flight controller on" in world.stdout.readline()
        service = subprocess.Popen(
            [replaced.get(word, word) for word in command], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        cleaning.callback(service.kill)
        station = Station(port, speed=1)
        cleaning.callback(station.close)
        station.wait_connected()
        station.wait_ready(60.0)
        service.send_signal(signal.SIGTERM)
        said, _ = service.communicate(timeout=45)
        assert service.returncode == 0, said
    assert "\x1b" not in said and "\r" not in said, "a status line in the journal"
    assert list((folder / "state").iterdir()), "nothing was kept in the state folder"
    return checked


def test_ssh_takes_keys_only_and_shows_its_banner():
    """The snippet forbids passwords and root and names the banner; where sshd is installed it must accept the file."""
    text = (FOLDER / "sshd_kestrel.conf").read_text()
    settings = dict(line.split(None, 1) for line in text.splitlines() if line and not line.startswith("#"))
    wanted = {
        "PasswordAuthentication": "no", "KbdInteractiveAuthentication": "no", "PubkeyAuthentication": "yes",
        "PermitRootLogin": "no", "LogLevel": "VERBOSE", "Banner": "/etc/ssh/kestrel_banner",
    }  # fmt: skip
    assert {k: settings.get(k) for k in wanted} == wanted, settings
    banner = (FOLDER / "kestrel_banner").read_text()
    assert "written down" in banner and len(banner.splitlines()) <= 4
    page = (WORKSPACE / "docs" / "deployment.md").read_text()
    for name in ("kestrel.service", "sshd_kestrel.conf", "kestrel_banner"):
        assert name in page, f"docs/deployment.md does not name {name}"
    sshd = shutil.which("sshd", path="/usr/sbin:/usr/local/sbin:/usr/bin")
    if not sshd:
        return "read here; sshd is not installed to read it"
    folder = Path(tempfile.mkdtemp(prefix="sshd-", dir=out_folder()))
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / "key"], check=True, timeout=20)
    (folder / "conf").write_text(re.sub(r"^Banner .*", f"Banner {FOLDER}/kestrel_banner", text, flags=re.M) + f"HostKey {folder}/key\n")
    done = subprocess.run([sshd, "-t", "-f", folder / "conf"], capture_output=True, text=True, timeout=20)
    assert done.returncode == 0, done.stderr
    return "accepted by sshd"
