"""Follows the wall on its right by off-board speeds and OBSTACLE_DISTANCE, 0.8 m off. Needs pymavlink, `kestrel` running.

Usage: python follow_wall.py [connection [seconds]]      default udpout:127.0.0.1:14555 20
"""
import sys
import time

from vehicle import Vehicle

vehicle = Vehicle(sys.argv[1] if len(sys.argv) > 1 else "udpout:127.0.0.1:14555")
seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 20.0
OFF_M, AHEAD_M = 0.8, 1.0


def nearest(begin_deg, end_deg):
    """Nearest wall between two bearings, degrees to the right, m: bin i of 72 looks 5 i degrees to the right."""
    bins = vehicle.latest["OBSTACLE_DISTANCE"].distances
    seen = [bins[(deg // 5) % 72] for deg in range(begin_deg, end_deg + 1, 5)]
    known = [cm for cm in seen if cm != 65535]
    return min(known, default=400) / 100


vehicle.take_off(1.0)
vehicle.wait(lambda: "OBSTACLE_DISTANCE" in vehicle.latest, "OBSTACLE_DISTANCE")
offsets, end, begun, found = [], time.monotonic() + seconds, False, False
while time.monotonic() < end:
    ahead, beside, behind = nearest(-20, 20), nearest(60, 90), nearest(90, 120)
    found = found or beside < 1.4 * OFF_M
    if ahead < AHEAD_M:
        forward, turn = 0.0, -0.6  # a corner, or the wall at last: to the left
    elif not found:
        forward, turn = 0.35, 0.0  # straight on until there is a wall
    else:
        # Too far off: to the right; nose away from the wall (nearer behind than before the beam): to the right too.
        turn = max(-0.6, min(0.6, 0.7 * (min(beside, 1.6) - OFF_M) + 0.8 * (min(beside, 1.6) - min(behind, 1.6))))
        forward = 0.35
    vehicle.speed(forward, 0.0, 0.0, turn)
    if found:
        offsets.append(beside)
    if not begun:
        vehicle.off_board()
        begun = True
    time.sleep(0.05)
offsets.sort()
print(f"beside the wall at {offsets[len(offsets) // 2]:.2f} m (median)" if offsets else "no wall was found")
vehicle.land()
