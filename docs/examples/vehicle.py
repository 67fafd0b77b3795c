"""What the programs beside this share: a connection with a heartbeat, commands, the newest message of each kind. Needs pymavlink."""
import math
import os
import threading
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402 - the dialect is chosen by the environment

mavlink = mavutil.mavlink
NAN = math.nan


class Vehicle:
    """One vehicle, from a ground station of our own."""

    def __init__(self, link="udpout:127.0.0.1:14555", system=1):
        self.system, self.latest, self.texts = system, {}, []
        self.conn = mavutil.mavlink_connection(link, source_system=255)
        self._beat()
        for task in (self._beats, self._reads):
            threading.Thread(target=task, daemon=True).start()
        self.wait(lambda: "HEARTBEAT" in self.latest and "LOCAL_POSITION_NED" in self.latest, "the vehicle")

    # A station says that it is there; if it stops, the vehicle lands. Often, so that a simulator at four times the speed hears enough.
    def _beat(self):
        self.conn.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)

    def _beats(self):
        while True:
            self._beat()
            time.sleep(0.2)

    def _reads(self):
        while True:
            message = self.conn.recv_match(blocking=True, timeout=1)
            if message and message.get_srcSystem() == self.system and message.get_srcComponent() == 1:
                if message.get_type() == "STATUSTEXT":
                    self.texts.append(message.text)
                self.latest[message.get_type()] = message

    def wait(self, is_so, what, seconds=60):
        """Until something is so."""
        end = time.monotonic() + seconds
        while not is_so():
            if time.monotonic() > end:
                raise SystemExit(f"{what} did not come; last heard: {self.texts[-3:]}")
            time.sleep(0.02)

    def command(self, number, *params, seconds=40):
        """COMMAND_LONG until it is accepted: "not yet" is tried again, and the flight controller needs five seconds after its start."""
        values, end = [*params, *[0.0] * (7 - len(params))], time.monotonic() + seconds
        while time.monotonic() < end:
            self.latest.pop("COMMAND_ACK", None)
            self.conn.mav.command_long_send(self.system, 1, number, 0, *values)
            until = time.monotonic() + 1.0
            while time.monotonic() < until:
                ack = self.latest.get("COMMAND_ACK")
                if ack and ack.command == number:
                    if ack.result == mavlink.MAV_RESULT_ACCEPTED:
                        return
                    break
                time.sleep(0.02)
            time.sleep(0.3)
        raise SystemExit(f"command {number} is refused: {self.texts[-3:]}")

    @property
    def position(self):
        """North, east, down of home, m."""
        p = self.latest["LOCAL_POSITION_NED"]
        return p.x, p.y, p.z

    @property
    def is_armed(self):
        return bool(self.latest["HEARTBEAT"].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    def take_off(self, height_m=1.0):
        self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, height_m)
        self.wait(lambda: self.position[2] < 0.1 - height_m, "the take-off")
        time.sleep(1.0)

    def place(self, north, east, down):
        """A place to hold, as an off-board set point; send it a few times a second."""
        self.conn.mav.set_position_target_local_ned_send(
            0, self.system, 1, mavlink.MAV_FRAME_LOCAL_NED, 0b1101_1111_1000, north, east, down, *[NAN] * 8
        )

    def speed(self, forward, right, down, turn):
        """Speeds of the body, m/s, and clockwise turn, rad/s, as an off-board set point."""
        self.conn.mav.set_position_target_local_ned_send(
            0, self.system, 1, mavlink.MAV_FRAME_BODY_FRD, 0b0101_1100_0111, NAN, NAN, NAN, forward, right, down, NAN, NAN, NAN, NAN, turn
        )

    def off_board(self):
        """Set points count from here on; some must have been sent."""
        self.command(mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 6)

    def land(self):
        self.command(mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, NAN, NAN, NAN, NAN)
        self.wait(lambda: not self.is_armed, "the landing")
        print("landed")
