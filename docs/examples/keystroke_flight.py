"""Flies by key strokes over MAVLink's shell (SERIAL_CONTROL), as the pilots of uQuad did. Needs pymavlink, `kestrel` running.

Usage: python keystroke_flight.py [connection [keys ...]]      default udpout:127.0.0.1:14555 8 8 q q e d w w 2 2

m manual mode, 8 2 4 6 a step forward, back, left, right, e d up and down, q w turn, j g y h lean, i k 0 weight, ESC lands.
"""
import sys
import time

from vehicle import Vehicle, mavlink

vehicle = Vehicle(sys.argv[1] if len(sys.argv) > 1 else "udpout:127.0.0.1:14555")
keys = sys.argv[2:] or ["8", "8", "q", "q", "e", "d", "w", "w", "2", "2"]


def press(key):
    """A line of the shell; its answer."""
    vehicle.latest.pop("SERIAL_CONTROL", None)
    data = (key + "\n").encode()
    flags = mavlink.SERIAL_CONTROL_FLAG_RESPOND | mavlink.SERIAL_CONTROL_FLAG_MULTI
    vehicle.conn.mav.serial_control_send(mavlink.SERIAL_CONTROL_DEV_SHELL, flags, 0, 0, len(data), list(data.ljust(70, b"\0")))
    vehicle.wait(lambda: "SERIAL_CONTROL" in vehicle.latest, f"an answer to {key!r}", 5)
    answer = vehicle.latest["SERIAL_CONTROL"]
    return bytes(answer.data[: answer.count]).decode().strip()


vehicle.take_off(1.0)
print(press("m"))
for key in keys:
    print(f"{key}  {press(key)}")
    time.sleep(0.5)
time.sleep(2.0)
print("at north %.2f, east %.2f, down %.2f" % vehicle.position)
press("m")
vehicle.land()
