#!/usr/bin/env python3
"""What the whole program costs: `kestrel sim`, headless, with full telemetry to one station, and `kestrel fly` beside a simulated vehicle.

    python tests/perf/system.py [--seconds 60] [--json FILE]        KESTREL_BIN names the program (default target/release/kestrel)

The vehicle flies between two places meanwhile: filter at the sample rate, localization and avoidance at theirs. Said: processor time as
a share of one core, for the simulator and for the rest of the program apart (`kestrel sim --cpu` counts it), resident memory,
context switches a second. Needs pymavlink. Budget: the rest at most 4 % of a reference core, 25 MB without video.
"""

import argparse
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs" / "examples"))
BUDGET_SHARE, BUDGET_MB = 0.04, 25.0


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def usage(pid):
    """Processor seconds, resident MB, context switches of a process and its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    cpu_s = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    switches = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            lines = (task / "status").read_text().splitlines()
            switches += sum(int(line.split()[1]) for line in lines if "ctxt_switches" in line)
    return cpu_s, int(status["VmRSS"].split()[0]) / 1024, switches


def fly(port, seconds, watched):
    """Takes off and flies to and fro for a while; answers what the watched processes used in that time."""
    from vehicle import Vehicle

    vehicle = Vehicle(f"udpout:127.0.0.1:{port}")
    vehicle.take_off(1.0)
    before = {name: usage(pid) for name, pid in watched.items()}
    began, received = time.monotonic(), vehicle.conn.mav.total_packets_received
    north, east, down = vehicle.position
    while (left := began + seconds - time.monotonic()) > 0:
        goal = north + (0.8 if int(left / 5) % 2 else 0.0)
        vehicle.place(goal, east, down)
        if "off_board" not in vars(vehicle):
            vehicle.off_board()
            vars(vehicle)["off_board"] = None
        time.sleep(0.1)
    took = time.monotonic() - began
    after = {name: usage(pid) for name, pid in watched.items()}
    frames = vehicle.conn.mav.total_packets_received - received
    used = {
        name: {
            "core_share": (after[name][0] - before[name][0]) / took,
            "rss_mb": after[name][1],
            "switches_per_s": (after[name][2] - before[name][2]) / took,
        }
        for name in watched
    }
    vars(vehicle).pop("off_board", None)
    return vehicle, used, frames / took


def simulated(binary, seconds):
    """`kestrel sim`: one process, split by what it counts itself."""
    port = free_port(socket.SOCK_DGRAM)
    command = [binary, "sim", "office", "--seed", "1", "--headless", "--quiet", "--cpu", "--mavlink", f"udpserver://127.0.0.1:{port}"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        vehicle, used, frames = fly(port, seconds, {"kestrel sim": running.pid})
        whole_s, _, _ = usage(running.pid)
        running.send_signal(signal.SIGINT)
        said, _ = running.communicate(timeout=60)
    finally:
        running.kill()
    count = json.loads(next(line for line in said.splitlines() if line.startswith("{")))
    time_s = count["simulated_s"]
    rest_s = max(whole_s, count["thread_s"]) - count["simulator_s"]
    return used["kestrel sim"] | {
        "frames_per_s": frames,
        "simulator_share": count["simulator_s"] / time_s,
        "rest_share": rest_s / time_s,
        "flight_share": count["flight_s"] / time_s,
        "ground_share": count["ground_s"] / time_s,
    }


def rehearsed(binary, seconds):
    """`kestrel rehearse` is the simulator, `kestrel fly` is everything else, with real serial lines between."""
    folder = Path(tempfile.mkdtemp(prefix="kestrel-system-"))
    subprocess.run([binary, "rooms", "office", "--export", folder], check=True, stdout=subprocess.DEVNULL)
    fc, port = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
    sensors = ["--sensor", f"tof_ring://{folder}/ring", "--sensor", f"msp://{folder}/flow"]
    world = subprocess.Popen([binary, "rehearse", "office", "--fc", f"tcpserver://127.0.0.1:{fc}", *sensors], stdout=subprocess.PIPE, text=True)
    world.stdout.readline()
    command = [binary, "fly", "--fc", f"tcpclient://127.0.0.1:{fc}", "--map", folder / "plan.yaml", *sensors, "--headless", "--quiet"]
    command += ["--state-dir", folder / "state", "--mavlink", f"udpserver://127.0.0.1:{port}"]
    flying = subprocess.Popen(command)
    try:
        vehicle, used, frames = fly(port, seconds, {"rehearse": world.pid, "fly": flying.pid})
        for process in (flying, world):
            process.send_signal(signal.SIGINT)
            process.wait(60)
    finally:
        flying.kill()
        world.kill()
    return used["fly"] | {"frames_per_s": frames, "simulator_share": used["rehearse"]["core_share"]}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", metavar="FILE")
    arguments = parser.parse_args()
    binary = os.environ.get("KESTREL_BIN", str(ROOT / "target/release/kestrel"))
    rows = {"kestrel sim": simulated(binary, arguments.seconds), "kestrel fly": rehearsed(binary, arguments.seconds)}
    for name, row in rows.items():
        print(json.dumps({"bench": f"system/{name}", **{k: round(v, 4) for k, v in row.items()}}))
    rest, memory = rows["kestrel sim"]["rest_share"], rows["kestrel sim"]["rss_mb"]
    is_met = rest <= BUDGET_SHARE and memory <= BUDGET_MB
    print(
        f"beyond the simulator {100 * rest:.1f} % of a core (budget {100 * BUDGET_SHARE:.0f} %), simulator {100 * rows['kestrel sim']['simulator_share']:.1f} %, "
        f"{memory:.1f} MB (budget {BUDGET_MB:.0f} MB): {'met' if is_met else 'NOT MET'}"
    )
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(rows, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
