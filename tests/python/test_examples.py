"""The programs of docs/examples, run as a user runs them."""

import subprocess
import sys
import time
from pathlib import Path

from kestrel_harness import Kestrel

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
    """The Python block of README.md, word for word but for the port; the simulator has been up for a while, as it says."""
    code = (ROOT / "README.md").read_text().split("```python\n")[1].split("```")[0]
    with Kestrel("office", seed=4, speed=4) as kestrel:
        time.sleep(3)
        assert "udpout:127.0.0.1:14555" in code
        code = code.replace("127.0.0.1:14555", f"127.0.0.1:{kestrel.ports[0]}")
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=240)
        assert done.returncode == 0, done.stdout + done.stderr
    return judge(kestrel)


def run_example(name, kestrel, connection):
    program = [sys.executable, str(EXAMPLES / name), connection.format(kestrel.ports[0])]
    done = subprocess.run(program, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0 and "landed" in done.stdout, done.stdout + done.stderr


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
