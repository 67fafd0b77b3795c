"""MAVSDK with asyncio: take off, fly a metre by set points, come home, land. Needs: pip install mavsdk==4.1.0, and `kestrel` running.

Usage: python mavsdk_async.py [connection]      default udpout://127.0.0.1:14555
"""
import asyncio
import sys

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, PositionNedYaw
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync


async def until(stream, condition):
    """The first value of a stream that satisfies a condition."""
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

        # The flight controller needs five seconds after start before it lets itself be armed.
        await asyncio.wait_for(until(telemetry.subscribe_health_all_ok(), bool), 40)
        await action.set_takeoff_altitude(1.0)
        await action.arm()
        await action.takeoff()
        # The take-off ends in Hold (3), a little below or above the height.
        await asyncio.wait_for(until(telemetry.subscribe_position_velocity_ned(), lambda p: p.position.down_m < -0.85), 20)
        await asyncio.sleep(3)

        # Local metres: north, east, down of home; degrees.
        await offboard.set_position_ned(PositionNedYaw(1.0, 0.5, -1.0, 0.0))
        await offboard.start()
        near = lambda p: abs(p.position.north_m - 1.0) < 0.15 and abs(p.position.east_m - 0.5) < 0.15  # noqa: E731
        await asyncio.wait_for(until(telemetry.subscribe_position_velocity_ned(), near), 20)
        await offboard.stop()

        await action.return_to_launch()
        await asyncio.wait_for(until(telemetry.subscribe_armed(), lambda armed: not armed), 60)
        print("landed")


asyncio.run(main())
