"""MAVSDK: a search pattern of parallel tracks over a rectangle, then home. Needs: pip install mavsdk==4.1.0, and `kestrel` running.

Usage: python mavsdk_search.py [connection]      default udpout://127.0.0.1:14555
"""
import asyncio
import math
import sys

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, PositionNedYaw
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

# The rectangle, north and east of home in metres, and the distance between the tracks.
SOUTH, NORTH, WEST, EAST, SWATH, DOWN = -0.6, 1.2, -0.6, 0.6, 0.6, -1.0


def tracks():
    """Ends of the tracks, there and back."""
    n = round((EAST - WEST) / SWATH) + 1
    for k in range(n):
        east = WEST + k * SWATH
        ends = [(SOUTH, east), (NORTH, east)]
        yield from ends if k % 2 == 0 else reversed(ends)


async def until(stream, condition):
    async for value in stream:
        if condition(value):
            return value


async def main():
    link = sys.argv[1] if len(sys.argv) > 1 else "udpout://127.0.0.1:14555"
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        await mavsdk.add_any_connection(link)
        system = await mavsdk.first_autopilot(15.0)
        if system is None:
            sys.exit("no vehicle")
        action, telemetry, offboard = ActionAsync(system), TelemetryAsync(system), OffboardAsync(system)
        await asyncio.wait_for(until(telemetry.subscribe_health_all_ok(), bool), 40)
        await action.set_takeoff_altitude(-DOWN)
        await action.arm()
        await action.takeoff()
        await asyncio.wait_for(until(telemetry.subscribe_position_velocity_ned(), lambda p: p.position.down_m < 0.15 + DOWN), 20)
        await asyncio.sleep(2)
        begun = False
        for north, east in tracks():
            await offboard.set_position_ned(PositionNedYaw(north, east, DOWN, 0.0))
            if not begun:
                await offboard.start()
                begun = True

            def is_there(p, north=north, east=east):
                return math.hypot(p.position.north_m - north, p.position.east_m - east) < 0.15

            await asyncio.wait_for(until(telemetry.subscribe_position_velocity_ned(), is_there), 25)
            print(f"searched to north {north:.1f}, east {east:.1f}")
        await offboard.stop()
        await action.return_to_launch()
        await asyncio.wait_for(until(telemetry.subscribe_armed(), lambda armed: not armed), 60)
        print("landed")


asyncio.run(main())
