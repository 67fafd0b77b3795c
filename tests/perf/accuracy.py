#!/usr/bin/env python3
"""Every figure that the last ./test.sh measured, as Markdown: python3 tests/perf/accuracy.py > accuracy.md

Reads target/test-logs/rust.log (blocks FIGURES ... END) and python.log (what the client tests say behind `ok`).
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LOGS = ROOT / "target" / "test-logs"


def main():
    rust, clients = LOGS / "rust.log", LOGS / "python.log"
    if not rust.exists():
        print("no target/test-logs/rust.log: run ./test.sh first", file=sys.stderr)
        return 1
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True).stdout.strip()
    print(f"# Figures of the tests\n\nWritten by `tests/perf/accuracy.py` from the logs of `./test.sh`, commit {commit or '?'}.\n\n## Rust tests\n")
    text = rust.read_text(errors="replace")
    for block in re.findall(r"^FIGURES(.*?)^END", text, re.M | re.S):
        print(f"```text\n{block.strip()}\n```\n")
    if clients.exists():
        print("## Real clients\n\n| Test | Measured |\n| --- | --- |")
        for name, told in re.findall(r"^ok +(\S+) +[\d.]+ s +(\S.*)$", clients.read_text(errors="replace"), re.M):
            print(f"| {name} | {told.replace('|', ',')} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
