"""uQuad, flown by motor speeds from the bytes of its inertial unit: the same MAVLink, the same keys."""

import contextlib
import math
import os
import pty
import struct
import subprocess
import threading
import time
import tty
from pathlib import Path

import kestrel_harness
from kestrel_harness import Kestrel, Skipped, out_folder
from station import NAN, Station, mav
from test_keys import Pilot, expect_step


def test_uquad_flies_by_mavlink_and_keys():
    """Arm, take off to 1 m, two keys, go to a place, land: `kestrel sim --airframe uquad`."""
    with Kestrel("office", seed=1, speed=2, name="uquad", extra=["--airframe", "uquad"]) as kestrel:
        station = kestrel.station()
        station.take_off(1.0)
        pilot = Pilot(station, "QGroundControl")
        pilot.console.line("m")
        expect_step(pilot, "e", up=0.2)
        expect_step(pilot, "d", up=-0.2)
        pilot.console.line("m")
        station.go_to(0.8, 0.0)
        station.sleep(3.0)
        station.land()
    truth = kestrel.truth()
    flying = [s for s in truth.samples if s.z < -0.6]
    assert len(flying) > 500, "it never flew"
    assert not any(s.contact for s in truth.samples), "it touched something"
    last = truth.samples[-1]
    off = math.dist((last.x, last.y), (0.8, 0.0))
    assert off < 0.3, f"landed {off:.2f} m beside its place"
    errors = sorted(s.position_error for s in flying)
    return f"landed {off:.2f} m beside; estimate within {errors[int(len(errors) * 0.95)]:.2f} m in 95 % of the flight"


def frame(row, period_us):
    """A binary frame of the board from a row of imu_raw."""
    values = [int(v) for v in row]
    return b"A" + struct.pack("<I9hHI", period_us, *values[3:12], values[12], values[13]) + b"Z"


def recorded():
    """Rows of the recorded imu_raw and its calibration."""
    data = Path(os.environ.get("KESTREL_DATA", kestrel_harness.WORKSPACE.parent / "shared/data")) / "uquad"
    raw = data / "imu_raw_still.log"
    if not raw.exists():
        raise Skipped(f"no {raw} (KESTREL_DATA)")
    rows = [line.split() for line in raw.read_text().splitlines() if line.strip()]
    return raw, data / "imu_calib_final.txt", rows


class Board(threading.Thread):
    """The inertial unit at the other end of a pseudo terminal: recorded frames, a hundred a second, again and again."""

    def __init__(self, rows):
        super().__init__(daemon=True)
        self.rows, self.silent, self.over = rows, threading.Event(), threading.Event()
        self.gains, self.heard = [1.0, 1.0], b""  # of accelerometer and magnetometer; what was said to it
        self.master, slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(slave)
        self.name_of_line = os.ttyname(slave)
        self.slave = slave
        os.set_blocking(self.master, False)
        self.sent = 0

    def listen(self):
        with contextlib.suppress(BlockingIOError):
            self.heard += os.read(self.master, 64)

    def run(self):
        due = time.monotonic()
        while not self.over.is_set():
            due += 0.01
            time.sleep(max(0.0, due - time.monotonic()))
            self.listen()
            if not self.silent.is_set():
                row = [float(v) for v in self.rows[self.sent % len(self.rows)]]
                for first, gain in zip((3, 9), self.gains):
                    row[first : first + 3] = [gain * v for v in row[first : first + 3]]
                os.write(self.master, frame(row, 10_000))
                self.sent += 1


def fly_command(port, name, *more):
    folder = out_folder() / f"{name}-{os.getpid()}"
    command = [kestrel_harness.binary(), "fly", "--airframe", "uquad", "--headless", "--state-dir", folder]
    command += ["--mavlink", f"udpserver://127.0.0.1:{port}", *more]
    return [str(word) for word in command]


def test_uquad_on_a_serial_line():
    """`kestrel fly --airframe uquad --imu serial://PTY`: calibrates, tells its attitude, arms, and stops when the line falls silent."""
    _, calibration, rows = recorded()
    board = Board(rows[100:])
    port = kestrel_harness.free_port()
    log = out_folder() / f"uquad-serial-{os.getpid()}.log"
    board.start()
    with open(log, "w") as output:
        command = fly_command(port, "uquad-serial", "--imu", f"serial://{board.name_of_line}?baudrate=115200")
        command += ["--calib", str(calibration), "--motors", "sim"]
        running = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
        try:
            station = Station(port, speed=1)
            station.wait_connected()
            station.wait_for(lambda: station.has_said("IMU calibrated"), 20.0, "the calibration at rest")
            attitude = station.next("ATTITUDE")
            # psi and phi of the recording, in aviation's signs.
            assert abs(attitude.roll + 0.042) < 0.03 and abs(attitude.pitch + 0.02) < 0.03, attitude
            station.wait_ready()
            station.arm()
            station.command(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, 1.0, 1.0, 1.0, expect=["TEMPORARILY_REJECTED", "DENIED", "UNSUPPORTED"])
            station.sleep(3.0)
            assert station.is_armed, "still armed, motors idling"
            board.silent.set()
            station.wait_for(lambda: station.has_said("Motors stopped"), 6.0, "motors stop without frames")
            station.wait_disarmed(5.0)
        finally:
            board.over.set()
            running.terminate()
            code = running.wait(20)
    assert code == 0, f"exit code {code}: {log.read_text()}"
    return f"{board.sent} frames through the pseudo terminal"


def test_uquad_replays_a_recording():
    """`--imu imu_raw.log`: as slow as it was recorded, and ends with it; states and speeds are logged."""
    raw, calibration, rows = recorded()
    folder = out_folder() / f"uquad-replay-{os.getpid()}"
    command = fly_command(kestrel_harness.free_port(), "uquad-replay", "--imu", raw, "--calib", calibration)
    command += ["--calibration-frames", "100", "--log-dir", str(folder)]
    began = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL)
    took = time.monotonic() - began
    assert done.returncode == 0, done.stderr + done.stdout
    time_us = sum(int(row[2]) for row in rows[1:])
    assert took > time_us * 1e-6, f"the log lasts {time_us * 1e-6:.1f} s, the replay took {took:.1f} s"
    states = [line.split() for line in (folder / "x_hat.log").read_text().splitlines()]
    assert len(states) >= len(rows) - 110 and all(len(row) == 12 for row in states), len(states)
    tilt = max(abs(float(row[3])) + abs(float(row[4])) for row in states)
    assert tilt < 0.15, f"a craft at rest does not tilt: {tilt}"
    return f"{len(states)} estimates of {len(rows)} rows, {took:.1f} s"


def test_uquad_gain_files_are_refused_before_anything_turns():
    """Wrong size, NaN, gains that do not hold it: named errors, exit code 2."""
    folder = out_folder() / f"uquad-gains-{os.getpid()}"
    folder.mkdir(parents=True, exist_ok=True)
    cases = {"1 2 3": "4 x 12 = 48", "nan " * 48: "not a number", "0 " * 48: "do not hold"}
    for text, reason in cases.items():
        file = folder / "K.txt"
        file.write_text(text)
        done = kestrel_harness.run("sim", "--airframe", "uquad", "--gains", file, "--headless")
        assert done.returncode == 2 and reason in done.stderr, (text, done.returncode, done.stderr)


STREAMS = ("imu_raw", "kalman_in", "flags", "x_hat", "w", "w_ctrl", "int", "t_err", "err")


def test_uquad_words_flags_and_logs():
    """The board is told to run, to resume when it is silent and to stop at the end; norms 30 % too large show in SYS_STATUS and in
    the logs; every stream has its file, and imu_raw.log flies again."""
    _, calibration, rows = recorded()
    board = Board(rows[100:])
    port = kestrel_harness.free_port()
    folder = out_folder() / f"uquad-logs-{os.getpid()}"
    board.start()
    command = fly_command(port, "uquad-words", "--imu", f"serial://{board.name_of_line}?baudrate=115200")
    command += ["--calib", str(calibration), "--motors", "sim", "--calibration-frames", "150", "--log-dir", str(folder)]
    command += ["--ring", "16", "--fir", "0.5,0.3,0.2"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, text=True)
    try:
        station = Station(port, speed=1)
        station.wait_connected()
        station.wait_for(lambda: station.has_said("IMU calibrated"), 20.0, "the calibration at rest")
        assert board.heard == b"!\n", board.heard
        station.ask_interval(mav.MAVLINK_MSG_ID_SYS_STATUS, 10)
        sensors = [mav.MAV_SYS_STATUS_SENSOR_3D_ACCEL, mav.MAV_SYS_STATUS_SENSOR_3D_MAG]

        def healthy():
            return [bool(station.latest["SYS_STATUS"].onboard_control_sensors_health & bit) for bit in sensors]

        station.wait_for(lambda: healthy() == [True, True], 5.0, "both norms are right")
        board.gains[0] = 1.3
        station.wait_for(lambda: healthy() == [False, True], 5.0, "the accelerometer's flag")
        board.gains[:] = [1.0, 1.3]
        station.wait_for(lambda: healthy() == [True, False], 5.0, "the magnetometer's flag")
        board.gains[1] = 1.0
        station.wait_for(lambda: healthy() == [True, True], 5.0, "both again")
        board.silent.set()
        station.wait_for(lambda: board.heard == b"!\n#\n", 5.0, "a silent board is asked to resume")
        board.silent.clear()
        station.sleep(1.0)
    finally:
        running.terminate()
        said, _ = running.communicate(timeout=20)
        time.sleep(0.05)
        board.over.set()
        board.join()
    board.listen()
    assert running.returncode == 0, said
    assert board.heard.endswith(b"$\n"), board.heard
    texts = {name: (folder / f"{name}.log").read_text() for name in STREAMS}
    flags = {tuple(line.split("\t")[2:]) for line in texts["flags"].splitlines()}
    assert {("1", "1", "1", "1"), ("0", "1", "1", "1"), ("1", "0", "1", "1")} <= flags, flags
    counts = {name: len(text.splitlines()) for name, text in texts.items()}
    assert counts["imu_raw"] > 200 and len({counts[n] for n in ("kalman_in", "flags", "x_hat", "w", "w_ctrl", "int")}) == 1, counts
    for words in ("proportional gains", "accel_reference_degc", "ring_frames: 16", "IMU calibrated", "0 records lost"):
        assert words in texts["err"], f"{words} is missing in err.log"
    again = kestrel_harness.run(
        "eval", "uquad", "--raw", folder / "imu_raw.log", "--calib", calibration, "--calibration-frames", "150", "--out", folder / "again"
    )
    assert again.returncode == 0, again
    return f"{counts['imu_raw']} frames, {board.heard!r}"


def test_uquad_settings_that_cannot_be_are_refused():
    """Ring, filter, calibration, control rate: each with its rule, exit code 2, before anything turns."""
    cases = {
        ("--ring", "6"): "ring must be longer",
        ("--ring", "33"): "32 at most",
        ("--fir", "0.5,0.4"): "add up",
        ("--frames-per-action", "0"): "every step",
        ("--declination", "400"): "declination",
    }
    for words, reason in cases.items():
        done = kestrel_harness.run("sim", "--airframe", "uquad", *words, "--headless")
        assert done.returncode == 2 and reason in done.stderr, (words, done.returncode, done.stderr)
