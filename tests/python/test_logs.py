"""Flight logs, read by the programs people read them with: the Python package `mcap` and pymavlink."""

import json
import signal
import tempfile
from pathlib import Path

from kestrel_harness import Kestrel, out_folder, run


def folder(name):
    return Path(tempfile.mkdtemp(prefix=f"{name}-", dir=out_folder()))


def matches(value, schema, at="$"):
    """What of a JSON value is not as its schema says; the part of JSON Schema that our schemas use."""
    wrong = []
    kinds = {"object": dict, "string": str, "number": (int, float), "integer": int, "array": list}
    if "type" in schema and (not isinstance(value, kinds[schema["type"]]) or isinstance(value, bool)):
        return [f"{at} is no {schema['type']}: {value!r}"]
    if "oneOf" in schema and value not in [one["const"] for one in schema["oneOf"]]:
        wrong.append(f"{at} is none of its choices: {value!r}")
    if "minimum" in schema and value < schema["minimum"] or "maximum" in schema and value > schema["maximum"]:
        wrong.append(f"{at} is out of range: {value!r}")
    wrong += [f"{at}.{name} is missing" for name in schema.get("required", []) if name not in value]
    for name, sub in schema.get("properties", {}).items():
        if name in value:
            wrong += matches(value[name], sub, f"{at}.{name}")
    for i, item in enumerate(value if isinstance(value, list) else []):
        wrong += matches(item, schema.get("items", {}), f"{at}[{i}]")
    return wrong


def recorded_flight(state, seed=71, seconds=6.0):
    with Kestrel("office", seed=seed, speed=4, state_dir=state, name="log") as kestrel:
        station = kestrel.station()
        station.take_off(1.0)
        station.sleep(seconds)
        station.land()
        return kestrel


def test_mcap_and_tlog_are_read_whole_by_other_programs():
    """Every message fits its schema, the 3D topics are there, the head tells parameters, the .tlog has the flight."""
    from mcap.reader import make_reader
    from pymavlink import mavutil

    state = folder("state")
    recorded_flight(state)
    mcap, tlog = state / "logs" / "0001.mcap", state / "logs" / "0001.tlog"
    count, times = {}, []
    with open(mcap, "rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        schemas = {schema.name for schema in summary.schemas.values()}
        assert {f"foxglove.{n}" for n in ("PoseInFrame", "FrameTransform", "PointCloud", "Grid", "Log")} <= schemas, schemas
        facts = {record.name: record.metadata for record in reader.iter_metadata()}
        assert facts["kestrel"]["seed"] == "71" and facts["kestrel"]["source"] == "sim office", facts["kestrel"]
        assert len(facts["parameters"]) > 100 and facts["parameters"]["COM_DL_LOSS_T"] == "3 (default)"
        assert [a.name for a in reader.iter_attachments()] == ["flight.postcard"]
        parsed = {}
        for schema, channel, message in reader.iter_messages():
            count[channel.topic] = count.get(channel.topic, 0) + 1
            times.append(message.log_time)
            if schema is None:
                continue
            value = json.loads(message.data)
            shape = parsed.setdefault(schema.id, json.loads(schema.data))
            wrong = matches(value, shape)
            assert not wrong, f"{channel.topic}: {wrong}"
            last = value if channel.topic == "/summary" else None
            if last:
                assert last["duration_s"] > 5 and last["faults"] == [], last
    for topic in ("/flight", "/state", "/pose", "/tf", "/scan", "/map", "/log", "/summary"):
        assert count.get(topic), f"nothing on {topic}: {count}"
    seconds = (max(times) - min(times)) * 1e-9
    kinds = {}
    log = mavutil.mavlink_connection(str(tlog))
    while (message := log.recv_match()) is not None:
        kinds[message.get_type()] = kinds.get(message.get_type(), 0) + 1
    assert "BAD_DATA" not in kinds, kinds
    assert {"HEARTBEAT", "ATTITUDE", "COMMAND_LONG", "COMMAND_ACK", "STATUSTEXT"} <= kinds.keys(), kinds
    size = mcap.stat().st_size + tlog.stat().st_size
    ten_minutes_mb = size / seconds * 600e-6
    assert ten_minutes_mb <= 60, f"{ten_minutes_mb:.0f} MB in 10 min"
    return f"{sum(count.values())} messages, {sum(kinds.values())} frames in {seconds:.0f} s; 10 min would be {ten_minutes_mb:.0f} MB"


def test_a_recorded_flight_replays_and_its_tables_and_pictures_come_out():
    state, out = folder("state"), folder("out")
    recorded_flight(state, seed=72)
    mcap = state / "logs" / "0001.mcap"
    check = run("replay", mcap, "--check")
    assert check.returncode == 0 and "the same, bit for bit" in check.stdout, check.stdout + check.stderr
    other = run("replay", mcap, "--set", "MPC_TKO_SPEED=0.3")
    assert other.returncode == 0 and "first difference" in other.stdout, other.stdout + other.stderr
    info = run("log", "info", mcap)
    assert info.returncode == 0 and "seed" in info.stdout and "/state" in info.stdout, info.stdout + info.stderr
    assert run("log", "plot", mcap, "--out", out / "f.html").returncode == 0
    assert "<svg" in (out / "f.html").read_text()
    assert run("log", "export", mcap, "--out", out).returncode == 0
    head, *rows = (out / "state.csv").read_text().splitlines()
    assert "position_m.0" in head and len(rows) > 100
    assert run("log", "cut", mcap, "--until", "5", "--out", out / "head.mcap").returncode == 0
    check = run("replay", out / "head.mcap", "--check")
    assert check.returncode == 0, check.stdout + check.stderr
    broken = out / "broken.mcap"
    broken.write_bytes(b"nothing of the kind")
    refused = run("log", "info", broken)
    assert refused.returncode == 1 and "no flight log" in refused.stderr, refused.stderr
    return check.stdout.splitlines()[0]


def test_kill_9_leaves_logs_that_are_read_to_within_a_second():
    """Killed at any moment: what the station heard a second before is in the log, which replays and can be mended."""
    from mcap.exceptions import McapError
    from mcap.records import Message, Metadata
    from mcap.stream_reader import StreamReader

    state, missing = folder("state"), []
    for number in (1, 2, 3):
        with Kestrel("office", seed=72 + number, state_dir=state, name="kill") as kestrel:
            station = kestrel.station()
            station.sleep(1.2 + 0.37 * number)
            heard_s = station.next("ATTITUDE").time_boot_ms * 1e-3
            kestrel.process.send_signal(signal.SIGKILL)
            kestrel.process.wait()
        path, ends_ns, boot_us = state / "logs" / f"{number:04}.mcap", 0, None
        with open(path, "rb") as file:
            try:
                for record in StreamReader(file).records:
                    if isinstance(record, Message):
                        ends_ns = max(ends_ns, record.log_time)
                    elif isinstance(record, Metadata) and record.name == "kestrel":
                        boot_us = int(record.metadata["boot_utc_us"])
            except (McapError, EOFError):
                pass
        missing.append(heard_s - (ends_ns * 1e-9 - boot_us * 1e-6))
        check = run("replay", path, "--check")
        assert check.returncode == 0, check.stdout + check.stderr
        whole = state / f"whole{number}.mcap"
        assert run("log", "cut", path, "--out", whole).returncode == 0
        assert "its end is missing" not in run("log", "info", whole).stdout
    assert max(missing) < 1.0, missing
    return f"killed three times; missing at the end: {', '.join(f'{m:.2f}' for m in missing)} s"
