"""MSP version 1 over TCP in a few lines, and Betaflight's simulator build by hand: the independent eye of the firmware tests.

Nothing here is shared with Kestrel; layouts are those of the firmware's own `msp.c` and `sitl.c`.
"""

import contextlib
import ctypes
import socket
import struct
import subprocess
import threading
import time

UART1 = 5761
API_VERSION, FEATURE_CONFIG, MODE_RANGES, SET_MODE_RANGE = 1, 36, 34, 35
STATUS, MOTOR, ATTITUDE, RXFAIL_CONFIG, EEPROM_WRITE, REBOOT = 101, 104, 108, 77, 250, 68


class Refused(AssertionError):
    """The controller answered with an error frame."""


class Mute(AssertionError):
    """The controller does not answer."""


class Msp:
    """One client of one UART."""

    def __init__(self, port=UART1, within_s=10.0):
        end = time.monotonic() + within_s
        while True:
            try:
                self.socket = socket.create_connection(("127.0.0.1", port), timeout=2.0)
                self.socket.settimeout(0.5)
                break
            except OSError:
                assert time.monotonic() < end, f"nobody listens on port {port}"
                time.sleep(0.05)
        self.pending = b""

    def close(self):
        self.socket.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def ask(self, command, payload=b"", within_s=6.0):
        """Payload of the answer."""
        body = bytes([len(payload), command]) + payload
        end = time.monotonic() + within_s
        while time.monotonic() < end:
            self.socket.sendall(b"$M<" + body + bytes([xor(body)]))
            answer = self._answer(command, time.monotonic() + 1.5)
            if answer is not None:
                return answer
        raise Mute(f"no answer to MSP {command}")

    def _answer(self, command, end):
        while time.monotonic() < end:
            try:
                piece = self.socket.recv(4096)
            except TimeoutError:
                continue
            assert piece, "the controller closed the connection"
            self.pending += piece
            while (start := self.pending.find(b"$M")) >= 0 and len(self.pending) >= start + 6:
                length = self.pending[start + 3]
                stop = start + 6 + length
                if len(self.pending) < stop:
                    break
                frame, self.pending = self.pending[start:stop], self.pending[stop:]
                if frame[4] == command and xor(frame[3:-1]) == frame[-1]:
                    if frame[2:3] == b"!":
                        raise Refused(f"MSP {command}")
                    return frame[5:-1]
        return None


def type_in(lines):
    """The firmware's command line, as in a configurator's: it wants a moment of silence after its `#`."""
    with Msp() as line:
        for text in ("#", *(f"{text}\n" for text in lines)):
            line.socket.sendall(text.encode())
            end = time.monotonic() + 0.8
            while time.monotonic() < end:
                with contextlib.suppress(OSError):
                    line.socket.recv(4096)


def xor(data):
    total = 0
    for byte in data:
        total ^= byte
    return total


def settings(eeprom):
    """Every parameter group of an `eeprom.bin`, byte for byte: {(group number, profile): bytes}."""
    data = eeprom.read_bytes()
    assert data[1] == 0xBE, "no settings in there"
    groups, at = {}, 2
    while size := struct.unpack_from("<H", data, at)[0]:
        group, _version, flags = struct.unpack_from("<HBB", data, at + 2)
        groups[group, flags & 3] = data[at + 6 : at + size]
        at += size
    return groups


def exact_timers():
    """Timer slack of 1 ns for what is started next: with the usual 50 us the firmware's scheduler starves its UARTs."""
    PR_SET_TIMERSLACK = 29
    ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)


class Firmware:
    """The simulator build, started again when it "reboots", standing level and still on the floor."""

    def __init__(self, program, folder):
        self.program, self.folder = program, folder
        self.ended = threading.Event()
        self.channels = [1500, 1500, 1000, 1500] + [1000] * 12
        self.sends_rc = False
        self.starts = 0
        self.log = open(folder / "by-hand.log", "wb")
        self.process = self._spawn()
        self.threads = [threading.Thread(target=task, daemon=True) for task in (self._keep, self._feed)]
        for thread in self.threads:
            thread.start()

    def _spawn(self):
        self.starts += 1
        exact_timers()
        return subprocess.Popen([self.program], cwd=self.folder, stdin=subprocess.DEVNULL, stdout=self.log, stderr=self.log)

    def _keep(self):
        while not self.ended.wait(0.05):
            if self.process.poll() is not None:
                self.process = self._spawn()

    def _feed(self):
        state = struct.pack("<18d", 1.0, *(0.0,) * 3, 0.0, 0.0, -9.80665, 1.0, *(0.0,) * 3, *(0.0,) * 6, 101325.0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not self.ended.wait(0.004):
                out.sendto(state, ("127.0.0.1", 9003))
                if self.sends_rc:
                    out.sendto(struct.pack("<d16H", 1.0, *self.channels), ("127.0.0.1", 9004))

    def make_sure_it_runs(self):
        """About one start in twelve gets stuck (cycle time 0, boot grace for ever, or mute): such a one is started again."""
        for _ in range(6):
            end = time.monotonic() + 4.0
            with contextlib.suppress(Mute):
                while time.monotonic() < end:
                    with Msp() as line:
                        if struct.unpack_from("<H", line.ask(STATUS))[0]:
                            return
                    time.sleep(0.2)
            self.process.kill()
            time.sleep(1.0)
        raise AssertionError("the firmware's scheduler does not run, six starts in a row")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.ended.set()
        for thread in self.threads:
            thread.join()
        self.process.kill()
        self.process.wait()
        self.log.close()
