"""Row 5 with real clients: missions over a link that loses, repeats and reorders datagrams. `KESTREL_FULL=1` for all cells and 20 runs."""

import heapq
import os
import random
import socket
import threading
import time

from kestrel_harness import Kestrel
from station import Station, mav, takeoff_item, waypoint
from test_mavsdk_table import Plugins

FULL = bool(os.environ.get("KESTREL_FULL"))


class Weather:
    """A UDP relay in front of a port: loses a share of the datagrams each way, delays all up to 40 ms, repeats one in twenty."""

    def __init__(self, port, loss, seed):
        self.to, self.loss, self.dice = ("127.0.0.1", port), loss, random.Random(seed)
        self.front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.front.bind(("127.0.0.1", 0))
        self.back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.back.bind(("127.0.0.1", 0))
        self.port, self.client, self.open = self.front.getsockname()[1], None, True
        self.air, self.count = [], 0
        self.lock = threading.Lock()
        for task in (lambda: self.carry(self.front, self.back), lambda: self.carry(self.back, self.front), self.deliver):
            threading.Thread(target=task, daemon=True).start()

    def carry(self, source, sink):
        source.settimeout(0.2)
        while self.open:
            try:
                data, address = source.recvfrom(4096)
            except OSError:
                continue
            if source is self.front:
                self.client = address
            for _ in range(2 if self.loss and self.dice.random() < 0.05 else 1):
                if self.dice.random() >= self.loss:
                    with self.lock:
                        self.count += 1
                        delay = self.dice.random() * 0.04 if self.loss else 0.0
                        heapq.heappush(self.air, (time.monotonic() + delay, self.count, sink, data))

    def deliver(self):
        while self.open:
            with self.lock:
                due = []
                while self.air and self.air[0][0] <= time.monotonic():
                    due.append(heapq.heappop(self.air))
            for _, _, sink, data in due:
                to = self.to if sink is self.back else self.client
                if to:
                    try:
                        sink.sendto(data, to)
                    except OSError:
                        return
            time.sleep(0.001)

    def close(self):
        self.open = False
        self.front.close()
        self.back.close()


def plan(count):
    return [takeoff_item(1.0), *(waypoint(0.01 * (i % 40), 0.0, -1.0) for i in range(count - 1))]


def patient_upload(station, items, seconds):
    """A script that answers whatever is asked, and says its last word again after silence."""
    last = lambda out: out.mission_count_send(1, 1, len(items), 0)  # noqa: E731
    with station.listen("MISSION_REQUEST_INT", "MISSION_ACK") as mailbox:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            with station.sending() as out:
                last(out)
            try:
                message = mailbox.get(timeout=1.0 / station.speed + 0.3)
            except Exception:  # nothing came: the last word again
                continue
            if message.get_type() == "MISSION_ACK":
                return message.type == mav.MAV_MISSION_ACCEPTED
            last = lambda out, seq=message.seq: out.mission_item_int_send(1, 1, seq, *items[seq], 0)  # noqa: E731
    return False


def patient_download(station, seconds):
    found, count, end = {}, None, time.monotonic() + seconds
    with station.listen("MISSION_COUNT", "MISSION_ITEM_INT") as mailbox:
        while time.monotonic() < end and (count is None or len(found) < count):
            with station.sending() as out:
                if count is None:
                    out.mission_request_list_send(1, 1, 0)
                else:
                    out.mission_request_int_send(1, 1, next(i for i in range(count) if i not in found), 0)
            try:
                message = mailbox.get(timeout=0.4)
            except Exception:  # asked again
                continue
            if message.get_type() == "MISSION_COUNT":
                count = message.count
            else:
                found[message.seq] = message
        with station.sending() as out:
            out.mission_ack_send(1, 1, 0, 0)
    return [found[i] for i in sorted(found)]


def test_pymavlink_missions_in_bad_weather():
    """Upload and download by a patient script, once for each size and loss: identical."""
    cells = [(2, 0.0), (2, 0.1), (2, 0.3), (50, 0.0), (50, 0.1), (50, 0.3)] + ([(500, 0.0), (500, 0.1), (500, 0.3)] if FULL else [])
    lines = []
    with Kestrel(seed=95, speed=4, name="weather") as kestrel:
        kestrel.station()
        for n, (count, loss) in enumerate(cells):
            weather = Weather(kestrel.ports[0], loss, seed=n)
            station = Station(weather.port, speed=4, system=240, is_ground_station=False)
            try:
                station.wait_connected()
                items = plan(count)
                began = time.monotonic()
                assert patient_upload(station, items, 30 + count), f"{count} items, loss {loss}: not taken"
                up = time.monotonic() - began
                back = patient_download(station, 30 + count)
                down = time.monotonic() - began - up
                same = [(i.command, i.x, i.y, round(i.z, 4)) for i in back] == [(i[1], i[8], i[9], round(i[10], 4)) for i in items]
                assert same, f"{count} items, loss {loss}: {len(back)} came back"
                lines.append(f"{count}/{loss:.0%} {up:.1f}+{down:.1f} s")
            finally:
                station.close()
                weather.close()
    return ", ".join(lines)


def test_mavsdk_mission_of_50_items_with_a_tenth_lost():
    """mission_raw, 50 items, 10 % lost: taken within four tries each run; the items in the vehicle are those of the last success."""
    from mavsdk import ComponentType, Configuration, Mavsdk

    runs = 20 if FULL else 4
    tries_of = []
    with Kestrel(seed=96, speed=1, servers=2, name="weather-mavsdk") as kestrel:
        watch = kestrel.station(index=1, system=200)
        watch.wait_connected()
        weather = Weather(kestrel.ports[0], 0.1, seed=5)
        sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        try:
            sdk.add_any_connection(f"udpout://127.0.0.1:{weather.port}")
            system = sdk.first_autopilot(20.0)
            assert system
            p = Plugins(system)
            raw = p.module("mission_raw")
            for run in range(runs):
                items = [
                    raw.MissionItem(i, 1, 16, int(i == 0), 1, 0.0, 0.0, 0.0, float("nan"), 100 * (i % 40), 10 * run, -1.0, 0)
                    for i in range(50)
                ]
                for attempt in range(1, 5):
                    try:
                        p.mission_raw.upload_mission(items)
                        tries_of.append(attempt)
                        break
                    except raw.MissionRawError:
                        continue
                else:
                    raise AssertionError(f"run {run}: not taken in four tries")
                assert [(i.x, i.y) for i in watch.download()] == [(100 * (i % 40), 10 * run) for i in range(50)]
            p.close()
        finally:
            sdk.destroy()
            weather.close()
    return f"{runs} of {runs}, tries {' '.join(map(str, tries_of))}"
