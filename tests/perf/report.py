#!/usr/bin/env python3
"""Runs every bench, with peers in the same run, and writes what was measured as Markdown. Usually called by ./perf.sh.

    ./perf.sh                          everything, about 15 minutes on two idle cores, into target/perf/report.md
    ./perf.sh --out docs/performance.md
    ./perf.sh --only mavlink --only system
    ./perf.sh --quick                  short runs: to see that it works, not to quote

A peer that is not installed is said and left out. Compare only figures of one run; tails mean something on an idle host only.
"""

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def read(path):
    try:
        return Path(path).read_text()
    except OSError:
        return ""


def said(*command):
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    return done.stdout.strip()


class Section:
    """A title, a command, and what it prints: lines of JSON, and a table of its own."""

    def __init__(self, key, title, command, notes="", quick=()):
        self.key, self.title, self.command, self.notes, self.quick = key, title, command, notes, quick

    def run(self, is_quick, environment):
        command = [*self.command, *(self.quick if is_quick else ())]
        load, began = read("/proc/loadavg").split()[0], time.monotonic()
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
        self.seconds = time.monotonic() - began
        self.load = (load, read("/proc/loadavg").split()[0])
        self.rows, self.text = [], []
        for line in done.stdout.splitlines():
            if line.startswith("{"):
                self.rows.append(json.loads(line))
            elif line.strip():
                self.text.append(line.rstrip())
        if done.returncode != 0:
            self.text.append(f"FAILED with exit code {done.returncode}: {done.stderr.strip()[-600:]}")
        self.is_good = done.returncode == 0
        return self

    def markdown(self):
        command = " ".join(str(word).replace(str(ROOT) + "/", "") for word in self.command)
        out = [f"## {self.title}", "", f"`{command}`; load {self.load[0]} before, {self.load[1]} after.", ""]
        out += [self.notes, ""] if self.notes else []
        named = [row for row in self.rows if "bench" in row]
        if named:
            out += ["| | figures |", "| --- | --- |"]
            for row in named:
                figures = ", ".join(f"{k.replace('_', ' ')} {shown(v)}" for k, v in row.items() if k != "bench")
                out.append(f"| {row['bench']} | {figures} |")
            out.append("")
        if self.text:
            out += ["<!-- not run: what the bench printed -->", "```text", *self.text, "```", ""]
        return "\n".join(out)


def shown(value):
    return f"{value:g}" if isinstance(value, float) else str(value)


def sections(python):
    bench = lambda package, name, *words: ["cargo", "bench", "-q", "-p", package, "--bench", name, *words]  # noqa: E731
    tests = ROOT / "tests" / "python" / "run.py"
    return [
        Section("mavlink", "MAVLink: parse and serialise, beside the crate mavlink and pymavlink", bench("mavlink-dialect", "codec")),
        Section("link", "Frames from socket to socket, beside MAVProxy; start", bench("bridge", "link")),
        Section("msp", "MSP: parse a frame, beside the crate multiwii_serial_protocol_v2", bench("msp", "codec")),
        Section(
            "msp-roundtrip", "MSP: round trips over a line, beside YAMSPy", [python, tests, "--once", "-k", "yamspy_reads_our_controller"]
        ),
        Section(
            "loop",
            "Flight thread: from the last byte of an attitude to the RC frame, and the timer",
            bench("bridge", "flight_thread", "--", "--seconds", "60"),
            quick=("--seconds", "3"),
        ),
        Section("kalman", "Error-state filter, 15 states", bench("estimator", "kalman")),
        Section("mcl", "Monte Carlo localization on floor20", bench("estimator", "mcl")),
        Section("peers", "The same by filterpy, vqf and numpy", [python, ROOT / "tests/perf/estimator_peers.py", "--peers"]),
        Section("vfh", "Obstacle avoidance, 81 x 81 cells", bench("planner", "vfh")),
        Section("lqr", "Optimal gains", bench("control", "lqr")),
        Section(
            "system",
            "The whole program",
            [python, ROOT / "tests/perf/system.py"],
            notes="Shares are of one core. `rest` is everything that would run on a vehicle; `kestrel fly` is the same behind serial lines.",
            quick=("--seconds", "10"),
        ),
    ]


def find(parts, key, bench, field):
    """A figure of a section, if it was measured."""
    for part in parts:
        if part.key == key:
            for row in part.rows:
                if row.get("bench") == bench and field in row:
                    return float(row[field])
    return None


def words(parts, key, pattern):
    for part in parts:
        if part.key == key and (found := re.search(pattern, "\n".join(part.text))):
            return float(found[1])
    return None


def beside(parts):
    """Kestrel and its peers where both were measured."""
    pairs = [
        ("parse a MAVLink message", "ns", find(parts, "mavlink", "codec", "parse_ns"), "crate mavlink", find(parts, "mavlink", "codec", "mavlink_parse_ns")),
        ("serialise a MAVLink message", "ns", find(parts, "mavlink", "codec", "serialize_ns"), "crate mavlink", find(parts, "mavlink", "codec", "mavlink_serialize_ns")),
        ("predict and 9 measurements", "ns", find(parts, "kalman", "ekf/predict+update9", "best_ns"), "filterpy", find(parts, "peers", "filterpy/predict + 9 measurements", "best_ns")),
    ]  # fmt: skip
    for ours in [row for part in parts if part.key == "msp" for row in part.rows if "times_faster" in row]:
        name = ours["bench"].removesuffix("/bar")
        mine = find(parts, "msp", name, "best_ns") or find(parts, "msp", f"{name}/kestrel", "best_ns")
        if mine:
            pairs.append((f"MSP {name}", "ns", mine, "multiwii_serial_protocol_v2", mine * ours["times_faster"]))
    for k in (8, 60):
        best = next(
            (float(r["best"]) for p in parts if p.key == "mcl" for r in p.rows if re.fullmatch(rf"mcl/update/N2000/K{k}", r.get("bench", ""))), None
        )
        pairs.append((f"localization, 2,000 particles, {k} beams, a particle", "ns", best, "numpy", find(parts, "peers", f"numpy/mcl update N=2000 K={k}", "best_ns")))
    forward = {r["program"]: r for p in parts if p.key == "link" for r in p.rows if r.get("bench") == "link/forward"}
    if len(forward) == 2:
        other = next(name for name in forward if name != "kestrel")
        for field, unit in (("p50_us", "us"), ("p99_us", "us"), ("cpu_us_per_message", "us"), ("rss_mb", "MB")):
            pairs.append((f"forward a message, {field.replace('_', ' ')}", unit, forward["kestrel"][field], other, forward[other][field]))
    for name, pattern in (("MSP round trip, p50", r"ours ([\d.]+)/"), ("MSP, CPU a request", r"us: ours (\d+)")):
        peer = words(parts, "msp-roundtrip", pattern.replace("ours", "YAMSPy"))
        pairs.append((name, "ms" if "trip" in name else "us", words(parts, "msp-roundtrip", pattern), "YAMSPy", peer))
    rows = [p for p in pairs if p[2] and p[4]]
    out = ["## Beside peers, in this run", "", "| | Kestrel | peer | ratio |", "| --- | --- | --- | --- |"]
    out += [f"| {what} | {ours:.4g} {unit} | {peer}: {theirs:.4g} {unit} | {theirs / ours:.1f} |" for what, unit, ours, peer, theirs in rows]
    return "\n".join([*out, ""]) if rows else ""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "target/perf/report.md")
    parser.add_argument("--only", action="append", metavar="KEY", help="mavlink, link, msp, msp-roundtrip, loop, kalman, mcl, peers, vfh, lqr, system")
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    environment = os.environ | {"KESTREL_PYTHON": sys.executable}
    environment.setdefault("KESTREL_BIN", str(ROOT / "target/release/kestrel"))
    todo = [s for s in sections(sys.executable) if not arguments.only or s.key in arguments.only]
    parts = []
    for section in todo:
        print(f"{section.key}: {section.title} ...", flush=True)
        parts.append(section.run(arguments.quick, environment))
        print(f"  {'done' if parts[-1].is_good else 'FAILED'} in {parts[-1].seconds:.0f} s", flush=True)
    model = re.search(r"model name\s*: (.+)", read("/proc/cpuinfo"))
    dirty = ", changed since" if said("git", "status", "--porcelain", "-uno") else ""
    memory = re.search(r"MemTotal:\s*(\d+)", read("/proc/meminfo"))
    versions = said(sys.executable, "-m", "pip", "list", "--format=freeze", "--disable-pip-version-check")
    peers = [v for v in versions.splitlines() if re.match(r"(?i)(numpy|filterpy|vqf|pymavlink|MAVProxy|yamspy)==", v)]
    head = [
        "# Performance",
        "",
        "Written by `./perf.sh`; figures of one machine in one run. What they mean: [accuracy-and-speed.md](accuracy-and-speed.md).",
        "",
        "| | |",
        "| --- | --- |",
        f"| when | {datetime.now(UTC):%Y-%m-%d %H:%M} UTC{', short runs: not to be quoted' if arguments.quick else ''} |",
        f"| commit | {said('git', 'rev-parse', '--short', 'HEAD')}{dirty} |",
        f"| host | {model[1] if model else platform.processor()}, {os.cpu_count()} cores, {int(memory[1]) // 1048576 if memory else '?'} GiB, Linux {platform.release()} |",
        f"| compiler | {said('rustc', '--version')}, profile release |",
        f"| load | {parts[0].load[0]} at the start, {parts[-1].load[1]} at the end |",
        f"| peers | {', '.join(peers) or 'none installed'}; crates mavlink and multiwii_serial_protocol_v2 as locked |",
        "",
    ]
    text = "\n".join([*head, beside(parts), *[part.markdown() for part in parts]])
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(text.rstrip() + "\n")
    print(arguments.out)
    return 0 if all(part.is_good for part in parts) else 1


if __name__ == "__main__":
    sys.exit(main())
