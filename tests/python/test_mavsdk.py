"""Row 7: MAVSDK 4.1.0. Every call succeeds, and its effect is there in the truth.

MAVSDK beats and times out on the wall clock (heartbeat 1 Hz, set points 20 Hz), so these flights run in real time or
twice as fast, where one lost beat is not yet a lost station.
"""

import math
import threading
import time
from contextlib import contextmanager

from kestrel_harness import Kestrel
from rooms import Room
from test_keys import number
from truth import wrap

EARTH_RADIUS_M = 6378137.0


class Drone:
    """A MAVSDK system with its plugins and the vehicle's clock."""

    def __init__(self, kestrel, speed):
        from mavsdk import ComponentType, Configuration, ConnectionResult, Mavsdk
        from mavsdk.plugins.action import Action
        from mavsdk.plugins.manual_control import ManualControl
        from mavsdk.plugins.mission import Mission
        from mavsdk.plugins.offboard import Offboard
        from mavsdk.plugins.param import Param
        from mavsdk.plugins.shell import Shell
        from mavsdk.plugins.telemetry import Telemetry

        self.kestrel, self.speed = kestrel, speed
        self.mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        result = self.mavsdk.add_any_connection(f"udpout://127.0.0.1:{kestrel.ports[0]}")
        assert result == ConnectionResult.SUCCESS, result
        self.system = self.mavsdk.first_autopilot(15.0)
        assert self.system, "MAVSDK found no autopilot"
        self.action, self.telemetry = Action(self.system), Telemetry(self.system)
        self.mission, self.offboard = Mission(self.system), Offboard(self.system)
        self.manual, self.shell, self.param = ManualControl(self.system), Shell(self.system), Param(self.system)

    def close(self):
        for plugin in (self.action, self.telemetry, self.mission, self.offboard, self.manual, self.shell, self.param):
            plugin.destroy()
        self.mavsdk.destroy()

    @property
    def now(self):
        """Vehicle seconds, from the time stamp of the attitude."""
        return self.telemetry.attitude_euler().timestamp_us * 1e-6

    def wait(self, condition, within_s, what):
        """Polls the client; returns the vehicle time."""
        deadline = time.monotonic() + within_s / self.speed + 2.0
        while not condition():
            self.kestrel.check_alive()
            assert time.monotonic() < deadline, f"{what}: not within {within_s} s; {self.describe()}"
            time.sleep(0.05)
        return self.now

    def sleep(self, seconds):
        time.sleep(seconds / self.speed)

    def describe(self):
        place = self.telemetry.position_velocity_ned().position
        mode = self.telemetry.flight_mode()
        return f"mode {getattr(mode, 'name', mode)}, at ({place.north_m:.2f}, {place.east_m:.2f}, {place.down_m:.2f})"

    def place(self):
        p = self.telemetry.position_velocity_ned().position
        return (p.north_m, p.east_m, p.down_m)

    def global_of(self, north, east):
        """Latitude and longitude of a place in local metres."""
        home = self.telemetry.home()
        lat = home.latitude_deg + math.degrees(north / EARTH_RADIUS_M)
        return lat, home.longitude_deg + math.degrees(east / (EARTH_RADIUS_M * math.cos(math.radians(home.latitude_deg))))

    def take_off(self, height_m=1.0):
        self.wait(self.telemetry.health_all_ok, 40.0, f"health_all_ok ({self.telemetry.health()})")
        self.action.set_takeoff_altitude(height_m)
        self.action.arm()
        self.action.takeoff()
        self.wait(self.telemetry.in_air, 10.0, "in_air")
        self.wait(lambda: -self.place()[2] > height_m - 0.15, 15.0, "reaches the take-off height")
        self.wait(lambda: self.telemetry.flight_mode() == 3, 10.0, "flight_mode HOLD after take-off")
        self.sleep(2.0)


@contextmanager
def flight(seed, speed, **options):
    """A simulator with a connected MAVSDK."""
    with Kestrel("office", seed=seed, speed=speed, name=f"mavsdk-seed{seed}", **options) as kestrel:
        drone = Drone(kestrel, speed)
        try:
            yield kestrel, drone
        finally:
            drone.close()


def test_connect_arm_takeoff_goto_hold_shell_land():
    """Health, arm, take-off, go-to, hold, shell, land."""
    replies = []
    with flight(seed=21, speed=1) as (kestrel, drone):
        assert drone.mavsdk.version().lstrip("v").startswith("4.1.0"), drone.mavsdk.version()
        ready = drone.wait(drone.telemetry.health_all_ok, 40.0, f"health_all_ok ({drone.telemetry.health()})")
        health = drone.telemetry.health()
        flags = {k: v for k, v in vars(health).items() if k.startswith("is_")}
        assert all(flags.values()), flags
        drone.action.set_takeoff_altitude(1.2)
        assert abs(drone.action.get_takeoff_altitude() - 1.2) < 1e-6
        drone.action.arm()
        drone.wait(drone.telemetry.armed, 3.0, "armed")
        drone.action.takeoff()
        drone.wait(lambda: -drone.place()[2] > 1.05 and drone.telemetry.flight_mode() == 3, 20.0, "take-off ends in HOLD")
        drone.sleep(3.0)
        risen = drone.now

        lat, lon = drone.global_of(1.0, 1.2)
        home = drone.telemetry.home()
        drone.action.goto_location(lat, lon, home.absolute_altitude_m + 1.0, 90.0)
        drone.wait(lambda: math.dist(drone.place()[:2], (1.0, 1.2)) < 0.15, 20.0, "goes there")
        drone.sleep(4.0)
        arrived = drone.now

        drone.action.hold()
        drone.sleep(1.0)
        holds = drone.now
        drone.sleep(6.0)
        held = drone.now

        drone.shell.subscribe_receive(lambda receive, _: replies.append(text_of(receive)))
        drone.shell.send("status", 10)
        drone.wait(lambda: "".join(replies), 5.0, "the shell answers `status`")
        status = "".join(replies)
        for key in ("m", "8", "8"):
            before = len(replies)
            drone.shell.send(key, 10)
            drone.wait(lambda before=before: "kg" in "".join(replies[before:]), 5.0, f"the shell answers {key!r}")
        heading = number("".join(replies), "yaw")
        pressed = drone.now
        drone.sleep(4.0)
        nudged = drone.now
        drone.shell.send("m", 10)
        drone.sleep(0.5)

        drone.action.land()
        drone.wait(lambda: not drone.telemetry.armed(), 30.0, "lands and disarms")
        drone.wait(lambda: not drone.telemetry.in_air(), 3.0, "in_air becomes false")
    truth = kestrel.truth()
    height = -truth.at(risen).z
    goto = math.dist((truth.at(arrived).x, truth.at(arrived).y, truth.at(arrived).z), (1.0, 1.2, -1.0))
    turned = abs(wrap(truth.at(arrived).yaw - math.pi / 2))
    rest = truth.between(holds, held)
    drift = rest.spread()
    a, b = truth.at(pressed - 0.5), truth.at(nudged)
    forward = (b.x - a.x) * math.cos(heading) + (b.y - a.y) * math.sin(heading)
    landed = math.dist((truth.last.x, truth.last.y), (b.x, b.y))
    figures = (
        f"healthy at {ready:.1f} s, take-off 1.2 m: {height:.2f} m, go-to missed by {goto:.2f} m, hold drift {drift:.2f} m, "
        f"two `8` keys: {forward:.2f} m forward, landed {landed:.2f} m from there"
    )
    assert abs(height - 1.2) < 0.15, figures
    assert goto <= 0.25 and turned < 0.15, f"{figures}, heading off by {turned:.2f} rad"
    assert drift <= 0.2, figures
    assert abs(forward - 0.4) < 0.25, figures
    assert landed < 0.25 and truth.last.z > -0.1 and truth.contacts() == 0, figures
    assert len(status) > 20, status
    return figures


def text_of(receive):
    data = receive.data
    return data.decode(errors="replace") if isinstance(data, bytes) else str(data)


def test_mission_upload_start_progress_finished():
    """A mission through a door and back, with parameters and pause on the way, then return to launch."""
    from mavsdk.plugins.mission import MissionItem, MissionPlan

    room = Room.export("office")
    names = ("lab-corridor", "corridor", "lab-corridor", "lab")
    points = [(*room.place(name), -1.0) for name in names]
    progress = []
    with flight(seed=22, speed=2) as (kestrel, drone):
        drone.param.set_param_float("COM_DL_LOSS_T", 8.0)
        assert abs(drone.param.get_param_float("COM_DL_LOSS_T") - 8.0) < 1e-6
        drone.wait(drone.telemetry.health_all_ok, 40.0, f"health_all_ok ({drone.telemetry.health()})")
        items = []
        for north, east, down in points:
            lat, lon = drone.global_of(north, east)
            items.append(
                MissionItem(
                    latitude_deg=lat,
                    longitude_deg=lon,
                    relative_altitude_m=-down,
                    speed_m_s=0.6,
                    is_fly_through=True,
                    acceptance_radius_m=0.15,  # MAVSDK's own value for fly-through is 3 m: half of the way would count as flown
                )
            )
        drone.mission.subscribe_mission_progress(lambda p, _: progress.append((p.current, p.total)))
        drone.mission.set_return_to_launch_after_mission(False)
        drone.mission.upload_mission(MissionPlan(items))
        back = drone.mission.download_mission()
        assert len(back.mission_items) == len(items)
        for sent, got in zip(items, back.mission_items):
            assert (
                abs(sent.latitude_deg - got.latitude_deg) < 2e-7
                and abs(sent.relative_altitude_m - got.relative_altitude_m) < 1e-3
            )
        drone.action.arm()
        drone.mission.start_mission()
        drone.wait(lambda: drone.telemetry.flight_mode() == 4, 5.0, "flight_mode MISSION")
        drone.wait(lambda: any(current >= 1 for current, _ in progress), 60.0, "first item done")
        drone.mission.pause_mission()
        drone.sleep(2.0)
        paused = drone.now
        drone.sleep(3.0)
        resumed = drone.now
        assert not drone.mission.is_mission_finished()
        drone.mission.start_mission()
        finished = drone.wait(drone.mission.is_mission_finished, 120.0, f"mission finished (progress {progress[-3:]})")
        drone.action.return_to_launch()
        drone.wait(lambda: not drone.telemetry.armed(), 60.0, "returns, lands, disarms")
    truth = kestrel.truth()
    passed = truth.between(0.0, finished + 0.5).passes(points, 0.25)
    rest = truth.between(paused, resumed)
    moved = rest.spread()
    figures = (
        f"way points passed at {' '.join(f'{d:.2f}' for d in passed)} m, moved {moved:.2f} m while paused, "
        f"landing {truth.landing_error():.2f} m, progress {' '.join(f'{c}/{t}' for c, t in dict.fromkeys(progress))}"
    )
    assert max(passed) <= 0.25 and moved <= 0.15 and truth.landing_error() <= 0.3 and truth.contacts() == 0, figures
    steps = [c for c, _ in progress]
    assert steps == sorted(steps) and progress[-1] == (len(items), len(items)), figures
    return figures


def test_offboard_and_manual_control():
    """Position and velocity set points in every frame; sticks with their signs."""
    from mavsdk.plugins.offboard import PositionNedYaw, VelocityBodyYawspeed, VelocityNedYaw

    with flight(seed=23, speed=1) as (kestrel, drone):
        drone.take_off(1.0)
        marks = {}

        drone.offboard.set_position_ned(PositionNedYaw(0.8, -0.9, -1.2, 0.0))
        drone.offboard.start()
        drone.wait(lambda: drone.telemetry.flight_mode() == 7, 3.0, "flight_mode OFFBOARD")
        drone.sleep(8.0)
        marks["position"] = drone.now

        def velocity(name, setpoint, seconds, set_velocity):
            begin = drone.now
            set_velocity(setpoint)
            drone.sleep(seconds)
            marks[name] = (begin, drone.now)
            drone.offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, math.degrees(drone_yaw())))
            drone.sleep(2.0)

        def drone_yaw():
            return math.radians(drone.telemetry.attitude_euler().yaw_deg)

        velocity("south", VelocityNedYaw(-0.4, 0.0, 0.0, 0.0), 3.0, drone.offboard.set_velocity_ned)
        velocity("east and turn", VelocityNedYaw(0.0, 0.4, 0.0, 90.0), 3.0, drone.offboard.set_velocity_ned)
        velocity("up", VelocityNedYaw(0.0, 0.0, -0.2, 90.0), 2.0, drone.offboard.set_velocity_ned)
        velocity("body back", VelocityBodyYawspeed(-0.3, 0.0, 0.0, 0.0), 3.0, drone.offboard.set_velocity_body)
        velocity("body left", VelocityBodyYawspeed(0.0, -0.3, 0.0, 0.0), 2.0, drone.offboard.set_velocity_body)
        velocity("spin", VelocityBodyYawspeed(0.0, 0.0, 0.0, -30.0), 3.0, drone.offboard.set_velocity_body)
        drone.offboard.stop()
        drone.wait(lambda: drone.telemetry.flight_mode() == 3, 3.0, "flight_mode HOLD after off-board")

        lat, lon = drone.global_of(0.0, 0.0)
        home = drone.telemetry.home()
        drone.action.goto_location(lat, lon, home.absolute_altitude_m + 1.0, 0.0)
        drone.sleep(10.0)

        sticks = [0.0, 0.0, 0.5, 0.0]
        running = threading.Event()
        running.set()

        def stream():
            while running.is_set():
                drone.manual.set_manual_control_input(*sticks)
                time.sleep(0.04)

        thread = threading.Thread(target=stream)
        thread.start()
        try:
            time.sleep(0.3)
            drone.manual.start_position_control()
            drone.wait(lambda: drone.telemetry.flight_mode() == 11, 3.0, "flight_mode POSCTL")

            def push(name, x=0.0, y=0.0, z=0.5, r=0.0, seconds=1.5):
                begin = drone.now
                sticks[:] = [x, y, z, r]
                drone.sleep(seconds)
                marks[name] = (begin, drone.now)
                sticks[:] = [0.0, 0.0, 0.5, 0.0]
                drone.sleep(1.5)

            push("stick forward", x=0.5)
            push("stick back", x=-0.5)
            push("stick right", y=0.5)
            push("stick left", y=-0.5)
            push("stick clockwise", r=0.5)
            push("stick counter-clockwise", r=-0.5)
            push("stick up", z=0.8)
            push("stick down", z=0.2)
            begin = drone.now
            drone.sleep(3.0)
            marks["centred"] = (begin, drone.now)
        finally:
            running.clear()
            thread.join()
        drone.action.hold()
        drone.action.land()
        drone.wait(lambda: not drone.telemetry.armed(), 30.0, "lands and disarms")
    truth = kestrel.truth()
    reached = truth.at(marks["position"])
    missed = math.dist((reached.x, reached.y, reached.z), (0.8, -0.9, -1.2))
    assert missed <= 0.25, f"off-board position missed by {missed:.2f} m"
    assert truth.contacts() == 0

    def moved(name):
        """Displacement north, east, up, forward, right (m, of the heading at the start) and turn clockwise (rad)."""
        a, b = (truth.at(t) for t in marks[name])
        north, east = b.x - a.x, b.y - a.y
        forward = north * math.cos(a.yaw) + east * math.sin(a.yaw)
        right = -north * math.sin(a.yaw) + east * math.cos(a.yaw)
        return {"north": north, "east": east, "up": a.z - b.z, "forward": forward, "right": right, "turn": wrap(b.yaw - a.yaw)}

    # (mark, axis that must move at least so much and at most so much, axes that must not move more than 0.2)
    wanted = [
        ("south", "north", -1.4, -0.7, ("east", "up")),
        ("east and turn", "east", 0.7, 1.4, ("north", "up")),
        ("east and turn", "turn", 1.2, 1.9, ()),
        ("up", "up", 0.2, 0.6, ("north", "east")),
        ("body back", "forward", -1.1, -0.5, ("right", "up")),
        ("body left", "right", -0.9, -0.3, ("forward", "up")),
        ("spin", "turn", -1.9, -1.1, ()),
        ("stick forward", "forward", 0.15, 1.6, ("right", "up")),
        ("stick back", "forward", -1.6, -0.15, ("right", "up")),
        ("stick right", "right", 0.15, 1.6, ("forward", "up")),
        ("stick left", "right", -1.6, -0.15, ("forward", "up")),
        ("stick clockwise", "turn", 0.3, 2.5, ()),
        ("stick counter-clockwise", "turn", -2.5, -0.3, ()),
        ("stick up", "up", 0.1, 1.2, ("forward", "right")),
        ("stick down", "up", -1.2, -0.1, ("forward", "right")),
        ("centred", "forward", -0.15, 0.15, ("right", "up")),
    ]
    wrong = []
    for name, axis, least, most, still in wanted:
        motion = moved(name)
        if not least <= motion[axis] <= most or any(abs(motion[other]) > 0.2 for other in still):
            wrong.append(f"{name}: " + ", ".join(f"{k} {v:+.2f}" for k, v in motion.items()))
    assert not wrong, "\n".join(wrong)
    return f"position missed by {missed:.2f} m; " + ", ".join(f"{n} {moved(n)[a]:+.2f}" for n, a, *_ in wanted)
