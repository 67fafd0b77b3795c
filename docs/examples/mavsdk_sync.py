"""MAVSDK without asyncio: a parameter, take off, one place, land. Needs: pip install mavsdk==4.1.0, and `kestrel` running.

Usage: python mavsdk_sync.py [connection]      default udpout://127.0.0.1:14555
"""
import math
import sys
import time

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

link = sys.argv[1] if len(sys.argv) > 1 else "udpout://127.0.0.1:14555"
mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
mavsdk.add_any_connection(link)
system = mavsdk.first_autopilot(15.0)
if system is None:
    sys.exit("no vehicle")
action, param, telemetry = Action(system), Param(system), Telemetry(system)


def wait(condition, seconds, what):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            sys.exit(f"not within {seconds} s: {what}")
        time.sleep(0.05)


wait(telemetry.health_all_ok, 40, "healthy")
param.set_param_float("MIS_TAKEOFF_ALT", 1.1)
action.arm()
action.takeoff()
wait(lambda: telemetry.position_velocity_ned().position.down_m < -0.95, 20, "at height")
time.sleep(3)

# One metre north and 0.8 m east of home, as latitude and longitude about home.
home = telemetry.home()
lat = home.latitude_deg + math.degrees(1.0 / 6378137.0)
lon = home.longitude_deg + math.degrees(0.8 / (6378137.0 * math.cos(math.radians(home.latitude_deg))))
action.goto_location(lat, lon, home.absolute_altitude_m + 1.1, 90.0)
place = lambda: telemetry.position_velocity_ned().position  # noqa: E731
wait(lambda: math.dist((place().north_m, place().east_m), (1.0, 0.8)) < 0.15, 20, "there")

action.land()
wait(lambda: not telemetry.armed(), 40, "landed")
print("landed")
# MAVSDK's threads outlive the script unless told.
for plugin in (action, param, telemetry):
    plugin.destroy()
mavsdk.destroy()
