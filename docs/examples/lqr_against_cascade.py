"""The same hover and the same step of a metre under two laws, judged by the simulator's truth. Needs pymavlink and `kestrel`.

Usage: python lqr_against_cascade.py [variant ...]      default cascade lqr
"""
import csv
import math
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from vehicle import Vehicle

SPEED = 2
folder = Path(tempfile.mkdtemp(prefix="laws-"))


def fly(variant):
    """Truth of a flight: times of hover and step, and rows of t, north, east, down."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    truth = folder / f"{variant}.csv"
    world = ["kestrel", "sim", "office", "--seed", "1", "--speed", str(SPEED), "--headless", "--truth", str(truth)]
    world += ["--param", f"KST_CTL_VARIANT={variant}", "--param", "KST_OFFB_AVOID=0", "--mavlink", f"udpserver://127.0.0.1:{port}"]
    running = subprocess.Popen(world, stdout=subprocess.DEVNULL)
    try:
        vehicle = Vehicle(f"udpout:127.0.0.1:{port}")
        vehicle.take_off(1.0)
        time.sleep(6 / SPEED)
        marks = [vehicle.latest["ATTITUDE"].time_boot_ms / 1e3]
        time.sleep(10 / SPEED)
        north, east, down = vehicle.position
        vehicle.place(north + 1.0, east, down)
        vehicle.off_board()
        marks.append(vehicle.latest["ATTITUDE"].time_boot_ms / 1e3)
        end = time.monotonic() + 8 / SPEED
        while time.monotonic() < end:
            vehicle.place(north + 1.0, east, down)
            time.sleep(0.05)
        marks.append(vehicle.latest["ATTITUDE"].time_boot_ms / 1e3)
        vehicle.land()
    finally:
        running.send_signal(signal.SIGINT)
        running.wait(30)
    with open(truth) as file:
        rows = [[float(row[name]) for name in ("t_s", "x", "y", "z")] for row in csv.DictReader(file)]
    return marks, rows


print(f"{'law':<10} {'hover RMS':>10} {'overshoot':>10} {'within 10 cm':>13}")
for variant in sys.argv[1:] or ["cascade", "lqr"]:
    (hover, step, end), rows = fly(variant)
    still = [row[1:] for row in rows if hover <= row[0] < step]
    middle = [sum(values) / len(still) for values in zip(*still)]
    rms = math.sqrt(sum(math.dist(row, middle) ** 2 for row in still) / len(still))
    path = [(t - step, x) for t, x, *_ in rows if step <= t < end]
    rest = sum(x for _, x in path[-50:]) / 50
    way = rest - path[0][1]
    overshoot = max((x - path[0][1]) / way for _, x in path) - 1
    settled = max((t for t, x in path if abs(x - rest) > 0.1), default=0.0)
    print(f"{variant:<10} {rms:8.3f} m {100 * overshoot:8.1f} % {settled:11.2f} s", flush=True)
