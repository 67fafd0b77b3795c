"""Rows 2b and 7 over real sockets: roles, a peer on another address, exclusive control, STOP, a component behind Kestrel, a full
radio, announcement by broadcast."""

import http.client
import json
import re
import socket
import subprocess
import tempfile
import time
from pathlib import Path

from kestrel_harness import Kestrel, binary, free_port
from station import Station, Timeout, mav, mavutil


def own_address():
    """An address of this machine that is not loopback; none if there is no network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("198.51.100.1", 9))  # nothing is sent
            address = probe.getsockname()[0]
        except OSError:
            return None
    return None if address.startswith("127.") else address


def far_station(address, port, **keywords):
    """A station that speaks to Kestrel by the machine's own network address: for Kestrel another machine."""
    station = Station.__new__(Station)
    real = mavutil.mavlink_connection
    mavutil.mavlink_connection = lambda url, **k: real(url.replace("127.0.0.1", address), **k)
    try:
        station.__init__(port, **keywords)
    finally:
        mavutil.mavlink_connection = real
    return station


def test_a_peer_on_another_address_watches_and_is_told_how_to_fly():
    """Telemetry and reading yes; arming DENIED with the exact flag; STOP works; `role=pilot` flies but sets no parameter."""
    address = own_address() or "127.0.0.1"
    if address == "127.0.0.1":
        from kestrel_harness import Skipped

        raise Skipped("this machine has no address but loopback")
    watch, fly = free_port(), free_port()
    urls = [f"udpserver://0.0.0.0:{watch}", f"udpserver://0.0.0.0:{fly}?role=pilot"]
    with Kestrel(seed=71, speed=1, extra=[w for url in urls for w in ("--mavlink", url)]) as kestrel:
        local = kestrel.station()
        local.wait_ready()
        guest = far_station(address, watch, system=201, is_ground_station=False)
        pilot = far_station(address, fly, system=202, is_ground_station=False)
        try:
            guest.wait_connected()
            pilot.wait_connected()
            assert guest.param("MIS_TAKEOFF_ALT") > 0, "a viewer reads parameters"
            guest.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, expect="DENIED")
            guest.wait_for(lambda: guest.has_said("--mavlink", f"udpserver://0.0.0.0:{watch}?role=pilot"), 3.0, "told the flag")
            assert guest.has_said("kestrel keys new pilot.key")
            before = guest.param("MIS_TAKEOFF_ALT")
            assert guest.set_param("MIS_TAKEOFF_ALT", before + 0.5) == before, "a viewer sets nothing"
            assert pilot.set_param("MIS_TAKEOFF_ALT", before + 0.5) == before, "a pilot sets no parameter"
            guest.upload([], expect=None) if False else None
            with guest.listen("MISSION_ACK") as mailbox:
                with guest.sending() as out:
                    out.mission_count_send(1, 1, 3, 0)
                assert guest.take(mailbox, what="MISSION_ACK").type == mav.MAV_MISSION_DENIED
            with guest.listen("SERIAL_CONTROL") as mailbox:
                with guest.sending() as out:
                    out.serial_control_send(10, 2, 0, 0, 4, list(b"arm\n".ljust(70, b"\0")))
                line = guest.take(mailbox, what="the console's refusal")
                assert b"refused" in bytes(line.data)
            assert not local.is_armed
            pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
            pilot.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, float("nan"), float("nan"), float("nan"), 1.0)
            local.wait_for(lambda: local.height > 0.8 and local.mode == "LOITER", 20.0, "takes off")
            pilot.command_int(
                mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, float("nan"), x=15000, y=0, z=-1.0, frame=mav.MAV_FRAME_LOCAL_NED
            )
            local.sleep(1.0)
            guest.command(mav.MAV_CMD_DO_PAUSE_CONTINUE, 0)
            local.sleep(1.5)
            stopped = local.position
            local.sleep(3.0)
            drift = sum((a - b) ** 2 for a, b in zip(stopped, local.position)) ** 0.5
            # The second within three seconds lands, by mode Hold as well.
            guest.command(mav.MAV_CMD_NAV_LOITER_UNLIM)
            guest.command(mav.MAV_CMD_DO_SET_MODE, 1, 4, 3)
            local.wait_for(lambda: local.mode == "LAND", 2.0, "STOP twice lands")
            local.wait_disarmed(30.0)
        finally:
            guest.close()
            pilot.close()
    assert kestrel.truth().contacts() == 0 and drift < 0.25, drift
    return f"by {address}: viewer refused with the flag, stopped the vehicle (drift {drift:.2f} m) and landed it"


def request_control(station, action, takeover=0, expect="ACCEPTED"):
    station.command(32100, action, takeover, 5, 0, expect=expect)


def test_exclusive_control_passes_from_station_to_station():
    """CTRL_POLICY exclusive: NOT_IN_CONTROL (10) for others, handed over on request, freed by silence, STOP for all."""
    with Kestrel(seed=72, speed=1, servers=4, extra=["--param", "CTRL_POLICY=1"]) as kestrel:
        a, b, c = (kestrel.station(index=i, system=s) for i, s in ((0, 251), (1, 252), (2, 253)))
        a.wait_ready()
        not_in_control = mav.enums["MAV_RESULT"].get(10)
        name = not_in_control.name.removeprefix("MAV_RESULT_") if not_in_control else 10

        def arm(station):
            with station.listen("COMMAND_ACK", when=lambda m: m.command == 400 and m.target_system in (0, station.conn.mav.srcSystem)) as box:
                with station.sending() as out:
                    out.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
                ack = station.take(box, 3.0, "COMMAND_ACK")
                while ack.result == mav.MAV_RESULT_IN_PROGRESS:
                    ack = station.take(box, 6.0, "COMMAND_ACK")
                return ack.result

        assert arm(a) == 10, f"nobody is in control yet ({name})"
        request_control(a, 1)
        assert arm(b) == 10 and arm(a) == 0
        a.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, float("nan"), float("nan"), float("nan"), 1.0)
        a.wait_for(lambda: a.height > 0.8 and a.mode == "LOITER", 20.0, "takes off")
        # b asks; a is asked and allows; b has it.
        with a.listen("COMMAND_LONG", when=lambda m: m.command == 32100) as asked:
            request_control(b, 1, expect="FAILED")
            question = a.take(asked, 3.0, "the request passed on")
            assert (question.target_system, round(question.param4)) == (251, 252)
        request_control(a, 1, takeover=1)
        a.wait_for(lambda: a.has_said("system 252 is in control"), 3.0, "b is in control")
        with b.sending() as out:
            out.set_mode_send(1, 1, 3 << 16)
        b.sleep(0.5)
        # STOP of one who has nothing to say.
        c.command(mav.MAV_CMD_DO_PAUSE_CONTINUE, 0)
        # The owner falls silent: control is free, and the ground counts as lost though a and c still beat.
        b.beating.clear()
        a.wait_for(lambda: a.has_said("system 252 lost"), 6.0, "control is free again")
        a.wait_for(lambda: a.mode == "LAND", 6.0, "the ground-loss failsafe lands")
        request_control(c, 1)
        a.wait_disarmed(40.0)
    assert kestrel.truth().contacts() == 0
    return "asked, passed on, allowed, freed by silence; STOP by a stranger"


def test_a_companion_behind_is_seen_and_commanded():
    """`?route=on`: heartbeat and status of a second component reach the ground, a command by name reaches it and is answered."""
    behind = free_port()
    with Kestrel(seed=73, speed=1, extra=["--mavlink", f"udpserver://127.0.0.1:{behind}?route=on"]) as kestrel:
        station = kestrel.station()
        companion = mavutil.mavlink_connection(f"udpout:127.0.0.1:{behind}", source_system=1, source_component=191)
        ground = mavutil.mavlink_connection(f"udpout:127.0.0.1:{kestrel.ports[0]}", source_system=250, source_component=190)
        try:
            seen, deadline = None, time.monotonic() + 8.0
            while seen is None and time.monotonic() < deadline:
                companion.mav.heartbeat_send(18, 8, 0, 0, 4)
                ground.mav.heartbeat_send(18, 8, 0, 0, 4)
                while message := ground.recv_match(type="HEARTBEAT", blocking=True, timeout=0.2):
                    if (message.get_srcSystem(), message.get_srcComponent()) == (1, 191):
                        seen = message
                        break
            assert seen is not None, "the companion's heartbeat does not reach the ground"
            ground.mav.command_long_send(1, 191, 31000, 0, 42, 0, 0, 0, 0, 0, 0)
            heard = None
            deadline = time.monotonic() + 3.0
            while heard is None and time.monotonic() < deadline:
                message = companion.recv_match(type="COMMAND_LONG", blocking=True, timeout=0.5)
                heard = message if message and message.target_component == 191 else None
            assert heard is not None and round(heard.param1) == 42, "the command does not reach the companion"
            companion.mav.command_ack_send(31000, 0, 0, 0, 250, 190)
            ack, deadline = None, time.monotonic() + 3.0
            while ack is None and time.monotonic() < deadline:
                message = ground.recv_match(type="COMMAND_ACK", blocking=True, timeout=0.5)
                ack = message if message and message.get_srcComponent() == 191 else None
            assert ack is not None, "its answer does not come back"
            assert station.request(148).uid, "Kestrel itself answers as ever"
        finally:
            companion.close()
            ground.close()


def test_a_full_radio_halves_telemetry_and_commands_pass():
    """RADIO_STATUS with 10 % of its buffer free; `?rate=`; both on their own link only."""
    thin = free_port()
    with Kestrel(seed=74, speed=1, servers=2, extra=["--mavlink", f"udpserver://127.0.0.1:{thin}?rate=1200"]) as kestrel:
        radio, other = kestrel.station(), kestrel.station(index=1, system=254)
        radio.wait_ready()

        def rate(station, seconds=4.0):
            count, start = station.counts["ATTITUDE"], station.now
            station.sleep(seconds)
            return (station.counts["ATTITUDE"] - count) / (station.now - start)

        before = rate(radio)
        with radio.sending() as out:
            out.radio_status_send(100, 100, 10, 30, 30, 0, 0)
        after, alone = rate(radio), rate(other)
        assert abs(before - 20) < 1.5 and abs(after - 10) < 1.0 and abs(alone - 20) < 1.5, (before, after, alone)
        began = time.monotonic()
        radio.command(mav.MAV_CMD_REQUEST_MESSAGE, 148)
        took = time.monotonic() - began
        assert took < 0.3, took
        raw = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        raw.settimeout(0.2)
        beat = mav.MAVLink(None, srcSystem=249).heartbeat_encode(18, 8, 0, 0, 4)
        link = mav.MAVLink(None, srcSystem=249)
        got, start = 0, time.monotonic()
        while time.monotonic() - start < 10.0:
            raw.sendto(beat.pack(link), ("127.0.0.1", thin))
            end = time.monotonic() + 0.5
            while time.monotonic() < end:
                try:
                    n = len(raw.recv(4096))
                except TimeoutError:
                    continue
                if time.monotonic() - start > 4.0:
                    got += n
        raw.close()
        bytes_per_s = got / 6.0
    assert bytes_per_s < 1.25 * 1200, bytes_per_s
    return f"ATTITUDE {before:.1f} -> {after:.1f} Hz, other link {alone:.1f}, command in {took * 1e3:.0f} ms; rate=1200: {bytes_per_s:.0f} B/s"


def test_it_is_announced_by_broadcast_until_a_station_answers():
    """`udpbroadcast://`: heartbeats only, to everybody; who answers gets telemetry and the calling stops."""
    port = free_port()
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    listener.bind(("", port))
    listener.settimeout(3.0)
    with Kestrel(seed=75, speed=1, extra=["--mavlink", f"udpbroadcast://127.255.255.255:{port}"]):
        parser = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        parser.robust_parsing = True
        ids, sender, end = set(), None, time.monotonic() + 4.0
        while time.monotonic() < end:
            data, sender = listener.recvfrom(4096)
            ids |= {m.get_msgId() for m in parser.parse_buffer(data) or []}
        assert ids == {0}, f"not heartbeats alone: {ids}"
        beat = parser.heartbeat_encode(6, 8, 0, 0, 4)
        seen, end = set(), time.monotonic() + 3.0
        while time.monotonic() < end:
            listener.sendto(beat.pack(parser), sender)
            data, _ = listener.recvfrom(4096)
            seen |= {m.get_msgId() for m in parser.parse_buffer(data) or []}
    listener.close()
    assert 30 in seen and len(seen) > 10, seen
    return f"{len(seen)} kinds of message after the answer"


def test_log_ins_leave_no_memory_behind():
    """A password's work takes 19 MB for a moment, whichever thread does it; twelve log-ins cost nothing that stays."""
    state, port, password = tempfile.mkdtemp(prefix="kestrel-users-"), free_port(socket.SOCK_STREAM), "twelve times in a row"
    command = [binary(), "passwd", "ana", "--role", "viewer", "--state-dir", state]
    subprocess.run(command, input=password + "\n", text=True, check=True, stdout=subprocess.DEVNULL)

    def log_in():
        conn = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        body = json.dumps({"user": "ana", "password": password})
        conn.request("POST", "/api/login", body, {"Origin": f"http://127.0.0.1:{port}", "Content-Type": "application/json"})
        status = conn.getresponse().status
        conn.close()
        assert status == 200, status

    def resident_mb(pid):
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1024

    with Kestrel(seed=76, speed=1, state_dir=state, extra=["--console", f"127.0.0.1:{port}"], name="log-ins") as kestrel:
        kestrel.station()
        log_in()
        before = resident_mb(kestrel.process.pid)
        for _ in range(12):
            log_in()
        after = resident_mb(kestrel.process.pid)
    assert after - before < 10.0, f"{before:.1f} -> {after:.1f} MB"
    return f"{before:.1f} -> {after:.1f} MB after twelve log-ins"
