"""Row 9: every key of the key console, in the framings of QGroundControl, MAVProxy and MAVSDK.

Key table (uQuad, seed of the project): `m` manual mode; `j g` roll right + -; `y h` nose down + -; `q w` counter-clockwise
+ -, 0.045 rad each; `e d` height + - 0.2 m; `i k` mass + - 0.05 kg, `0` its default; `8 2 4 6` nudge the hover 0.2 m
forward, back, left, right; lone ENTER a marker; lone ESC lands.
"""

import math
import os
import pty
import re
import select
import time
from contextlib import contextmanager

from kestrel_harness import Kestrel, binary
from station import mav
from truth import wrap

SHELL = mav.SERIAL_CONTROL_DEV_SHELL
RESPOND, EXCLUSIVE, MULTI = 2, 4, 16
ANGLE, HEIGHT, NUDGE, MASS = 0.045, 0.2, 0.2, 0.05


class Console:
    """The shell of one station, framed as one of the three clients frames it."""

    # End of line, flags, whether it polls with empty requests.
    FRAMINGS = {
        "QGroundControl": ("\n", RESPOND | EXCLUSIVE | MULTI, False),
        "MAVProxy": ("\r\n", RESPOND | EXCLUSIVE | MULTI, True),
        "MAVSDK": ("\n", RESPOND, False),  # as 4.1.0 sends with a subscription; it shows every reply that comes
        "MAVSDK without subscription": ("\n", 0, False),
    }

    def __init__(self, station, framing):
        self.station = station
        self.end, self.flags, self.polls = self.FRAMINGS[framing]

    def send(self, text):
        """Bytes as they are, in pieces of at most 70."""
        data = text.encode()
        for i in range(0, len(data), 70):
            self._transmit(data[i : i + 70])

    def _transmit(self, piece):
        with self.station.sending() as out:
            out.serial_control_send(SHELL, self.flags, 0, 0, len(piece), list(piece.ljust(70, b"\0")))

    def line(self, text, answer=True):
        """A line and the reply to it."""
        reply = ""
        with self.station.listen("SERIAL_CONTROL", when=lambda m: m.device == SHELL) as mailbox:
            self.send(text + self.end)
            quiet, polled = time.monotonic(), 0.0
            for _ in self.station.ticks(3.0 if answer else 1.0):
                if self.polls and time.monotonic() - polled > 0.05:
                    self._transmit(b"")
                    polled = time.monotonic()
                while not mailbox.empty():
                    message = mailbox.get()
                    assert message.flags & 1, f"reply without the REPLY flag: {message}"
                    assert message.count <= 70
                    reply += bytes(message.data[: message.count]).decode("ascii")
                    quiet = time.monotonic()
                if reply and time.monotonic() - quiet > 0.2:
                    break
                time.sleep(0.01)
        assert reply or not answer, f"no reply to {text!r}"
        return reply


def number(reply, label):
    """The last number after a label in a reply: a line of several keys is answered key by key."""
    found = re.findall(rf"\b{label}\s*[:=]?\s*([-+]?\d+(?:\.\d+)?)", reply, re.IGNORECASE)
    assert found, f"no number after {label!r} in {reply!r}"
    return float(found[-1])


class Pilot:
    """Presses keys and watches set point and truth marks."""

    def __init__(self, station, framing):
        self.station, self.console = station, Console(station, framing)
        station.ask_interval(mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED, 20)

    def setpoint(self):
        """Position of the set point, as POSITION_TARGET_LOCAL_NED says it now."""
        self.station.sleep(0.2)
        target = self.station.next("POSITION_TARGET_LOCAL_NED")
        return (target.x, target.y, target.z)

    def press(self, key):
        """A key; returns position set point before and after, and the reply."""
        before = self.setpoint()
        reply = self.console.line(key)
        return before, self.setpoint(), reply

    def yaw(self):
        """Heading set point, from the reply to a key that changes nothing while the mass is the default one. (In the air
        the nose may look around a person: what POSITION_TARGET_LOCAL_NED says of the heading is not only the keys'.)"""
        return number(self.console.line("0"), "yaw")


def close(a, b, tolerance=2e-3):
    return abs(a - b) <= tolerance


def is_same_place(before, after):
    """The hover position is the same."""
    return all(close(a, b) for a, b in zip(before, after))


def expect_step(pilot, key, *, forward=0.0, right=0.0, up=0.0, turn=0.0):
    """The set point changes by exactly this, and the reply shows it."""
    yaw = pilot.yaw()
    before, after, reply = pilot.press(key)
    north, east = after[0] - before[0], after[1] - before[1]
    got = {
        "forward": north * math.cos(yaw) + east * math.sin(yaw),
        "right": -north * math.sin(yaw) + east * math.cos(yaw),
        "up": before[2] - after[2],
        "turn": wrap(number(reply, "yaw") - yaw),
    }
    wanted = {"forward": forward, "right": right, "up": up, "turn": turn}
    assert all(close(got[k], wanted[k]) for k in wanted), f"key {key!r}: set point changed by {got}, wanted {wanted}"
    shown = (number(reply, "x"), number(reply, "y"), -number(reply, "height"))
    assert math.dist(shown, after) < 0.02, f"key {key!r}: the reply {reply!r} shows another set point than {after}"


@contextmanager
def hovering(framing, seed):
    """A hovering vehicle and a pilot."""
    with Kestrel("office", seed=seed, speed=2, name="keys") as kestrel:
        station = kestrel.station()
        station.take_off(1.0)
        yield kestrel, station, Pilot(station, framing)


def fly_keys(framing, seed):
    """All keys in one flight."""
    # (what, begin, end, heading, axis, least, most): the set point is exact, the truth wanders with the estimate (0.1 m).
    moves = []
    with hovering(framing, seed) as (kestrel, station, pilot):
        console = pilot.console

        # Off: ignored, with a word about it.
        for key in ("8", "j", "e", "i"):
            before, after, reply = pilot.press(key)
            assert is_same_place(before, after), f"{key!r} moved the set point while manual mode is off: {before} became {after}"
            assert "manual" in reply.lower() or "'m'" in reply, f"no word about manual mode: {reply!r}"

        reply = console.line("m")
        assert "on" in reply.lower(), reply
        begin, heading = station.now, number(reply, "yaw")

        def flown(what, axis, least, most, seconds=4.0):
            nonlocal begin
            station.sleep(seconds)
            moves.append((what, begin, station.now, heading, axis, least, most))
            begin = station.now

        # Nudges: exact step, then two more in one line.
        for key, axis, sign in (("8", "forward", 1), ("2", "forward", -1), ("6", "right", 1), ("4", "right", -1)):
            expect_step(pilot, key, **{axis: sign * NUDGE})
            console.line(key * 2)
            flown(key * 3, axis, *sorted((sign * 0.35, sign * 0.85)))
        # Height.
        for key, sign in (("e", 1), ("d", -1)):
            expect_step(pilot, key, up=sign * HEIGHT)
            console.line(key)
            flown(key * 2, "up", *sorted((sign * 0.28, sign * 0.52)))
        # Yaw: + is counter-clockwise, against the heading.
        for key, sign in (("q", -1), ("w", 1)):
            expect_step(pilot, key, turn=sign * ANGLE)
            console.line(key * 5)
            flown(key * 6, "turn", *sorted((sign * 0.17, sign * 0.37)))

        # Tilt: the set point steps by 0.045 rad, height is held, the vehicle goes that way and stops when level again.
        for key, undo, axis, label, sign in (
            ("j", "g", "right", "roll", 1),
            ("g", "j", "right", "roll", -1),
            ("y", "h", "forward", "nose[ -]down", 1),
            ("h", "y", "forward", "nose[ -]down", -1),
        ):
            step = 1 if key in "jy" else -1
            value = number(console.line(key), label)
            assert close(value, step * ANGLE, 6e-4), f"{key!r}: {label} is {value}, wanted {step * ANGLE}"
            flown(key, axis, *sorted((sign * 0.15, sign * 1.5)), seconds=1.5)
            value = number(console.line(undo), label)
            assert close(value, 0.0, 6e-4), f"{undo!r} after {key!r}: {label} is {value}, wanted 0"
            station.sleep(3.0)
            begin = station.now
        # Two keys add up, and a latched tilt keeps below a speed at which it can stop.
        value = number(console.line("jj"), "roll")
        assert close(value, 2 * ANGLE, 6e-4), value
        console.line("gg")
        station.sleep(3.0)

        # Mass of the thrust model.
        mass = number(console.line("0"), "mass")
        assert close(number(console.line("i"), "mass"), mass + MASS), "i"
        assert close(number(console.line("kk"), "mass"), mass - MASS), "kk"
        assert close(number(console.line("0"), "mass"), mass), "0"

        # Lines: a word is the word; an unknown letter refuses the whole line; escape sequences and ENTER move nothing.
        before = pilot.setpoint()
        for line in ("8x8", "88?", "\x1b[A", ""):
            console.line(line, answer=False)
        after = pilot.setpoint()
        assert is_same_place(before, after), f"{before} became {after}"
        assert "status" in console.line("help").lower()
        assert len(console.line("status")) > 20
        # Half a line is no line until its end comes.
        console.send("8")
        station.sleep(1.0)
        assert is_same_place(before, pilot.setpoint()), "half a line was executed"
        console.line("")
        assert close(math.dist(before, pilot.setpoint()), NUDGE), "the half line was lost"
        console.line("2")
        # Words.
        assert "1" in console.line("param get MIS_TAKEOFF_ALT")

        reply = console.line("m")
        assert "off" in reply.lower(), reply
        before, after, reply = pilot.press("8")
        assert is_same_place(before, after), "8 counted after manual mode was switched off"

        console.line("\x1b", answer=False)
        station.wait_for(lambda: station.mode == "LAND", 3.0, "ESC lands")
        station.wait_disarmed(30.0)
    truth = kestrel.truth()
    wrong, shown = [], []
    for what, start, end, heading, axis, least, most in moves:
        a, b = truth.at(start), truth.at(end)
        north, east = b.x - a.x, b.y - a.y
        motion = {
            "forward": north * math.cos(heading) + east * math.sin(heading),
            "right": -north * math.sin(heading) + east * math.cos(heading),
            "up": a.z - b.z,
            "turn": wrap(b.yaw - a.yaw),
        }
        shown.append(f"{what} {motion[axis]:+.2f}")
        still = [k for k in ("forward", "right", "up") if k != axis and abs(motion[k]) > 0.2]
        if not least <= motion[axis] <= most or still:
            wrong.append(
                f"{what}: wanted {axis} {least:+.2f}..{most:+.2f}, got " + ", ".join(f"{k} {v:+.2f}" for k, v in motion.items())
            )
    assert not wrong, "\n".join(wrong)
    assert truth.contacts() == 0
    return ", ".join(shown)


def test_every_key_as_qgroundcontrol_sends_it():
    return fly_keys("QGroundControl", 41)


def test_every_key_as_mavproxy_sends_it():
    return fly_keys("MAVProxy", 42)


def test_every_key_as_mavsdk_sends_it():
    return fly_keys("MAVSDK", 43)


def test_keys_without_asking_for_replies():
    """Flags 0, as MAVSDK's shell sends without a subscription: the key counts all the same."""
    with hovering("MAVSDK without subscription", 44) as (kestrel, station, pilot):
        pilot.console.line("m", answer=False)
        before = pilot.setpoint()
        pilot.console.line("8", answer=False)
        after = pilot.setpoint()
        assert close(math.dist(before[:2], after[:2]), NUDGE), f"{before} became {after}"
        station.land()


def test_keys_on_the_ground():
    """Manual mode needs a flying vehicle; ESC on the ground disarms."""
    with Kestrel("office", seed=45, speed=2, name="keys-ground") as kestrel:
        station = kestrel.station()
        station.wait_ready()
        console = Console(station, "QGroundControl")
        reply = console.line("m")
        assert "fly" in reply.lower(), reply
        station.arm()
        console.line("\x1b", answer=False)
        station.wait_for(lambda: not station.is_armed, 3.0, "ESC disarms on the ground")
    return reply.strip().splitlines()[0]


def test_shell_words_fly():
    """`arm`, `takeoff`, `hold`, `land` typed at the console."""
    with Kestrel("office", seed=46, speed=4, name="shell") as kestrel:
        station = kestrel.station()
        station.wait_ready()
        console = Console(station, "QGroundControl")
        console.line("param set MIS_TAKEOFF_ALT 1.3")
        assert close(station.param("MIS_TAKEOFF_ALT"), 1.3, 1e-6)
        console.line("arm")
        station.wait_for(lambda: station.is_armed, 3.0, "armed")
        console.line("takeoff")
        station.wait_for(lambda: -station.position[2] > 1.15 and station.mode == "LOITER", 20.0, "takes off")
        station.sleep(2.0)
        risen = station.now
        console.line("hold")
        console.line("land")
        station.wait_disarmed(40.0)
    height = -kestrel.truth().at(risen).z
    assert abs(height - 1.3) < 0.15, height
    return f"{height:.2f} m high"


class Typist:
    """`kestrel mav keys` on a pseudo terminal: what a person types, and what he reads."""

    def __init__(self, port):
        self.pid, self.fd = pty.fork()
        if self.pid == 0:
            os.execv(binary(), ["kestrel", "mav", "--to", f"udpclient://127.0.0.1:{port}", "keys"])
        assert "Ctrl-D ends" in self.read(10.0, "Ctrl-D ends")

    def read(self, within_s, until=None):
        """What is shown until nothing more comes for a while."""
        text, deadline, quiet = "", time.monotonic() + within_s, None
        while time.monotonic() < deadline:
            if select.select([self.fd], [], [], 0.02)[0]:
                try:
                    text += os.read(self.fd, 4096).decode(errors="replace")
                except OSError:
                    break
                quiet = time.monotonic() + 0.25
            if quiet and time.monotonic() > quiet and (until is None or until in text):
                break
        return text

    def line(self, keys, answer=True):
        """Types keys, without ENTER; returns the replies."""
        os.write(self.fd, keys.encode())
        reply = self.read(3.0 if answer else 0.3)
        assert reply or not answer, f"no reply to {keys!r}"
        return reply

    def end(self):
        """Ctrl-D; returns the exit code."""
        os.write(self.fd, b"\x04")
        self.read(2.0)
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


def test_every_key_at_a_terminal():
    """`kestrel mav keys`: a key counts at once, without ENTER, by exactly its step; ignored while manual mode is off."""
    with Kestrel("office", seed=47, speed=2, servers=2, name="keys-terminal") as kestrel:
        station = kestrel.station(index=1, is_ground_station=False, system=200)
        station.wait_ready()
        typist = Typist(kestrel.ports[0])
        typist.line(":arm\n")
        station.wait_for(lambda: station.is_armed, 5.0, "armed")
        typist.line(":takeoff\n")
        station.wait_for(lambda: station.height > 0.9 and station.mode == "LOITER", 30.0, "takes off")
        pilot = Pilot(station, "QGroundControl")
        pilot.console = typist
        before, after, reply = pilot.press("e")
        assert is_same_place(before, after) and "manual" in reply.lower(), reply
        assert "on" in typist.line("m").lower()
        for key, step in (
            ("8", {"forward": NUDGE}), ("2", {"forward": -NUDGE}), ("6", {"right": NUDGE}), ("4", {"right": -NUDGE}),
            ("e", {"up": HEIGHT}), ("d", {"up": -HEIGHT}), ("q", {"turn": -ANGLE}), ("w", {"turn": ANGLE}),
        ):  # fmt: skip
            expect_step(pilot, key, **step)
        for key, undo, label, sign in (("j", "g", "roll", 1), ("g", "j", "roll", -1), ("y", "h", "nose[ -]down", 1), ("h", "y", "nose[ -]down", -1)):
            assert close(number(typist.line(key), label), sign * ANGLE, 6e-4), key
            assert close(number(typist.line(undo), label), 0.0, 6e-4), undo
        mass = number(typist.line("0"), "mass")
        assert close(number(typist.line("i"), "mass"), mass + MASS), "i"
        assert close(number(typist.line("kk"), "mass"), mass - MASS), "two keys at once"
        assert close(number(typist.line("0"), "mass"), mass), "0"
        assert "off" in typist.line("m").lower()
        typist.line("\x1b", answer=False)
        station.wait_for(lambda: station.mode == "LAND", 3.0, "ESC lands")
        station.wait_disarmed(30.0)
        assert typist.end() == 0
    truth = kestrel.truth()
    assert truth.contacts() == 0
    return "m 8 2 6 4 e d q w j g y h i k 0 ESC"
