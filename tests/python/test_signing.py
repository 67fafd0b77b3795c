"""Signed links with pymavlink: who knows the key is heard, everybody else is not."""

import socket
import time

from kestrel_harness import Kestrel, run
from station import mav, mavutil


def connect(port, system, passphrase=None):
    """A plain pymavlink link, signed with SHA-256 of a pass phrase as MAVProxy does it."""
    import hashlib

    conn = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=system)
    if passphrase:
        conn.setup_signing(hashlib.sha256(passphrase.encode()).digest(), sign_outgoing=True)
    return conn


def ask(conn, within_s=2.0):
    """Asks for AUTOPILOT_VERSION; true if a COMMAND_ACK comes."""
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        conn.mav.heartbeat_send(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        conn.mav.command_long_send(1, 1, mav.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
        ack = conn.recv_match(type="COMMAND_ACK", blocking=True, timeout=0.3)
        if ack and ack.target_system == conn.mav.srcSystem:
            return True
    return False


def test_signed_link_takes_only_its_key():
    """Right key heard; no key, wrong key and a replay not; `kestrel keys` makes a file that a link can use."""
    from kestrel_harness import free_port

    port = free_port()
    with Kestrel(seed=71, speed=1, extra=["--mavlink", f"udpserver://127.0.0.1:{port}?key=pass:hangar"]) as kestrel:
        friend = connect(port, 250, "hangar")
        assert ask(friend, 5.0), "the right key is not heard"
        assert friend.recv_match(type="HEARTBEAT", blocking=True, timeout=3.0), "our frames do not pass pymavlink's check"
        assert not ask(connect(port, 251)), "unsigned frames are heard"
        assert not ask(connect(port, 252, "other")), "a wrong key is heard"

        # A recorded arm command, said again from elsewhere.
        friend.mav.command_long_send(1, 1, mav.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
        sent = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
        station = kestrel.station()
        station.wait_ready()
        frame = bytes(sent.pack(friend.mav))
        friend.write(frame)
        station.wait_for(lambda: station.is_armed, 3.0, "the signed arm arms")
        station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0)
        station.wait_for(lambda: not station.is_armed, 3.0, "disarmed")
        thief = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        for _ in range(5):
            thief.sendto(frame, ("127.0.0.1", port))
            station.sleep(0.3)
            assert not station.is_armed, "a replayed frame arms"
        assert ask(friend), "the right key is no longer heard"
        assert "ignored: not signed" in kestrel.log(), "rejected frames are not told"
        path = kestrel.folder / "pilot.key"
        assert run("keys", "new", path).returncode == 0 and path.stat().st_mode & 0o077 == 0
        assert run("keys", "new", path).returncode == 2, "overwrites a key"
        shown = run("keys", "show", path).stdout.strip()
        assert len(bytes.fromhex(shown)) == 32
