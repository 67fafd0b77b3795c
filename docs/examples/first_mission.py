"""First mission: take off, fly to one place, come home, land. Needs: pip install pymavlink, and `kestrel` running.

Usage: python first_mission.py [connection]      default udpout:127.0.0.1:14555
"""
import math
import sys
import time

from pymavlink import mavutil

link = sys.argv[1] if len(sys.argv) > 1 else "udpout:127.0.0.1:14555"
vehicle = mavutil.mavlink_connection(link, source_system=255)
mavlink = mavutil.mavlink


def say_hello():
    """A station says once a second that it is there; if it stops, the vehicle lands."""
    vehicle.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)


say_hello()
vehicle.wait_heartbeat()

# Local frame: north and east of home in 1e-4 m, down is negative height. Take-off and return need no place.
items = [
    (mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, 0.0, 0.0, 1.0),
    (mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_FRAME_LOCAL_NED, 2.9, 2.0, -1.0),
    (mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, mavlink.MAV_FRAME_MISSION, 0.0, 0.0, 0.0),
]
vehicle.mav.mission_count_send(1, 1, len(items))
while True:
    message = vehicle.recv_match(type=["MISSION_REQUEST_INT", "MISSION_ACK"], blocking=True, timeout=5)
    if message is None:
        sys.exit("the vehicle does not answer")
    if message.get_type() == "MISSION_ACK":
        if message.type != mavlink.MAV_MISSION_ACCEPTED:
            sys.exit(f"the mission was refused: {message.type}")
        break
    command, frame, x, y, z = items[message.seq]
    vehicle.mav.mission_item_int_send(
        1, 1, message.seq, frame, command, 0, 1, 0, 0, 0, math.nan, int(x * 1e4), int(y * 1e4), z
    )

# The flight controller needs five seconds after start before it lets itself be armed.
while True:
    say_hello()
    vehicle.arducopter_arm()
    ack = vehicle.recv_match(type="COMMAND_ACK", blocking=True, timeout=3)
    if ack and ack.result == mavlink.MAV_RESULT_ACCEPTED:
        break
    time.sleep(1)
vehicle.set_mode("MISSION")

flying = False
while True:
    say_hello()
    state = vehicle.recv_match(type="EXTENDED_SYS_STATE", blocking=True, timeout=3)
    if state is None:
        continue
    flying = flying or state.landed_state != mavlink.MAV_LANDED_STATE_ON_GROUND
    if flying and state.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND:
        break
print("landed")
