"""A square by set points in the body's own frame: forward and a quarter turn, four times. Needs: pip install pymavlink, `kestrel` running.

Usage: python offboard_square.py [connection]      default udpout:127.0.0.1:14555
"""
import math
import os
import sys
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402 - the dialect is chosen by the environment

link = sys.argv[1] if len(sys.argv) > 1 else "udpout:127.0.0.1:14555"
vehicle = mavutil.mavlink_connection(link, source_system=255)
mavlink = mavutil.mavlink
nan = math.nan


def beat():
    vehicle.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)


def command(number, *params):
    """COMMAND_LONG until it is accepted; a refusal is tried again."""
    values = list(params) + [0.0] * (7 - len(params))
    while True:
        beat()
        vehicle.mav.command_long_send(1, 1, number, 0, *values)
        ack = vehicle.recv_match(type="COMMAND_ACK", blocking=True, timeout=3)
        if ack and ack.command == number and ack.result == mavlink.MAV_RESULT_ACCEPTED:
            return
        time.sleep(0.5)


def stream(seconds, mask, x=nan, y=nan, z=nan, vx=nan, vy=nan, vz=nan, yaw=nan, rate=nan):
    """A set point twenty times a second: the vehicle holds when they stop. Frame 12: forward, right, down of where it is."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        beat()
        vehicle.mav.set_position_target_local_ned_send(
            0, 1, 1, mavlink.MAV_FRAME_BODY_FRD, mask, x, y, z, vx, vy, vz, nan, nan, nan, yaw, rate
        )
        vehicle.recv_match(blocking=False)
        time.sleep(0.05)


beat()
vehicle.wait_heartbeat()
command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, 1.0)
# Bits say what to ignore: speed alone leaves 3, 4, 5 clear; a place alone 0, 1, 2.
SPEED, PLACE, TURN = 0b1101_1100_0111, 0b1101_1111_1000, 0b1001_1111_1111
stream(8, SPEED, vx=0, vy=0, vz=0)
vehicle.set_mode("OFFBOARD")
for _ in range(4):
    stream(4, PLACE, x=0.6, y=0.0, z=0.0)
    stream(3, TURN, yaw=math.pi / 2)
command(mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, nan, nan, nan, nan)
while True:
    beat()
    state = vehicle.recv_match(type="HEARTBEAT", blocking=True, timeout=3)
    if state and state.get_srcComponent() == 1 and not state.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED:
        break
print("landed")
