"""Row 1: every call of MAVSDK 4.1.0 that makes sense for a multicopter indoors, with its result. Nothing may time out: a call
works, or is refused at once with the right code. `KESTREL_OUT` gets the whole table (`mavsdk-calls.txt`).
"""

import base64
import importlib
import json
import queue
import tempfile
import time
from pathlib import Path

from kestrel_harness import Kestrel, out_folder

PATIENCE_S = 30.0  # a calibration by restarting the flight controller takes 8 s
AT_ONCE_S = 3.5  # MAVSDK asks three times, half a second apart: longer is a time-out that calls itself otherwise
VIDEO = "rtsp://127.0.0.1:8554/front"


class Table:
    """Calls made and what came of them."""

    def __init__(self):
        self.rows, self.wrong = [], []

    def add(self, name, result, seconds, wanted, value=""):
        self.rows.append((name, result, seconds, value))
        if result not in wanted.split("|") or seconds > (PATIENCE_S if "calibrate" in name or "download" in name else AT_ONCE_S):
            self.wrong.append(f"{name}: {result} after {seconds:.2f} s, wanted {wanted} {value}")

    def call(self, name, function, *arguments, wanted="SUCCESS", check=None):
        """A blocking call. `check` judges what it gives back."""
        began = time.monotonic()
        try:
            value = function(*arguments)
            result = "SUCCESS"
            if check is not None and not check(value):
                result = "WRONG VALUE"
        except Exception as error:
            value, result = None, getattr(getattr(error, "result", None), "name", None) or type(error).__name__
        self.add(name, result, time.monotonic() - began, wanted, short(value))
        return value

    def follow(self, name, function, *arguments, wanted="SUCCESS"):
        """A call that reports again and again, until it says something final; the last result counts."""
        news, began = queue.Queue(), time.monotonic()
        function(*arguments, lambda result, data, _: news.put((result.name, data)))
        steps, last = [], "TIMEOUT"
        while time.monotonic() - began < PATIENCE_S:
            try:
                last, data = news.get(timeout=0.2)
            except queue.Empty:
                continue
            steps.append(short(data))
            if last not in ("NEXT", "IN_PROGRESS"):
                break
        self.add(name, last, time.monotonic() - began, wanted, f"{len(steps)} reports")
        return steps

    def hear(self, name, subscribe, unsubscribe, within_s=4.0, wanted="heard"):
        """A stream says something."""
        news, began = queue.Queue(), time.monotonic()
        handle = subscribe(lambda *values: news.put(values))
        try:
            values = news.get(timeout=within_s)
            self.add(name, "heard", 0.0, wanted, short(values[0]))
        except queue.Empty:
            self.add(name, "silence", time.monotonic() - began if wanted == "heard" else 0.0, wanted)
        finally:
            unsubscribe(handle)

    def print(self, path):
        lines = [f"{name:<52}{result:<22}{seconds:7.2f} s  {value}" for name, result, seconds, value in self.rows]
        path.write_text("\n".join(lines) + "\n")


def short(value):
    return " ".join(str(value).split())[:90] if value is not None else ""


class Plugins:
    """Plugins of a system by name, made when they are first used."""

    def __init__(self, system):
        self._system, self._made = system, {}

    def __getattr__(self, name):
        if name not in self._made:
            module = self.module(name)
            kind = next(v for k, v in vars(module).items() if k.lower() == name.replace("_", "") and isinstance(v, type))
            self._made[name] = kind(self._system)
        return self._made[name]

    @staticmethod
    def module(name):
        return importlib.import_module(f"mavsdk.plugins.{name}.{name}")

    def close(self):
        for plugin in self._made.values():
            plugin.destroy()


def test_every_call_works_or_is_refused_at_once():
    """On the ground: the whole table."""
    from mavsdk import ComponentType, Configuration, ConnectionResult, Mavsdk

    folder = Path(tempfile.mkdtemp(prefix="mavsdk-table-", dir=out_folder()))
    state = folder / "state"
    with Kestrel("office", seed=24, speed=1, state_dir=state, name="mavsdk-table", extra=["--video", VIDEO]) as kestrel:
        sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        assert sdk.add_any_connection(f"udpout://127.0.0.1:{kestrel.ports[0]}") == ConnectionResult.SUCCESS
        system = sdk.first_autopilot(15.0)
        assert system
        p, table = Plugins(system), Table()
        try:
            deadline = time.monotonic() + 40.0
            while not p.telemetry.health_all_ok():
                assert time.monotonic() < deadline, f"not healthy: {p.telemetry.health()}"
                time.sleep(0.1)
            for part in (info, telemetry, params, missions, fence, files, calibration, cameras, others, actions):
                part(p, table, folder)
        finally:
            table.print(out_folder() / "mavsdk-calls.txt")
            p.close()
            sdk.destroy()
    results = [r for _, r, _, _ in table.rows]
    worked = sum(r in ("SUCCESS", "heard") for r in results)
    timed_out = sum(r == "TIMEOUT" for r in results)
    figures = f"{len(results)} calls: {worked} worked, {len(results) - worked} refused or silent by contract, {timed_out} time-outs"
    assert not table.wrong, figures + "\n" + "\n".join(table.wrong)
    return figures


def info(p, table, _):
    time.sleep(0.5)
    table.call("info.get_identification", p.info.get_identification, check=lambda v: v.legacy_uid != 0)
    table.call("info.get_product", p.info.get_product)
    table.call("info.get_version", p.info.get_version, check=lambda v: v.flight_sw_major == 1 and v.flight_sw_minor == 15)
    table.hear("info.flight_information", p.info.subscribe_flight_information, p.info.unsubscribe_flight_information, 6.0)
    m = p.module("component_metadata")
    news = queue.Queue()
    p.component_metadata.subscribe_metadata_available(lambda *v: news.put(v))
    p.component_metadata.request_autopilot_component()
    kinds = m.MetadataType
    deadline = time.monotonic() + 15.0
    while time.monotonic() < deadline:
        try:
            if any(str(kinds.ALL_COMPLETED.value) in str(v) or "ALL_COMPLETED" in str(v) for v in news.get(timeout=0.5)):
                break
        except queue.Empty:
            pass
    table.call(
        "component_metadata.get_metadata(PARAMETER)",
        p.component_metadata.get_metadata,
        1,
        kinds.PARAMETER,
        check=lambda v: "MIS_TAKEOFF_ALT" in str(getattr(v, "json_metadata", v)),
    )
    table.call(
        "component_metadata.get_metadata(EVENTS)", p.component_metadata.get_metadata, 1, kinds.EVENTS, wanted="NOT_AVAILABLE|UNSUPPORTED"
    )


def telemetry(p, table, _):
    t = p.telemetry
    rates = {
        "position": 5, "home": 1, "in_air": 1, "landed_state": 1, "attitude_quaternion": 10, "attitude_euler": 20,
        "velocity_ned": 5, "gps_info": 1, "raw_gps": 1, "battery": 1, "rc_status": 2, "odometry": 10, "position_velocity_ned": 20,
        "imu": 20, "scaled_imu": 10, "raw_imu": 10, "distance_sensor": 5, "altitude": 4, "health": 1, "unix_epoch_time": 1,
        "fixedwing_metrics": 2,
    }  # fmt: skip
    for name, hz in rates.items():
        table.call(f"telemetry.set_rate_{name}({hz})", getattr(t, f"set_rate_{name}"), hz)
    for name in ("vtol_state",):
        table.call(f"telemetry.set_rate_{name}(1)", getattr(t, f"set_rate_{name}"), 1)
    for name in ("actuator_control_target", "actuator_output_status", "ground_truth"):
        table.call(f"telemetry.set_rate_{name}(1)", getattr(t, f"set_rate_{name}"), 1, wanted="UNSUPPORTED|COMMAND_DENIED|SUCCESS")
    spoken = {
        "position", "home", "in_air", "landed_state", "armed", "vtol_state", "attitude_quaternion", "attitude_euler",
        "attitude_angular_velocity_body", "velocity_ned", "gps_info", "raw_gps", "battery", "flight_mode", "health", "rc_status",
        "odometry", "position_velocity_ned", "imu", "scaled_imu", "raw_imu", "health_all_ok", "unix_epoch_time",
        "distance_sensor", "altitude", "heading",
    }  # fmt: skip
    for name in sorted(spoken):
        table.hear(f"telemetry.{name}", getattr(t, f"subscribe_{name}"), getattr(t, f"unsubscribe_{name}"))
    table.call("telemetry.get_gps_global_origin", t.get_gps_global_origin, check=lambda v: abs(v.latitude_deg - 47.397742) < 1e-4)


def params(p, table, _):
    table.call("param.get_all_params", p.param.get_all_params, check=lambda v: len(v.int_params) + len(v.float_params) > 60)
    table.call("param.get_param_float", p.param.get_param_float, "MIS_TAKEOFF_ALT")
    table.call("param.set_param_float", p.param.set_param_float, "MIS_TAKEOFF_ALT", 1.25)
    table.call("param.get_param_float again", p.param.get_param_float, "MIS_TAKEOFF_ALT", check=lambda v: abs(v - 1.25) < 1e-6)
    table.call("param.set_param_int", p.param.set_param_int, "NAV_DLL_ACT", 1)
    table.call("param.get_param_int", p.param.get_param_int, "NAV_DLL_ACT", check=lambda v: v == 1)
    table.call("param.set_param_float(out of range)", p.param.set_param_float, "MIS_TAKEOFF_ALT", 1e9, wanted="VALUE_OUT_OF_RANGE")
    table.call("param.get_param_int(of a float)", p.param.get_param_int, "MIS_TAKEOFF_ALT", wanted="WRONG_TYPE")
    table.call("param.get_param_float(unknown)", p.param.get_param_float, "NO_SUCH_NAME", wanted="DOES_NOT_EXIST")
    table.call("param.set_param_int(unknown)", p.param.set_param_int, "NO_SUCH_NAME", 1, wanted="DOES_NOT_EXIST|FAILED")


def missions(p, table, _):
    raw = p.module("mission_raw")
    home = p.telemetry.home()

    def item(seq, command, x=0, y=0, z=1.0, frame=3, params=(0.0, 0.0, 0.0, float("nan")), kind=0):
        return raw.MissionItem(seq, frame, command, int(seq == 0), 1, *params, x, y, z, kind)

    lat, lon = round(home.latitude_deg * 1e7), round(home.longitude_deg * 1e7)
    plan = [item(0, 22, lat, lon), item(1, 16, lat + 90, lon + 90), item(2, 20)]
    table.call("mission_raw.upload_mission", p.mission_raw.upload_mission, plan)
    table.call(
        "mission_raw.download_mission", p.mission_raw.download_mission,
        check=lambda v: [(i.command, i.x, i.y) for i in v] == [(i.command, i.x, i.y) for i in plan],
    )  # fmt: skip
    wall = [item(0, 16, lat + 90_000, lon)]
    table.call("mission_raw.upload_mission(off the plan)", p.mission_raw.upload_mission, wall, wanted="INVALID_ARGUMENT|ERROR|DENIED")
    table.call("mission_raw.download_mission: the old one", p.mission_raw.download_mission, check=lambda v: len(v) == len(plan))
    table.call("mission_raw.set_current_mission_item(1)", p.mission_raw.set_current_mission_item, 1)
    table.call("mission_raw.set_current_mission_item(9)", p.mission_raw.set_current_mission_item, 9, wanted="INVALID_ARGUMENT|ERROR|DENIED|UNSUPPORTED")
    table.call("mission_raw.mission_progress", p.mission_raw.mission_progress, check=lambda v: v.total == len(plan))
    table.call("mission_raw.is_mission_finished", p.mission_raw.is_mission_finished, check=lambda v: v is False)
    table.call("mission_raw.pause_mission (on the ground)", p.mission_raw.pause_mission)
    table.call("mission.is_mission_finished", p.mission.is_mission_finished, check=lambda v: v is False)
    rally = [item(0, 5100, lat + 50, lon + 50, kind=2)]
    table.call("mission_raw.upload_rally_points", p.mission_raw.upload_rally_points, rally)
    table.call("mission_raw.download_rallypoints", p.mission_raw.download_rallypoints, check=lambda v: len(v) == 1 and v[0].x == lat + 50)
    table.call("mission_raw.clear_mission", p.mission_raw.clear_mission)
    table.call("mission_raw.download_mission: none", p.mission_raw.download_mission, wanted="SUCCESS|NO_MISSION_AVAILABLE")
    table.call("mission_raw.start_mission: none", p.mission_raw.start_mission, wanted="ERROR|DENIED|NO_MISSION_AVAILABLE|BUSY")


def fence(p, table, _):
    m = p.module("geofence")
    home = p.telemetry.home()
    corner = lambda n, e: m.Point(home.latitude_deg + n * 9e-6, home.longitude_deg + e * 1.3e-5)  # noqa: E731
    keep_in = m.Polygon([corner(-8, -8), corner(-8, 8), corner(8, 8), corner(8, -8)], m.FenceType.INCLUSION)
    circle = m.Circle(corner(3, 3), 0.5, m.FenceType.EXCLUSION)
    table.call("geofence.upload_geofence", p.geofence.upload_geofence, m.GeofenceData([keep_in], [circle]))
    table.call(
        "geofence.download_geofence", p.geofence.download_geofence, check=lambda v: len(v.polygons) == 1 and len(v.circles) == 1
    )
    table.call("geofence.clear_geofence", p.geofence.clear_geofence)
    table.call("geofence.download_geofence: none", p.geofence.download_geofence, wanted="SUCCESS|ERROR")


def files(p, table, folder):
    own = folder / "hello.txt"
    own.write_text("hello " * 500)
    names = lambda v: str([getattr(e, "name", e) for e in v.entries])  # noqa: E731
    table.call("ftp.list_directory(/)", p.ftp.list_directory, "/", check=lambda v: "parameters.json" in names(v))
    table.follow("ftp.download(burst)", p.ftp.download_async, "/parameters.json", str(folder), True)
    table.follow("ftp.download(no burst)", p.ftp.download_async, "/general.json", str(folder), False)
    assert "parameters" in json.loads((folder / "parameters.json").read_text())
    table.follow("ftp.download(unknown)", p.ftp.download_async, "/no-such-file", str(folder), True, wanted="FILE_DOES_NOT_EXIST")
    table.follow("ftp.upload(/upload)", p.ftp.upload_async, str(own), "/upload")
    table.call("ftp.are_files_identical", p.ftp.are_files_identical, str(own), "/upload/hello.txt", check=lambda v: v is True)
    table.call("ftp.create_directory", p.ftp.create_directory, "/upload/a", wanted="FILE_PROTECTED")
    table.call("ftp.remove_directory", p.ftp.remove_directory, "/upload/a", wanted="FILE_PROTECTED")
    table.call("ftp.rename", p.ftp.rename, "/upload/hello.txt", "/upload/b.txt", wanted="SUCCESS|UNSUPPORTED|PROTOCOL_ERROR|FILE_IO_ERROR")
    table.call("ftp.remove_file", p.ftp.remove_file, "/upload/hello.txt", wanted="SUCCESS|FILE_DOES_NOT_EXIST")
    table.call("ftp.remove_file(/general.json)", p.ftp.remove_file, "/general.json", wanted="FILE_PROTECTED|FILE_IO_ERROR|FILE_DOES_NOT_EXIST")
    table.call("ftp.list_directory(/../..)", p.ftp.list_directory, "/../..", wanted="FILE_DOES_NOT_EXIST|INVALID_PARAMETER|PROTOCOL_ERROR|FILE_IO_ERROR")
    entries = table.call("log_files.get_entries", p.log_files.get_entries, wanted="SUCCESS|NO_LOGFILES") or []
    if entries:
        into = folder / "flight.log"
        table.follow("log_files.download_log_file", p.log_files.download_log_file_async, entries[0], str(into))
        assert into.stat().st_size > 0


def calibration(p, table, _):
    c = p.calibration  # but for the gimbal's, which MAVSDK asks of a component that is not there
    for name, wanted in (
        ("level_horizon", "SUCCESS"),
        ("accelerometer", "SUCCESS"),
        ("gyro", "SUCCESS"),
        ("magnetometer", "UNSUPPORTED|COMMAND_DENIED|FAILED"),
    ):
        steps = table.follow(f"calibration.calibrate_{name}", getattr(c, f"calibrate_{name}_async"), wanted=wanted)
        if wanted == "SUCCESS" and not any("status_text=" in s or "progress=" in s for s in steps):
            table.wrong.append(f"calibrate_{name} told nothing: {steps}")
    table.call("calibration.cancel", c.cancel, wanted="SUCCESS|FAILED")
    time.sleep(1.0)


def cameras(p, table, _):
    c = p.camera
    deadline = time.monotonic() + 12.0
    while time.monotonic() < deadline and not getattr(c.camera_list(), "cameras", None):
        time.sleep(0.2)
    table.call("camera.camera_list", c.camera_list, check=lambda v: len(v.cameras) == 1)
    cameras = c.camera_list().cameras
    number = cameras[0].component_id if cameras else 1
    # MAVSDK 4.1.0 asks for VIDEO_STREAM_STATUS only, so its own answer stays empty; asked by hand the stream is described.
    table.call("camera.get_video_stream_info", c.get_video_stream_info, number)
    heard = queue.Queue()
    d = p.module("mavlink_direct")
    handle = p.mavlink_direct.subscribe_message("VIDEO_STREAM_INFORMATION", lambda message, _: heard.put(message))
    values = {"target_system": 1, "target_component": 100, "command": 512, "confirmation": 0, "param1": 269.0}
    ask = d.MavlinkMessage("COMMAND_LONG", 255, 190, 1, 100, json.dumps(values | {f"param{i}": 0.0 for i in range(2, 8)}))
    table.call("mavlink_direct.send_message(COMMAND_LONG)", p.mavlink_direct.send_message, ask)
    try:
        told = heard.get(timeout=3.0).fields_json
        table.add("VIDEO_STREAM_INFORMATION", "heard" if VIDEO.split("//")[1] in told.replace("\\/", "/") else "WRONG VALUE", 0.0, "heard", short(told))
    except queue.Empty:
        table.add("VIDEO_STREAM_INFORMATION", "silence", 3.0, "heard")
    p.mavlink_direct.unsubscribe_message(handle)
    table.call("camera.get_mode", c.get_mode, number, wanted="SUCCESS|UNAVAILABLE")
    table.call("camera.get_storage", c.get_storage, number, wanted="SUCCESS|UNAVAILABLE")
    refused = "ACTION_UNSUPPORTED|PROTOCOL_UNSUPPORTED|DENIED|ERROR|UNAVAILABLE|WRONG_ARGUMENT"
    mode = p.module("camera").Mode
    table.call("camera.set_mode(VIDEO)", c.set_mode, number, mode.VIDEO, wanted=f"SUCCESS|{refused}")
    table.call("camera.start_video_streaming", c.start_video_streaming, number, 1, wanted=f"SUCCESS|{refused}")
    table.call("camera.stop_video_streaming", c.stop_video_streaming, number, 1, wanted=refused)
    for name, *more in (
        ("take_photo",), ("start_photo_interval", 1.0), ("stop_photo_interval",), ("start_video",), ("stop_video",), ("set_mode", mode.PHOTO),
        ("format_storage", 1), ("reset_settings",), ("zoom_in_start",), ("zoom_out_start",), ("zoom_stop",), ("zoom_range", 50.0),
        ("focus_in_start",), ("focus_out_start",), ("focus_stop",), ("focus_range", 50.0), ("focus_auto",),
        ("track_point", 0.5, 0.5, 0.1), ("track_rectangle", 0.1, 0.1, 0.5, 0.5), ("track_stop",),
    ):  # fmt: skip
        table.call(f"camera.{name}", getattr(c, name), number, *more, wanted=refused)


def others(p, table, _):
    replies = []
    p.shell.subscribe_receive(lambda receive, _: replies.append(str(receive.data)))
    table.call("shell.send(status)", p.shell.send, "status", 10)
    deadline = time.monotonic() + 3.0
    while time.monotonic() < deadline and not replies:
        time.sleep(0.05)
    table.add("shell.receive", "heard" if replies else "silence", 0.0, "heard", short("".join(replies)))
    m = p.module("failure")
    table.call(
        "failure.inject(SENSOR_GPS, OFF)", p.failure.inject, m.FailureUnit.SENSOR_GPS, m.FailureType.OFF, 0,
        wanted="UNSUPPORTED|DISABLED|DENIED",
    )  # fmt: skip
    table.call("log_streaming.start", p.log_streaming.start_log_streaming, wanted="UNSUPPORTED|COMMAND_DENIED")
    table.call("log_streaming.stop", p.log_streaming.stop_log_streaming, wanted="UNSUPPORTED|COMMAND_DENIED")
    rtcm = base64.b64encode(b"\xd3\x00\x13" + bytes(30)).decode()
    table.call("rtk.send_rtcm_data", p.rtk.send_rtcm_data, p.module("rtk").RtcmData(rtcm))
    heard = queue.Queue()
    handle = p.mavlink_direct.subscribe_message("ATTITUDE", lambda message, _: heard.put(message))
    try:
        table.add("mavlink_direct.subscribe(ATTITUDE)", "heard", 0.0, "heard", short(heard.get(timeout=2.0).fields_json))
    except queue.Empty:
        table.add("mavlink_direct.subscribe(ATTITUDE)", "silence", 2.0, "heard")
    p.mavlink_direct.unsubscribe_message(handle)
    d = p.module("mavlink_direct")
    ping = d.MavlinkMessage("PING", 255, 190, 1, 1, json.dumps({"time_usec": 1, "seq": 7, "target_system": 0, "target_component": 0}))
    table.call("mavlink_direct.send_message(PING)", p.mavlink_direct.send_message, ping)
    report = getattr(p.events, "get_health_and_arming_checks_report")
    table.call("events.get_health_and_arming_checks_report", report, wanted="NOT_AVAILABLE|UNSUPPORTED")


def actions(p, table, _):
    a = p.action
    home = p.telemetry.home()
    place = (home.latitude_deg, home.longitude_deg, home.absolute_altitude_m)
    table.call("action.get_takeoff_altitude", a.get_takeoff_altitude, check=lambda v: abs(v - 1.25) < 1e-6)
    table.call("action.set_takeoff_altitude", a.set_takeoff_altitude, 1.0)
    table.call("action.get_return_to_launch_altitude", a.get_return_to_launch_altitude)
    table.call("action.set_return_to_launch_altitude", a.set_return_to_launch_altitude, 1.0)
    table.call("action.set_current_speed", a.set_current_speed, 0.7)
    table.call("action.set_home(here)", a.set_home, True, float("nan"), float("nan"), float("nan"))
    table.call("action.set_home(place)", a.set_home, False, *place)
    table.call("action.set_gps_global_origin", a.set_gps_global_origin, 47.397742, 8.545594, 0.0)
    denied = "COMMAND_DENIED|UNSUPPORTED|BUSY|FAILED|NO_VTOL_TRANSITION_SUPPORT|VTOL_TRANSITION_SUPPORT_UNKNOWN|PARAMETER_ERROR"
    orbit = p.module("action").OrbitYawBehavior.HOLD_INITIAL_HEADING
    table.call("action.do_orbit", a.do_orbit, 1.0, 0.5, orbit, *place, wanted=denied)
    table.call("action.goto_location (on the ground)", a.goto_location, *place, 0.0, wanted=denied)
    table.call("action.goto_location_fixedwing", a.goto_location_fixedwing, *place, 5.0, wanted=denied + "|SUCCESS")
    table.call("action.set_actuator", a.set_actuator, 1, 0.1, wanted=denied)
    table.call("action.set_relay", a.set_relay, 0, p.module("action").RelayCommand.ON, wanted=denied)
    table.call("action.transition_to_fixedwing", a.transition_to_fixedwing, wanted=denied)
    table.call("action.transition_to_multicopter", a.transition_to_multicopter, wanted=denied)
    table.call("action.land (on the ground)", a.land, wanted=denied)
    table.call("action.return_to_launch (on the ground)", a.return_to_launch, wanted=denied)
    table.call("action.hold (on the ground)", a.hold)
    time.sleep(6.0)  # the flight controller was restarted by the calibration of its gyroscope
    table.call("action.arm", a.arm)
    table.call("action.reboot (armed)", a.reboot, wanted="COMMAND_DENIED|COMMAND_DENIED_NOT_LANDED")
    table.call("action.disarm", a.disarm)
    table.call("action.arm_force", a.arm_force, wanted="SUCCESS|COMMAND_DENIED")
    table.call("action.kill", a.kill)
    table.call("action.terminate", a.terminate)
    table.call("action.shutdown", a.shutdown, wanted=denied)
    time.sleep(1.5)  # until the flight controller has said that it is disarmed
    table.call("action.reboot", a.reboot)
    table.call("info.get_speed_factor", p.info.get_speed_factor, check=lambda v: 0.2 < v < 1.3)
    fly = p.module("offboard")
    table.call("offboard.start (no set point)", p.offboard.start, wanted="NO_SETPOINT_SET")
    table.call("offboard.is_active", p.offboard.is_active, check=lambda v: v is False)
    table.call("offboard.set_attitude", p.offboard.set_attitude, fly.Attitude(0.0, 0.0, 0.0, 0.0))
    table.call("offboard.stop", p.offboard.stop)
    table.call("manual_control.set_manual_control_input", p.manual_control.set_manual_control_input, 0.0, 0.0, 0.5, 0.0)
    table.call("manual_control.start_altitude_control", p.manual_control.start_altitude_control, wanted="SUCCESS|COMMAND_DENIED")
