"""Row 2: off-board set points in every frame and mask, by what the vehicle then did in truth."""

import math
import time

from kestrel_harness import Kestrel
from station import NAN, mav
from truth import wrap

POSITION, VELOCITY, ACCELERATION, FORCE, YAW, YAW_RATE = 0b111, 0b111000, 0b111000000, 0x200, 0x400, 0x800
ALL = POSITION | VELOCITY | ACCELERATION | YAW | YAW_RATE


def only(*bits):
    """A type_mask that uses these and ignores the rest."""
    mask = ALL
    for bit in bits:
        mask &= ~bit
    return mask


class Stream:
    """Set points at 25 Hz of wall time while vehicle time goes by."""

    def __init__(self, station, marks):
        self.station, self.marks = station, marks

    def _run(self, name, seconds, send):
        begin = self.station.now
        for _ in self.station.ticks(seconds):
            with self.station.sending() as out:
                send(out)
            time.sleep(0.02)
        self.marks[name] = (begin, self.station.now)

    def local(self, name, seconds, frame, mask, position=(0, 0, 0), velocity=(0, 0, 0), yaw=0.0, rate=0.0):
        """SET_POSITION_TARGET_LOCAL_NED; ignored fields are NaN, as careful programs send them."""
        pick = lambda values, bits: [v if not mask & (bits & -bits) << i else NAN for i, v in enumerate(values)]  # noqa: E731
        p, v = pick(position, POSITION), pick(velocity, VELOCITY)
        y, r = (NAN if mask & YAW else yaw), (NAN if mask & YAW_RATE else rate)
        self._run(name, seconds, lambda out: out.set_position_target_local_ned_send(0, 1, 1, frame, mask, *p, *v, NAN, NAN, NAN, y, r))

    def globally(self, name, seconds, frame, mask, lat, lon, alt, velocity=(0, 0, 0), yaw=0.0):
        self._run(
            name, seconds,
            lambda out: out.set_position_target_global_int_send(0, 1, 1, frame, mask, lat, lon, alt, *velocity, 0, 0, 0, yaw, 0),
        )  # fmt: skip

    def attitude(self, name, seconds, roll, pitch, yaw, thrust, mask=0b111, rate=0.0):
        q = quaternion(roll, pitch, yaw)
        self._run(name, seconds, lambda out: out.set_attitude_target_send(0, 1, 1, mask, q, 0, 0, rate, thrust))


def quaternion(roll, pitch, yaw):
    cr, sr, cp, sp, cy, sy = (f(a / 2) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy]


def test_every_frame_and_mask_of_set_position_target_moves_as_it_says():
    """Frames 1, 7, 8, 9, 12 with positions, single axes, velocities, heights, headings and turn rates; GLOBAL_INT in its frames."""
    marks, goals = {}, {}
    with Kestrel("office", seed=61, speed=3, name="setpoints") as kestrel:
        station = kestrel.station()
        station.take_off(1.0)
        stream = Stream(station, marks)
        home = (0.6, -0.4, -1.2)
        stream.local("enter", 0.6, 1, only(POSITION, YAW), home)
        station.set_mode("OFFBOARD")
        stream.local("frame 1 position yaw", 7, 1, only(POSITION, YAW), home, yaw=0.0)
        goals["frame 1 position yaw"] = (*home, 0.0)
        stream.local("frame 1 position velocity", 6, 1, only(POSITION, VELOCITY), (0.2, 0.2, -1.0), (0.3, 0.0, 0.0))
        goals["frame 1 position velocity"] = (0.2, 0.2, -1.0, None)
        stream.local("frame 1 x alone", 5, 1, only(0b001), (0.7, 0, 0))
        goals["frame 1 x alone"] = (0.7, 0.2, -1.0, None)
        stream.local("frame 1 z alone, velocity", 3, 1, only(0b100, 0b011000), (0, 0, -1.3), (-0.2, 0.0, 0.0))
        stream.local("frame 1 position rate", 5, 1, only(POSITION, YAW_RATE), (0.2, 0.0, -1.1), rate=0.3)
        stream.local("back 1", 5, 1, only(POSITION, YAW), (0.0, 0.0, -1.1), yaw=math.pi / 2)
        goals["back 1"] = (0.0, 0.0, -1.1, math.pi / 2)
        stream.local("frame 7 offset", 6, 7, only(POSITION, YAW), (0.5, -0.3, -0.2), yaw=math.pi / 2)
        stream.local("frame 8 offset", 6, 8, only(POSITION), (0.4, 0.0, 0.0))
        stream.local("frame 9 offset", 6, 9, only(POSITION), (0.0, 0.4, 0.2))
        stream.local("frame 12 offset", 6, 12, only(POSITION, YAW), (-0.4, 0.0, 0.0), yaw=-math.pi / 2)
        stream.local("still", 1.5, 1, only(VELOCITY))
        for frame in (1, 7, 8, 9, 12):
            stream.local(f"frame {frame} velocity", 2.5, frame, only(VELOCITY), velocity=(0.25, 0.0, 0.0))
            stream.local(f"frame {frame} velocity back", 2.5, frame, only(VELOCITY), velocity=(-0.25, 0.0, 0.0))
            stream.local("still", 1.0, frame, only(VELOCITY))
        stream.local("climb", 1.5, 1, only(VELOCITY), velocity=(0.0, 0.0, -0.2))
        stream.local("still", 1.0, 1, only(VELOCITY))
        stream.local("yaw alone", 5, 1, only(YAW), yaw=0.0)
        stream.local("rate alone", 3, 1, only(YAW_RATE), rate=0.4)
        stream.local("still", 1.5, 1, only(VELOCITY))
        # What nobody can follow: refused in words, and the mode is left for want of a stream.
        stream.local("force", 0.3, 1, only(POSITION) | FORCE, (5.0, 5.0, -1.0))
        station.sleep(2.2)  # complaints come every 2 s at most
        stream.local("nothing", 0.3, 1, ALL, (5.0, 5.0, -1.0))
        station.sleep(2.2)
        stream.local("acceleration", 0.3, 1, only(ACCELERATION))
        station.sleep(2.2)
        stream.local("mixed", 0.3, 1, only(0b001, 0b010000), (5.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        station.wait_for(lambda: station.mode == "LOITER", 4.0, "Hold when the stream says nothing")
        assert station.has_said("force") and station.has_said("neither position") and station.has_said("together")
        for frame in (0, 5, 3, 6, 11):
            lat, lon, _ = station.to_global(0.4 if frame in (0, 3, 11) else -0.2, 0.3, -1.0)
            name = f"global {frame}"
            arguments = (frame, only(POSITION, YAW), round(lat * 1e7), round(lon * 1e7), 1.0 + 0.05 * frame)
            stream.globally("enter", 0.5, *arguments)
            if station.mode != "OFFBOARD":
                station.set_mode("OFFBOARD")
            stream.globally(name, 5, *arguments)
            goals[name] = (0.4 if frame in (0, 3, 11) else -0.2, 0.3, -1.0 - 0.05 * frame, 0.0)
        station.set_mode("LOITER")
        station.land()
    truth = kestrel.truth()
    wrong, lines = [], []

    def judge(name, is_right, figure):
        lines.append(f"{name} {figure}")
        if not is_right:
            wrong.append(f"{name}: {figure}")

    for name, (x, y, z, yaw) in goals.items():
        s = truth.at(marks[name][1])
        miss = math.dist((s.x, s.y, s.z), (x, y, z))
        turn = 0.0 if yaw is None else abs(wrap(s.yaw - yaw))
        judge(name, miss < 0.2 and turn < 0.15, f"{miss:.2f} m {turn:.2f} rad off")

    def moved(name):
        a, b = (truth.at(t) for t in marks[name])
        north, east = b.x - a.x, b.y - a.y
        forward = north * math.cos(a.yaw) + east * math.sin(a.yaw)
        right = -north * math.sin(a.yaw) + east * math.cos(a.yaw)
        return {"north": north, "east": east, "up": a.z - b.z, "forward": forward, "right": right, "turn": wrap(b.yaw - a.yaw)}

    wanted = [
        ("frame 1 z alone, velocity", {"north": (-0.9, -0.3), "east": (-0.15, 0.15), "up": (0.15, 0.4)}),
        ("frame 1 position rate", {"turn": (0.9, 1.7)}),
        ("frame 7 offset", {"north": (0.35, 0.65), "east": (-0.45, -0.15), "up": (0.1, 0.3)}),
        ("frame 8 offset", {"forward": (0.25, 0.55), "right": (-0.15, 0.15), "up": (-0.1, 0.1)}),
        ("frame 9 offset", {"forward": (-0.15, 0.15), "right": (0.25, 0.55), "up": (-0.3, -0.1)}),
        ("frame 12 offset", {"forward": (-0.55, -0.25), "right": (-0.2, 0.2), "turn": (-1.75, -1.4)}),
        ("climb", {"up": (0.1, 0.5), "north": (-0.15, 0.15), "east": (-0.15, 0.15)}),
        ("yaw alone", {"north": (-0.15, 0.15), "east": (-0.15, 0.15)}),
        ("rate alone", {"turn": (0.7, 1.5), "north": (-0.15, 0.15), "east": (-0.15, 0.15)}),
    ]
    for frame in (1, 7, 8, 9, 12):
        along, across = ("forward", "right") if frame in (8, 9, 12) else ("north", "east")
        for name, sign in ((f"frame {frame} velocity", 1), (f"frame {frame} velocity back", -1)):
            low, high = sorted((0.3 * sign, 0.8 * sign))
            wanted.append((name, {along: (low, high), across: (-0.2, 0.2), "up": (-0.15, 0.15)}))
    for name, bounds in wanted:
        m = moved(name)
        is_right = all(low <= m[axis] <= high for axis, (low, high) in bounds.items())
        judge(name, is_right, " ".join(f"{axis} {m[axis]:+.2f}" for axis in bounds))
    a, b = truth.at(marks["force"][0]), truth.at(marks["mixed"][1])
    judge("refused masks", math.dist((a.x, a.y, a.z), (b.x, b.y, b.z)) < 0.15, "moved nothing")
    assert not wrong, "\n".join(wrong)
    assert truth.contacts() == 0
    return f"{len(lines)} cases: " + ", ".join(lines)


def test_attitude_targets_tilt_turn_and_carry():
    """SET_ATTITUDE_TARGET: roll, pitch, yaw, yaw rate with a thrust that carries; refusals in words."""
    marks = {}
    with Kestrel("office", seed=62, speed=1, name="attitude") as kestrel:
        station = kestrel.station()
        station.take_off(1.6)
        station.ask_interval(83, 10)
        # What carries on average: a moment's thrust lets it sink or climb.
        thrusts = [station.next("ATTITUDE_TARGET").thrust for _ in range(30)]
        hover = sum(thrusts) / len(thrusts)
        yaw = station.latest["ATTITUDE"].yaw
        stream = Stream(station, marks)
        stream.attitude("enter", 0.5, 0, 0, yaw, hover)
        station.set_mode("OFFBOARD")
        stream.attitude("roll right", 0.6, 0.12, 0, yaw, hover)
        stream.attitude("roll left", 0.9, -0.12, 0, yaw, hover)
        stream.attitude("level", 0.5, 0.06, 0, yaw, hover)
        station.set_mode("LOITER")
        station.sleep(3.0)
        stream.attitude("enter", 0.5, 0, 0, yaw, hover)
        station.set_mode("OFFBOARD")
        stream.attitude("nose down", 0.6, 0, -0.12, yaw, hover)
        stream.attitude("nose up", 0.9, 0, 0.12, yaw, hover)
        station.set_mode("LOITER")
        station.sleep(3.0)
        stream.attitude("enter", 0.5, 0, 0, yaw, hover)
        station.set_mode("OFFBOARD")
        stream.attitude("by rate", 1.5, 0, 0, 0, hover, mask=0b011, rate=0.6)
        station.set_mode("LOITER")
        for mask, thrust in ((128, 0.5), (0b111 | 64, 0.5), (0b111, 1.5)):
            stream.attitude("refused", 0.1, 0, 0, 0, thrust, mask=mask)
            station.sleep(2.2)
        assert station.has_said("body rates") and station.has_said("no thrust") and station.has_said("outside 0..1")
        station.land()
    truth = kestrel.truth()

    def moved(name):
        a, b = (truth.at(t) for t in (marks[name][0], marks[name][1] + 0.1))
        north, east = b.x - a.x, b.y - a.y
        return (
            north * math.cos(a.yaw) + east * math.sin(a.yaw),
            -north * math.sin(a.yaw) + east * math.cos(a.yaw),
            wrap(b.yaw - a.yaw),
        )

    right, forward, turn = moved("roll right")[1], moved("nose down")[0], moved("by rate")[2]
    figures = f"hover thrust {hover:.2f}; 0.12 rad for 0.6 s: {right:.2f} m right, {forward:.2f} m forward; 0.6 rad/s for 1.5 s: {turn:.2f} rad"
    assert 0.03 < right < 0.6 and 0.03 < forward < 0.6 and 0.4 < turn < 1.4, figures
    assert truth.contacts() == 0, figures
    return figures
