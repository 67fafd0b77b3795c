"""The programs of docs/examples, run as a user runs them."""

import math
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

from kestrel_harness import Kestrel, airspace, binary, out_folder, run
from station import NAN, mav
from truth import Truth

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "docs" / "examples"


def judge(kestrel):
    """It passed the place of the example and came home."""
    truth = kestrel.truth()
    nearest = min(((s.x - 2.9) ** 2 + (s.y - 2.0) ** 2) ** 0.5 for s in truth.samples)
    landing = (truth.samples[-1].x ** 2 + truth.samples[-1].y ** 2) ** 0.5
    figures = f"passed at {nearest:.2f} m, landed at {landing:.2f} m"
    assert nearest < 0.25 and landing < 0.3, figures
    return figures


def test_first_mission_flies_and_lands_at_home():
    """The README's first program, longer words: take off, one place, home, land."""
    with Kestrel("office", seed=3, speed=4) as kestrel:
        program = [sys.executable, str(EXAMPLES / "first_mission.py"), f"udpout:127.0.0.1:{kestrel.ports[0]}"]
        done = subprocess.run(program, capture_output=True, text=True, timeout=240)
        assert done.returncode == 0 and "landed" in done.stdout, done.stdout + done.stderr
    return judge(kestrel)


def test_the_first_mission_of_the_readme_flies():
    """The Python block of README.md, word for word but for the port, started beside the simulator: who is quick is refused at first."""
    code = (ROOT / "README.md").read_text().split("```python\n")[1].split("```")[0]
    with Kestrel("office", seed=4, speed=4) as kestrel:
        assert "udpout:127.0.0.1:14555" in code
        code = code.replace("127.0.0.1:14555", f"127.0.0.1:{kestrel.ports[0]}")
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=240)
        assert done.returncode == 0, done.stdout + done.stderr
    return judge(kestrel)


def run_example(name, kestrel, connection):
    program = [sys.executable, str(EXAMPLES / name), connection.format(kestrel.ports[0])]
    done = subprocess.run(program, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0 and "landed" in done.stdout, done.stdout + done.stderr


def run_program(kestrel, name, *words, timeout=240, cwd=None):
    """An example as a user starts it, with `kestrel` on his path; returns what it printed."""
    folder = kestrel.folder if kestrel else cwd
    programs = folder / "bin"
    programs.mkdir(exist_ok=True)
    if not (programs / "kestrel").exists():
        (programs / "kestrel").symlink_to(binary())
    environment = os.environ | {"PATH": f"{programs}:{os.environ['PATH']}"}
    program = [str(EXAMPLES / name)] if name.endswith(".sh") else [sys.executable, str(EXAMPLES / name)]
    command = [*program, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, cwd=cwd or folder, env=environment)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def scratch(name):
    return Path(tempfile.mkdtemp(prefix=f"{name}-", dir=out_folder()))


def test_a_patrol_with_its_report():
    """docs/examples/patrol_report.py: every room of the office, the report of the round printed."""
    with Kestrel("office", seed=31, speed=4, name="patrol-report") as kestrel:
        plan = kestrel.folder / "patrol.plan"
        assert run("plan", "office", "-o", plan).returncode == 0
        said = run_program(kestrel, "patrol_report.py", plan, f"udpout:127.0.0.1:{kestrel.ports[0]}")
    truth = kestrel.truth()
    report = next((line for line in said.splitlines() if "ound" in line and " m" in line), None)
    assert report and said.rstrip().endswith("landed"), said
    assert truth.path_length() > 10 and truth.contacts() == 0 and truth.landing_error() < 0.3
    return report


def test_following_a_wall():
    """docs/examples/follow_wall.py: along the wall on its right, clear of it."""
    with Kestrel("office", seed=32, speed=1, name="follow-wall") as kestrel:
        said = run_program(kestrel, "follow_wall.py", f"udpout:127.0.0.1:{kestrel.ports[0]}", 20)
    truth = kestrel.truth()
    assert "beside the wall" in said and "landed" in said, said
    median = float(said.split("wall at ")[1].split()[0])
    assert 0.4 < median < 1.2 and truth.contacts() == 0 and truth.path_length() > 2.5, (median, truth.path_length())
    return f"{said.splitlines()[0]}, {truth.path_length():.1f} m flown"


def test_a_room_from_a_picture():
    """docs/examples/room_from_image.sh: a scan becomes a plan and a patrol."""
    from test_plans import MARKS, house, png

    folder = scratch("room")
    (folder / "scan.png").write_bytes(png(444, 224, house))
    said = run_program(None, "room_from_image.sh", "scan.png", *MARKS, cwd=folder)
    assert "now: kestrel sim" in said and (folder / "room" / "patrol.svg").exists(), said
    assert "NAV_WAYPOINT" in said, said


def test_watching_localization():
    """docs/examples/watch_localization.py: a vehicle that does not know where it is finds out, line by line."""
    with Kestrel("office", seed=33, speed=4, start="unknown", servers=2, name="watch-localization") as kestrel:
        station = kestrel.station(index=1)
        said, link = [], f"udpclient://127.0.0.1:{kestrel.ports[0]}"
        watch = threading.Thread(target=lambda: said.append(run_program(kestrel, "watch_localization.py", link, 500)))
        watch.start()
        station.wait_ready(60.0)
        station.arm()
        station.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, 1.0)
        station.wait_for(lambda: station.is_localized, 90.0, "finds its place")
        watch.join()
        station.land()
    lines = said[0].splitlines()
    assert len(lines) > 30 and lines[0].split()[0] != "localized" and lines[-1].startswith("localized"), said[0]
    return lines[-1]


def test_keystrokes():
    """docs/examples/keystroke_flight.py: each key is answered, and two steps forward and two back end where they began."""
    with Kestrel("office", seed=34, speed=2, name="keystrokes") as kestrel:
        said = run_program(kestrel, "keystroke_flight.py", f"udpout:127.0.0.1:{kestrel.ports[0]}")
    truth = kestrel.truth()
    far = max((s.x**2 + s.y**2) ** 0.5 for s in truth.samples)
    assert "landed" in said and 0.25 < far < 0.8 and truth.contacts() == 0, (far, said)
    return f"farthest {far:.2f} m"


def test_a_search_by_mavsdk():
    """docs/examples/mavsdk_search.py: three tracks of 1.8 m, 0.6 m apart, then home."""
    with Kestrel("office", seed=35, speed=2, name="search") as kestrel:
        run_example("mavsdk_search.py", kestrel, "udpout://127.0.0.1:{}")
    truth = kestrel.truth()
    corners = [truth.nearest((north, east, -1.0)) for north in (-0.6, 1.2) for east in (-0.6, 0.0, 0.6)]
    assert max(corners) < 0.3 and truth.contacts() == 0 and truth.landing_error() < 0.3, corners
    return f"ends of tracks within {max(corners):.2f} m"


def test_replay_with_other_gains():
    """docs/examples/replay_other_gains.sh: the flight as it was is the same; with another gain the first difference is named."""
    folder = scratch("replay-gains")
    said = run_program(None, "replay_other_gains.sh", cwd=folder)
    before, _, after = said.partition("--- with")
    assert (folder / "flight.mcap").exists() and after.strip(), said
    return after.strip().splitlines()[-1]


def test_lqr_against_cascade():
    """docs/examples/lqr_against_cascade.py: both laws hover and step; the table has their figures."""
    with airspace():
        folder = scratch("laws")
        said = run_program(None, "lqr_against_cascade.py", cwd=folder)
    rows = {line.split()[0]: line.split() for line in said.splitlines()[1:] if " m " in line}
    assert set(rows) == {"cascade", "lqr"}, said
    assert all(float(row[1]) < 0.12 and float(row[3]) < 25 for row in rows.values()), said
    return "; ".join(" ".join(row) for row in rows.values())


def test_two_drones_swap_places():
    """docs/examples/two_drones.py: two programs, two system ids, one world; they pass each other without touching."""
    with airspace():
        folder = scratch("two")
        said = run_program(None, "two_drones.py", folder / "world", cwd=folder)
    first, second = (Truth.read(folder / "world" / name) for name in ("truth.csv", "truth-2.csv"))
    nearest = min(math.dist((a.x, a.y), (b.x, b.y)) for a, b in zip(first.samples, second.samples) if a.z < -0.5 and b.z < -0.5)
    assert "swapped" in said and said.count("landed") == 2, said
    assert nearest > 0.35 and not any(s.contact for s in first.samples + second.samples), f"{nearest:.2f} m\n{said}"
    return f"nearest {nearest:.2f} m"


def test_mavsdk_with_asyncio():
    """docs/examples/mavsdk_async.py: set points, return, landing at home."""
    with Kestrel("office", seed=5, speed=1) as kestrel:
        run_example("mavsdk_async.py", kestrel, "udpout://127.0.0.1:{}")
    truth = kestrel.truth()
    nearest = truth.nearest((1.0, 0.5, -1.0))
    assert nearest < 0.2 and truth.landing_error() < 0.3 and truth.contacts() == 0, nearest
    return f"passed at {nearest:.2f} m, landed at {truth.landing_error():.2f} m"


def test_mavsdk_without_asyncio():
    """docs/examples/mavsdk_sync.py: a parameter, a place, landing there."""
    with Kestrel("office", seed=6, speed=1) as kestrel:
        run_example("mavsdk_sync.py", kestrel, "udpout://127.0.0.1:{}")
    truth = kestrel.truth()
    off = truth.landing_error((1.0, 0.8))
    assert off < 0.25 and truth.contacts() == 0, off
    return f"landed {off:.2f} m from the place"


def test_a_square_by_set_points():
    """docs/examples/offboard_square.py: four sides of 0.6 m, back where it began."""
    with Kestrel("office", seed=7, speed=1) as kestrel:
        run_example("offboard_square.py", kestrel, "udpout:127.0.0.1:{}")
    truth = kestrel.truth()
    far = max((s.x**2 + s.y**2) ** 0.5 for s in truth.samples)
    assert 0.6 < far < 1.2 and truth.landing_error() < 0.4 and truth.contacts() == 0, (far, truth.landing_error())
    return f"farthest {far:.2f} m, back at {truth.landing_error():.2f} m"


def test_the_start_file_of_mavproxy():
    """docs/examples/mavinit.scr in a headless MAVProxy: its words fly."""
    import tempfile

    from kestrel_harness import out_folder
    from test_mavproxy import Prompt

    folder = Path(tempfile.mkdtemp(prefix="mavproxy-", dir=out_folder()))
    with Kestrel("office", seed=8, speed=1, servers=2, name="mavproxy-script") as kestrel:
        watch = kestrel.station(index=1, is_ground_station=False, system=200)
        watch.wait_connected()
        prompt = Prompt(kestrel.ports[0], folder)
        try:
            prompt.expect("Received", "parameters", within_s=30.0)
            watch.wait_ready()
            mark = prompt.type(f"script {EXAMPLES / 'mavinit.scr'}")
            prompt.expect("Loaded module nsh", since=mark)
            prompt.type("arm throttle")
            watch.wait_for(lambda: watch.is_armed, 10.0, "armed")
            prompt.type("up")
            watch.wait_for(lambda: watch.height > 0.85 and watch.mode == "LOITER", 30.0, "takes off")
            prompt.type("stop")
            watch.sleep(4.0)
            assert watch.mode == "LOITER"
            prompt.type("down")
            watch.wait_disarmed(60.0)
        finally:
            prompt.close()
    truth = kestrel.truth()
    assert truth.contacts() == 0 and truth.landing_error() < 0.3
    return f"landed at {truth.landing_error():.2f} m"
