"""A patrol of every room, and its report: rooms visited, way, time, battery, as the vehicle tells them. Needs pymavlink.

    kestrel plan office -o patrol.plan
    kestrel sim office &
    python patrol_report.py patrol.plan [connection]
"""
import json
import sys
import time

from vehicle import NAN, Vehicle, mavlink

items = json.load(open(sys.argv[1]))["mission"]["items"]
vehicle = Vehicle(sys.argv[2] if len(sys.argv) > 2 else "udpout:127.0.0.1:14555")


def upload():
    """The plan's items; the vehicle checks each against the floor plan and says what it does not like."""
    local = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_ENU)
    vehicle.conn.mav.mission_count_send(1, 1, len(items))
    answered = None
    while True:
        ack, request = vehicle.latest.pop("MISSION_ACK", None), vehicle.latest.pop("MISSION_REQUEST_INT", None)
        if ack:
            return ack.type
        if request and request.seq != answered:
            item = items[request.seq]
            *four, x, y, z = [NAN if v is None else v for v in item["params"]]
            scale = 1e4 if item["frame"] in local else 1e7
            x, y = (0 if v != v else round(v * scale) for v in (x, y))
            command = item["command"]
            vehicle.conn.mav.mission_item_int_send(1, 1, request.seq, item["frame"], command, 0, 1, *four, x, y, 0 if z != z else z)
            answered = request.seq
        time.sleep(0.005)


result = upload()
if result != mavlink.MAV_MISSION_ACCEPTED:
    sys.exit(f"the mission was refused: {result}, {vehicle.texts[-2:]}")
vehicle.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
vehicle.command(mavlink.MAV_CMD_MISSION_START, 0, 0)
vehicle.wait(lambda: vehicle.position[2] < -0.5, "the take-off")
shown = 0
while vehicle.is_armed:
    for text in vehicle.texts[shown:]:
        print(text)
    shown = len(vehicle.texts)
    time.sleep(0.1)
print("\n".join(vehicle.texts[shown:]))
print("landed")
