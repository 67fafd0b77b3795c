"""`kestrel fly` flies a simulated vehicle as the real thing: flight controller on TCP, sensors on pseudo terminals or by MAVLink."""

import contextlib
import math
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import kestrel_harness
from kestrel_harness import airspace, out_folder
from rooms import Room
from station import Station
from truth import Truth

ROOM = "office"


class Rehearsal:
    """`kestrel rehearse` and `kestrel fly` on it. `sensors` are URLs in which `{folder}` and `{mavlink}` are filled in."""

    def __init__(self, *sensors, fly=(), seed=1):
        self.folder = Path(tempfile.mkdtemp(prefix="rehearsal-", dir=out_folder()))
        self.mavlink = kestrel_harness.free_port()
        self.fc = kestrel_harness.free_port(socket.SOCK_STREAM)
        filled = [s.format(folder=self.folder, mavlink=f"127.0.0.1:{self.mavlink}") for s in sensors]
        named = [word for url in filled for word in ("--sensor", url)]
        self.truth_file = self.folder / "truth.csv"
        self.world_command = [kestrel_harness.binary(), "rehearse", ROOM, "--fc", f"tcpserver://127.0.0.1:{self.fc}"]
        self.world_command += [*named, "--seed", str(seed), "--truth", str(self.truth_file)]
        self.room = Room.export(ROOM)
        self.fly_command = [kestrel_harness.binary(), "fly", "--fc", f"tcpclient://127.0.0.1:{self.fc}", "--map", self.room.plan]
        self.fly_command += ["--mavlink", f"udpserver://127.0.0.1:{self.mavlink}", "--headless", *named, *fly]
        self.fly_command += ["--state-dir", str(self.folder / "state")]
        self.log_file = self.folder / "fly.log"

    def __enter__(self):
        self.resources = contextlib.ExitStack()
        self.resources.enter_context(airspace())
        self.world = subprocess.Popen(self.world_command, stdout=subprocess.PIPE, text=True, start_new_session=True)
        said = self.world.stdout.readline()
        assert "flight controller on" in said, said
        log = self.resources.enter_context(open(self.log_file, "w"))
        self.flying = subprocess.Popen(
            [str(word) for word in self.fly_command], stdout=log, stderr=subprocess.STDOUT, start_new_session=True
        )
        self.station = Station(self.mavlink, speed=1, alive=self.check_alive)
        self.station.wait_connected()
        return self

    def check_alive(self):
        assert self.flying.poll() is None, self.log()

    def log(self):
        return self.log_file.read_text(errors="replace")

    def __exit__(self, kind, error, traceback):
        try:
            if error is None:
                self.flying.send_signal(signal.SIGINT)
                assert self.flying.wait(40.0) == 0, self.log()
                self.world.send_signal(signal.SIGINT)
                assert self.world.wait(10.0) == 0
            else:
                error.add_note(f"fly said:\n{self.log()[-3000:]}\nfiles: {self.folder}")
        finally:
            for process in (self.flying, self.world):
                process.kill()
                process.wait()
            self.world.stdout.close()
            self.station.close()
            self.resources.close()
        if error is None:
            self.truth = Truth.read(self.truth_file)
            if not os.environ.get("KESTREL_KEEP"):
                shutil.rmtree(self.folder, ignore_errors=True)
        return False


def hold(rehearsal, seconds=8.0):
    """Takes off, holds, lands; how far it strayed by its own account."""
    station = rehearsal.station
    station.wait_ready(60.0)
    station.take_off(1.0)
    station.sleep(2.0)
    began = station.position
    strayed = 0.0
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        station.sleep(0.25)
        strayed = max(strayed, math.dist(station.position[:2], began[:2]))
        assert abs(station.height - 1.0) < 0.35, f"height {station.height:.2f}"
    station.land()
    station.wait_disarmed()
    return strayed


def judged(rehearsal, strayed):
    """What the truth says of such a flight."""
    samples = rehearsal.truth.samples
    flown = [s for s in samples if s.z < -0.5]
    assert flown, "never left the floor"
    contacts = sum(s.contact for s in samples)
    home = samples[0]
    reach = max(math.hypot(s.x - home.x, s.y - home.y) for s in flown)
    text = f"flew {len(flown) / 50:.0f} s, strayed {strayed:.2f} m by its own account, {reach:.2f} m in truth"
    assert contacts == 0 and strayed < 0.4 and reach < 0.5, f"{text}, {contacts} contacts"
    return text


def test_fly_takes_off_and_holds_with_a_lidar_and_a_flow_module_on_serial_lines():
    """LD06 packets and MSP module messages through pseudo terminals: bytes to scan to place to sticks."""
    with Rehearsal("ld06://{folder}/lidar?yaw_deg=90&z_m=-0.05", "msp://{folder}/flow") as rehearsal:
        strayed = hold(rehearsal)
    return judged(rehearsal, strayed)


def test_fly_takes_off_and_holds_with_everything_by_mavlink():
    """OBSTACLE_DISTANCE, DISTANCE_SENSOR down and OPTICAL_FLOW_RAD of a companion program."""
    with Rehearsal("mavlink://{mavlink}?obstacle=on&down=on&flow=on&from=42/196", seed=2) as rehearsal:
        strayed = hold(rehearsal)
    return judged(rehearsal, strayed)


def test_a_lidar_that_is_asked_and_a_ring_of_depths_fly_too():
    """RPLIDAR A1: stop, health, scan, points. Then the frames of a microcontroller with four multizone sensors."""
    with Rehearsal("rplidar://{folder}/lidar", "msp://{folder}/flow", seed=3) as rehearsal:
        strayed = hold(rehearsal, 4.0)
    lidar = judged(rehearsal, strayed)
    with Rehearsal("tof_ring://{folder}/tof", "msp://{folder}/flow", seed=4) as rehearsal:
        strayed = hold(rehearsal, 4.0)
    return f"rplidar: {lidar}; tof_ring: {judged(rehearsal, strayed)}"


def test_a_lidar_unplugged_in_flight_lands_the_vehicle_by_the_failsafe_of_silent_rangers():
    """Its line goes dead while flow and height go on; on the ground it is named, and arming is refused."""
    with Rehearsal("ld06://{folder}/lidar", "msp://{folder}/flow", seed=5) as rehearsal:
        station = rehearsal.station
        station.wait_ready(60.0)
        station.take_off(1.0)
        (rehearsal.folder / "lidar.cut").touch()
        cut_at = station.now
        station.wait_disarmed(40.0)
        took = station.now - cut_at
        assert station.has_said("range finders silent"), station.texts[-8:]
        station.wait_for(lambda: "nothing to use" in rehearsal.log(), 10.0, "the lidar is named")
        station.arm(expect="TEMPORARILY_REJECTED")
    samples = rehearsal.truth.samples
    assert sum(s.contact for s in samples) == 0
    return f"down and disarmed {took:.1f} s after the line was cut"


def test_sensors_that_cannot_be_together_are_refused_at_the_start_with_both_names_and_the_rule():
    """Exit code 2, before anything is opened."""
    plan = Room.export(ROOM).plan
    link = ["--mavlink", f"udpserver://127.0.0.1:{kestrel_harness.free_port()}"]

    def said(*sensors):
        words = [word for url in sensors for word in ("--sensor", url)]
        done = kestrel_harness.run("fly", "--fc", "serial:///dev/ttyNONE", "--map", plan, *link, *words)
        assert done.returncode == 2, (done.returncode, done.stderr)
        return done.stderr

    both = said("ld06:///dev/ttyUSB0", "tof_ring:///dev/ttyUSB1")
    assert "ld06" in both and "tof_ring" in both and "64 beams" in both, both
    both = said("ld06:///dev/ttyNONE")
    assert "--fc" in both and "ld06" in both and "one reader" in both, both
    both = said("gpsd:", "gps_fake:?values=random")
    assert "gpsd" in both and "gps_fake" in both and "one source" in both, both
    done = kestrel_harness.run(
        "fly", "--fc", "serial:///dev/ttyNONE", "--map", plan, *link, "--sensor", "gpsd:", "--param", "KST_FC_GPS=1",
        "--state-dir", str(out_folder() / "refused"),
    )  # fmt: skip
    assert done.returncode == 2 and "KST_FC_GPS and gpsd" in done.stderr, done.stderr
    assert "did you mean `yaw_deg`" in said("ld06:///dev/ttyUSB0?yaw_dge=3")
    return "five refusals"
