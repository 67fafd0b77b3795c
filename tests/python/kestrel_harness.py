"""Starts and stops the program, and says how to fly a failed flight again.

    with Kestrel(seed=7, speed=4) as kestrel:
        station = kestrel.station()          # a ground station on kestrel's MAVLink server
        ...
    assert kestrel.truth().landing_error() < 0.3   # scored after the program has ended

Leaving the block presses Ctrl-C and asserts that the program ends with exit code 0. A test that fails keeps the folders
of its flights and prints the seed and the command line that flies the same flight again.

Environment: `KESTREL_BIN` the program (default: the workspace's newest target/ci/kestrel or target/release/kestrel),
`KESTREL_JOBS` how many simulators may fly at once on this machine, `KESTREL_OUT` where flights leave their files.
"""

import contextlib
import fcntl
import os
import shlex
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from pathlib import Path

from station import Station
from truth import Truth

WORKSPACE = Path(__file__).resolve().parents[2]
LANDING_S = 60.0  # time after Ctrl-C in which the vehicle must be down and the program gone


class Skipped(Exception):
    """Raised by a test that cannot run here; the text says why."""


def binary():
    """The program under test."""
    given = os.environ.get("KESTREL_BIN")
    if given:
        return str(Path(given).resolve())
    built = [path for path in WORKSPACE.glob("target/*/kestrel") if path.parent.name in ("ci", "release")]
    assert built, "no program to test: build it (cargo build --profile ci) or set KESTREL_BIN"
    return str(max(built, key=lambda path: path.stat().st_mtime))


def out_folder():
    """Where flights leave their files."""
    folder = Path(os.environ.get("KESTREL_OUT") or Path(tempfile.gettempdir()) / "kestrel-tests")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def free_port(kind=socket.SOCK_DGRAM):
    """A loopback port that nobody uses now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def jobs():
    """How many simulators may fly at once."""
    return int(os.environ.get("KESTREL_JOBS", 3 * (os.cpu_count() or 1)))


def slots_of_airspace():
    """One open file for each place in the air."""
    folder = Path(tempfile.gettempdir()) / f"kestrel-airspace-{os.getuid()}"
    folder.mkdir(exist_ok=True)
    return [open(folder / str(i), "w") for i in range(jobs())]


IS_ALONE = threading.Event()


@contextlib.contextmanager
def alone():
    """All places in the air, for flights that need the machine to themselves. Only one test process may ask at a time."""
    slots = slots_of_airspace()
    try:
        for slot in slots:
            fcntl.flock(slot, fcntl.LOCK_EX)
        IS_ALONE.set()
        yield
    finally:
        IS_ALONE.clear()
        for slot in slots:
            slot.close()


@contextlib.contextmanager
def airspace():
    """Waits for one of `jobs()` places in the air, shared by all test processes of this user through file locks."""
    if IS_ALONE.is_set():
        yield
        return
    slots = slots_of_airspace()
    try:
        while True:
            for slot in slots:
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(slot, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    for other in slots:
                        if other is not slot:
                            other.close()
                    yield
                    return
            time.sleep(0.05)
    finally:
        for slot in slots:
            slot.close()


def run(*arguments, timeout=60, **keywords):
    """Runs the program to its end."""
    return subprocess.run(
        [binary(), *map(str, arguments)], capture_output=True, text=True, timeout=timeout, stdin=subprocess.DEVNULL, **keywords
    )


FLIGHTS = []  # every Kestrel of this test, so that a verdict after the flight can still say how to fly it again


def settle(error=None):
    """At the end of a test: drops the files of its flights, or keeps them and adds to the error how to repeat them."""
    for kestrel in FLIGHTS:
        if error is not None and len(FLIGHTS) <= 3:
            kestrel.blame(error)
        if error is None and not os.environ.get("KESTREL_KEEP"):
            shutil.rmtree(kestrel.folder, ignore_errors=True)


class Kestrel:
    """One run of `kestrel sim` (or another sub-command that flies)."""

    def __init__(
        self,
        room="office",
        *,
        seed=1,
        speed=1,
        rangers=None,
        start=None,
        servers=1,
        state_dir=None,
        extra=(),
        name=None,
    ):
        self.seed, self.speed = seed, float(speed)
        self.ports = [free_port() for _ in range(servers)]
        label = name or f"{Path(str(room)).stem}-{rangers or 'default'}-seed{seed}"
        self.folder = Path(tempfile.mkdtemp(prefix=f"{label}-", dir=out_folder()))
        self.truth_file = self.folder / "truth.csv"
        self.log_file = self.folder / "kestrel.log"
        self.arguments = ["sim", str(room), "--seed", str(seed), "--speed", f"{speed:g}", "--headless"]
        self.arguments += ["--rangers", str(rangers)] if rangers else []
        self.arguments += ["--start", start] if start else []
        self.arguments += ["--state-dir", str(state_dir)] if state_dir else []
        self.arguments += [str(word) for word in extra]
        self.arguments += ["--truth", str(self.truth_file)]
        for port in self.ports:
            self.arguments += ["--mavlink", f"udpserver://127.0.0.1:{port}"]
        self.stations = []
        self.process = None
        self.is_told = False
        FLIGHTS.append(self)
        self._resources = contextlib.ExitStack()

    # -- life ---------------------------------------------------------------------------------------------------------

    def __enter__(self):
        self._resources.enter_context(airspace())
        log = self._resources.enter_context(open(self.log_file, "wb"))
        self.started = time.monotonic()
        self.process = subprocess.Popen(
            [binary(), *self.arguments], stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
        )
        return self

    def __exit__(self, kind, error, traceback):
        try:
            if error is None:
                self.stop()
        except BaseException as failure:
            self.blame(failure)
            raise
        finally:
            self.kill()
            for station in self.stations:
                station.close()
            self._resources.close()
        if error is not None:
            self.blame(error)
        return False

    def blame(self, error):
        """Adds to a failure how to fly this flight again."""
        if not self.is_told:
            self.is_told = True
            error.add_note(self.how_to_repeat())

    def stop(self, how=signal.SIGINT):
        """Ctrl-C (or SIGTERM): the program must land, clean up and end with exit code 0. Returns the seconds it took."""
        if self.process.returncode is not None:
            return 0.0
        began = time.monotonic()
        if self.process.poll() is None:
            self.process.send_signal(how)
        try:
            code = self.process.wait(LANDING_S)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"still running {LANDING_S:.0f} s after {how.name}") from None
        assert code == 0, f"exit code {code} after {how.name}"
        assert "panicked at" not in self.log(), "the program panicked"
        return time.monotonic() - began

    def kill(self):
        """Ends it whatever it does."""
        if self.process and self.process.poll() is None:
            self.process.kill()
            self.process.wait()

    # -- what it said and did -----------------------------------------------------------------------------------------

    def station(self, index=0, **keywords):
        """A ground station on the program's n-th MAVLink server; returns once a heartbeat has come."""
        station = Station(self.ports[index], speed=self.speed, alive=self.check_alive, **keywords)
        self.stations.append(station)
        station.wait_connected()
        return station

    def check_alive(self):
        """Fails at once, with its last words, when the program has ended by itself."""
        code = self.process.poll()
        assert code is None, f"the program ended with exit code {code}"

    def truth(self):
        """The flight as it was; complete once the program has ended."""
        return Truth.read(self.truth_file)

    def log(self):
        """What the program printed."""
        return self.log_file.read_text(errors="replace") if self.log_file.exists() else ""

    def how_to_repeat(self):
        """Seed, command line, last lines of output and last texts: what one needs to look into a failure."""
        tail = "\n".join(f"    | {line}" for line in self.log().splitlines()[-12:])
        texts = [f"    [{t:7.2f} s] {text}" for s in self.stations for t, _, text in s.texts[-8:]]
        return "\n".join(
            [
                f"  seed {self.seed}; fly it again: {shlex.join(['kestrel', *self.arguments])}",
                f"  files: {self.folder}",
                *(["  its last output:", tail] if tail else []),
                *(["  last STATUSTEXT:", *texts] if texts else []),
            ]
        )


def fly_all(fly, seeds):
    """Flies `fly(seed)` for every seed, as many at once as the airspace holds; returns {seed: result or exception}."""
    from concurrent.futures import ThreadPoolExecutor

    def guarded(seed):
        try:
            return fly(seed)
        except Exception as failure:  # noqa: BLE001 - judged by the caller
            return failure

    with ThreadPoolExecutor(jobs()) as pool:
        return dict(zip(seeds, pool.map(guarded, seeds)))


def explain(results):
    """Text of every flight that ended in an exception."""
    return "\n".join(
        f"seed {seed}: {result}\n" + "\n".join(getattr(result, "__notes__", []))
        for seed, result in results.items()
        if isinstance(result, Exception)
    )


def seeds():
    """Seeds of a campaign: 1 to 20, or `KESTREL_SEEDS=a..b`."""
    first, _, last = os.environ.get("KESTREL_SEEDS", "1..20").partition("..")
    return list(range(int(first), int(last or first) + 1))
