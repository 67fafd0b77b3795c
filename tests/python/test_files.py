"""Files, flight logs, fence and rally points through MAVSDK's own plugins and pymavlink, judged by the disk and the truth."""

import json
import math
import tempfile
import threading
import time
from pathlib import Path

from kestrel_harness import Kestrel, out_folder
from station import item, mav
from test_mavsdk import flight


def folder(name):
    return Path(tempfile.mkdtemp(prefix=f"{name}-", dir=out_folder()))


def finish(start, within_s=30.0):
    """Calls an asynchronous MAVSDK function with a callback and waits for its last result's name."""
    done, results = threading.Event(), []

    def callback(result, *_):
        results.append(result.name)
        if result.name != "NEXT":
            done.set()

    start(callback)
    assert done.wait(within_s), f"no end within {within_s} s: {results[-3:]}"
    return results[-1]


def test_files_and_metadata_with_mavsdk():
    """Metadata by COMPONENT_METADATA and by hand, uploads that arrive on the disk, and paths that lead nowhere."""
    from mavsdk.plugins.component_metadata import ComponentMetadata, MetadataType
    from mavsdk.plugins.ftp import Ftp, FtpError

    state, local = folder("state"), folder("local")
    with flight(seed=61, speed=1, state_dir=state) as (_, drone):
        ftp = Ftp(drone.system)
        entries = ftp.list_directory("/").entries
        names = {entry.name for entry in entries}
        assert {"logs", "upload", "general.json", "parameters.json.xz"} <= names, names
        for use_burst in (False, True):
            for name in ("parameters.json", "parameters.json.xz", "general.json"):
                result = finish(lambda cb, n=name, b=use_burst: ftp.download_async(f"/{n}", str(local), b, cb))
                assert result == "SUCCESS", f"{name}, burst {use_burst}: {result}"
            told = json.loads((local / "parameters.json").read_text())["parameters"]
            assert any(p["name"] == "MIS_TAKEOFF_ALT" and p["type"] == "Float" for p in told)
        import lzma

        assert lzma.decompress((local / "parameters.json.xz").read_bytes()) == (local / "parameters.json").read_bytes()

        plan = local / "plan.bin"
        plan.write_bytes(bytes(i * 7 % 251 for i in range(5_000)))
        result = finish(lambda cb: ftp.upload_async(str(plan), "/upload", cb))
        assert result == "SUCCESS", result
        assert (state / "upload" / "plan.bin").read_bytes() == plan.read_bytes()
        assert ftp.are_files_identical(str(plan), "/upload/plan.bin")
        ftp.remove_file("/upload/plan.bin")
        assert not (state / "upload" / "plan.bin").exists()

        (state / "upload" / "link").symlink_to(local / "general.json")
        refused = {}
        for path in ("/upload/../parameters.toml", "/etc/passwd", "/upload/link", "/upload/no-such-file"):
            refused[path] = finish(lambda cb, p=path: ftp.download_async(p, str(local), False, cb), 15.0)
        assert "SUCCESS" not in refused.values(), refused
        for call in (ftp.create_directory, ftp.remove_directory, ftp.remove_file):
            try:
                call("/upload/../x")
            except FtpError as refusal:
                assert "TIMEOUT" not in str(refusal), refusal
            else:
                raise AssertionError(f"{call.__name__} climbs out")

        metadata = ComponentMetadata(drone.system)
        got = threading.Event()
        metadata.subscribe_metadata_available(lambda update, _: got.set() if update.type == MetadataType.PARAMETER else None)
        metadata.request_autopilot_component()
        assert got.wait(15.0), "MAVSDK finds no parameter metadata"
        told = json.loads(metadata.get_metadata(1, MetadataType.PARAMETER).json_metadata)
        for plugin in (metadata, ftp):
            plugin.destroy()
    assert len(told["parameters"]) > 50
    return f"{len(told['parameters'])} parameters told; refused: {refused}"


def test_flight_logs_with_mavsdk():
    """The log of a flight is listed, downloaded bit for bit in the next run, and erased."""
    from mavsdk.plugins.log_files import LogFiles

    state, local = folder("state"), folder("local")
    with Kestrel("office", seed=62, speed=4, state_dir=state, name="first") as kestrel:
        station = kestrel.station()
        station.take_off(1.0)
        station.sleep(3.0)
        station.land()
    recorded = (state / "logs" / "0001.mcap").read_bytes()
    assert recorded.startswith(b"\x89MCAP0\r\n") and len(recorded) > 50_000, len(recorded)
    with flight(seed=62, speed=1, state_dir=state) as (_, drone):
        logs = LogFiles(drone.system)
        entries = logs.get_entries()
        assert [entry.size_bytes for entry in entries][0] == len(recorded) and len(entries) == 4, entries
        target = local / "flight.mcap"
        began = time.monotonic()
        result = finish(lambda cb: logs.download_log_file_async(entries[0], str(target), cb), 120.0)
        took = time.monotonic() - began
        assert result == "SUCCESS", result
        assert target.read_bytes() == recorded
        logs.erase_all_log_files()
        drone.wait(lambda: not (state / "logs" / "0001.mcap").exists(), 5.0, "the log is erased")
        assert (state / "logs" / "0002.mcap").exists(), "the log of this run is gone"
        logs.destroy()
    return f"{len(recorded)} bytes in {took:.1f} s, {len(recorded) / took / 1e3:.0f} kB/s"


def test_fence_stops_the_vehicle_and_outlives_the_program():
    """A fence drawn with MAVSDK: sticks towards its border end in Hold inside. Rally points come back."""
    from mavsdk.plugins.geofence import Circle, FenceType, Geofence, GeofenceData, Point, Polygon

    state = folder("state")
    half_m = 0.9
    with flight(seed=63, speed=1, state_dir=state) as (kestrel, drone):
        station = kestrel.station(system=200, is_ground_station=False)
        drone.wait(drone.telemetry.health_all_ok, 40.0, "health_all_ok")
        corners = [Point(*drone.global_of(n * half_m, e * half_m)) for n, e in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        fence = Geofence(drone.system)
        far = Circle(Point(*drone.global_of(30.0, 30.0)), 0.5, FenceType.EXCLUSION)
        fence.upload_geofence(GeofenceData([Polygon(corners, FenceType.INCLUSION)], [far]))
        back = fence.download_geofence()
        assert len(back.polygons) == 1 and len(back.circles) == 1
        for sent, got in zip(corners, back.polygons[0].points):
            assert abs(sent.latitude_deg - got.latitude_deg) < 2e-7 and abs(sent.longitude_deg - got.longitude_deg) < 2e-7
        rally = [item(mav.MAV_CMD_NAV_RALLY_POINT, frame=6, x=round(corners[0].latitude_deg * 1e7), y=85455940, z=1.0)]
        station.upload(rally, kind=2)
        assert [point.command for point in station.download(kind=2)] == [mav.MAV_CMD_NAV_RALLY_POINT]

        drone.take_off(1.0)
        for _ in station.ticks(0.3):
            with station.sending() as out:
                out.manual_control_send(1, 0, 0, 500, 0, 0)
            time.sleep(0.02)
        station.set_mode("POSCTL")
        for _ in station.ticks(6.0):
            with station.sending() as out:
                out.manual_control_send(1, 0, -1000, 500, 0, 0)
            time.sleep(0.02)
            if station.mode == "LOITER":
                break
        assert station.has_said("Fence ahead: Hold"), "full stick at the fence is not stopped"
        sticks = drone.now
        drone.sleep(3.0)
        drone.action.return_to_launch()
        drone.wait(lambda: not drone.telemetry.armed(), 60.0, "returns, lands, disarms")
        fence.destroy()
    truth = kestrel.truth()
    reach = max(max(abs(row.x), abs(row.y)) for row in truth.samples)
    assert 0.3 < reach <= half_m + 0.1, f"reached {reach:.2f} m, the fence is at {half_m} m"
    assert truth.contacts() == 0 and math.isfinite(sticks)
    with Kestrel("office", seed=63, speed=2, state_dir=state, name="again") as kestrel:
        station = kestrel.station()
        assert len(station.download(kind=1)) == 5 and len(station.download(kind=2)) == 1
        with station.listen("MISSION_ACK", when=lambda m: m.mission_type == 1) as mailbox:
            with station.sending() as out:
                out.mission_clear_all_send(1, 1, 1)
            assert station.take(mailbox, what="MISSION_ACK").type == 0
        assert station.download(kind=1) == [] and len(station.download(kind=2)) == 1
    return f"fence at {half_m} m, never beyond {reach:.2f} m"
