"""The camera for ground stations: announced over MAVLink, its picture by RTP, read by a real player."""

import os
import shutil
import socket
import subprocess
import tempfile
import time

from kestrel_harness import Kestrel, Skipped, binary, free_port, run
from station import mav, mavutil

CAMERA = 100


def has_video():
    """Whether the program under test was built with video."""
    return run("video", "sdp").returncode == 0


def ask_camera(link, message_id):
    """REQUEST_MESSAGE to the camera component, and what it sends."""
    name = {259: "CAMERA_INFORMATION", 269: "VIDEO_STREAM_INFORMATION", 270: "VIDEO_STREAM_STATUS"}[message_id]
    link.mav.command_long_send(1, CAMERA, mav.MAV_CMD_REQUEST_MESSAGE, 0, message_id, 0, 0, 0, 0, 0, 0)
    seen, deadline = {}, time.monotonic() + 5
    while len(seen) < 2:
        assert time.monotonic() < deadline, f"no {name}: {seen}"
        message = link.recv_match(type=[name, "COMMAND_ACK"], blocking=True, timeout=1)
        if message is not None and message.get_srcComponent() == CAMERA:
            seen[message.get_type()] = message
    assert seen["COMMAND_ACK"].result == mav.MAV_RESULT_ACCEPTED, seen
    return seen[name]


def test_a_station_is_told_of_the_picture_and_gets_it_by_rtp():
    """VIDEO_STREAM_INFORMATION names port, size and rate; packets come only while the port is open."""
    if not has_video():
        raise Skipped("this program was built without video")
    port = free_port()
    with Kestrel(seed=81, speed=1, extra=["--video-to", f"127.0.0.1:{port}", "--no-console"]) as kestrel:
        kestrel.station()
        # A station of tests hears the autopilot only.
        link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{kestrel.ports[0]}", source_system=200)
        link.mav.heartbeat_send(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        stream = ask_camera(link, 269)
        assert (stream.type, stream.encoding, stream.count) == (mav.VIDEO_STREAM_TYPE_RTPUDP, 1, 1), stream
        assert (stream.resolution_h, stream.resolution_v, stream.uri) == (640, 480, str(port)), stream
        assert ask_camera(link, 259).flags & mav.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM
        assert ask_camera(link, 270).bitrate == stream.bitrate > 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as player:
            player.bind(("127.0.0.1", port))
            player.settimeout(10)
            began = time.monotonic()
            kinds, pictures, size, last = set(), 0, 0, None
            while pictures < 30:
                packet = player.recv(2048)
                if len(packet) == 12:
                    continue  # a knock
                assert packet[0] == 0x80 and packet[1] & 0x7F == 96, packet[:2].hex()
                sequence = int.from_bytes(packet[2:4], "big")
                assert last is None or sequence == (last + 1) % 65536, f"{last} then {sequence}"
                last, size = sequence, size + len(packet)
                kind = packet[12] & 0x1F
                kinds.add(packet[13] & 0x1F if kind == 28 else kind)
                pictures += packet[1] >> 7
            took = time.monotonic() - began
        link.close()
        assert {7, 8, 5, 1} <= kinds, f"parameter sets, key picture, others: {kinds}"
    return f"30 pictures in {took:.1f} s, {size * 8 / took / 1e3:.0f} kbit/s"


def test_ffprobe_reads_the_stream():
    """A player that knows nothing of us, by the session description that the program prints."""
    if not has_video():
        raise Skipped("this program was built without video")
    if not shutil.which("ffprobe"):
        raise Skipped("ffprobe is not installed (apt-get install ffmpeg)")
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        sdp = os.path.join(folder, "video.sdp")
        with open(sdp, "w") as file:
            file.write(run("video", "sdp", "--port", port).stdout)
        with Kestrel(seed=82, speed=1, extra=["--video-to", f"127.0.0.1:{port}", "--no-console"]) as kestrel:
            kestrel.station()
            command = ["ffprobe", "-v", "error", "-protocol_whitelist", "file,rtp,udp", "-show_entries"]
            command += ["stream=codec_name,profile,width,height", "-of", "csv=p=0", sdp]
            done = subprocess.run(command, capture_output=True, text=True, timeout=40)
        assert done.stdout.strip() in ("h264,Constrained Baseline,640,480", "h264,Baseline,640,480"), done.stdout + done.stderr
    return done.stdout.strip()


def test_a_camera_that_is_none_is_refused_with_the_list():
    """A mistyped source ends with exit code 2 and says what there is."""
    for arguments, word in ((["--camera", "front"], "rtsp" if has_video() else "without video"), (["--camera", "none", "--video-to", "127.0.0.1"], "video")):
        done = run("sim", "--no-console", "--headless", "--mavlink", "udpserver://127.0.0.1:0", *arguments)
        assert done.returncode == 2 and word in done.stderr, (arguments, done)


def nals_of(data):
    """NAL units of a byte stream."""
    parts = data.replace(b"\x00\x00\x00\x01", b"\x00\x00\x01").split(b"\x00\x00\x01")
    return [part for part in parts if part]


class Reassembly:
    """NAL units from RTP packets, RFC 6184."""

    def __init__(self):
        self.nals, self.piece = [], b""

    def take(self, packet):
        kind = packet[12] & 0x1F
        if kind != 28:
            self.nals.append(packet[12:])
            return
        if packet[13] & 0x80:
            self.piece = bytes([packet[12] & 0xE0 | packet[13] & 0x1F])
        self.piece += packet[14:]
        if packet[13] & 0x40:
            self.nals.append(self.piece)


def test_a_recording_on_standard_input_reaches_a_station_unchanged():
    """Every NAL unit of the file, byte by byte and in order, at the pace that was asked for."""
    if not has_video():
        raise Skipped("this program was built without video")
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        clip = os.path.join(folder, "clip.h264")
        said = run("video", "clip", "maze", "-o", clip, "--seconds", "3").stdout.strip()
        with open(clip, "rb") as file:
            wanted = nals_of(file.read())
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as player, open(clip, "rb") as recording:
            player.bind(("127.0.0.1", port))
            player.settimeout(10)
            command = [binary(), "sim", "--headless", "--quiet", "--no-console", "--mavlink", "udpserver://127.0.0.1:0"]
            command += ["--camera", "-?fps=30", "--video-to", f"127.0.0.1:{port}"]
            program = subprocess.Popen(command, stdin=recording)
            try:
                got, began = Reassembly(), time.monotonic()
                while len(got.nals) < len(wanted) - 1:
                    packet = player.recv(2048)
                    if len(packet) > 12:
                        got.take(packet)
                took = time.monotonic() - began
            finally:
                program.kill()
                program.wait()
    assert got.nals == wanted[: len(got.nals)], "byte by byte"
    assert took > 2.0, f"{took} s for 3 s of pictures"
    return f"{len(got.nals)} NAL units in {took:.1f} s; {said.split(': ', 1)[1]}"
