#!/usr/bin/env bash
# Measures everything, beside its peers, and writes the report as Markdown (default target/perf/report.md).
# `./perf.sh --help` says more. Needs an idle machine for its tails to mean something; about 15 minutes.
set -uo pipefail
cd "$(dirname "$0")"
requirements=tests/perf/requirements.txt
stamp=target/perf-venv/installed-$(cksum <"$requirements" | cut -d' ' -f1)
if [ ! -e "$stamp" ]; then
    echo "making a Python environment in target/perf-venv for the peers"
    rm -rf target/perf-venv
    python3 -m venv target/perf-venv || exit 1
    # One by one: a peer that cannot be installed is left out, not all of them.
    sed -E 's/ *#.*//; /^ *$/d' "$requirements" | while read -r package; do
        target/perf-venv/bin/pip install -q --disable-pip-version-check --no-deps "$package" || echo "not installed: $package"
    done
    touch "$stamp"
fi
case " $* " in *" --help "*) ;; *) cargo build --release --locked || exit 1 ;; esac
exec target/perf-venv/bin/python tests/perf/report.py "$@"
