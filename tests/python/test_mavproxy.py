"""Row 8: MAVProxy 1.8.75 without a window, driven as somebody at its prompt would."""

import contextlib
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from kestrel_harness import Kestrel, out_folder
from rooms import Room
from test_keys import number

# All but `adsb`, which wants an imaging library to colour aircraft on a map.
MODULES = "log,signing,wp,rally,fence,ftp,param,relay,tuneopt,arm,mode,calibration,rc,auxopt,misc,cmdlong,battery,output"


# MAVProxy draws graphs in a process of its own, by matplotlib in a window. Without a window: the same process, which writes down what it is
# given to draw.
HEADLESS = """
import os, sys

def use(_):
    graph = sys._getframe(1).f_locals["self"]
    with open(os.environ["GRAPH_FILE"], "a", buffering=1) as out:
        while not graph.close_graph.is_set():
            if graph.child_pipe.poll(0.2):
                print(*graph.child_pipe.recv(), file=out)
    os._exit(0)
"""

# That process is a fork, and closes its standard input first. Where this is a pipe, a thread of MAVProxy reads from it and holds its lock:
# the fork would wait for ever.
FORK = """
import multiprocessing.util

multiprocessing.util._close_stdin = lambda: None
"""


class Prompt:
    """MAVProxy with its standard input and output."""

    def __init__(self, port, folder):
        script = Path(sys.executable).parent / "mavproxy.py"
        self.graph_file = folder / "graph.txt"
        (folder / "headless").mkdir(exist_ok=True)
        (folder / "headless" / "matplotlib.py").write_text(HEADLESS)
        (folder / "headless" / "sitecustomize.py").write_text(FORK)
        paths = f"{folder / 'headless'}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
        self.process = subprocess.Popen(
            [sys.executable, "-u", str(script), f"--master=udpout:127.0.0.1:{port}", f"--default-modules={MODULES}"],
            cwd=folder,
            env={
                **os.environ,
                "HOME": str(folder),
                "PYTHONUNBUFFERED": "1",
                "MAVLINK20": "1",
                "PYTHONPATH": paths,
                "GRAPH_FILE": str(self.graph_file),
            },
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self.transcript = ""
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        while text := self.process.stdout.read(1):
            self.transcript += text

    def type(self, line):
        """Types a line; returns where the transcript stood."""
        mark = len(self.transcript)
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        return mark

    def expect(self, *words, since=0, within_s=15.0):
        """Waits until one of the texts appears (in any case)."""
        deadline = time.monotonic() + within_s
        while time.monotonic() < deadline:
            text = self.transcript[since:].lower()
            if any(word.lower() in text for word in words):
                return self.transcript[since:]
            time.sleep(0.05)
        raise AssertionError(f"MAVProxy shows none of {words} within {within_s} s; since then:\n{self.transcript[since:]}")

    def close(self):
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        # Its graphs too.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)


WAY = ("lab-corridor", "corridor", "lab-corridor")


def way_point_file(folder, room, lat0, lon0):
    """A QGC WPL 110 file as MAVProxy writes them: item 0 is home in the global frame. Returns path and number of items."""
    lines = ["QGC WPL 110"]
    places = [(0.0, 0.0, 0, 16, 0.0), (0.0, 0.0, 3, 22, 1.0), *((*room.place(name), 3, 16, 1.0) for name in WAY)]
    for i, (north, east, frame, command, alt) in enumerate(places):
        lat = lat0 + math.degrees(north / 6378137.0)
        lon = lon0 + math.degrees(east / (6378137.0 * math.cos(math.radians(lat0))))
        lines.append(f"{i}\t{int(i == 0)}\t{frame}\t{command}\t0\t0\t0\t0\t{lat:.8f}\t{lon:.8f}\t{alt:.6f}\t1")
    lines.append(f"{len(places)}\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1")
    path = Path(folder) / "office.txt"
    path.write_text("\n".join(lines) + "\n")
    return path, len(places) + 1


def test_arm_takeoff_mission_and_keys():
    """`arm throttle`, `takeoff`, `wp load`, `wp list`, `param set`, `nsh` with keys; transcript and truth."""
    room = Room.export("office")
    folder = Path(tempfile.mkdtemp(prefix="mavproxy-", dir=out_folder()))
    with Kestrel("office", seed=31, speed=1, servers=2, name="mavproxy") as kestrel:
        # The watcher only reads the clock and the origin: it is no ground station, MAVProxy's heartbeats must do.
        watch = kestrel.station(index=1, is_ground_station=False, system=200)
        origin = watch.latest.get("GPS_GLOBAL_ORIGIN") or watch.next("GPS_GLOBAL_ORIGIN", within_s=12.0)
        watch.wait_ready()
        prompt = Prompt(kestrel.ports[0], folder)
        try:
            prompt.expect("Detected vehicle 1:1", "Mode ", "LOITER>", within_s=20.0)
            prompt.expect("Received", "parameters", within_s=30.0)

            path, items = way_point_file(folder, room, origin.latitude * 1e-7, origin.longitude * 1e-7)
            mark = prompt.type(f"wp load {path}")
            prompt.expect(f"Loaded {items} waypoints", since=mark)
            prompt.expect(f"Sent all {items} waypoints", since=mark)
            mark = prompt.type("wp list")
            prompt.expect(f"Requesting {items} waypoints", since=mark)
            prompt.expect(f"Saved {items} waypoints", since=mark)

            mark = prompt.type("param set MIS_TAKEOFF_ALT 1.1")
            watch.sleep(1.0)
            mark = prompt.type("param show MIS_TAKEOFF_ALT")
            prompt.expect("1.1", since=mark)

            mark = prompt.type("arm throttle")
            prompt.expect("ARMED", since=mark)
            watch.wait_for(lambda: watch.is_armed, 3.0, "armed")
            mark = prompt.type("takeoff 1")
            prompt.expect("Got COMMAND_ACK: NAV_TAKEOFF: ACCEPTED", since=mark)
            watch.wait_for(lambda: -watch.position[2] > 0.85 and watch.mode == "LOITER", 20.0, "takes off")
            watch.sleep(3.0)
            risen = watch.now

            prompt.type("module load nsh")
            prompt.type("nsh start")
            watch.sleep(1.0)
            mark = prompt.type("help")
            prompt.expect("takeoff", since=mark)
            mark = prompt.type("8")
            prompt.expect("manual", since=mark)
            mark = prompt.type("m")
            heading = number(prompt.expect("kg", since=mark), "yaw")
            key_from = watch.now
            for key in ("8", "88", "66"):
                mark = prompt.type(key)
                prompt.expect("height", since=mark, within_s=5.0)
            watch.sleep(5.0)
            key_to = watch.now
            prompt.type("m")
            prompt.type(".")
            watch.sleep(1.0)

            # The mission that was loaded above: mode Mission by the command every station knows.
            prompt.type("long MISSION_START 0 0")
            watch.wait_for(lambda: watch.mode == "MISSION", 5.0, "mode Mission")
            watch.wait_disarmed(120.0)
            prompt.expect("DISARMED", since=mark)
        finally:
            prompt.close()
            (folder / "transcript.txt").write_text(prompt.transcript)
        assert "Traceback" not in prompt.transcript, prompt.transcript[-2000:]
    truth = kestrel.truth()
    height = -truth.at(risen).z
    a, b = truth.at(key_from), truth.at(key_to)
    forward = (b.x - a.x) * math.cos(heading) + (b.y - a.y) * math.sin(heading)
    right = -(b.x - a.x) * math.sin(heading) + (b.y - a.y) * math.cos(heading)
    points = [(*room.place(name), -1.0) for name in WAY]
    passed = truth.between(key_to).passes(points, 0.25)
    figures = (
        f"take-off 1 m: {height:.2f} m, keys 8 88 66: {forward:.2f} m forward {right:.2f} m right, "
        f"way points at {' '.join(f'{d:.2f}' for d in passed)} m, landing {truth.landing_error():.2f} m"
    )
    assert abs(height - 1.0) < 0.15, figures
    assert abs(forward - 0.6) < 0.25 and abs(right - 0.4) < 0.25, figures
    assert max(passed) <= 0.25 and truth.landing_error() <= 0.3 and truth.contacts() == 0, figures
    return figures


def test_parameters_plans_files_and_logs_at_the_prompt():
    """Row 3: `param show *`, `param set`, `wp`, `fence`, `rally`, `ftp`, `log`, `mode`, `status`, `graph`: the transcript."""
    room = Room.export("office")
    folder = Path(tempfile.mkdtemp(prefix="mavproxy-", dir=out_folder()))
    state = folder / "state"
    with Kestrel("office", seed=32, speed=1, servers=2, state_dir=state, name="mavproxy-services") as kestrel:
        watch = kestrel.station(index=1, is_ground_station=False, system=200)
        origin = watch.latest.get("GPS_GLOBAL_ORIGIN") or watch.next("GPS_GLOBAL_ORIGIN", within_s=12.0)
        watch.wait_ready()
        lat0, lon0 = origin.latitude * 1e-7, origin.longitude * 1e-7

        def place(north, east):
            return lat0 + math.degrees(north / 6378137.0), lon0 + math.degrees(east / (6378137.0 * math.cos(math.radians(lat0))))

        prompt = Prompt(kestrel.ports[0], folder)
        try:
            prompt.expect("Detected vehicle 1:1", within_s=20.0)
            prompt.expect("Received", "parameters", within_s=30.0)

            mark = prompt.type("param show *")
            shown = prompt.expect("VFH_WINDOW", since=mark)
            assert shown.count("\n") > 80 and "SYS_AUTOSTART" in shown and "4001" in shown, shown[-500:]
            mark = prompt.type("param set RTL_RETURN_ALT 1.5")
            watch.sleep(1.0)
            assert abs(watch.param("RTL_RETURN_ALT") - 1.5) < 1e-6
            mark = prompt.type("param set NAV_DLL_ACT 1")
            watch.sleep(1.0)
            assert watch.param("NAV_DLL_ACT") == 1
            mark = prompt.type(f"param save {folder / 'all.parm'}")
            prompt.expect("Saved", since=mark)

            path, items = way_point_file(folder, room, lat0, lon0)
            mark = prompt.type(f"wp load {path}")
            prompt.expect(f"Sent all {items} waypoints", since=mark)
            mark = prompt.type(f"wp save {folder / 'back.txt'}")
            prompt.expect(f"Saved {items} waypoints", since=mark)
            lines = (folder / "back.txt").read_text().splitlines()
            assert len(lines) == items + 1 and lines[2].split()[3] == "22"

            fence = folder / "fence.txt"
            corners = [place(*c) for c in ((-8, -8), (-8, 8), (8, 8), (8, -8))]
            rows = ["QGC WPL 110"]
            rows += [f"{i}\t0\t3\t5001\t4\t0\t0\t0\t{a:.8f}\t{o:.8f}\t0\t1" for i, (a, o) in enumerate(corners)]
            fence.write_text("\n".join(rows) + "\n")
            mark = prompt.type(f"fence load {fence}")
            prompt.expect("Sent all", since=mark)
            mark = prompt.type("fence list")
            prompt.expect("Saved", "polygon", "5001", since=mark)
            assert len(watch.download(kind=1)) == 4

            rally = folder / "rally.txt"
            lat, lon = place(0.5, 0.5)
            rally.write_text(f"QGC WPL 110\n0\t0\t3\t5100\t0\t0\t0\t0\t{lat:.8f}\t{lon:.8f}\t1\t1\n")
            mark = prompt.type(f"rally load {rally}")
            prompt.expect("Sent all", since=mark)
            assert len(watch.download(kind=2)) == 1

            mark = prompt.type("ftp list /")
            prompt.expect("Total size", since=mark)
            into = folder / "general.json"
            mark = prompt.type(f"ftp get /general.json {into}")
            prompt.expect("Wrote", since=mark, within_s=20.0)
            assert "metadataTypes" in into.read_text()
            mark = prompt.type("log list")
            prompt.expect("Log ", since=mark)

            mark = prompt.type("mode")
            prompt.expect("LOITER", "RTL", since=mark)
            mark = prompt.type("status ATTITUDE")
            prompt.expect("ATTITUDE", since=mark)
            mark = prompt.type("module load graph")
            prompt.expect("Loaded module graph", since=mark)
            mark = prompt.type("graph ATTITUDE.yaw LOCAL_POSITION_NED.z")
            prompt.expect("Adding graph", since=mark)
            mark = prompt.type("graph SYS_STATUS.voltage_battery")
            prompt.expect("Adding graph", since=mark)
            watch.sleep(3.0)
            mark = prompt.type("graph")
            prompt.expect("Graph 1: ['SYS_STATUS.voltage_battery']", since=mark)
            rows = [line.split() for line in prompt.graph_file.read_text().splitlines()[:-1]]
            pairs = [(float(a), float(b)) for row in rows if len(row) == 2 and "None" not in row for a, b in [row]]
            volts = [float(row[0]) for row in rows if len(row) == 1]
            assert len(pairs) > 20 and volts, f"{len(pairs)} and {len(volts)} rows drawn"
            assert abs(pairs[-1][0] - watch.latest["ATTITUDE"].yaw) < 0.1 and abs(pairs[-1][1]) < 0.3, pairs[-1]
            assert all(9_000 < v < 30_000 for v in volts), volts[-1]
        finally:
            prompt.close()
            (folder / "transcript.txt").write_text(prompt.transcript)
        assert watch.conn.mav_loss == 0
    return f"{len(prompt.transcript.splitlines())} lines of transcript, {shown.count(chr(10))} parameters shown"
