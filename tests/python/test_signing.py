"""Signed links with pymavlink: who knows the key is heard, everybody else is not."""

import hashlib
import socket
import tempfile
import time
from pathlib import Path

from kestrel_harness import Kestrel, Skipped, free_port, out_folder, run
from station import mav, mavutil


def connect(port, system, passphrase=None, address="127.0.0.1"):
    """A plain pymavlink link, signed with SHA-256 of a pass phrase as MAVProxy does it."""
    conn = mavutil.mavlink_connection(f"udpout:{address}:{port}", source_system=system)
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
        # Frames of the right key that were made two minutes ago, as a recording has them. (A station whose clock is late sets it by the
        # first frame it hears and is then on time: that is how signing is meant.)
        late = connect(port, 249, "hangar")
        old = late.mav.signing.timestamp - 120 * 100_000
        late.mav.signing.link_id = 9
        for k in range(10):
            late.mav.signing.timestamp = old + 10 * k
            late.mav.command_long_send(1, 1, mav.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
            ack = late.recv_match(type="COMMAND_ACK", blocking=True, timeout=0.2)
            assert not ack or ack.target_system != 249, "old frames are heard"
        assert ask(friend), "the right key is no longer heard"
        assert "ignored: not signed" in kestrel.log(), "rejected frames are not told"
        path = kestrel.folder / "pilot.key"
        assert run("keys", "new", path).returncode == 0 and path.stat().st_mode & 0o077 == 0
        assert run("keys", "new", path).returncode == 2, "overwrites a key"
        shown = run("keys", "show", path).stdout.strip()
        assert len(bytes.fromhex(shown)) == 32


def give_key(conn, key):
    """SETUP_SIGNING as pymavlink's and MAVProxy's stations send it."""
    conn.mav.heartbeat_send(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 0)
    conn.mav.setup_signing_send(1, 1, list(key), int((time.time() - 1420070400) * 1e5))


def test_a_key_from_the_ground_station():
    """SETUP_SIGNING: refused from another machine with the reason; taken here, kept over a restart; then others must sign."""
    from test_access import own_address

    address = own_address()
    if address is None:
        raise Skipped("this machine has no address but loopback")
    state = Path(tempfile.mkdtemp(prefix="signing-", dir=out_folder())) / "state"
    port = free_port()
    key = hashlib.sha256(b"hangar").digest()
    extra = ["--mavlink", f"udpserver://0.0.0.0:{port}"]
    with Kestrel(seed=72, speed=1, state_dir=state, extra=extra) as kestrel:
        station = kestrel.station()
        station.wait_ready()
        far = connect(port, 251, address=address)
        assert ask(far, 5.0), "a viewer is heard"
        give_key(far, key)
        station.wait_for(lambda: station.has_said("SETUP_SIGNING refused", "only from this machine"), 3.0, "refused from afar")
        assert not (state / "signing.key").exists()

        near = connect(port, 250)
        assert ask(near, 5.0)
        give_key(near, key)
        station.wait_for(lambda: station.has_said("Signing key stored"), 3.0, "taken here")
        station.wait_for((state / "signing.key").exists, 3.0, "kept")
        kept = state / "signing.key"
        assert kept.stat().st_mode & 0o077 == 0 and bytes.fromhex(kept.read_text()) == key
        friend = connect(port, 252, "hangar", address=address)
        assert ask(friend, 5.0), "who signs from afar is heard"
        assert friend.recv_match(type="HEARTBEAT", blocking=True, timeout=3.0), "our frames do not pass pymavlink's check"
        assert not ask(far), "who does not sign is heard from afar"
        assert not ask(connect(port, 253, "other", address=address)), "another key is heard"
        friend.mav.command_long_send(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
        station.wait_for(lambda: station.is_armed, 3.0, "who knows the key may fly")
        give_key(near, bytes(32))
        station.wait_for(lambda: station.has_said("SETUP_SIGNING refused", "disarm first"), 3.0, "not while armed")
        station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0)
        station.wait_for(lambda: not station.is_armed, 3.0, "disarmed")
    logs = b"".join(path.read_bytes() for path in state.rglob("*") if path.is_file() and path != kept)
    assert key not in logs and key.hex().encode() not in logs, "the key is in a log"

    with Kestrel(seed=72, speed=1, state_dir=state, extra=extra) as kestrel:
        assert ask(connect(port, 252, "hangar", address=address), 5.0), "who signs is not heard after the restart"
        assert not ask(connect(port, 251, address=address)), "who does not sign is heard after the restart"
        near = connect(port, 250)
        assert ask(near, 5.0), "this machine need not sign"
        give_key(near, bytes(32))
        station = kestrel.station()
        station.wait_for(lambda: kept.read_text() == "", 3.0, "taken away")
        assert ask(connect(port, 251, address=address), 5.0), "a viewer again"
