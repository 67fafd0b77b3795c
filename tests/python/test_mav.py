"""Item 7: `kestrel mav` against `kestrel sim`: every word, its output and its exit code; and our own messages in Python."""

import importlib
import json
import subprocess
import tempfile
import time
from pathlib import Path

from kestrel_harness import Kestrel, binary, out_folder
from station import mav

DONE, REFUSED, USAGE, SILENT = 0, 1, 2, 3


class Mav:
    """The client at one vehicle."""

    def __init__(self, url):
        self.url, self.runs = url, 0

    def __call__(self, *words, exits=DONE, typed="", timeout=150):
        self.runs += 1
        command = [binary(), "mav", "--to", self.url, *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, input=typed)
        assert done.returncode == exits, f"{words}: exit {done.returncode}, wanted {exits}\n{done.stdout}\n{done.stderr}"
        assert "panicked" not in done.stderr
        return done.stdout if exits == DONE else done.stderr


def test_every_word_of_the_client():
    """Status, parameters, missions, take-off to landing, keys, logs, watching; exit codes for refusals and silence."""
    folder = Path(tempfile.mkdtemp(prefix="mav-", dir=out_folder()))
    state = folder / "state"
    with Kestrel("office", seed=81, speed=2, servers=2, state_dir=state, name="mav") as kestrel:
        say = Mav(f"udpclient://127.0.0.1:{kestrel.ports[0]}")
        watch = kestrel.station(index=1, is_ground_station=False, system=200)
        watch.wait_ready()
        status = say("status")
        assert "Hold, disarmed" in status and "would be accepted" in status and "on the ground" in status, status

        assert say("params", "get", "MIS_TAKEOFF_ALT") == "MIS_TAKEOFF_ALT 1\n"
        assert say("params", "set", "MIS_TAKEOFF_ALT", "1.3") == "MIS_TAKEOFF_ALT 1.3\n"
        assert watch.param("MIS_TAKEOFF_ALT") > 1.29
        assert say("params", "set", "NAV_DLL_ACT", "1") == "NAV_DLL_ACT 1\n"
        diff = say("params", "diff")
        assert "MIS_TAKEOFF_ALT 1.3 (there 1)" in diff and "NAV_DLL_ACT 1 (there 3)" in diff, diff
        say("params", "save", folder / "all.txt")
        assert len((folder / "all.txt").read_text().splitlines()) > 80
        say("params", "set", "MIS_TAKEOFF_ALT", "1.0")
        assert "MIS_TAKEOFF_ALT" in say("params", "diff", folder / "all.txt")
        assert say("params", "load", folder / "all.txt") == "1 parameters set\n"
        assert watch.param("MIS_TAKEOFF_ALT") > 1.29
        assert "refused" in say("params", "set", "MIS_TAKEOFF_ALT", "99", exits=REFUSED)
        assert "no parameter" in say("params", "get", "NO_SUCH_NAME", exits=REFUSED)
        assert "whole number" in say("params", "set", "NAV_DLL_ACT", "1.5", exits=REFUSED)

        home = watch.to_global(0.0, 0.0, -1.0)
        plan = {
            "fileType": "Plan", "version": 1,
            "mission": {"items": [
                {"type": "SimpleItem", "command": 22, "frame": 3, "autoContinue": True, "params": [0, 0, 0, None, *home[:2], 1.0]},
                {"type": "SimpleItem", "command": 16, "frame": 1, "autoContinue": True, "params": [0, 0, 0, None, 1.0, 0.5, -1.0]},
                {"type": "SimpleItem", "command": 20, "frame": 2, "autoContinue": True, "params": [0, 0, 0, 0, 0, 0, 0]},
            ]},
            "geoFence": {"polygons": [{"inclusion": True, "polygon": [watch.to_global(*c, 0)[:2] for c in ((-9, -9), (-9, 9), (9, 9), (9, -9))]}], "circles": []},
            "rallyPoints": {"points": [[*home[:2], 1.0]]},
        }  # fmt: skip
        (folder / "a.plan").write_text(json.dumps(plan))
        assert "NAV_TAKEOFF" in say("mission", "show", folder / "a.plan")
        assert say("mission", "up", folder / "a.plan") == "3 mission items, 4 of the fence, 1 rally points\n"
        say("mission", "down", folder / "b.plan")
        back = json.loads((folder / "b.plan").read_text())
        assert [i["command"] for i in back["mission"]["items"]] == [22, 16, 20]
        assert back["mission"]["items"][1]["params"][4:] == [1.0, 0.5, -1.0]
        assert len(back["geoFence"]["polygons"][0]["polygon"]) == 4 and len(back["rallyPoints"]["points"]) == 1
        plan["mission"]["items"][1]["params"][4] = 500.0
        (folder / "wall.plan").write_text(json.dumps(plan))
        assert "stays" in say("mission", "up", folder / "wall.plan", exits=REFUSED)
        assert say("mission", "down").count("NAV_WAYPOINT") == 1
        (folder / "wrong.plan").write_text("{}")
        say("mission", "up", folder / "wrong.plan", exits=USAGE)

        assert "not flying" in say("goto", "1", "0", exits=REFUSED)
        say("takeoff", "1.2")
        assert abs(watch.height - 1.2) < 0.2 and watch.is_armed
        say("goto", "1.0", "-0.5", "1.0", "--yaw", "90")
        watch.sleep(2.0)
        arrived = watch.now
        assert "flying" in say("disarm", exits=REFUSED)
        answers = say("keys", typed="status\nm\n88\nm\n")
        assert "mode Hold" in answers and "height" in answers, answers
        watch.sleep(3.0)
        nudged = watch.now
        seen = say("watch", "ATTITUDE", "--hz", "50", "-n", "20")
        assert seen.count("ATTITUDE") >= 20 and "roll" in seen
        assert "did you mean `ATTITUDE`" in say("watch", "ATITUDE", exits=USAGE)
        say("stop")
        say("land")
        assert not watch.is_armed
        logs = say("log", "list")
        number = logs.split()[0]
        say("log", "get", number, folder / "flight.klog")
        assert (folder / "flight.klog").stat().st_size > 10_000
        assert "there is no log" in say("log", "get", "999", folder / "x", exits=REFUSED)
        say("arm")
        say("disarm")
        tcp = Mav("udpclient://127.0.0.1:9")
        assert "no vehicle" in tcp("--patience", "0.5", "status", exits=SILENT)
        tcp("--patience", "0.5", "fly", exits=USAGE)
        Mav("nonsense")("status", exits=USAGE)
    truth = kestrel.truth()
    s, n = truth.at(arrived), truth.at(nudged)
    miss = ((s.x - 1.0) ** 2 + (s.y + 0.5) ** 2 + (s.z + 1.0) ** 2) ** 0.5
    assert miss < 0.25 and truth.contacts() == 0, miss
    assert 0.2 < n.y - s.y < 0.6, f"two forward keys facing east moved {n.y - s.y:.2f} m"
    return f"{say.runs + 3} runs; go-to missed by {miss:.2f} m"


def dialect(folder):
    """Our dialect as a user generates it, and pymavlink with it."""
    from pymavlink import dialects
    from pymavlink.dialects import v20
    from pymavlink.generator import mavgen

    folder = Path(folder)
    for path in v20.__path__:
        for needed in ("common.xml", "minimal.xml", "standard.xml"):
            if (Path(path) / needed).exists():
                (folder / needed).write_text((Path(path) / needed).read_text())
    (folder / "kestrel.xml").write_text(subprocess.run([binary(), "mav", "dialect"], capture_output=True, text=True, check=True).stdout)
    options = mavgen.Opts(str(folder / "kestrel.py"), wire_protocol="2.0", language="Python3", validate=False)
    assert mavgen.mavgen(options, [str(folder / "kestrel.xml")])
    v20.__path__.append(str(folder))
    return importlib.import_module("pymavlink.dialects.v20.kestrel"), dialects


def test_our_own_messages_reach_python():
    """`kestrel mav dialect`, mavgen, and the four messages asked for while it flies."""
    from pymavlink import mavutil

    module, _ = dialect(tempfile.mkdtemp(prefix="dialect-", dir=out_folder()))
    assert module.MAVLINK_MSG_ID_KESTREL_LOCALIZATION == 53000
    with Kestrel("office", seed=82, speed=1, servers=2, name="dialect") as kestrel:
        station = kestrel.station()
        station.take_off(1.0)
        mavutil.set_dialect("kestrel")
        conn = mavutil.mavlink_connection(f"udpout:127.0.0.1:{kestrel.ports[1]}", source_system=240)
        try:
            conn.mav.heartbeat_send(18, 8, 0, 0, 4)
            conn.wait_heartbeat(timeout=5)
            got = {}
            for number in (53000, 53001, 53002, 53003):
                conn.mav.command_long_send(1, 1, mav.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, 100_000, 0, 0, 0, 0, 0)
            end = time.monotonic() + 6.0
            while time.monotonic() < end and len(got) < 4:
                message = conn.recv_match(blocking=True, timeout=1.0)
                if message and message.get_type().startswith("KESTREL_"):
                    got[message.get_type()] = message
            lost = conn.mav_loss
        finally:
            conn.close()
            mavutil.set_dialect("ardupilotmega")
        station.land()
    assert len(got) == 4, sorted(got)
    place, avoid, control, loop = (got[f"KESTREL_{k}"] for k in ("LOCALIZATION", "AVOIDANCE", "CONTROL", "LOOP"))
    assert place.state == 2 and place.particles > 100 and 0 < place.effective_particles <= place.particles and place.cluster_mass > 0.5
    assert 0.02 <= avoid.threshold <= 5 and avoid.reason == 0 and avoid.nearest > 0.3
    assert 0.1 < control.thrust < 0.9 and abs(control.velocity_sp[0]) < 0.5
    assert loop.ticks > 100 and loop.sample_to_command_p50 > 0 and loop.service_rate > 20 and lost == 0
    return f"{place.particles} particles, effective {place.effective_particles:.0f}, mass {place.cluster_mass:.2f}; nearest {avoid.nearest:.2f} m"
