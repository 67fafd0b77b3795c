"""Row 7: YAMSPy, a real client library of flight controllers, against our MSP server and through our pass-through; its CPU
beside that of our client."""

import contextlib
import json
import os
import pty
import re
import resource
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import tty

import kestrel_harness
import msp
from kestrel_harness import out_folder
from rooms import Room
from station import Station

# Round trips of each client, and what each asks in turn.
ROUNDS = 150
# 250 requests of it are warm-up enough: both clients identify the controller before they are measured.
QUESTIONS = ("MSP_ATTITUDE", "MSP_ANALOG", "MSP_RC")

# The peer, in a process of its own so that its CPU is its own. It prints what it read and what it used.
PEER = """
import json, resource, sys, time
from yamspy import MSPy
device, rounds = sys.argv[1], int(sys.argv[2])
# The log level is the quietest: what it writes down is not what we measure.
with MSPy(device=device, loglevel="CRITICAL", logfilename="yamspy.log", baudrate=115200) as board:
    assert board != 1, "YAMSPy found no flight controller"
    for name in ("MSP_API_VERSION", "MSP_FC_VARIANT", "MSP_FC_VERSION"):
        assert board.send_RAW_msg(MSPy.MSPCodes[name], data=[])
        board.process_recv_data(board.receive_msg())
    took = []
    before = resource.getrusage(resource.RUSAGE_SELF)
    for _ in range(rounds):
        for name in %r:
            start = time.perf_counter()
            assert board.send_RAW_msg(MSPy.MSPCodes[name], data=[])
            board.process_recv_data(board.receive_msg())
            took.append(time.perf_counter() - start)
    after = resource.getrusage(resource.RUSAGE_SELF)
    took.sort()
    print(json.dumps({
        "api": board.CONFIG["apiVersion"], "variant": board.CONFIG["flightControllerIdentifier"],
        "version": board.CONFIG["flightControllerVersion"],
        "attitude": board.SENSOR_DATA["kinematics"], "analog": board.ANALOG, "rc": board.RC["channels"],
        "requests": len(took), "p50_ms": 1e3 * took[len(took) // 2], "p99_ms": 1e3 * took[len(took) * 99 // 100],
        "cpu_us": 1e6 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime) / len(took),
    }))
""" % (QUESTIONS,)


class Server:
    """`kestrel msp serve` on a free port."""

    def __init__(self, *arguments):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.url = f"tcpclient://127.0.0.1:{self.port}"
        command = [kestrel_harness.binary(), "msp", "serve", f"tcpserver://127.0.0.1:{self.port}", *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        said = self.process.stdout.readline()
        assert "flight controller on" in said, said

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


class Passthrough:
    """`kestrel fc passthrough` on a free port."""

    def __init__(self, fc):
        self.port = kestrel_harness.free_port(socket.SOCK_STREAM)
        command = [kestrel_harness.binary(), "fc", "passthrough", "--fc", fc, "--listen", f"tcpserver://127.0.0.1:{self.port}"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        said = self.process.stdout.readline()
        assert "one client at a time" in said, said

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()

    def end(self):
        """Ctrl-C: what it has said since the start."""
        self.process.send_signal(signal.SIGINT)
        said, _ = self.process.communicate(timeout=10.0)
        assert self.process.returncode == 0, said
        return said


class Cable:
    """A pseudo terminal whose other end is the server's TCP port: YAMSPy speaks to serial ports only."""

    def __init__(self, port):
        self.ours, theirs = pty.openpty()
        tty.setraw(theirs)
        self.device = os.ttyname(theirs)
        self.theirs = theirs
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.is_open = True
        self.thread = threading.Thread(target=self.carry, daemon=True)
        self.thread.start()

    def carry(self):
        while self.is_open:
            for ready in select.select([self.ours, self.socket], [], [], 0.1)[0]:
                if ready is self.socket:
                    os.write(self.ours, self.socket.recv(4096))
                else:
                    self.socket.sendall(os.read(self.ours, 4096))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.is_open = False
        self.thread.join()
        self.socket.close()
        os.close(self.ours)
        os.close(self.theirs)


def ask_with_yamspy(port):
    """YAMSPy through the same questions: what it read and what it used."""
    with Cable(port) as cable:
        done = subprocess.run(
            [sys.executable, "-c", PEER, cable.device, str(ROUNDS)],
            capture_output=True,
            text=True,
            timeout=120,
            cwd=out_folder(),
        )
    assert done.returncode == 0, f"YAMSPy failed:\n{done.stdout[-500:]}\n{done.stderr[-3000:]}"
    theirs = json.loads(done.stdout.strip().splitlines()[-1])
    assert theirs["variant"] == "BTFL" and theirs["version"] == "4.6.0", theirs
    assert theirs["api"].startswith("1.47"), theirs
    roll, pitch, yaw = theirs["attitude"]
    assert abs(roll) < 2 and abs(pitch) < 2 and 0 <= yaw < 360, f"standing level: {theirs['attitude']}"
    assert 10 < theirs["analog"]["voltage"] < 17, theirs["analog"]
    assert len(theirs["rc"]) >= 8 and all(0 <= us <= 2200 for us in theirs["rc"]), theirs["rc"]
    return theirs


def ask_with_ours(url):
    """Our client through the same questions: its last words and its CPU per request in microseconds."""
    command = [kestrel_harness.binary(), "msp", "ask", url, *QUESTIONS]
    # What the start of a program costs is measured by itself and taken away.
    cpu, said = [], ""
    for rounds in (1, ROUNDS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([*command, "--count", str(rounds)], capture_output=True, text=True, timeout=60)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert done.returncode == 0, done.stderr
        cpu.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        said = done.stderr.strip()
    return said, 1e6 * (cpu[1] - cpu[0]) / ((ROUNDS - 1) * len(QUESTIONS))


def test_yamspy_reads_our_controller_and_our_client_needs_a_quarter_of_its_cpu():
    """Row 7: version, attitude, analog, RC; round trips; CPU per request <= 1/4 of YAMSPy's."""
    with Server("--serial-rate", "1000", "--baud", "1000000") as server:
        theirs = ask_with_yamspy(server.port)
        time.sleep(0.2)  # the server takes the next client when it has seen this one go
        ours_said, ours_cpu_us = ask_with_ours(server.url)
    figures = re.search(r"round trip p50 (\d+) us, p99 (\d+) us", ours_said)
    assert figures, ours_said
    p50, p99 = (int(value) / 1e3 for value in figures.groups())
    part = ours_cpu_us / theirs["cpu_us"]
    text = (
        f"round trip p50/p99 ms: ours {p50:.2f}/{p99:.2f}, YAMSPy {theirs['p50_ms']:.2f}/{theirs['p99_ms']:.2f}; "
        f"CPU per request us: ours {ours_cpu_us:.0f}, YAMSPy {theirs['cpu_us']:.0f} ({part:.2f} of it)"
    )
    assert part <= 0.25, text
    return text


def test_yamspy_reads_the_controller_through_our_pass_through():
    """Row 7: the same values by the same client, and what the way through costs; a second client is sent away."""
    with Server("--serial-rate", "1000", "--baud", "1000000") as server:
        direct = ask_with_yamspy(server.port)
        time.sleep(0.3)
        with Passthrough(server.url) as door:
            through = ask_with_yamspy(door.port)
            time.sleep(0.3)
            with msp.Msp(door.port) as first:
                assert first.ask(msp.API_VERSION)[1:3] == bytes([1, 47])
                with socket.create_connection(("127.0.0.1", door.port), timeout=5.0) as second:
                    assert second.recv(1) == b"", "two clients at once"
                assert len(first.ask(msp.ATTITUDE)) == 6, "the second client disturbed the first"
            said = door.end()
        assert said.count("has the line") == 2 and said.count("the client left") == 2, said
        for name in ("api", "variant", "version"):
            assert direct[name] == through[name]
    return (
        f"YAMSPy round trip p50/p99 ms: direct {direct['p50_ms']:.2f}/{direct['p99_ms']:.2f}, "
        f"through {through['p50_ms']:.2f}/{through['p99_ms']:.2f}"
    )


SET_RAW_RC, SET_MOTOR = 200, 214
LEVEL, IDLE, STILL = 1500, 1000, [1000] * 4


def motors(line):
    return list(struct.unpack_from("<4H", line.ask(msp.MOTOR)))


def test_pass_through_ends_when_it_arms_and_leaves_no_motor_turning():
    """Armed by the client's own sticks: it is sent away. A motor that a client left turning is stopped. SIGHUP, too."""
    with Server("--serial-rate", "1000", "--baud", "1000000") as server:
        with Passthrough(server.url) as door:
            with msp.Msp(door.port) as line:
                line.ask(SET_MOTOR, struct.pack("<8H", 1080, *[1000] * 7))
                assert motors(line)[0] == 1080, motors(line)
            time.sleep(0.5)
            with msp.Msp(door.port) as line:
                assert motors(line) == STILL, motors(line)
                began, armed_at = time.monotonic(), None
                with contextlib.suppress(AssertionError, OSError):
                    while time.monotonic() - began < 15.0:
                        arm = 2000 if time.monotonic() - began > 7.0 else 1000
                        if arm == 2000:
                            armed_at = armed_at or time.monotonic()
                        line.ask(SET_RAW_RC, struct.pack("<8H", LEVEL, LEVEL, IDLE, LEVEL, arm, 2000, 1000, 1000), 1.0)
                        time.sleep(0.02)
                sent_away = time.monotonic()
                assert armed_at and sent_away - armed_at < 3.0, "armed and still there"
            said = door.end()
        assert "is armed" in said, said
    return f"sent away {sent_away - armed_at:.2f} s after the switch"


def test_fly_lends_its_line_to_a_configurator_and_takes_it_back():
    """`fly --passthrough`: the client reads the controller, the bridge has none meanwhile and finds it again afterwards."""
    mavlink, port = kestrel_harness.free_port(), kestrel_harness.free_port(socket.SOCK_STREAM)
    log = out_folder() / f"fly-passthrough-{os.getpid()}.log"
    with Server("--serial-rate", "1000", "--baud", "1000000") as server, open(log, "w") as output:
        command = [kestrel_harness.binary(), "fly", "--fc", server.url, "--map", Room.export().plan, "--headless"]
        command += ["--mavlink", f"udpserver://127.0.0.1:{mavlink}", "--passthrough", f"tcpserver://127.0.0.1:{port}"]
        command += ["--state-dir", str(out_folder() / f"fly-passthrough-{os.getpid()}")]
        running = subprocess.Popen([str(word) for word in command], stdout=output, stderr=subprocess.STDOUT)
        try:
            station = Station(mavlink, speed=1)
            station.wait_connected()
            attitudes = []
            take = station._take

            def listen(message):
                if message.get_type() == "ATTITUDE":
                    attitudes.append(time.monotonic())
                take(message)

            station._take = listen
            station.wait_for(lambda: len(attitudes) > 5, 15.0, "the controller is heard")
            for turn in (1, 2):
                with msp.Msp(port) as line:
                    assert line.ask(msp.API_VERSION)[1:3] == bytes([1, 47])
                    for _ in range(20):
                        assert len(line.ask(msp.ATTITUDE)) == 6
                left = time.monotonic()
                station.wait_for(lambda: attitudes[-1] > left + 0.5, 15.0, "the controller is heard again")  # noqa: B023
                said = log.read_text()
                assert said.count("a configurator has the flight controller") == turn, said
                assert said.count("the configurator's time is over: the client left") == turn, said
            station.close()
            running.send_signal(signal.SIGINT)
            assert running.wait(15.0) == 0, log.read_text()
        finally:
            running.kill()
            running.wait()
    return "lent twice, taken back twice"


def hears_hangup():
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def test_a_motor_test_ends_with_motors_standing_still_however_it_is_ended():
    """Ctrl-C, SIGTERM, and SIGHUP as from a terminal that is closed."""
    with Server("--serial-rate", "1000", "--baud", "1000000") as server:
        for how in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            command = [kestrel_harness.binary(), "fc", "motor-test", "--fc", server.url]
            command += ["--props-off", "--motor", "3", "--seconds", "20"]
            # A terminal's child, also where the tests themselves run without one and ignore its end.
            running = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, preexec_fn=hears_hangup)
            assert "motor 3 at" in running.stdout.readline()
            time.sleep(0.3)
            running.send_signal(how)
            said, _ = running.communicate(timeout=10.0)
            assert running.returncode == 1 and "motors stopped" in said, f"{how.name}: {running.returncode} {said}"
            time.sleep(0.2)
            with msp.Msp(server.port) as line:
                assert motors(line) == STILL, f"{how.name}: {motors(line)}"
            time.sleep(0.2)
    return "SIGINT, SIGTERM, SIGHUP"
