"""Step (c) of the order: what every ground station asks for. Connect, parameters, modes, missions, intervals, clocks."""

import math
import time

from kestrel_harness import Kestrel
from rooms import Room
from station import NAN, PX4_MODES, decode_param, item, mav, mavutil, return_item, takeoff_item, waypoint

INT32, REAL32 = mav.MAV_PARAM_TYPE_INT32, mav.MAV_PARAM_TYPE_REAL32


def test_handshake_of_a_ground_station():
    """Every step QGroundControl takes is acknowledged."""
    with Kestrel(seed=51) as kestrel:
        station = kestrel.station()
        began = station.now
        beat = station.latest["HEARTBEAT"]
        assert (beat.type, beat.autopilot) == (mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PX4)
        version = station.request(148)
        assert version.capabilities == 0xE9FD, hex(version.capabilities)
        assert version.flight_sw_version >= 0x01040100 and version.uid
        wanted = set()
        with station.listen("AVAILABLE_MODES") as mailbox:
            station.command(mav.MAV_CMD_REQUEST_MESSAGE, 435, 0)
            first = station.take(mailbox, what="AVAILABLE_MODES")
            wanted = {first.mode_index}
            while len(wanted) < first.number_modes:
                wanted.add(station.take(mailbox, what=f"all {first.number_modes} AVAILABLE_MODES").mode_index)
        assert wanted == set(range(1, first.number_modes + 1))
        station.command(mav.MAV_CMD_REQUEST_MESSAGE, 397)
        values = list_params(station)
        for mission_type in (0, 1, 2):
            with station.listen("MISSION_COUNT", when=lambda m, kind=mission_type: m.mission_type == kind) as mailbox:
                with station.sending() as out:
                    out.mission_request_list_send(1, 1, mission_type)
                assert station.take(mailbox, what=f"MISSION_COUNT of type {mission_type}").count == 0
                with station.sending() as out:
                    out.mission_ack_send(1, 1, 0, mission_type)
        took = station.now - began
        home = station.request(242)
        assert abs(home.x) < 0.01 and abs(home.y) < 0.01
        with station.listen("FILE_TRANSFER_PROTOCOL") as mailbox:
            open_file = bytes([1, 0, 0, 4, 16, 0, 0, 0, 0, 0, 0, 0]) + b"@PARAM/param.pck"
            with station.sending() as out:
                out.file_transfer_protocol_send(0, 1, 1, list(open_file.ljust(251, b"\0")))
            assert station.take(mailbox, what="FTP answer").payload[3] == 129, "FTP does not answer NAK"
        with station.listen("LOG_ENTRY") as mailbox:
            with station.sending() as out:
                out.log_request_list_send(1, 1, 0, 0xFFFF)
            assert station.take(mailbox, what="LOG_ENTRY").num_logs == 0
    return f"{len(values)} parameters, {first.number_modes} modes, {took:.2f} s"


def list_params(station):
    """PARAM_REQUEST_LIST; {name: value}."""
    found = {}
    with station.listen("PARAM_VALUE") as mailbox:
        with station.sending() as out:
            out.param_request_list_send(1, 0)
        while True:
            value = station.take(mailbox, 3.0, "PARAM_VALUE")
            if value.param_index == 0xFFFF:
                continue
            found[value.param_index] = value
            if len(found) == value.param_count:
                break
    assert sorted(found) == list(range(len(found)))
    assert all(v.param_type in (INT32, REAL32) for v in found.values())
    names = [v.param_id for v in found.values()]
    assert len(set(names)) == len(names)
    return {v.param_id: decode_param(v) for v in found.values()}


def test_parameters():
    """List, get, set in both types, refusals, REAL32 sets of integers by value, set while listing."""
    with Kestrel(seed=52, speed=2) as kestrel:
        station = kestrel.station()
        values = list_params(station)
        known_to_clients = "MIS_TAKEOFF_ALT RTL_RETURN_ALT MPC_XY_VEL_MAX COM_DISARM_LAND NAV_DLL_ACT COM_DL_LOSS_T MPC_XY_CRUISE"
        missing = set(known_to_clients.split()) - set(values)
        assert not missing, missing
        assert station.set_param("MIS_TAKEOFF_ALT", 1.5) == 1.5
        assert station.param("MIS_TAKEOFF_ALT") == 1.5
        assert station.set_param("NAV_DLL_ACT", 1, INT32) == 1
        # What a plain pymavlink script does: REAL32 for an integer parameter, by value.
        with station.listen("PARAM_VALUE", when=lambda m: m.param_id == "NAV_DLL_ACT") as mailbox:
            with station.sending() as out:
                out.param_set_send(1, 1, b"NAV_DLL_ACT", 3.0, REAL32)
            assert decode_param(station.take(mailbox, what="echo")) == 3
        for wrong in (NAN, math.inf, -5.0, 1e6):
            assert station.set_param("MIS_TAKEOFF_ALT", wrong) == 1.5, f"took {wrong}"
        assert station.set_param("NAV_DLL_ACT", 99, INT32) == 3
        # Set while listing.
        with station.listen("PARAM_VALUE") as mailbox:
            with station.sending() as out:
                out.param_request_list_send(1, 1)
            with station.sending() as out:
                out.param_set_send(1, 1, b"MIS_TAKEOFF_ALT", 1.7, REAL32)
            seen = set()
            while len(seen) < len(values):
                message = station.take(mailbox, what="rest of the list")
                if message.param_index != 0xFFFF:
                    seen.add(message.param_index)
        assert abs(list_params(station)["MIS_TAKEOFF_ALT"] - 1.7) < 1e-6
    return f"{len(values)} parameters"


def test_every_mode_by_every_form():
    """DO_SET_MODE in three forms, SET_MODE, DO_SET_STANDARD_MODE, and pymavlink's set_mode(name)."""
    with Kestrel(seed=53, speed=2) as kestrel:
        station = kestrel.station()
        station.take_off(1.0)
        for name in ("LOITER", "POSCTL", "ALTCTL", "LOITER"):
            if name in ("POSCTL", "ALTCTL"):
                stick(station)
            station.set_mode(name)
            stick(station)
        packed = {name: main << 16 | sub << 24 for name, (main, sub) in PX4_MODES.items()}

        def becomes(name):
            station.wait_for(lambda: station.mode == name, 3.0, f"mode {name}")

        # Legacy message, as QGroundControl sends it with the PX4 identity.
        with station.sending() as out:
            out.set_mode_send(1, 129, packed["POSCTL"])
        becomes("POSCTL")
        # Packed value in DO_SET_MODE.
        station.command(mav.MAV_CMD_DO_SET_MODE, 129, packed["LOITER"])
        becomes("LOITER")
        station.command(mav.MAV_CMD_DO_SET_STANDARD_MODE, 1)
        becomes("POSCTL")
        # pymavlink's names.
        assert station.conn.mode_mapping() and "RTL" in station.conn.mode_mapping()
        with station.sending():
            station.conn.set_mode("LOITER")
        becomes("LOITER")
        current = station.request(436)
        assert current.custom_mode == packed["LOITER"]
        station.set_mode("RTL")
        station.wait_disarmed(60.0)
    assert kestrel.truth().landing_error() <= 0.3 and kestrel.truth().contacts() == 0


def stick(station):
    """One centred MANUAL_CONTROL."""
    with station.sending() as out:
        out.manual_control_send(1, 0, 0, 500, 0, 0)


def test_missions_survive_the_round_trip():
    """All item kinds and frames come back as they went; clear; a large plan; a late request."""
    room = Room.export("office")
    with Kestrel(seed=54, speed=2) as kestrel:
        station = kestrel.station()
        station.wait_ready()
        n, e = room.place("corridor")
        lat, lon, _ = station.to_global(n, e, -1.0)
        latlon = {"x": round(lat * 1e7), "y": round(lon * 1e7)}
        items = [
            takeoff_item(1.0),
            waypoint(*room.place("lab-corridor"), -1.0, hold_s=1.0, acceptance_m=0.2, yaw_deg=90.0),
            item(mav.MAV_CMD_NAV_WAYPOINT, 0, 0, 0, NAN, frame=mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, z=1.0, **latlon),
            item(mav.MAV_CMD_NAV_LOITER_TIME, 2, 0, 0, NAN, frame=mav.MAV_FRAME_GLOBAL_INT, z=1.0, **latlon),
            item(mav.MAV_CMD_DO_CHANGE_SPEED, 1, 0.5, -1),
            item(mav.MAV_CMD_NAV_DELAY, 1, -1, -1, -1),
            item(mav.MAV_CMD_CONDITION_DELAY, 1),
            item(mav.MAV_CMD_CONDITION_YAW, 90, 0, 1, 0),
            item(mav.MAV_CMD_DO_JUMP, 1, 1),
            item(mav.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 1),
            item(mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, 0, 0, NAN, NAN),
            return_item(),
        ]
        ack = station.upload(items)
        assert ack.mission_type == 0
        back = station.download()
        for sent, got in zip(items, back):
            fields = ("frame", "command", "current", "autocontinue", "param1", "param2", "param3", "param4", "x", "y", "z")
            for field, a in zip(fields, sent):
                b = getattr(got, field)
                same = abs(a - b) < 1e-4 * max(1.0, abs(a)) or (math.isnan(a) and math.isnan(b))
                # `current` is the vehicle's to say.
                assert same or field == "current", f"item {got.seq}, {field}: sent {a}, came back {b}"
        many = [takeoff_item(1.0), *(waypoint(0.01 * (i % 50), 0.0, -1.0) for i in range(509)), return_item()]
        station.upload(many, within_s=20.0)
        assert len(station.download()) == len(many)
        with station.listen("MISSION_ACK") as mailbox:
            with station.sending() as out:
                out.mission_clear_all_send(1, 1, 255)
            assert station.take(mailbox, what="MISSION_ACK").type == 0
        assert station.download() == []
        # An upload that is abandoned leaves the old plan alone.
        station.upload(items)
        with station.listen("MISSION_REQUEST_INT") as mailbox:
            with station.sending() as out:
                out.mission_count_send(1, 1, 5, 0)
            station.take(mailbox, what="MISSION_REQUEST_INT")
            station.take(mailbox, what="the request again")
        station.sleep(7.0)
        assert len(station.download()) == len(items)


def test_intervals_clocks_and_streams():
    """SET_MESSAGE_INTERVAL to 50 Hz, off, default; TIMESYNC, PING; telemetry of the contract at its rates."""
    with Kestrel(seed=55, speed=1) as kestrel:
        station = kestrel.station()
        station.wait_ready()
        counts, start = dict(station.counts), station.now
        station.sleep(6.0)
        rates = {k: (station.counts.get(k, 0) - counts.get(k, 0)) / (station.now - start) for k in station.counts}
        wanted = {
            "HEARTBEAT": 1, "SYS_STATUS": 1, "EXTENDED_SYS_STATE": 1, "ATTITUDE": 20, "ATTITUDE_QUATERNION": 10, "LOCAL_POSITION_NED": 20,
            "GLOBAL_POSITION_INT": 5, "GPS_RAW_INT": 1, "VFR_HUD": 4, "ALTITUDE": 1, "ODOMETRY": 10, "ESTIMATOR_STATUS": 1,
            "RC_CHANNELS": 2, "DISTANCE_SENSOR": 5, "OBSTACLE_DISTANCE": 5, "MISSION_CURRENT": 1, "SYSTEM_TIME": 1, "BATTERY_STATUS": 0.5,
        }  # fmt: skip
        slow = {k: round(rates.get(k, 0.0), 2) for k, hz in wanted.items() if rates.get(k, 0.0) < 0.8 * hz - 0.17}
        assert not slow, f"too slow, Hz: {slow}"

        def rate(kind, seconds=4.0):
            count, start = station.counts.get(kind, 0), station.now
            station.sleep(seconds)
            return (station.counts.get(kind, 0) - count) / (station.now - start)

        station.ask_interval(30, 50)
        fast = rate("ATTITUDE")
        assert abs(fast - 50) <= 1.5, f"ATTITUDE at {fast:.1f} Hz, asked for 50"
        interval = station.command(mav.MAV_CMD_GET_MESSAGE_INTERVAL, 30)
        assert interval is not None
        station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 0)
        assert abs(rate("ATTITUDE") - 20) <= 1.0
        station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 31, -1)
        station.sleep(0.2)
        assert rate("ATTITUDE_QUATERNION", 2.0) == 0.0
        station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 0, -1, expect=("DENIED", "UNSUPPORTED", "FAILED"))
        station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 500, expect=("DENIED", "UNSUPPORTED", "FAILED"))

        with station.listen("TIMESYNC", when=lambda m: m.tc1 != 0) as mailbox:
            with station.sending() as out:
                out.timesync_send(0, 123456789)
            assert station.take(mailbox, what="TIMESYNC").ts1 == 123456789
        with station.listen("PING") as mailbox:
            with station.sending() as out:
                out.ping_send(0, 77, 0, 0)
            answer = station.take(mailbox, what="PING")
            assert (answer.seq, answer.target_system, answer.target_component) == (77, 255, 190)
        with station.sending() as out:
            out.request_data_stream_send(1, 1, 0, 4, 1)
        station.sleep(1.0)
    return f"ATTITUDE {fast:.1f} Hz when asked for 50, {sum(rates.values()):.0f} messages/s by default"


def test_two_stations_and_tcp():
    """Two stations on one server and one on TCP all get telemetry; answers reach their asker."""
    import socket as sockets

    from kestrel_harness import free_port

    tcp = free_port(sockets.SOCK_STREAM)
    with Kestrel(seed=56, speed=1, extra=["--mavlink", f"tcpserver://127.0.0.1:{tcp}"]) as kestrel:
        first = kestrel.station()
        second = kestrel.station(system=254)
        version = second.request(148)
        assert version.uid
        conn = mavutil.mavlink_connection(f"tcp:127.0.0.1:{tcp}", source_system=253)
        beat = conn.wait_heartbeat(timeout=10)
        assert beat and beat.get_srcComponent() == 1
        conn.mav.command_long_send(1, 1, mav.MAV_CMD_REQUEST_MESSAGE, 0, 242, 0, 0, 0, 0, 0, 0)
        deadline, home, ack = time.monotonic() + 5.0, None, None
        while time.monotonic() < deadline and not (home and ack):
            message = conn.recv_match(type=["HOME_POSITION", "COMMAND_ACK"], blocking=True, timeout=1.0)
            if message and message.get_type() == "HOME_POSITION":
                home = message
            elif message and message.target_system == 253:
                ack = message
        conn.close()
        assert home and ack, "no answer on TCP"
        lost = first.conn.mav_loss
        assert lost == 0, f"{lost} sequence gaps on a clean link"


def test_manual_control_signs():
    """MANUAL_CONTROL and RC_CHANNELS_OVERRIDE move the vehicle the right way; stale sticks end in Hold."""
    with Kestrel("office", seed=57, speed=2, name="sticks") as kestrel:
        station = kestrel.station()
        station.take_off(1.0)
        marks = {}

        def push(name, seconds, x=0, y=0, z=500, r=0):
            begin = station.now
            for _ in station.ticks(seconds):
                with station.sending() as out:
                    out.manual_control_send(1, x, y, z, r, 0)
                time.sleep(0.02)
            marks[name] = (begin, station.now)

        push("centre", 0.3)
        station.set_mode("POSCTL")
        for name, sticks in (("forward", {"x": 500}), ("back", {"x": -500}), ("right", {"y": 500}), ("left", {"y": -500})):
            push(name, 1.5, **sticks)
            push("centre", 1.5)
        silent = station.now
        took = station.wait_for(lambda: station.mode == "LOITER", 6.0, "silent sticks end in Hold") - silent
        station.land()
    truth = kestrel.truth()
    for name, axis, sign in (("forward", 0, 1), ("back", 0, -1), ("right", 1, 1), ("left", 1, -1)):
        a, b = (truth.at(t) for t in marks[name])
        north, east = b.x - a.x, b.y - a.y
        motion = (north * math.cos(a.yaw) + east * math.sin(a.yaw), -north * math.sin(a.yaw) + east * math.cos(a.yaw))
        assert sign * motion[axis] > 0.15 and abs(motion[1 - axis]) < 0.2, f"{name}: forward, right = {motion}"
    assert truth.contacts() == 0
    return f"Hold {took:.1f} s after the last stick"


def test_sticks_towards_a_wall_stop_before_it():
    """Avoidance brakes the pilot: ten seconds of full stick against the lab's wall, no contact."""
    with Kestrel("office", seed=58, speed=2, name="wall") as kestrel:
        station = kestrel.station()
        station.take_off(1.0)
        stick(station)
        station.set_mode("POSCTL")
        for _ in station.ticks(10.0):
            with station.sending() as out:
                out.manual_control_send(1, 0, -1000, 500, 0, 0)
            time.sleep(0.02)
        end = station.now
        station.set_mode("LOITER")
        station.sleep(2.0)
        station.land()
    truth = kestrel.truth()
    a = truth.at(end)
    assert truth.contacts() == 0 and math.hypot(a.x, a.y) > 0.7, (
        f"moved {math.hypot(a.x, a.y):.2f} m, contacts {truth.contacts()}"
    )
    return f"went {math.hypot(a.x, a.y):.2f} m, no contact"
