"""What `kestrel rooms NAME --export DIR` tells about a room, and courses laid through it."""

import json
import math
import subprocess
import tempfile
from pathlib import Path

import kestrel_harness

CRUISE_HEIGHT_M = 1.0


class Room:
    """Places and doors of a room, in plan metres and NED about home."""

    def __init__(self, folder):
        self.folder = Path(folder)
        self.facts = json.loads((self.folder / "rooms.json").read_text())

    @classmethod
    def export(cls, name="office"):
        """Asks the program."""
        folder = tempfile.mkdtemp(prefix=f"kestrel-room-{name}-")
        command = [kestrel_harness.binary(), "rooms", name, "--export", folder]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, f"{' '.join(map(str, command))}: exit {done.returncode}\n{done.stderr}"
        return cls(folder)

    @property
    def plan(self):
        return self.folder / "plan.yaml"

    @property
    def home_map(self):
        return self.facts["home"]["map_m"]

    @property
    def doors(self):
        return {door["name"]: door for door in self.facts["doors"]}

    def place(self, name):
        """A named place or door, NED about home, m."""
        for entry in self.facts["rooms"] + self.facts["doors"]:
            if entry["name"] == name:
                return tuple(entry["ned_m"])
        raise KeyError(f"{self.facts['name']} has no place or door named {name}")

    def to_ned(self, x, y):
        """Plan metres to NED about home: `north_deg` is the plan direction of north, counter-clockwise from plan x."""
        north = math.radians(self.facts["north_deg"])
        dx, dy = x - self.home_map[0], y - self.home_map[1]
        return (dx * math.cos(north) + dy * math.sin(north), dx * math.sin(north) - dy * math.cos(north))

    def doors_passed(self, truth):
        """Names of the doors flown through, in order."""
        passed = []
        samples = truth.samples[::5]
        for a, b in zip(samples, samples[1:]):
            for name, door in self.doors.items():
                centre = door["ned_m"]
                # Through the door = the step crosses the door's threshold: within its width of the centre, and the
                # sign of the distance along the passage changes.
                along = self._passage(door)
                before = along[0] * (a.x - centre[0]) + along[1] * (a.y - centre[1])
                after = along[0] * (b.x - centre[0]) + along[1] * (b.y - centre[1])
                near = math.hypot(b.x - centre[0], b.y - centre[1]) < 0.5 * door["width_m"] + 0.1
                if near and (before < 0.0) != (after < 0.0):
                    passed.append(name)
        return passed

    def _passage(self, door):
        """Direction one flies through a door, NED: the axis of the plan along which both sides are free floor."""
        plan = self._floor()
        x, y = door["map_m"]
        free_along_x = all(plan(x + d, y) for d in (-0.4, 0.4))
        away = self.to_ned(x + 1.0, y) if free_along_x else self.to_ned(x, y + 1.0)
        here = self.to_ned(x, y)
        return (away[0] - here[0], away[1] - here[1])

    def _floor(self):
        """The exported PGM as a function: is this plan point free floor?"""
        if not hasattr(self, "_free"):
            yaml = dict(line.split(":", 1) for line in self.plan.read_text().splitlines() if ":" in line and line[0] != " ")
            resolution = float(yaml["resolution"])
            origin = json.loads(yaml["origin"])
            width, height, pixels = read_pgm(self.folder / yaml["image"].strip())

            def free(x, y):
                column = int((x - origin[0]) / resolution)
                row = height - 1 - int((y - origin[1]) / resolution)
                return 0 <= column < width and 0 <= row < height and pixels[row * width + column] > 200

            self._free = free
        return self._free


def read_pgm(path):
    """Width, height and bytes of a binary PGM."""
    data = Path(path).read_bytes()
    fields, position = [], 0
    while len(fields) < 4:
        end = position
        while not data[end : end + 1].isspace():
            end += 1
        word = data[position:end]
        if word.startswith(b"#"):
            end = data.index(b"\n", position)
        elif word:
            fields.append(word)
        position = end + 1
    assert fields[0] == b"P5", fields
    return int(fields[1]), int(fields[2]), data[position:]


# Six way points through two doors or more, by name. Seeds alternate between them, so that one lucky route is not enough.
COURSES = (
    ("lab-corridor", "corridor", "corridor-office a", "office a", "corridor", "lab-corridor"),
    ("lab-workshop", "workshop", "workshop-corridor", "corridor", "lab-corridor", "lab"),
)


def course(room, seed):
    """The six way points of a seed, NED with the cruise height."""
    return [(*room.place(name), -CRUISE_HEIGHT_M) for name in COURSES[seed % len(COURSES)]]
