"""Two drones in one simulated room, each with a program of its own, swap places and keep clear of each other. Needs pymavlink, `kestrel`.

Usage: python two_drones.py [folder]      devices, logs and truth go there; default a temporary one
"""
import math
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from vehicle import Vehicle

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="two-"))
# Where the second stands in the lab, on the plan: x, y in metres, heading in radians. The first stands at home.
SECOND = (1.5, 3.3, -1.5708)
subprocess.run(["kestrel", "rooms", "office", "--export", folder / "plans"], check=True, stdout=subprocess.DEVNULL)


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


programs = []
sensors = [f"--sensor=ld06://{folder}/lidar", f"--sensor=msp://{folder}/flow"]
fc = free_port(socket.SOCK_STREAM)
also = ",".join(map(str, SECOND))
world = ["kestrel", "rehearse", "office", "--fc", f"tcpserver://127.0.0.1:{fc}", *sensors, f"--also={also}", "--truth", str(folder / "truth.csv")]
programs.append(subprocess.Popen(world, stdout=subprocess.PIPE, text=True))
programs[0].stdout.readline()
drones = []
for number, place in enumerate((None, SECOND)):
    own = "" if number == 0 else "-2"
    port = free_port(socket.SOCK_DGRAM)
    fly = ["kestrel", "fly", "--fc", f"tcpclient://127.0.0.1:{fc + number}", "--map", str(folder / "plans/plan.yaml"), "--headless", "--quiet"]
    fly += [word + own for word in sensors] + ["--param", f"MAV_SYS_ID={number + 1}", "--state-dir", str(folder / f"state{number + 1}")]
    fly += ["--start=" + ",".join(map(str, place))] if place else []
    programs.append(subprocess.Popen([*fly, "--mavlink", f"udpserver://127.0.0.1:{port}"]))
    drones.append(Vehicle(f"udpout:127.0.0.1:{port}", system=number + 1))
try:
    for drone in drones:
        drone.take_off(1.0)
    starts = [drone.position for drone in drones]
    for drone, (north, east, _) in zip(drones, reversed(starts)):
        drone.place(north, east, -1.0)
    nearest, begun = math.inf, time.monotonic()
    for drone in drones:
        drone.off_board()
    while time.monotonic() < begun + 30:
        for drone, (north, east, _) in zip(drones, reversed(starts)):
            drone.place(north, east, -1.0)
        nearest = min(nearest, math.dist(drones[0].position[:2], drones[1].position[:2]))
        if all(math.dist(d.position[:2], s[:2]) < 0.3 for d, s in zip(drones, reversed(starts))):
            print("they have swapped places")
            break
        time.sleep(0.1)
    print(f"nearest {nearest:.2f} m")
    for drone in drones:
        drone.land()
finally:
    for program in reversed(programs):
        program.send_signal(signal.SIGINT)
    for program in programs:
        program.wait(40)
