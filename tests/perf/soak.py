#!/usr/bin/env python3
"""Half an hour of `kestrel fly` in real time with every kind of link under load: memory and descriptors stay as they were.

    python tests/perf/soak.py [--minutes 30] [--json FILE]          KESTREL_BIN names the program (default target/release/kestrel)

The vehicle and its sensors are `kestrel rehearse` (TCP, pseudo terminals). A UDP station flies it to and fro, a TCP station comes and goes
and each time reads all parameters, a serial station only listens, four pages of the console are open, of
which two log in anew every 20 s and 600 s. Every six minutes the vehicle lands and its battery is changed: the simulated vehicle
ends, and another one starts.

Said: resident memory and descriptors after the first ten minutes and at the end, what grew an hour, the latencies each flight told of.
Exit code 1 if more than 1 MB an hour or a descriptor was left behind. Needs pymavlink.
"""

import argparse
import contextlib
import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from system import ROOT, free_port, usage

WARM_UP_S, ROUND_S, LOOK_S = 600.0, 360.0, 10.0
# The index of a log's part waits in memory for the part's end, about 3 MB an hour. Parts of two minutes instead of forty: many ends are seen.
PART_MB = 5
MOST_MB_H = 1.0
USER, PASSWORD = "soak", "half an hour of everything"


def descriptors(pid):
    return len(os.listdir(f"/proc/{pid}/fd"))


def rehearse(binary, fc, sensors):
    """A vehicle with a full battery; the socket of the one before may still be in use."""
    command = [binary, "rehearse", "office", "--fc", f"tcpserver://127.0.0.1:{fc}", *sensors]
    for _ in range(20):
        world = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        world.stdout.readline()
        time.sleep(0.5)
        if world.poll() is None:
            return world
    raise SystemExit("kestrel rehearse does not start")


def come_and_go(port, is_over, counts):
    """A TCP station that reads all parameters, goes, and comes again."""
    from pymavlink import mavutil

    while not is_over.is_set():
        with contextlib.suppress(OSError, ConnectionError):
            conn = mavutil.mavlink_connection(f"tcp:127.0.0.1:{port}", source_system=251, retries=1)
            conn.mav.heartbeat_send(6, 8, 0, 0, 0)
            conn.mav.param_request_list_send(1, 1)
            end, seen = time.monotonic() + 15.0, set()
            while time.monotonic() < end and not is_over.is_set():
                value = conn.recv_match(type="PARAM_VALUE", blocking=True, timeout=1.0)
                if value:
                    seen.add(value.param_index)
                    if len(seen) == value.param_count:
                        counts["lists"] += 1
                        break
            conn.close()
        is_over.wait(3.0)


def listen(master, is_over, counts):
    """A station on a serial line."""
    os.set_blocking(master, False)
    while not is_over.is_set():
        with contextlib.suppress(BlockingIOError):
            counts["serial_bytes"] += len(os.read(master, 65536))
        time.sleep(0.02)


def log_in(port):
    """A session of the console: its cookie."""
    conn = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    body = json.dumps({"user": USER, "password": PASSWORD})
    conn.request("POST", "/api/login", body, {"Origin": f"http://127.0.0.1:{port}", "Content-Type": "application/json"})
    answer = conn.getresponse()
    assert answer.status == 200, answer.read()
    cookie = answer.getheader("Set-Cookie").partition(";")[0]
    conn.close()
    return cookie


def watch(port, stays_s, is_over, counts):
    """A page of the console: loads what a page loads, then takes everything its socket brings, and is loaded again after a while."""
    while not is_over.is_set():
        with contextlib.suppress(OSError):
            cookie = log_in(port)
            conn = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
            for path in ("/", "/app.js", "/api/plan"):
                conn.request("GET", path, headers={"Cookie": cookie})
                conn.getresponse().read()
            conn.close()
            with socket.create_connection(("127.0.0.1", port), 10) as link:
                head = f"GET /api/socket HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\nCookie: {cookie}\r\n"
                head += "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
                link.sendall(head.encode())
                counts["pages"] += 1
                end = time.monotonic() + stays_s
                said = time.monotonic()
                while time.monotonic() < end and not is_over.is_set():
                    got = link.recv(65536)
                    if not got:
                        break
                    counts["page_bytes"] += len(got)
                    if time.monotonic() - said > 1.0:
                        # A page that is silent for ten seconds is gone: a text of two bytes, masked by zeros.
                        said = time.monotonic()
                        link.sendall(bytes([0x81, 0x82, 0, 0, 0, 0]) + b"{}")
        is_over.wait(1.0)


def fly_round(vehicle, until):
    vehicle.take_off(1.0)
    north, east, down = vehicle.position
    is_off_board = False
    while (left := until - time.monotonic()) > 0 and vehicle.is_armed:
        vehicle.place(north + (0.8 if int(left / 5) % 2 else 0.0), east, down)
        if not is_off_board:
            vehicle.off_board()
            is_off_board = True
        time.sleep(0.1)
    vehicle.land()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--json", metavar="FILE")
    arguments = parser.parse_args()
    sys.path.insert(0, str(ROOT / "docs" / "examples"))
    from vehicle import Vehicle

    binary = os.environ.get("KESTREL_BIN", str(ROOT / "target/release/kestrel"))
    folder = Path(tempfile.mkdtemp(prefix="kestrel-soak-"))
    subprocess.run([binary, "rooms", "office", "--export", folder], check=True, stdout=subprocess.DEVNULL)
    fc, udp, tcp = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    web = free_port(socket.SOCK_STREAM)
    master, slave = os.openpty()
    sensors = ["--sensor", f"tof_ring://{folder}/ring", "--sensor", f"msp://{folder}/flow"]
    world = rehearse(binary, fc, sensors)
    command = [binary, "fly", "--fc", f"tcpclient://127.0.0.1:{fc}", "--map", folder / "plan.yaml", *sensors, "--headless"]
    state = folder / "state"
    subprocess.run([binary, "passwd", USER, "--role", "engineer", "--state-dir", state], input=PASSWORD + "\n", text=True, check=True, stdout=subprocess.DEVNULL)
    command += ["--state-dir", state, "--console", f"127.0.0.1:{web}", "--param", f"LOG_PART_MB={PART_MB}"]
    for link in (f"udpserver://127.0.0.1:{udp}", f"tcpserver://127.0.0.1:{tcp}", f"serial://{os.ttyname(slave)}?baudrate=57600"):
        command += ["--mavlink", link]
    with open(folder / "fly.log", "w") as log:
        program = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
    is_over, samples = threading.Event(), []
    counts = {"lists": 0, "serial_bytes": 0, "pages": 0, "page_bytes": 0}
    try:
        tasks = [(come_and_go, tcp), (listen, master), *((watch, web, stays_s) for stays_s in (20.0, 600.0, 3600.0, 3600.0))]
        for task, *what in tasks:
            threading.Thread(target=task, args=(*what, is_over, counts), daemon=True).start()
        began = time.monotonic()

        def look():
            while not is_over.wait(LOOK_S):
                cpu_s, rss_mb, _ = usage(program.pid)
                samples.append((time.monotonic() - began, rss_mb, descriptors(program.pid), cpu_s))

        threading.Thread(target=look, daemon=True).start()
        vehicle = Vehicle(f"udpout:127.0.0.1:{udp}")
        end, rounds = began + 60.0 * arguments.minutes, 0
        while time.monotonic() < end:
            fly_round(vehicle, min(time.monotonic() + ROUND_S, end))
            rounds += 1
            if time.monotonic() < end:
                world.terminate()
                world.wait(20)
                world = rehearse(binary, fc, sensors)
        time.sleep(2 * LOOK_S)
        is_over.set()
        program.send_signal(signal.SIGINT)
        program.wait(60)
    finally:
        for process in (program, world):
            process.kill()
    latency = [text for text in vehicle.texts if "sample to command" in text]
    warm = [s for s in samples if s[0] >= min(WARM_UP_S, samples[-1][0] / 3)]
    (t0, mb0, fds0, _), (t1, mb1, fds1, cpu_s) = warm[0], warm[-1]
    per_h = (mb1 - mb0) / ((t1 - t0) / 3600.0)
    said = {
        "minutes": round(t1 / 60, 1),
        "flights": rounds,
        "rss_mb": [round(mb0, 1), round(mb1, 1)],
        "rss_mb_per_h": round(per_h, 2),
        "descriptors": [fds0, fds1],
        "descriptors_most": max(s[2] for s in warm),
        "core_share": round(cpu_s / t1, 3),
        **counts,
        "latency": latency,
    }
    print(json.dumps(said))
    is_flat = per_h <= MOST_MB_H and fds1 <= fds0
    if arguments.json:
        Path(arguments.json).write_text(json.dumps({**said, "samples": samples}, indent=1))
    raise SystemExit(0 if is_flat else f"NOT FLAT: {per_h:+.2f} MB an hour, {fds1 - fds0:+d} descriptors")


if __name__ == "__main__":
    main()
