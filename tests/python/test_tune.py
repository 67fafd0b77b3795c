"""`kestrel tune`: a relay test proposes gains that leave 6 dB and settle."""

import re

from kestrel_harness import out_folder, run


def test_tune_proposes_gains_and_draws_them():
    """Level flight; its step judged by its own figures, its picture by its being there."""
    folder = out_folder() / "tune"
    done = run("tune", "--out", folder, "--headless", timeout=240)
    text = done.stdout + done.stderr
    assert done.returncode == 0, text
    margins = [float(m) for m in re.findall(r"([-\d.]+) dB proposed", text)]
    steps = re.findall(r"proposed: overshoot ([\d.]+) %, rise ([\d.]+) s, within 5 % after ([\d.]+) s", text)
    assert len(margins) == 1 and min(margins) >= 5.99, text
    assert len(steps) == 1 and all(float(o) < 15 for o, _, _ in steps), text
    assert "<svg" in (folder / "tune-level.svg").read_text()
    return f"margins {margins} dB, steps (overshoot %, rise s, settled s) {steps}"


def test_tune_is_for_loops_not_for_computed_gains():
    """uQuad's gains are computed: the refusal says so."""
    done = run("tune", "--airframe", "uquad")
    assert done.returncode == 2 and "lqr" in done.stderr, done.stderr
