"""Floor plans and patrols: `kestrel plan` and `kestrel map`; plan files go up as a station sends them and are flown."""

import json
import math
import re
import struct
import tempfile
import xml.etree.ElementTree as ElementTree
import zlib
from pathlib import Path

from kestrel_harness import Kestrel, run
from rooms import Room
from station import mav

LAT0, LON0 = 47.3977420, 8.5455940  # the default geo-anchor
EARTH_M = 6378137.0


def folder(name):
    return Path(tempfile.mkdtemp(prefix=f"kestrel-{name}-"))


def made(*arguments, code=0):
    """Runs the program, returns what it printed; exit code must be `code`."""
    done = run(*arguments)
    assert done.returncode == code, f"exit {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


def wire(plan):
    """The items of a plan file as QGroundControl sends them to a vehicle that takes no home item: ids count from 1 there, items
    from 0 here."""
    items = []
    for seq, item in enumerate(plan["mission"]["items"]):
        assert item["type"] == "SimpleItem" and item["doJumpId"] == seq + 1
        p = [math.nan if value is None else float(value) for value in item["params"]]
        if item["command"] == mav.MAV_CMD_DO_JUMP:
            p[0] -= 1
        items.append((item["frame"], item["command"], 0, 1, *p[:4], round(p[4] * 1e7), round(p[5] * 1e7), p[6]))
    return items


def ned(item):
    """North and east of home of an item."""
    north = math.radians(item[8] * 1e-7 - LAT0) * EARTH_M
    east = math.radians(item[9] * 1e-7 - LON0) * EARTH_M * math.cos(math.radians(LAT0))
    return (north, east, -item[10])


def fly(station, items, limit_s):
    station.upload(items)
    station.wait_ready()
    station.arm()
    station.command(mav.MAV_CMD_MISSION_START, 0, 0)
    station.wait_for(lambda: station.position[2] < -0.5, 20.0, "takes off")
    station.wait_disarmed(limit_s)


def off_path(sample, path):
    """Distance of a sample from the nearest leg of a path, m."""
    best = math.inf
    for (ax, ay, _), (bx, by, _) in zip(path, path[1:]):
        dx, dy = bx - ax, by - ay
        length2 = dx * dx + dy * dy
        t = max(0.0, min(1.0, ((sample.x - ax) * dx + (sample.y - ay) * dy) / length2)) if length2 else 0.0
        best = min(best, math.hypot(ax + t * dx - sample.x, ay + t * dy - sample.y))
    return best


def test_a_patrol_of_every_room_is_uploaded_and_flown():
    """Row 5c: two rounds of the office from a plan file; every room within 0.10 m, a report per round."""
    where = folder("plan")
    said = made("plan", "office", "--rounds", "2", "-o", where / "patrol.plan", "--picture", where / "patrol.svg")
    assert "7 rooms" in said and "left alone" in said, said
    plan = json.loads((where / "patrol.plan").read_text())
    assert plan["fileType"] == "Plan" and plan["version"] == 1 and plan["mission"]["version"] == 2
    picture = ElementTree.parse(where / "patrol.svg").getroot()
    assert picture.tag.endswith("svg") and "path" in {e.get("class") for e in picture.iter()}
    items = wire(plan)
    waypoints = [ned(i) for i in items if i[1] == mav.MAV_CMD_NAV_WAYPOINT]
    facts = Room.export("office")
    for room in plan["kestrel"]["rooms"]:
        assert math.dist(facts.place(room["name"]), (room["north_m"], room["east_m"])) < 0.01, room
    with Kestrel("office", seed=71, speed=4) as kestrel:
        station = kestrel.station()
        fly(station, items, 400.0)
        reports = [text for _, _, text in station.texts if text.startswith("Round ")]
        assert station.has_said("Round 1: 7 rooms") and station.has_said("Round 2: 7 rooms"), reports
    truth = kestrel.truth()
    passes = truth.airborne().passes([w[:2] for w in waypoints * 2], 0.1)
    assert max(passes) <= 0.10, passes
    assert truth.contacts() == 0 and truth.landing_error() <= 0.15
    return f"{len(waypoints)} rooms twice within {max(passes):.2f} m, landing {truth.landing_error():.2f} m"


def test_a_sweep_of_two_rooms_is_flown_along_its_plan():
    """The lab and the corridor swept; the flown path beside the planned one."""
    where = folder("sweep")
    said = made("plan", "office", "--coverage", "--rooms", "lab,corridor", "-o", where / "s.plan", "--picture", where / "s.svg")
    share = float(re.search(r"([\d.]+) % of", said).group(1))
    assert share >= 98.0, said
    items = wire(json.loads((where / "s.plan").read_text()))
    path = [(0.0, 0.0, -1.0)] + [ned(i) for i in items if i[1] == mav.MAV_CMD_NAV_WAYPOINT]
    with Kestrel("office", seed=72, speed=4) as kestrel:
        fly(kestrel.station(), items, 900.0)
    truth = kestrel.truth()
    reached_s = max(s.t_s for s in truth.samples if math.hypot(s.x - path[-1][0], s.y - path[-1][1]) < 0.15)
    swept = [s for s in truth.samples if s.z < -0.8 and s.t_s <= reached_s][::5]
    off = sorted(off_path(s, path) for s in swept)
    p95 = off[int(0.95 * len(off))]
    figures = f"{share:.1f} % planned, {len(path)} corners, off the plan p95 {p95:.2f} m, worst {off[-1]:.2f} m"
    assert truth.contacts() == 0 and p95 <= 0.10, figures
    return figures


def test_what_cannot_be_planned_is_refused_with_the_reason():
    where = folder("refused")
    out = where / "x.plan"
    assert "no room `attic`" in made("plan", "office", "--rooms", "attic", "-o", out, code=1)
    assert "did you mean `office`" in made("plan", "ofice", "-o", out, code=2)
    assert "swath of 9 m is outside" in made("plan", "office", "--coverage", "--swath", "9", "-o", out, code=1)
    assert "--height 9 is outside" in made("plan", "office", "--height", "9", "-o", out, code=2)
    assert "items, 512 fit" in made("plan", "office", "--coverage", "--swath", "0.25", "-o", out, code=2)
    # A plan whose only free floor is narrower than the vehicle, and one without free floor.
    for name, free, words in (("slot", range(10, 13), "no free cell where a vehicle"), ("solid", (), "no free cell")):
        rows = [bytes(254 if 0 < x < 39 and y in free else 0 for x in range(40)) for y in range(20)]
        (where / f"{name}.pgm").write_bytes(b"P5\n40 20\n255\n" + b"".join(rows))
        text = f"image: {name}.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nkestrel: {{home: [1.0, 0.45, 0.0]}}\n"
        (where / f"{name}.yaml").write_text(text)
        assert words in made("plan", where / f"{name}.yaml", "--coverage", "-o", out, code=1)
    assert not out.exists()


def png(width, height, dark):
    """A grey PNG, dark where it is asked to be."""
    rows = b"".join(b"\0" + bytes(0 if dark(x, y) else 255 for x in range(width)) for y in range(height))
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))  # noqa: E731
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def house(x, y):
    """Two rooms of 5 x 4 m at 40 pixels a metre, walls of 4 pixels, a word in the left one, a gap in the lower wall."""
    if 120 <= x < 180 and 100 <= y < 110:
        return True  # the word
    if 300 <= x < 308 and 196 <= y < 204:
        return False  # the gap: 0.2 m
    inside = 20 <= x < 424 and 20 <= y < 204
    walls = x < 24 or x >= 420 or y < 24 or y >= 200 or 220 <= x < 224
    return inside and walls


MARKS = [
    "--scale", "20,20,420,20,10", "--home", "100,150", "--room", "west,100,150", "--room", "east,330,120",
    "--door", "west-east,222,60,222,100", "--no-fly", "340,30,400,80", "--rubber", "110,90,190,120",
]  # fmt: skip


def test_a_drawing_becomes_a_plan_that_is_flown():
    """Scan, marks, warnings, plan; then a patrol of it in the simulator."""
    where = folder("map")
    (where / "scan.png").write_bytes(png(444, 224, house))
    plan = where / "plans" / "house.yaml"
    said = made("map", "import", where / "scan.png", *MARKS, "-o", plan)
    assert "warning: " in said and "the walls do not close: a gap about 0." in said and "with a warning" in said, said
    said = made("map", "import", where / "scan.png", *MARKS, "--wall", "290,202,320,202", "-o", plan, "--picture", where / "h.svg")
    assert "warning" not in said and "door west-east" in said, said
    assert "nothing wrong" in made("map", "check", plan)
    shown = made("map", "show", plan)
    assert "11.1 x 5.6 m" in shown and "no-fly zone of 4 corners" in shown, shown
    ElementTree.parse(where / "h.svg")
    shut = [word for word in MARKS if word not in ("--door", "west-east,222,60,222,100")]
    said = made("map", "import", where / "scan.png", *shut, "-o", where / "shut.yaml")
    assert "room `east`: no door reaches it" in said or "room `east`: the widest way" in said, said
    assert "room `east`" in made("map", "check", where / "shut.yaml", code=1)
    assert "cannot be reached" in made("plan", where / "shut.yaml", "-o", where / "x.plan", code=1)
    assert "off the picture" in made("map", "import", where / "scan.png", *MARKS, "--room", "attic,999,1", "-o", plan, code=1)

    made("plan", plan, "-o", where / "patrol.plan")
    items = wire(json.loads((where / "patrol.plan").read_text()))
    with Kestrel(plan, seed=73, speed=4, name="house") as kestrel:
        fly(kestrel.station(), items, 120.0)
    truth = kestrel.truth()
    east = ned(next(i for i in items if i[1] == mav.MAV_CMD_NAV_WAYPOINT))
    passed = truth.airborne().nearest(east[:2])
    assert passed <= 0.10 and truth.contacts() == 0 and truth.landing_error() <= 0.15
    return f"drawn, flown to the other room within {passed:.2f} m, back to {truth.landing_error():.2f} m"
