"""What bad input gets: on the command line, in files, on the wire, in flight."""

import math
import random
import signal
import socket
import subprocess
import tempfile
import time
from functools import partial
from pathlib import Path

import kestrel_harness
from kestrel_harness import Kestrel, free_port, out_folder
from rooms import Room
from station import NAN, item, mav, return_item, takeoff_item, waypoint


def refused(*arguments, says=(), code=None, one_line=True):
    """The program must end by itself, not with 0, and say these words, without a backtrace."""
    done = kestrel_harness.run(*arguments, timeout=20)
    shown = f"kestrel {' '.join(map(str, arguments))}: exit {done.returncode}\n{done.stderr or done.stdout}"
    assert done.returncode != 0 and (code is None or done.returncode == code), shown
    text = done.stderr.lower()
    missing = [word for word in says if word.lower() not in text]
    assert not missing, f"does not say {missing}: {shown}"
    assert "panicked" not in text and "backtrace" not in text, shown
    if one_line:
        assert len(done.stderr.strip().splitlines()) == 1, f"more than one line: {shown}"
    return done.stderr.strip()


def test_unknown_words_get_the_nearest_name_and_exit_2():
    """Sub-command, option, endpoint, room, ring, parameter."""
    udp = f"udpserver://127.0.0.1:{free_port()}"
    refused("simm", says=["sim"], code=2, one_line=False)
    refused("sim", "--sed", "3", says=["--seed"], code=2, one_line=False)
    refused("sim", "--mavlink", udp.replace("udpserver", "udpservr"), says=["udpservr", "udpserver"], code=2, one_line=False)
    refused("sim", "offce", "--mavlink", udp, says=["offce", "office"], code=2, one_line=False)
    refused("sim", "--rangers", "tof23", "--mavlink", udp, says=["tof32"], code=2, one_line=False)
    refused("params", "MIS_TAKEOF_ALT", says=["MIS_TAKEOFF_ALT"], code=2, one_line=False)
    refused("sim", "--param", "MIS_TAKEOF_ALT=1", "--mavlink", udp, says=["MIS_TAKEOFF_ALT"], code=2, one_line=False)
    refused("sim", "--param", "MIS_TAKEOFF_ALT=high", "--mavlink", udp, says=["MIS_TAKEOFF_ALT"], code=2, one_line=False)
    refused("sim", "--param", "MIS_TAKEOFF_ALT=-3", "--mavlink", udp, says=["MIS_TAKEOFF_ALT"], code=2, one_line=False)
    refused("rooms", "ofice", says=["office"], code=2, one_line=False)


def test_maps_that_cannot_be_used():
    """Missing, broken, without image, image missing, image too large: one line, exit code not 0."""
    folder = Path(tempfile.mkdtemp(prefix="maps-", dir=out_folder()))
    udp = ("--mavlink", f"udpserver://127.0.0.1:{free_port()}")
    fields = "resolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"

    def plan(name, yaml):
        path = folder / f"{name}.yaml"
        path.write_text(yaml)
        return path

    refused("sim", folder / "nowhere.yaml", *udp, says=["nowhere.yaml"])
    refused("sim", plan("broken", "image: [plan.pgm\n  : :\n"), *udp, says=["broken.yaml"])
    refused("sim", plan("empty", ""), *udp, says=["empty.yaml"])
    refused("sim", plan("imageless", fields), *udp, says=["imageless.yaml", "image"])
    refused("sim", plan("lost", f"image: lost.pgm\n{fields}"), *udp, says=["lost.pgm"])
    (folder / "text.pgm").write_text("this is no picture")
    refused("sim", plan("text", f"image: text.pgm\n{fields}"), *udp, says=["text"])
    (folder / "cut.pgm").write_bytes(b"P5\n100 100\n255\n" + bytes(50))
    refused("sim", plan("cut", f"image: cut.pgm\n{fields}"), *udp, says=["cut"])
    with open(folder / "huge.pgm", "wb") as huge:
        huge.write(b"P5\n9000 9000\n255\n")
        huge.truncate(9000 * 9000 + 17)
    refused("sim", plan("huge", f"image: huge.pgm\n{fields}"), *udp, says=["huge", "64"])
    (folder / "solid.pgm").write_bytes(b"P5\n20 20\n255\n" + bytes(400))
    refused("sim", plan("solid", f"image: solid.pgm\n{fields}"), *udp, says=["solid", "free"])
    (folder / "open.pgm").write_bytes(b"P5\n20 20\n255\n" + b"\xff" * 400)
    for wrong in ("0", "-0.05", "wide", "1e9"):
        refused("sim", plan("scale", f"image: open.pgm\n{fields.replace('0.05', wrong)}"), *udp, says=["resolution"])


def test_links_that_cannot_be_opened():
    """A named port in use and an absent serial device are errors; a default port in use gives the next free one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        refused("sim", "--headless", "--mavlink", f"udpserver://127.0.0.1:{port}", says=[str(port), "in use"])
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        refused("sim", "--headless", "--mavlink", f"tcpserver://127.0.0.1:{port}", says=[str(port), "in use"])
    refused("sim", "--headless", "--mavlink", "udpserver://127.0.0.1:70000", says=["70000"], code=2, one_line=False)
    plan, udp = Room.export("office").plan, ("--mavlink", f"udpserver://127.0.0.1:{free_port()}")
    # Without --mavlink it would announce itself on the network; the controller is what is missing here.
    refused("fly", "--fc", "serial:///dev/null", "--map", plan, says=["flight controller", "/dev/null"], code=1)
    refused("fly", "--fc", "serial:///dev/no-such-device?baudrate=115200", "--map", plan, *udp, says=["/dev/no-such-device"])
    return default_port_in_use()


def default_port_in_use():
    """With 14555 taken the server takes the next port and says so."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        try:
            taken.bind(("127.0.0.1", 14555))
        except OSError:
            pass  # another process has it: as good for this test
        program = subprocess.Popen(
            [kestrel_harness.binary(), "sim", "--headless"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        time.sleep(2.0)
        alive = program.poll() is None
        program.send_signal(signal.SIGINT)
        output, _ = program.communicate(timeout=60)
    assert alive and program.returncode == 0, f"exit {program.returncode}\n{output}"
    lines = [line for line in output.splitlines() if "14555" in line]
    assert lines, f"does not say that 14555 is in use:\n{output}"
    return lines[0].strip()


def test_flight_controller_that_does_not_answer():
    """`fly` on a serial device where nobody answers (a pseudo terminal): one line that names it, exit code not 0."""
    import os
    import pty

    ours, theirs = pty.openpty()
    try:
        plan, udp = Room.export("office").plan, ("--mavlink", f"udpserver://127.0.0.1:{free_port()}")
        device = os.ttyname(theirs)
        said = refused("fly", "--fc", f"serial://{device}?baudrate=115200", "--map", plan, *udp, says=[device, "answer"])
    finally:
        os.close(ours)
        os.close(theirs)
    return said


def garbage(rng, good):
    """Datagrams that no vehicle should obey."""
    yield bytes(rng.randrange(256) for _ in range(rng.randrange(1, 300)))
    yield good[: rng.randrange(1, len(good))]
    broken = bytearray(good)
    broken[rng.randrange(10, len(broken) - 2)] ^= 0x40
    yield bytes(broken)
    yield b"\xfd" * rng.randrange(1, 280)
    yield b"\xfe\xff" + bytes(rng.randrange(256) for _ in range(40))
    unknown = bytearray(b"\xfd\x04\x00\x00\x07\xff\xbe\xff\xff\xff" + b"abcd" + b"\x00\x00")
    yield bytes(unknown)


def test_garbage_on_the_wire_changes_nothing():
    """Random, truncated, wrong-CRC, unknown and foreign frames: the link lives, the vehicle stays as it was."""
    rng = random.Random(6)
    with Kestrel(seed=6, speed=2) as kestrel:
        station = kestrel.station()
        station.wait_ready()
        before = (station.mode, station.is_armed, station.param("MIS_TAKEOFF_ALT"))
        encoder = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        arm = encoder.command_long_encode(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0).pack(encoder)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hostile:
            for _ in range(400):
                for datagram in garbage(rng, arm):
                    hostile.sendto(datagram, ("127.0.0.1", kestrel.ports[0]))
                time.sleep(0.0005)
            # Well-formed, but for another system; and pretending to be the vehicle itself.
            other = encoder.command_long_encode(42, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0).pack(encoder)
            echo = mav.MAVLink(None, srcSystem=1, srcComponent=1)
            own = echo.command_long_encode(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0).pack(echo)
            for datagram in (other, own):
                hostile.sendto(datagram, ("127.0.0.1", kestrel.ports[0]))
        station.sleep(2.0)
        station.next("HEARTBEAT", within_s=3.0)
        after = (station.mode, station.is_armed, station.param("MIS_TAKEOFF_ALT"))
        assert after == before, f"{before} became {after}"
        # Non-numbers in well-formed messages.
        assert station.set_param("MIS_TAKEOFF_ALT", NAN) == before[2]
        assert station.set_param("MIS_TAKEOFF_ALT", 1e9) == before[2]
        with station.sending() as out:
            out.set_position_target_local_ned_send(0, 1, 1, 1, 0, NAN, math.inf, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
            out.manual_control_send(1, 32767, -32768, 32767, -32768, 0xFFFF)
            out.command_long_send(1, 1, mav.MAV_CMD_NAV_TAKEOFF, 0, *[math.inf] * 7)
        station.sleep(1.0)
        assert not station.is_armed
        station.take_off(1.0)
        station.land()
    assert kestrel.truth().contacts() == 0


def test_unknown_is_answered():
    """Unknown commands, modes, frames, mission types: UNSUPPORTED, DENIED or a MISSION_ACK, never silence."""
    with Kestrel(seed=7, speed=2) as kestrel:
        station = kestrel.station()
        station.command(31999, 1, 2, 3, expect="UNSUPPORTED")
        station.command(65000, expect="UNSUPPORTED")
        station.command_int(31999, expect="UNSUPPORTED")
        station.command(mav.MAV_CMD_DO_SET_MODE, 1, 99, 0, expect=("UNSUPPORTED", "DENIED"))
        station.command(mav.MAV_CMD_DO_SET_MODE, 1, 5, 0, expect=("UNSUPPORTED", "DENIED"))
        station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 16000000, 1e5, expect=("UNSUPPORTED", "DENIED", "FAILED"))
        station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 30, NAN, expect=("UNSUPPORTED", "DENIED", "FAILED"))
        station.command(mav.MAV_CMD_REQUEST_MESSAGE, 16000000, expect=("UNSUPPORTED", "DENIED", "FAILED"))
        station.command(mav.MAV_CMD_REQUEST_MESSAGE, 395, expect=("UNSUPPORTED", "DENIED", "FAILED"))
        # A mission item with an unknown command, one with an unknown frame: MISSION_ACK, and the old plan stays.
        room = Room.export("office")
        good = [takeoff_item(1.0), waypoint(*room.place("lab-corridor"), -1.0), return_item()]
        station.upload(good)
        station.upload([good[0], item(4711), good[2]], expect=mav.MAV_MISSION_UNSUPPORTED)
        north, east = room.place("corridor")
        odd = (99, *waypoint(north, east, -1.0)[1:])
        station.upload([good[0], odd, good[2]], expect=mav.MAV_MISSION_UNSUPPORTED_FRAME)
        kept = station.download()
        assert [i.command for i in kept] == [i[1] for i in good], "a refused mission replaced the old one"
        with station.listen("MISSION_ACK", "MISSION_REQUEST_INT") as mailbox:
            with station.sending() as out:
                out.mission_count_send(1, 1, 1, 77)
            answer = station.take(mailbox, what="an answer to an unknown mission type")
        assert answer.get_type() == "MISSION_ACK" and answer.type != mav.MAV_MISSION_ACCEPTED


def test_mission_items_in_walls_and_off_the_plan_are_refused():
    """With the reason as STATUSTEXT."""
    room = Room.export("office")
    n, e = room.to_ned(4.1, 4.25)
    in_wall = room.to_ned(2.0, 4.25)
    outside = room.to_ned(30.0, 30.0)
    with Kestrel(seed=8, speed=2) as kestrel:
        station = kestrel.station()
        station.wait_ready()
        for place, word in ((in_wall, "wall"), (outside, "plan")):
            since = station.now
            items = [takeoff_item(1.0), waypoint(n, e, -1.0), waypoint(*place, -1.0), return_item()]
            ack = station.upload(items, expect=None)
            assert ack.type != mav.MAV_MISSION_ACCEPTED, f"a way point in a wall or off the plan was accepted ({word})"
            reason_given = partial(station.has_said, word, since_s=since)
            station.wait_for(reason_given, 2.0, f"STATUSTEXT with {word!r}")
        station.take_off(1.0)
        lat, lon, alt = station.to_global(*in_wall, -1.0)
        into_wall = {"x": round(lat * 1e7), "y": round(lon * 1e7), "z": alt}
        station.command_int(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, **into_wall, expect=("DENIED", "TEMPORARILY_REJECTED"))
        station.land()
    return " | ".join(text for _, _, text in station.texts if "wall" in text or "plan" in text)[:160]


def test_arming_with_a_failing_check_is_refused_with_the_reason():
    """Before the flight controller and localization are up, and without localization when the search is forbidden."""
    with Kestrel(seed=9, speed=1, start="unknown") as kestrel:
        station = kestrel.station()
        station.set_param("LOC_SEARCH", 0)
        station.sleep(8.0)
        since = station.now
        station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, expect="TEMPORARILY_REJECTED")
        station.wait_for(lambda: station.has_said("locali", since_s=since), 2.0, "STATUSTEXT with the reason")
        assert not station.is_ready, "PREARM_CHECK is healthy while arming is refused"
        said = station.texts[-1][2]
    with Kestrel(seed=9, speed=1) as kestrel:
        station = kestrel.station()
        if not station.is_ready:
            station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, expect="TEMPORARILY_REJECTED")
            station.wait_for(lambda: station.texts, 2.0, "STATUSTEXT with the reason")
        station.wait_ready()
        station.command(mav.MAV_CMD_MISSION_START, 0, 0, expect=("DENIED", "TEMPORARILY_REJECTED"))
        station.set_mode("OFFBOARD", expect="TEMPORARILY_REJECTED")
        station.arm()
        station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0)
        station.take_off(1.0)
        station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, expect="DENIED")
        assert station.is_armed, "a plain disarm in flight stopped the motors"
        station.land()
    return said


def test_take_off_without_rangers_is_refused():
    """No working ring, no take-off."""
    ring = Path(tempfile.mkdtemp(prefix="ring-", dir=out_folder())) / "none.toml"
    ring.write_text(
        'name = "dead"\n[[ranger]]\nname = "dead"\nkind = "sonar"\nbearing_deg = 0.0\nhalf_cone_deg = 7.5\n'
        "min_m = 0.02\nmax_m = 4.0\nrate_hz = 0.1\nphase = 0.99\n"
    )
    with Kestrel(seed=9, speed=4, rangers=ring, name="dead-ring") as kestrel:
        station = kestrel.station()
        station.sleep(8.0)  # its one reading in ten seconds comes at 9.9 s
        station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, expect="TEMPORARILY_REJECTED")
        station.wait_for(lambda: station.has_said("range"), 2.0, "STATUSTEXT about the range finders")
        said = station.texts[-1][2]
    assert not kestrel.truth().has_flown
    return said


def test_offboard_stream_that_stops_leads_to_hold():
    """Half a second of silence, then Hold, and it stays where it is."""
    with Kestrel(seed=11, speed=1) as kestrel:
        station = kestrel.station()
        station.take_off(1.0)
        mask = 0b0000_1101_1100_0111 | 0x800  # velocity only

        def stream(seconds, north):
            for _ in station.ticks(seconds):
                with station.sending() as out:
                    out.set_position_target_local_ned_send(
                        0, 1, 1, mav.MAV_FRAME_LOCAL_NED, mask, 0, 0, 0, north, 0, 0, 0, 0, 0, 0, 0
                    )
                time.sleep(0.05)

        stream(0.6, 0.0)
        station.set_mode("OFFBOARD")
        stream(2.0, 0.3)
        stopped = station.now
        took = station.wait_for(lambda: station.mode == "LOITER", 3.0, "falls back to Hold") - stopped
        station.wait_for(lambda: station.has_said("off", since_s=stopped - 0.1), 2.0, "STATUSTEXT about it")
        station.sleep(5.0)
        station.land()
    truth = kestrel.truth()
    rest = truth.between(stopped + 3.0, stopped + 5.0)
    drift = rest.spread()
    assert truth.at(stopped).x > 0.3, f"did not follow the stream: {truth.at(stopped).x:.2f} m north"
    assert drift < 0.15 and truth.contacts() == 0, f"drifts {drift:.2f} m"
    return f"Hold {took:.2f} s after the last set point"


def test_lost_ground_station_lands():
    """No heartbeat of any station while flying: says so and lands. (Parameter COM_DL_LOSS_T, default 3 s.)"""
    with Kestrel(seed=12, speed=1) as kestrel:
        station = kestrel.station()
        station.take_off(1.0)
        station.beating.clear()
        lost = station.now
        took = station.wait_for(lambda: station.mode == "LAND", 8.0, "mode Land") - lost
        station.wait_for(lambda: station.has_said("ground", since_s=lost), 2.0, "STATUSTEXT about it")
        station.wait_disarmed(30.0)
    assert 2.5 < took < 5.0, f"Land {took:.1f} s after the last heartbeat"
    assert kestrel.truth().landing_error() < 0.3
    return f"Land {took:.1f} s after the last heartbeat"
