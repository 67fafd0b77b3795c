#!/usr/bin/env python3
"""Times the estimators beside filterpy, vqf and a Monte Carlo localization in numpy: same machine, same run, same sizes.

    python3 -m venv peers && peers/bin/pip install numpy filterpy vqf
    peers/bin/python tests/perf/estimator_peers.py            ours (cargo bench) and the peers that are installed
    peers/bin/python tests/perf/estimator_peers.py --peers    the peers only

One line of JSON a figure, best of many rounds; a table at the end. A peer that is not installed is said and left out.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def best_ns(call, rounds, per_round=1):
    """Nanoseconds of the best round, by the things done in it."""
    call()
    best = float("inf")
    for _ in range(rounds):
        begin = time.perf_counter_ns()
        call()
        best = min(best, time.perf_counter_ns() - begin)
    return best / per_round


def say(name, ns, unit):
    print(json.dumps({"bench": name, "best_ns": round(ns, 1), "unit": unit}), flush=True)
    return name, ns, unit


def filterpy_figures():
    """Fifteen states, nine measurements at once: position, velocity, attitude error."""
    import numpy as np
    from filterpy.kalman import KalmanFilter

    kf = KalmanFilter(dim_x=15, dim_z=9)
    kf.F = np.eye(15) + 1e-3 * np.ones((15, 15))
    kf.Q = np.eye(15) * 1e-6
    kf.H = np.eye(9, 15)
    kf.R = np.eye(9) * 0.0025
    z = np.full((9, 1), 0.01)

    def both():
        kf.predict()
        kf.update(z)

    def settle():
        kf.P = np.eye(15) * 0.01
        kf.F = np.eye(15)

    settle()
    yield say("filterpy/predict + 9 measurements", best_ns(both, 3000), "ns")


def vqf_figures():
    import numpy as np
    from vqf import VQF

    random = np.random.default_rng(1)
    n = 20_000
    gyro = random.normal(0.0, 0.2, (n, 3))
    accel = random.normal(0.0, 0.2, (n, 3)) + [0.0, 0.0, 9.81]
    mag = random.normal(0.0, 0.5, (n, 3)) + [0.0, 16.0, -41.0]
    gyro, accel, mag = (np.ascontiguousarray(a) for a in (gyro, accel, mag))

    def batch():
        VQF(0.0035).updateBatch(gyro, accel, mag)

    yield say("vqf/updateBatch, 9 axes", best_ns(batch, 10, n), "ns/sample")
    one = VQF(0.0035)

    def single():
        for k in range(1000):
            one.update(gyro[k], accel[k], mag[k])

    yield say("vqf/update, 9 axes", best_ns(single, 20, 1000), "ns/sample")


def numpy_figures():
    """Motion, likelihood field, weights, resampling, mean: what every numpy filter does, without a loop in Python."""
    import numpy as np

    random = np.random.default_rng(1)
    field = random.random((400, 400), dtype=np.float32)
    for n, k in [(2000, 8), (2000, 60)]:
        particles = random.normal([10.0, 10.0, 0.3], 0.2, (n, 3)).astype(np.float32)
        bearings = np.linspace(0.0, 2.0 * np.pi, k, endpoint=False, dtype=np.float32)
        ranges = random.uniform(1.0, 4.0, k).astype(np.float32)

        def update():
            x = particles[:, 0] + 0.02 + random.normal(0.0, 0.01, n)
            y = particles[:, 1] + random.normal(0.0, 0.01, n)
            yaw = particles[:, 2] + random.normal(0.0, 0.01, n)
            angles = yaw[:, None] + bearings
            column = ((x[:, None] + ranges * np.cos(angles)) * 20.0).astype(np.int32).clip(0, 399)
            row = ((y[:, None] + ranges * np.sin(angles)) * 20.0).astype(np.int32).clip(0, 399)
            d = field[row, column]
            logs = np.log(0.95 * np.exp(-0.5 * (d / 0.1) ** 2) + 0.05).sum(axis=1) * (8.0 / k)
            weights = np.exp(logs - logs.max())
            weights /= weights.sum()
            mean = np.average(np.stack([x, y]), axis=1, weights=weights)
            pointers = (random.random() + np.arange(n)) / n
            chosen = np.searchsorted(np.cumsum(weights), pointers).clip(0, n - 1)
            return mean, x[chosen], y[chosen], yaw[chosen]

        yield say(f"numpy/mcl update N={n} K={k}", best_ns(update, 100, n), "ns/particle")


def ours():
    for bench in ("kalman", "mcl"):
        command = ["cargo", "bench", "-q", "-p", "estimator", "--bench", bench]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
        for line in done.stdout.splitlines():
            if not line.startswith("{"):
                continue
            print(line, flush=True)
            row = json.loads(line)
            value = row.get("best_ns", row.get("best"))
            if "bench" in row and value is not None:
                yield f"kestrel {row['bench']}", value, row.get("unit", "ns")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", action="store_true", help="the peers only")
    args = parser.parse_args()
    figures = []
    for peer in (filterpy_figures, vqf_figures, numpy_figures):
        try:
            figures += list(peer())
        except ImportError as missing:
            print(f"SKIPPED: {missing.name} is not installed")
    if not args.peers:
        figures += list(ours())
    print(f"\n{'':<52} {'best':>10}")
    for name, value, unit in figures:
        print(f"{name:<52} {value:>10.1f} {unit}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
