"""A ground station on pymavlink, as a script of any user would write it, with vehicle time in place of wall time.

Vehicle time is `time_boot_ms` of ATTITUDE: at `--speed 4` it runs four times as fast as the clock on the wall. All
time-outs here are vehicle seconds; a generous wall-clock limit behind them only keeps a dead program from blocking.
"""

import math
import os
import queue
import threading
import time
from contextlib import contextmanager

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402 - the dialect is chosen by the environment

mav = mavutil.mavlink

NAN = float("nan")
PX4_MODES = {  # name as pymavlink shows it: (main, sub)
    "STABILIZED": (7, 0),
    "ALTCTL": (2, 0),
    "POSCTL": (3, 0),
    "TAKEOFF": (4, 2),
    "LOITER": (4, 3),
    "MISSION": (4, 4),
    "RTL": (4, 5),
    "LAND": (4, 6),
    "OFFBOARD": (6, 0),
}
RESULT = {value.name.removeprefix("MAV_RESULT_"): number for number, value in mav.enums["MAV_RESULT"].items()}


class Timeout(AssertionError):
    """Something that must come did not."""


class Station:
    """Connection, heartbeat and mailbox."""

    def __init__(self, port, *, speed=1.0, system=255, component=190, is_ground_station=True, heartbeat=True, alive=None):
        self.speed, self._alive = speed, alive or (lambda: None)
        self.conn = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=system, source_component=component)
        self.texts = []  # (vehicle seconds, severity, text)
        self.latest = {}  # type name: newest message of the autopilot
        self.counts = {}  # type name: how many
        self.now = 0.0
        self.is_ground_station = is_ground_station
        self.beating = threading.Event()
        if heartbeat:
            self.beating.set()
        self._listeners = []
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._partial_text = {}
        for task in (self._read, self._beat):
            threading.Thread(target=task, daemon=True).start()

    def close(self):
        self._closed.set()
        time.sleep(0)
        self.conn.close()

    # -- threads ------------------------------------------------------------------------------------------------------

    def _beat(self):
        # Five a vehicle second: at --speed 4 a beat a wall second would look like a station that is lost.
        kind = mav.MAV_TYPE_GCS if self.is_ground_station else mav.MAV_TYPE_ONBOARD_CONTROLLER
        while not self._closed.is_set():
            if self.beating.is_set():
                with self.sending() as out:
                    out.heartbeat_send(kind, mav.MAV_AUTOPILOT_INVALID, 0, 0, 0)
            time.sleep(max(0.02, 0.2 / self.speed))

    def _read(self):
        while not self._closed.is_set():
            try:
                message = self.conn.recv_match(blocking=True, timeout=0.2)
            except (OSError, ValueError, TypeError):
                if self._closed.is_set():
                    return
                continue
            if message is not None:
                self._take(message)

    def _take(self, message):
        kind = message.get_type()
        if kind == "BAD_DATA" or message.get_srcComponent() != mav.MAV_COMP_ID_AUTOPILOT1:
            return
        if kind == "ATTITUDE":
            self.now = message.time_boot_ms / 1000.0
        if kind == "STATUSTEXT":
            self._take_text(message)
        self.latest[kind] = message
        self.counts[kind] = self.counts.get(kind, 0) + 1
        with self._lock:
            for wanted, when, mailbox in self._listeners:
                if kind in wanted and when(message):
                    mailbox.put(message)

    def _take_text(self, message):
        text = message.text
        if message.id:
            parts = self._partial_text.setdefault(message.id, {})
            parts[message.chunk_seq] = text
            if len(text.encode()) >= 50:
                return
            text = "".join(parts[i] for i in sorted(parts))
            del self._partial_text[message.id]
        self.texts.append((self.now, message.severity, text))

    # -- sending and waiting ------------------------------------------------------------------------------------------

    @contextmanager
    def sending(self):
        """The pymavlink sender; two threads use it."""
        with self._lock:
            try:
                yield self.conn.mav
            except OSError:
                if not self._closed.is_set():
                    raise

    @contextmanager
    def listen(self, *kinds, when=lambda message: True):
        """A mailbox of the messages that come inside the block."""
        mailbox = queue.Queue()
        entry = (kinds, when, mailbox)
        with self._lock:
            self._listeners.append(entry)
        try:
            yield mailbox
        finally:
            with self._lock:
                self._listeners.remove(entry)

    def take(self, mailbox, within_s=3.0, what="an answer"):
        """The next message of a mailbox."""
        for _ in self.ticks(within_s):
            try:
                return mailbox.get(timeout=0.02)
            except queue.Empty:
                continue
        raise Timeout(f"no {what} within {within_s:g} s; {self.describe()}")

    def ticks(self, within_s):
        """Yields every few ms until so much vehicle time has gone by."""
        start, wall = self.now, time.monotonic()
        while True:
            yield self.now - start
            self._alive()
            if self.now - start > within_s:
                return
            if time.monotonic() - wall > 10.0 + 6.0 * within_s / self.speed:
                raise Timeout(f"vehicle time stands still at {self.now:.2f} s; {self.describe()}")

    def wait_for(self, condition, within_s, what):
        """Waits until `condition()` holds; returns the vehicle time."""
        for _ in self.ticks(within_s):
            if condition():
                return self.now
            time.sleep(0.01)
        raise Timeout(f"{what}: not within {within_s:g} s; {self.describe()}")

    def sleep(self, seconds):
        """Lets vehicle time go by."""
        for gone in self.ticks(seconds):
            time.sleep(min(0.02, max(0.002, (seconds - gone) / self.speed)))

    def next(self, kind, within_s=3.0, when=lambda message: True):
        """The next message of a type."""
        with self.listen(kind, when=when) as mailbox:
            return self.take(mailbox, within_s, kind)

    def wait_connected(self):
        """Until the first heartbeat and the first attitude."""
        began = time.monotonic()
        while "HEARTBEAT" not in self.latest or "ATTITUDE" not in self.latest:
            self._alive()
            if time.monotonic() - began > 20.0:
                raise Timeout(f"no heartbeat and attitude within 20 s of wall time; got {sorted(self.counts)}")
            time.sleep(0.01)

    def describe(self):
        """State in one line, for failures."""
        position = self.latest.get("LOCAL_POSITION_NED")
        place = f"({position.x:.2f}, {position.y:.2f}, {position.z:.2f})" if position else "nowhere"
        last = self.texts[-1][2] if self.texts else "none"
        return (
            f"vehicle at {self.now:.1f} s: mode {self.mode}, {'armed' if self.is_armed else 'disarmed'}, at {place}, "
            f"last text: {last}"
        )

    # -- state --------------------------------------------------------------------------------------------------------

    @property
    def is_armed(self):
        beat = self.latest.get("HEARTBEAT")
        return bool(beat and beat.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def mode(self):
        """Name of the mode as pymavlink shows it."""
        beat = self.latest.get("HEARTBEAT")
        return mavutil.mode_string_v10(beat) if beat else None

    @property
    def landed_state(self):
        state = self.latest.get("EXTENDED_SYS_STATE")
        return state.landed_state if state else mav.MAV_LANDED_STATE_UNDEFINED

    @property
    def position(self):
        """Where the vehicle says it is, NED."""
        p = self.latest["LOCAL_POSITION_NED"]
        return (p.x, p.y, p.z)

    @property
    def height(self):
        """Height above the floor at home, m: known before the place on the plan is."""
        altitude = self.latest.get("ALTITUDE")
        return altitude.altitude_relative if altitude else 0.0

    @property
    def is_ready(self):
        """Would arming be accepted now?"""
        status = self.latest.get("SYS_STATUS")
        return bool(status and status.onboard_control_sensors_health & mav.MAV_SYS_STATUS_PREARM_CHECK)

    @property
    def is_localized(self):
        """Does it claim to know its place on the plan (ESTIMATOR_STATUS: absolute horizontal position)?"""
        status = self.latest.get("ESTIMATOR_STATUS")
        return bool(status and status.flags & mav.ESTIMATOR_POS_HORIZ_ABS)

    def has_said(self, *words, since_s=0.0):
        """A STATUSTEXT that holds all these words, in any case."""
        return any(t >= since_s and all(w.lower() in text.lower() for w in words) for t, _, text in self.texts)

    # -- commands -----------------------------------------------------------------------------------------------------

    def command(self, command, *params, expect="ACCEPTED", within_s=3.0):
        """COMMAND_LONG and its acknowledgement; one that is IN_PROGRESS is waited for."""
        values = [float(p) for p in params] + [0.0] * (7 - len(params))
        with self.listen("COMMAND_ACK", when=lambda m: m.command == command and self._is_for_us(m)) as acks:
            with self.sending() as out:
                out.command_long_send(1, 1, command, 0, *values)
            return self._judge(acks, command, expect, within_s)

    def command_int(self, command, *params, x=0, y=0, z=0.0, frame=mav.MAV_FRAME_GLOBAL, expect="ACCEPTED", within_s=3.0):
        """COMMAND_INT and its acknowledgement."""
        values = [float(p) for p in params] + [0.0] * (4 - len(params))
        with self.listen("COMMAND_ACK", when=lambda m: m.command == command and self._is_for_us(m)) as acks:
            with self.sending() as out:
                out.command_int_send(1, 1, frame, command, 0, 0, *values, int(x), int(y), z)
            return self._judge(acks, command, expect, within_s)

    def _is_for_us(self, ack):
        """Acknowledgements go out on every link: another station's may come just now."""
        return ack.target_system in (0, 255, self.conn.mav.srcSystem)

    def _judge(self, acks, command, expect, within_s):
        ack = self.take(acks, within_s, f"COMMAND_ACK for {command_name(command)}")
        while ack.result == mav.MAV_RESULT_IN_PROGRESS:
            ack = self.take(acks, 30.0, f"final COMMAND_ACK for {command_name(command)}")
        allowed = [expect] if isinstance(expect, str) else expect
        got = mav.enums["MAV_RESULT"][ack.result].name.removeprefix("MAV_RESULT_")
        assert got in allowed, f"{command_name(command)} answered {got}, expected {' or '.join(allowed)}; {self.describe()}"
        assert (ack.target_system, ack.target_component) in ((255, 190), (self.conn.mav.srcSystem, self.conn.mav.srcComponent)), (
            f"COMMAND_ACK is addressed to {ack.target_system}/{ack.target_component}"
        )
        return ack

    def wait_ready(self, within_s=30.0):
        """Until the pre-flight checks pass (flight controller up, localized)."""
        return self.wait_for(lambda: self.is_ready, within_s, "pre-flight checks pass")

    def arm(self, expect="ACCEPTED"):
        self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, expect=expect)
        if expect == "ACCEPTED":
            self.wait_for(lambda: self.is_armed, 3.0, "heartbeat shows armed")

    def set_mode(self, name, expect="ACCEPTED"):
        """DO_SET_MODE as pymavlink sends it for the PX4 identity."""
        main, sub = PX4_MODES[name]
        ack = self.command(mav.MAV_CMD_DO_SET_MODE, mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, main, sub, expect=expect)
        if expect == "ACCEPTED":
            self.wait_for(lambda: self.mode == name, 3.0, f"heartbeat shows mode {name}")
        return ack

    def take_off(self, height_m=1.0):
        """Arms, climbs and hovers; returns when the vehicle reports the height and mode Hold."""
        self.wait_ready()
        self.arm()
        self.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, height_m)
        self.wait_for(lambda: -self.position[2] > height_m - 0.15 and self.mode == "LOITER", 20.0, "take-off ends in Hold")
        self.sleep(2.0)

    def go_to(self, north, east, down=None, yaw=NAN, within_s=40.0):
        """DO_REPOSITION to a place in local metres, by way of latitude and longitude; returns on arrival."""
        lat, lon, alt = self.to_global(north, east, self.position[2] if down is None else down)
        self.command_int(
            mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, yaw, x=round(lat * 1e7), y=round(lon * 1e7), z=alt, frame=mav.MAV_FRAME_GLOBAL
        )
        self.wait_for(lambda: math.dist(self.position[:2], (north, east)) < 0.15, within_s, f"arrives at ({north}, {east})")
        self.sleep(3.0)

    def to_global(self, north, east, down):
        """Local NED to latitude, longitude (degrees) and altitude (m AMSL), about GPS_GLOBAL_ORIGIN."""
        origin = self.latest.get("GPS_GLOBAL_ORIGIN") or self.next("GPS_GLOBAL_ORIGIN", within_s=12.0)
        lat0, lon0 = origin.latitude * 1e-7, origin.longitude * 1e-7
        lat = lat0 + math.degrees(north / 6378137.0)
        lon = lon0 + math.degrees(east / (6378137.0 * math.cos(math.radians(lat0))))
        return lat, lon, origin.altitude * 1e-3 - down

    def land(self, within_s=40.0):
        """NAV_LAND, until disarmed."""
        self.command(mav.MAV_CMD_NAV_LAND, 0, 0, 0, NAN, NAN, NAN, NAN)
        self.wait_disarmed(within_s)

    def wait_disarmed(self, within_s=60.0):
        return self.wait_for(lambda: not self.is_armed, within_s, "landed and disarmed")

    def ask_interval(self, message_id, hz):
        """SET_MESSAGE_INTERVAL."""
        self.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / hz)

    def request(self, message_id, within_s=3.0):
        """REQUEST_MESSAGE and the message."""
        kind = mav.mavlink_map[message_id].msgname
        with self.listen(kind) as mailbox:
            self.command(mav.MAV_CMD_REQUEST_MESSAGE, message_id)
            return self.take(mailbox, within_s, kind)

    # -- parameters ---------------------------------------------------------------------------------------------------

    def param(self, name, within_s=3.0):
        """Value of a parameter, decoded bytewise as the capability bit says."""
        with self.listen("PARAM_VALUE", when=lambda m: m.param_id == name) as mailbox:
            with self.sending() as out:
                out.param_request_read_send(1, 1, name.encode(), -1)
            return decode_param(self.take(mailbox, within_s, f"PARAM_VALUE {name}"))

    def set_param(self, name, value, kind=None, within_s=3.0):
        """PARAM_SET; returns the echoed value."""
        if kind is None:
            kind = mav.MAV_PARAM_TYPE_INT32 if isinstance(value, int) else mav.MAV_PARAM_TYPE_REAL32
        with self.listen("PARAM_VALUE", when=lambda m: m.param_id == name) as mailbox:
            with self.sending() as out:
                out.param_set_send(1, 1, name.encode(), encode_param(value, kind), kind)
            return decode_param(self.take(mailbox, within_s, f"PARAM_VALUE {name}"))

    # -- missions -----------------------------------------------------------------------------------------------------

    def upload(self, items, expect=mav.MAV_MISSION_ACCEPTED, within_s=10.0, kind=0):
        """Uploads mission items (see `waypoint`), a fence (kind 1) or rally points (kind 2); returns the MISSION_ACK, which
        must be `expect` unless that is None."""
        is_ours = lambda m: m.mission_type == kind  # noqa: E731
        with self.listen("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK", when=is_ours) as mailbox:
            with self.sending() as out:
                out.mission_count_send(1, 1, len(items), kind)
            while True:
                message = self.take(mailbox, within_s, "mission request or MISSION_ACK")
                if message.get_type() == "MISSION_ACK":
                    break
                assert message.get_type() == "MISSION_REQUEST_INT", "asks by the deprecated MISSION_REQUEST"
                with self.sending() as out:
                    out.mission_item_int_send(1, 1, message.seq, *items[message.seq], kind)
        names = mav.enums["MAV_MISSION_RESULT"]
        assert expect is None or message.type == expect, (
            f"MISSION_ACK {names[message.type].name}, expected {names[expect].name}; {self.describe()}"
        )
        return message

    def download(self, within_s=5.0, kind=0):
        """Downloads the mission, the fence (kind 1) or the rally points (kind 2): a list of MISSION_ITEM_INT."""
        items = []
        with self.listen("MISSION_COUNT", "MISSION_ITEM_INT", when=lambda m: m.mission_type == kind) as mailbox:
            with self.sending() as out:
                out.mission_request_list_send(1, 1, kind)
            count = self.take(mailbox, within_s, "MISSION_COUNT").count
            while len(items) < count:
                with self.sending() as out:
                    out.mission_request_int_send(1, 1, len(items), kind)
                items.append(self.take(mailbox, within_s, f"mission item {len(items)}"))
                assert items[-1].seq == len(items) - 1
            with self.sending() as out:
                out.mission_ack_send(1, 1, 0, kind)
        return items


def decode_param(message):
    """Bytewise encoding: the four bytes of the float field are the value in its own type."""
    if message.param_type == mav.MAV_PARAM_TYPE_REAL32:
        return message.param_value
    import struct

    return struct.unpack("<i", struct.pack("<f", message.param_value))[0]


def encode_param(value, kind):
    """The other way."""
    if kind == mav.MAV_PARAM_TYPE_REAL32:
        return float(value)
    import struct

    return struct.unpack("<f", struct.pack("<i", int(value)))[0]


def command_name(command):
    """MAV_CMD in words."""
    entry = mav.enums["MAV_CMD"].get(command)
    return entry.name if entry else f"command {command}"


# Mission items as the arguments of mission_item_int_send after `seq`: frame, command, current, autocontinue, p1..p4, x, y, z.


def waypoint(north, east, down, *, hold_s=0.0, acceptance_m=0.0, yaw_deg=NAN):
    """A way point in local metres (MAV_FRAME_LOCAL_NED: exact to 0.1 mm)."""
    return (
        mav.MAV_FRAME_LOCAL_NED,
        mav.MAV_CMD_NAV_WAYPOINT,
        0,
        1,
        hold_s,
        acceptance_m,
        0.0,
        yaw_deg,
        round(north * 1e4),
        round(east * 1e4),
        down,
    )


def takeoff_item(height_m):
    """Take-off to a height above home."""
    return (mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, mav.MAV_CMD_NAV_TAKEOFF, 1, 1, 0.0, 0.0, 0.0, NAN, 0, 0, height_m)


def return_item():
    """Fly home and land."""
    return (mav.MAV_FRAME_MISSION, mav.MAV_CMD_NAV_RETURN_TO_LAUNCH, 0, 1, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0)


def item(command, *params, frame=mav.MAV_FRAME_MISSION, x=0, y=0, z=0.0):
    """Any other item."""
    values = [float(p) for p in params] + [0.0] * (4 - len(params))
    return (frame, command, 0, 1, *values, int(x), int(y), float(z))
