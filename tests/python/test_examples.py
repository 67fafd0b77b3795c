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
