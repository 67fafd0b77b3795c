"""MSP on the running Betaflight firmware (simulator build): what our program reads is what its bytes say; RC frames keep it armed, and
without them it disarms in its own time; it arms only after it has seen the switch low."""

import json
import shutil
import struct
import subprocess
import tempfile
import time
from pathlib import Path

import msp
from kestrel_harness import binary, free_port, out_folder, run
from rooms import Room
from station import Station
from test_firmware import FC, the_firmware

RC, ANALOG, SET_RAW_RC = 105, 110, 200


def read_by_kestrel(*names):
    """Fields of each message, as `kestrel msp ask` prints them."""
    done = run("msp", "ask", FC, *names, timeout=30)
    assert done.returncode == 0, done.stderr
    return {row["name"]: row["fields"] for row in map(json.loads, done.stdout.splitlines())}


def told_by_mavlink(folder):
    """Battery and signal of `kestrel fly` beside the firmware's own bytes, asked on its second port at the same time."""
    port = free_port()
    command = [binary(), "fly", "--fc", FC, "--map", Room.export("office").plan, "--headless", "--quiet"]
    flying = subprocess.Popen([*command, "--state-dir", folder / "state", "--mavlink", f"udpserver://127.0.0.1:{port}"])
    station = Station(port, speed=1)
    try:
        station.wait_connected()
        station.sleep(3.0)
        with msp.Msp(msp.UART1 + 1) as line:
            volts, drawn, rssi, current = struct.unpack("<BHHh", line.ask(ANALOG)[:7])
        battery, status = station.next("BATTERY_STATUS"), station.next("SYS_STATUS")
        if volts:
            cells = sum(mv for mv in battery.voltages if mv != 65535)
            assert abs(cells - 100 * volts) <= 100 and abs(status.voltage_battery - 100 * volts) <= 100, (battery, volts)
        else:  # no battery is connected to the simulator build: no voltage, and none is made up
            assert battery.voltages[0] in (0, 65535) and status.voltage_battery in (0, 65535), (battery, status)
        assert battery.current_battery in (-1, current) and battery.current_consumed in (-1, drawn), (battery, current, drawn)
        signal = station.next("RC_CHANNELS").rssi
        assert signal == 255 or abs(signal - 254 * rssi / 1023) <= 2, (signal, rssi)
    finally:
        station.close()
        flying.terminate()
        flying.wait(40)
    return f"{volts / 10} V, {current / 100} A, {drawn} mAh, signal {rssi} of 1023 and {signal} of 254"


def test_attitude_analog_rc_and_motor_of_the_running_firmware():
    """Four of SNSI's six messages, read by Kestrel and, byte by byte, here. The other two are sent by the tests of motors and RC."""
    folder = Path(tempfile.mkdtemp(prefix="wire-", dir=out_folder()))
    with the_firmware() as program, msp.Firmware(program, folder) as firmware:
        firmware.make_sure_it_runs()
        firmware.sends_rc = True
        firmware.channels[:4] = [1620, 1450, 1100, 1380]
        time.sleep(1.0)
        with msp.Msp() as line:
            raw = {number: line.ask(number) for number in (msp.ATTITUDE, ANALOG, RC, msp.MOTOR)}
        said = read_by_kestrel("attitude", "analog", "rc", "motor")
        roll, pitch, yaw = struct.unpack("<3h", raw[msp.ATTITUDE][:6])
        ours = said["MSP_ATTITUDE"]
        assert abs(ours["roll_ddeg"] - roll) <= 3 and abs(ours["pitch_ddeg"] - pitch) <= 3, (ours, roll, pitch)
        assert abs((ours["yaw_deg"] - yaw + 180) % 360 - 180) <= 1, (ours, yaw)
        volts, drawn, rssi, current = struct.unpack("<BHHh", raw[ANALOG][:7])
        ours = said["MSP_ANALOG"]
        assert [ours["vbat_dv"], ours["drawn_mah"], ours["rssi"], ours["current_ca"]] == [volts, drawn, rssi, current], (ours, raw[ANALOG].hex())
        channels = struct.unpack(f"<{len(raw[RC]) // 2}H", raw[RC])
        ours = said["MSP_RC"]["channels_us"]
        assert all(abs(a - b) <= 1 for a, b in zip(ours, channels)) and len(ours) == len(channels), (ours, channels)
        assert {1620, 1450, 1100, 1380} <= {us + d for us in ours[:4] for d in (-1, 0, 1)}, ours
        motors = struct.unpack("<8H", raw[msp.MOTOR][:16])
        assert said["MSP_MOTOR"]["motors_us"][:4] == list(motors[:4]), (said["MSP_MOTOR"], motors)
        told = told_by_mavlink(folder)
    shutil.rmtree(folder)
    return f"{told}; attitude {roll} {pitch} {yaw}, analog {raw[ANALOG].hex()}, rc {channels[:4]}, motors {motors[:4]}"


class Sticks:
    """RC frames over MSP, ten a second."""

    def __init__(self, line):
        self.line, self.arm = line, 1000

    def frame(self):
        """Neutral sticks, throttle low, the arm switch on Aux1; whether it is armed after that."""
        channels = [1500, 1500, 1000, 1500, self.arm] + [1000] * 11
        self.line.ask(SET_RAW_RC, struct.pack("<16H", *channels))
        return bool(self.line.ask(msp.STATUS)[6] & 1)

    def stream(self, seconds, until=None):
        """What each status said, until it says this."""
        said, end = [], time.monotonic() + seconds
        while time.monotonic() < end:
            said.append(self.frame())
            if until is not None and said[-1] == until:
                break
            time.sleep(0.1)
        return said


def test_rc_frames_keep_it_armed_and_silence_disarms_it():
    """Provisioned by `kestrel fc provision`: a switch that was never low arms nothing, after a neutral phase it arms, ten frames a second
    keep it armed, and without frames it disarms by itself within its failsafe's time."""
    folder = Path(tempfile.mkdtemp(prefix="rc-", dir=out_folder()))
    with the_firmware() as program, msp.Firmware(program, folder) as firmware:
        firmware.make_sure_it_runs()
        done = run("fc", "provision", "--fc", FC, "--yes", "--save", folder / "old.json", timeout=90)
        assert done.returncode == 0, done.stderr
        firmware.make_sure_it_runs()
        time.sleep(6.0)  # boot grace
        with msp.Msp() as line:
            sticks = Sticks(line)
            sticks.arm = 2000
            assert not any(sticks.stream(2.5)), "armed by a switch that was never low"
            sticks.arm = 1000
            assert not any(sticks.stream(1.5))
            sticks.arm = 2000
            assert sticks.stream(3.0, until=True)[-1], "does not arm after the neutral phase"
            assert all(sticks.stream(3.0)), "it did not stay armed"
            began = time.monotonic()
            while line.ask(msp.STATUS)[6] & 1:
                assert time.monotonic() - began < 8.0, "armed for ever without RC frames"
                time.sleep(0.05)
            took = time.monotonic() - began
    shutil.rmtree(folder)
    assert 0.2 < took < 4.0, f"{took:.2f} s"
    return f"disarmed {took:.2f} s after the last frame"
