#!/usr/bin/env python3
"""Runs the client tests: every function `test_*` of every file `test_*.py` beside this one, several at once.

    run.py                 all
    run.py -k mavsdk       those whose name contains `mavsdk` (several -k: any of them)
    run.py --json out.json figures for programs

Needs Python 3.11 and the clients: `python3 -m venv .venv && .venv/bin/pip install --no-deps -r tests/python/requirements.txt`.

One line for each test: name, ok / FAILED / SKIPPED, seconds, and what it measured; failures with seed and command line
at the end; last line `N passed, N failed, N skipped`. Exit code 0 only if none failed. Each test has its own process, so
that a client library that crashes takes only its own test along.

Environment: KESTREL_BIN, KESTREL_JOBS, KESTREL_OUT (see kestrel_harness.py), KESTREL_SEEDS=a..b for campaigns over other
seeds than 1..20, KESTREL_KEEP=1 to keep the files of flights that passed.
"""

import argparse
import ast
import importlib
import json
import os
import subprocess
import sys
import time
import traceback
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).resolve().parent
TIME_LIMIT_S = 1200  # a test that has not ended by then hangs
ALONE = ("firmware", "rates")  # files whose tests fly in real time on a machine of their own
MARK = "@@result@@ "


def discover():
    """Names `file.function` in file order; files are only read, not imported."""
    names = []
    for path in sorted(HERE.glob("test_*.py")):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                names.append(f"{path.stem.removeprefix('test_')}.{node.name.removeprefix('test_')}")
    return names


def run_here(name):
    """Runs one test in this process and prints its result as JSON."""
    file, _, function = name.partition(".")
    from kestrel_harness import Skipped, settle

    try:
        test = getattr(importlib.import_module(f"test_{file}"), f"test_{function}")
        verdict, text = "ok", test() or ""
        settle()
    except Skipped as reason:
        verdict, text = "SKIPPED", str(reason)
        settle()
    except BaseException as error:  # whatever it is, it is the result
        settle(error)
        # An assertion without words is named by its source line.
        headline = (str(error).splitlines() or [traceback.extract_tb(error.__traceback__)[-1].line])[0]
        verdict, text = "FAILED", f"{headline}\n{traceback.format_exc()}"
    print(MARK + json.dumps({"verdict": verdict, "text": text}), flush=True)
    # MAVSDK's threads must not keep a finished test alive.
    os._exit(0)


def run_apart(name):
    """Runs one test in a process of its own."""
    began = time.monotonic()
    command = [sys.executable, str(HERE / "run.py"), "--one", name]
    try:
        done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, errors="replace", timeout=TIME_LIMIT_S)
        output = done.stdout
        lines = [line for line in output.splitlines() if line.startswith(MARK)]
        if lines:
            result = json.loads(lines[-1].removeprefix(MARK))
        else:
            result = {"verdict": "FAILED", "text": f"the test process died, exit {done.returncode}\n{output}\n{done.stderr}"}
    except subprocess.TimeoutExpired:
        result = {"verdict": "FAILED", "text": f"hangs: no end after {TIME_LIMIT_S} s"}
    return {"name": name, "seconds": round(time.monotonic() - began, 1), **result}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-k", action="append", metavar="WORD", help="only tests whose name contains WORD")
    parser.add_argument("-j", type=int, default=3 * (os.cpu_count() or 1), metavar="N", help="tests at once")
    parser.add_argument("--json", metavar="FILE", help="write results as JSON")
    parser.add_argument("--once", action="store_true", help="do not fly failed tests once more")
    parser.add_argument("--list", action="store_true", help="only list the names")
    parser.add_argument("--one", metavar="NAME", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        run_here(arguments.one)

    names = [n for n in discover() if not arguments.k or any(word in n for word in arguments.k)]
    if arguments.list:
        print("\n".join(names))
        return 0

    try:
        from kestrel_harness import binary, jobs, seeds
    except ImportError as missing:
        print(f"{missing}: install the clients with `pip install --no-deps -r {HERE / 'requirements.txt'}`", file=sys.stderr)
        return 1

    campaign = f"campaigns over seeds {seeds()[0]}..{seeds()[-1]}"
    print(f"{binary()}: {len(names)} tests, {arguments.j} at once, {jobs()} simulators at once, {campaign}", flush=True)

    # Long ones first: they would otherwise fly alone at the end. Those that ask for the machine to themselves come last, one by one:
    # waiting for each other they would hold up all the rest.
    ordered = sorted(names, key=lambda name: not name.startswith(("missions", "mavsdk")))
    together = [name for name in ordered if not name.startswith(ALONE)]
    with ThreadPoolExecutor(arguments.j) as pool:
        results = list(pool.map(run_and_tell, together))
    results += [run_and_tell(name) for name in ordered if name.startswith(ALONE)]

    # The clients live in real time and the machine is shared: what failed among the others flies once more alone. The
    # first failure is told too, so that nothing is hidden.
    for i, result in enumerate(results):
        if result["verdict"] != "FAILED" or arguments.once:
            continue
        print(f"{result['name']}: once more, alone", flush=True)
        again = run_and_tell(result["name"])
        if again["verdict"] == "ok":
            first = (result["text"].splitlines() or [""])[0]
            again["text"] = f"on the second try (first: {first}) {again['text']}"
        results[i] = again
    second = [r for r in results if r["text"].startswith("on the second try")]
    if second:
        print(f"\n{len(second)} passed only on the second try:")
        for r in second:
            print(f"  {r['name']}: {r['text'].splitlines()[0][:300]}")

    failed = [r for r in results if r["verdict"] == "FAILED"]
    for r in failed:
        print(f"\n--- {r['name']}\n{r['text'].rstrip().partition(chr(10))[2]}")
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(results, indent=1))
    count = {verdict: sum(r["verdict"] == verdict for r in results) for verdict in ("ok", "FAILED", "SKIPPED")}
    print(f"\n{count['ok']} passed, {count['FAILED']} failed, {count['SKIPPED']} skipped")
    return 1 if failed or not results else 0


def run_and_tell(name):
    """Runs one test and prints its line at once."""
    result = run_apart(name)
    lines = result["text"].strip().splitlines() or [""]
    text = lines[0] if result["verdict"] == "FAILED" else " | ".join(lines)
    print(f"{result['verdict']:8}{name:70}{result['seconds']:7.1f} s  {text[:400]}", flush=True)
    return result


if __name__ == "__main__":
    sys.exit(main())
