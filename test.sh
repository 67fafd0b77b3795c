#!/usr/bin/env bash
# Runs every test: format, lints, unit and property tests, flights in virtual time, documentation, the real MAVLink clients against the
# program, and the console in Chromium. Installs what it needs (a Python environment in .venv, Chromium) and says so.
# Ends with one line: N passed, N failed, N skipped. Exit code 0 only if nothing failed.
#
# Clients and browser meet the program of the tests' own profile, `ci`: optimized, with debug assertions, and built already.
# KESTREL_RELEASE=1 builds the release profile (seven minutes on two cores) and lets them meet that; ./perf.sh measures it in any case.
#
#   ./test.sh            everything
#   ./test.sh --quick    without the Python clients and the browser
#   KESTREL_FULL=1 ./test.sh    the long campaigns too (20 seeds everywhere)
#   KESTREL_RELEASE=1 ./test.sh clients and browser with the release binary
#   KESTREL_DATA=DIR     where the recordings are (default ../shared/data); tests that need them are skipped without
set -uo pipefail
cd "$(dirname "$0")"
export KESTREL_DATA="${KESTREL_DATA:-$(cd .. && pwd)/shared/data}"
export CARGO_TERM_COLOR="${CARGO_TERM_COLOR:-auto}"
quick=0
[ "${1:-}" = "--quick" ] && quick=1

passed=0 failed=0 skipped=0
log_dir=target/test-logs
mkdir -p "$log_dir"

say() { printf '\n== %s (%d:%02d)\n' "$*" $(((SECONDS - start) / 60)) $(((SECONDS - start) % 60)); }

# check NAME COMMAND...: one test that passes or fails.
check() {
    local name=$1 log
    shift
    log="$log_dir/${name// /-}.log"
    if "$@" >"$log" 2>&1; then
        passed=$((passed + 1))
        echo "ok      $name"
    else
        failed=$((failed + 1))
        echo "FAILED  $name"
        tail -n 60 "$log"
    fi
}

start=$SECONDS
command -v cargo >/dev/null || { echo "Rust is needed: https://rustup.rs"; exit 1; }

say "format and lints"
if cargo fmt --version >/dev/null 2>&1; then
    check "format" cargo fmt --all -- --check
else
    echo "SKIPPED format: rustfmt is not installed (rustup component add rustfmt)"; skipped=$((skipped + 1))
fi
if cargo clippy --version >/dev/null 2>&1; then
    check "lints" cargo clippy --workspace --all-targets --profile ci --locked -- -D warnings
else
    echo "SKIPPED lints: clippy is not installed (rustup component add clippy)"; skipped=$((skipped + 1))
fi

say "unit, property and flight tests"
rust_log="$log_dir/rust.log"
cargo test --workspace --profile ci --locked --no-fail-fast -- --show-output >"$rust_log" 2>&1
rust_status=$?
while read -r p f; do
    passed=$((passed + p)) failed=$((failed + f))
done < <(sed -nE 's/^test result: .* ([0-9]+) passed; ([0-9]+) failed;.*/\1 \2/p' "$rust_log")
rust_skipped=$(grep -c '^SKIPPED' "$rust_log")
skipped=$((skipped + rust_skipped)) passed=$((passed - rust_skipped))
grep -E '^SKIPPED|^test .*FAILED' "$rust_log"
if [ $rust_status -ne 0 ]; then
    # A build that broke has no test results of its own.
    grep -q '^test result: FAILED' "$rust_log" || failed=$((failed + 1))
    grep -n -B2 -A40 'panicked at\|^error' "$rust_log" | head -n 200
fi
sed -n '/^FIGURES/,/^END/p' "$rust_log"
echo "ok      $(grep -c '^test .* ok$' "$rust_log") Rust tests passed ($rust_log has their output)"

say "documentation"
check "rustdoc" env RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --profile ci --locked

if [ $quick -eq 0 ]; then
    profile=ci
    [ -z "${KESTREL_RELEASE:-}" ] || profile=release
    say "the program"
    # With the tests in one command the program is the one they were built with, and nothing is compiled twice.
    if [ $profile = ci ]; then
        check "build (ci)" cargo build --workspace --bins --tests --profile ci --locked
    else
        check "build (release)" cargo build --release --locked
    fi

    say "real clients"
    if ! python3 -c 'import venv, ensurepip' >/dev/null 2>&1; then
        echo "python3 with venv is missing: installing it"
        if command -v apt-get >/dev/null; then
            sudo=""; [ "$(id -u)" -eq 0 ] || sudo="sudo -n"
            $sudo apt-get update -qq && DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq python3 python3-venv python3-pip >/dev/null
        fi
    fi
    requirements=tests/python/requirements.txt
    stamp=.venv/installed-$(cksum <"$requirements" | cut -d' ' -f1)
    if [ ! -e "$stamp" ]; then
        echo "making a Python environment in .venv and installing $(grep -vc '^#' "$requirements") packages (pymavlink, MAVSDK, MAVProxy ...)"
        rm -rf .venv
        python3 -m venv .venv && .venv/bin/pip install -q --disable-pip-version-check --no-deps -r "$requirements" && touch "$stamp"
    fi
    if [ -e "$stamp" ]; then
        python_log="$log_dir/python.log"
        KESTREL_BIN="$PWD/target/$profile/kestrel" .venv/bin/python tests/python/run.py 2>&1 | tee "$python_log"
        read -r p f s < <(sed -nE 's/^([0-9]+) passed, ([0-9]+) failed, ([0-9]+) skipped$/\1 \2 \3/p' "$python_log" | tail -n 1)
        passed=$((passed + ${p:-0})) failed=$((failed + ${f:-1})) skipped=$((skipped + ${s:-0}))
    else
        echo "FAILED  the Python environment could not be made"; failed=$((failed + 1))
    fi
fi

if [ $quick -eq 0 ]; then
    say "console in a browser"
    chromium=$(command -v chromium || command -v chromium-browser || true)
    if { [ -z "$chromium" ] || ! command -v npm >/dev/null; } && command -v apt-get >/dev/null; then
        echo "chromium or npm is missing: installing it"
        sudo=""; [ "$(id -u)" -eq 0 ] || sudo="sudo -n"
        $sudo apt-get update -qq && DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq chromium npm >/dev/null
        chromium=$(command -v chromium || true)
    fi
    if [ -n "$chromium" ] && command -v npm >/dev/null && [ ! -e target/browser/node_modules/playwright-core ]; then
        echo "installing playwright-core (npm, no browser of its own) in target/browser"
        mkdir -p target/browser && npm install --silent --no-audit --no-fund --prefix target/browser playwright-core@1.60.0 >/dev/null 2>&1
    fi
    if [ -n "$chromium" ] && [ -e target/browser/node_modules/playwright-core ]; then
        browser_log="$log_dir/browser.log"
        CHROMIUM="$chromium" KESTREL_BIN="$PWD/target/$profile/kestrel" node tests/browser/console.mjs 2>&1 | tee "$browser_log"
        read -r p f s < <(sed -nE 's/^([0-9]+) passed, ([0-9]+) failed, ([0-9]+) skipped$/\1 \2 \3/p' "$browser_log" | tail -n 1)
        passed=$((passed + ${p:-0})) failed=$((failed + ${f:-1})) skipped=$((skipped + ${s:-0}))
    else
        echo "SKIPPED console in a browser: no chromium, npm or playwright-core could be installed"; skipped=$((skipped + 1))
    fi
fi

say "done"
echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" -eq 0 ]
