"""Every block of code in README, CONTRIBUTING and docs is run as it is printed, or says in a comment before it why not:

    <!-- not run: REASON -->          on the machine of a reader only
    <!-- run by: test_x.test_y -->    another test runs these very words
    <!-- words of: PATH -->           output; its words stand in that source

Blocks of `sh` run line by line in a folder of their own that has what the pages speak of: plans/house.yaml, a recorded flight, a
simulated flight controller and simulated sensors in place of the devices. Programs that go on (`kestrel sim`, `fly`, `rehearse`)
must come up, and end with exit 0 on Ctrl-C. Addresses and devices are replaced, `--headless` and `--state-dir` are added; nothing else.
"""

import contextlib
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import kestrel_harness
from kestrel_harness import WORKSPACE, Skipped, airspace, free_port, out_folder
from test_plans import house, png

PAGES = [WORKSPACE / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")] + sorted((WORKSPACE / "docs").glob("*.md"))
RUNNABLE = {"sh", "python", "toml", "yaml", "c", "diff"}
GOES_ON = re.compile(r"kestrel (sim|fly|rehearse)\b|kestrel replay .*--mavlink")


@dataclass
class Block:
    """A fenced block."""

    page: str
    line: int
    language: str
    text: str
    marker: tuple  # (kind, rest) or None

    def __str__(self):
        return f"{self.page}:{self.line}"


def blocks(path):
    """All of a page."""
    found, lines, at = [], path.read_text().splitlines(), 0
    while at < len(lines):
        if not lines[at].startswith("```"):
            at += 1
            continue
        end = next(i for i in range(at + 1, len(lines)) if lines[i].startswith("```"))
        before = next((line for line in reversed(lines[:at]) if line.strip()), "")
        marker = re.fullmatch(r"<!-- (not run|run by|words of): (.+) -->", before.strip())
        text = "\n".join(lines[at + 1 : end]) + "\n"
        found.append(Block(path.name, at + 1, lines[at][3:].strip(), text, marker and marker.groups()))
        at = end + 1
    return found


def commands(text):
    """Lines of a shell block: continued ones joined, comments away, a leading `$ ` too."""
    joined = re.sub(r"\\\n\s*", "", text)
    for line in joined.splitlines():
        line = re.sub(r"\s+#.*$", "", re.sub(r"^#.*$", "", line)).strip().removeprefix("$ ")
        if line:
            yield line


def test_every_block_is_run_or_says_why_not():
    """Each block has a language that is run, or a marker whose test or source is there."""
    run, marked = 0, 0
    for path in PAGES:
        for block in blocks(path):
            kind, rest = block.marker or (None, "")
            if kind == "run by":
                file, _, function = rest.removeprefix("test_").partition(".")
                text = (WORKSPACE / "tests" / "python" / f"test_{file}.py").read_text()
                assert f"\ndef {function}(" in text, f"{block}: there is no {rest}"
            elif kind == "words of":
                source = (WORKSPACE / rest).read_text()
                for line in block.text.splitlines():
                    phrases = re.findall(r"[A-Za-z,;]+(?: [A-Za-z,;]+){2,}", line)
                    assert any(phrase in source for phrase in phrases), f"{block}: {rest} never says {line!r}"
            elif kind is None:
                assert block.language in RUNNABLE, f"{block}: what is a block of {block.language!r}? Name a language that is run, or say why not"
                run += 1
            marked += kind is not None
    assert run > 20, run
    return f"{run} blocks are run, {marked} say why not"


class Scene:
    """A folder with what a page speaks of, and its shell."""

    def __init__(self, page):
        self.page = page
        self.folder = Path(tempfile.mkdtemp(prefix=f"docs-{Path(page).stem}-", dir=out_folder()))
        self.resources = contextlib.ExitStack()
        self.fc, self.mavlink, self.console = free_port(socket.SOCK_STREAM), free_port(), free_port(socket.SOCK_STREAM)
        self.ran = 0
        self.world = None

    def __enter__(self):
        self.resources.enter_context(airspace())
        (self.folder / "bin").mkdir()
        (self.folder / "bin" / "kestrel").symlink_to(kestrel_harness.binary())
        (self.folder / "home").mkdir()
        return self

    def __exit__(self, kind, error, traceback):
        self.resources.close()
        if kind is None and not os.environ.get("KESTREL_KEEP"):
            shutil.rmtree(self.folder, ignore_errors=True)
        return False

    @property
    def environment(self):
        paths = f"{self.folder / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}"
        return os.environ | {"PATH": paths, "HOME": str(self.folder / "home"), "MAVLINK20": "1"}

    # -- what pages speak of --------------------------------------------------------------------------------------------

    def draw_house(self):
        """plans/house.yaml with the rooms lab and hall, and the scan it was made from."""
        (self.folder / "scan.png").write_bytes(png(444, 224, house))
        marks = "--scale 20,20,420,20,10 --home 100,150 --room lab,100,150 --room hall,330,120 --door lab-hall,222,60,222,100 "
        marks += "--wall 290,202,320,202 --rubber 110,90,190,120 -o plans/house.yaml"
        self.shell(f"kestrel map import scan.png {marks}")

    def devices(self):
        """A simulated vehicle: flight controller on TCP, lidar and flow on pseudo terminals."""
        sensors = [f"--sensor ld06://{self.folder}/lidar", f"--sensor msp://{self.folder}/flow"]
        self.world = self.start(f"kestrel rehearse office --fc tcpserver://127.0.0.1:{self.fc} {' '.join(sensors)}")
        self.shell("kestrel rooms office --export plans/")

    def plan_here(self):
        """The exported plan in the folder itself."""
        for name in ("plan.yaml", "plan.pgm"):
            shutil.copy(self.folder / "plans" / name, self.folder / name)

    def replaced(self, line):
        """The line with other addresses and devices."""
        pairs = [
            (r"serial:///dev/tty(AMA|ACM)0(\?baudrate=\d+)?", f"tcpclient://127.0.0.1:{self.fc}"),
            (r"tcpclient://127\.0\.0\.1:5761", f"tcpclient://127.0.0.1:{self.fc}"),
            (r"/dev/ttyUSB0", f"{self.folder}/lidar"),
            (r"/dev/ttyUSB1", f"{self.folder}/flow"),
            (r"/tmp/(lidar|flow)", rf"{self.folder}/\1"),
            (r"(udpserver://127\.0\.0\.1):14555", rf"\1:{self.mavlink}"),
            (r"udpclient://(192\.168\.1\.2|127\.0\.0\.1):14550", f"udpclient://127.0.0.1:{free_port()}"),
            (r"--console( (127\.0\.0\.1|0\.0\.0\.0):8443)?$", f"--console 127.0.0.1:{self.console}"),
            (r"\bkestrel mav ", f"kestrel mav --to udpclient://127.0.0.1:{self.mavlink} "),
            (r"cargo run --release -- ", "kestrel "),
        ]
        for pattern, replacement in pairs:
            line = re.sub(pattern, replacement, line)
        if re.match(r"kestrel (sim|fly)\b", line):
            line += f" --headless --state-dir {self.folder}/state"
            if "--mavlink" not in line:
                line += f" --mavlink udpserver://127.0.0.1:{self.mavlink}"
        if line.startswith("kestrel rehearse") and "--fc" not in line:
            line += f" --fc tcpserver://127.0.0.1:{free_port(socket.SOCK_STREAM)}"
            line = line.replace(f"{self.folder}/", f"{self.folder}/own-")
        if line.startswith("kestrel demo"):
            line += " --headless --speed max --out demo"
        return line

    # -- its shell --------------------------------------------------------------------------------------------------------

    def shell(self, line, typed="", codes=(0,)):
        """A command that ends."""
        done = subprocess.run(
            ["bash", "-c", line], cwd=self.folder, env=self.environment, capture_output=True, text=True, input=typed, timeout=120
        )
        assert done.returncode in codes, f"{self.page}: {line}\nexit {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        assert "panicked at" not in done.stderr, done.stderr
        return done.stdout + done.stderr

    def start(self, line):
        """A program that goes on; returns once it has said something and lives. (A replay says nothing before its end.)"""
        log = open(self.folder / f"program-{self.ran}.log", "w+")
        self.ran += 1
        running = subprocess.Popen(
            ["bash", "-c", f"exec {line}"], cwd=self.folder, env=self.environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
        )
        self.resources.callback(running.kill)
        deadline = time.monotonic() + 30.0
        while not Path(log.name).stat().st_size and "replay" not in line:
            assert running.poll() is None and time.monotonic() < deadline, f"{self.page}: {line} said nothing, exit {running.poll()}"
            time.sleep(0.05)
        return running

    def goes_on(self, line):
        """It comes up, stays, and ends well on Ctrl-C."""
        running = self.start(line)
        log = self.folder / f"program-{self.ran - 1}.log"
        with contextlib.suppress(subprocess.TimeoutExpired):
            running.wait(1.5)
        said = log.read_text()
        assert running.poll() is None, f"{self.page}: {line}\nended with {running.poll()}\n{said}"
        running.send_signal(signal.SIGINT)
        wanted = (0, -signal.SIGINT) if "replay" in line else (0,)
        assert running.wait(40.0) in wanted, f"{self.page}: {line}\n{log.read_text()}"
        assert "panicked at" not in log.read_text()

    def run(self, only=None, typed="", codes=(0,)):
        """The page's blocks of `sh`, in their order."""
        for block in blocks(WORKSPACE / ("docs" if self.page != "README.md" else "") / self.page):
            if block.language == "sh" and block.marker is None:
                for line in commands(block.text):
                    if only and not only(line):
                        continue
                    line = self.replaced(line.removesuffix(" &"))
                    if GOES_ON.match(line):
                        self.goes_on(line)
                    else:
                        self.shell(line, typed=typed, codes=codes)
                    self.ran += 1
        assert self.ran, f"{self.page} has no command"
        return f"{self.ran} commands"


def test_readme():
    """The demo draws its flight."""
    with Scene("README.md") as scene:
        ran = scene.run()
        assert (scene.folder / "demo" / "flight.svg").exists()
    return ran


def test_console_page():
    with Scene("console.md") as scene:
        scene.devices()
        scene.plan_here()
        scene.replaced_before = scene.replaced
        fly = f"kestrel fly --fc tcpclient://127.0.0.1:{scene.fc} --map plan.yaml"
        scene.replaced = lambda line: scene.replaced_before(line.replace("kestrel fly ...", fly))
        return scene.run(typed="correct horse battery\n")


def test_first_flight_page():
    with Scene("first-flight.md") as scene:
        scene.draw_house()
        scene.devices()
        return scene.run()


def test_plans_page():
    """The drawing becomes a plan; the printed YAML is one."""
    with Scene("plans.md") as scene:
        (scene.folder / "scan.png").write_bytes(png(444, 224, house))
        ran = scene.run()
        block = next(b for b in blocks(WORKSPACE / "docs" / "plans.md") if b.language == "yaml")
        (scene.folder / "plan.yaml").write_text(block.text)
        # Ground 10 x 8 m with walls around and one between the rooms, open where the door is: row 0 is the top.
        wide, high = 200, 160

        def grey(x, y):
            wall = x < 2 or y < 2 or x >= wide - 2 or y >= high - 2 or (74 <= high - 1 - y < 76 and not 72 <= x <= 90) or False
            return 0 if (wall or 84 == high - 1 - y and not 72 <= x < 90) else 254

        (scene.folder / "ground.pgm").write_bytes(b"P5\n200 160\n255\n" + bytes(grey(x, y) for y in range(high) for x in range(wide)))
        said = scene.shell("kestrel map show plan.yaml")
        assert "lab" in said and "no-fly zone of 3 corners" in said, said
        return ran


def test_patrols_page():
    with Scene("patrols.md") as scene:
        scene.draw_house()
        return scene.run()


def test_avoidance_page():
    with Scene("avoidance.md") as scene:
        posts = [(-2.0 + 0.9 * (k % 3 - 1), 5.0 + k, 0.15) for k in range(6)]
        (scene.folder / "world_000.csv").write_text("x_m,y_m,radius_m\n" + "".join(f"{x},{y},{r}\n" for x, y, r in posts))
        return scene.run()


def test_logs_page():
    with Scene("logs.md") as scene:
        scene.shell("kestrel demo --headless --speed max --out demo --log 0007.log")
        return scene.run()


def test_accuracy_and_speed_page():
    with Scene("accuracy-and-speed.md") as scene:
        return scene.run()


def test_mav_page():
    """All words of the client, in the order of the page, on a vehicle that flies."""
    with Scene("mav.md") as scene:
        scene.shell("kestrel plan office -o plan.plan")
        world = scene.start(
            f"kestrel sim office --seed 5 --speed 4 --headless --state-dir state --mavlink udpserver://127.0.0.1:{scene.mavlink}"
        )
        scene.shell(f"for i in $(seq 40); do kestrel mav --to udpclient://127.0.0.1:{scene.mavlink} status | grep 'would be accepted' && exit; done; exit 1")
        ran = scene.run()
        world.send_signal(signal.SIGINT)
        assert world.wait(40.0) == 0
        return ran


def test_sensors_page():
    """Commands on simulated devices; each table as a configuration file; the C of the microcontroller, compiled and run."""
    with Scene("sensors.md") as scene:
        scene.devices()
        scene.plan_here()
        ran = scene.run(only=lambda line: "touch" not in line)
        page = blocks(WORKSPACE / "docs" / "sensors.md")
        for number, block in enumerate(b for b in page if b.language == "toml"):
            (scene.folder / f"{number}.toml").write_text(scene.replaced(block.text))
            line = f"kestrel fly --fc tcpclient://127.0.0.1:{scene.fc} --map plan.yaml --config {number}.toml"
            if "gpiochip" in block.text and not Path("/dev/gpiochip0").exists():
                # Read and understood; only the lines of the header are not there.
                assert "/dev/gpiochip0" in scene.shell(f"timeout 20 {scene.replaced(line)}", codes=(1, 2, 124))
            else:
                scene.goes_on(scene.replaced(line))
        c = next(b for b in page if b.language == "c")
        if shutil.which("gcc"):
            check_c(scene, c)
        return ran


def check_c(scene, block):
    """The function sends what the page says, byte by byte."""
    program = "#include <stdint.h>\n#include <stdio.h>\nstruct { void (*write)(uint8_t *, int); } Serial1;\n"
    program += "static void out(uint8_t *f, int n) { fwrite(f, 1, n, stdout); }\n" + block.text
    program += "int main() { uint16_t mm[64]; for (int i = 0; i < 64; i++) mm[i] = 100 + i; Serial1.write = out; send(3, 9, mm, 258); }\n"
    (scene.folder / "send.c").write_text(program)
    scene.shell("gcc -Wall -o send send.c")
    frame = subprocess.run([scene.folder / "send"], capture_output=True, check=True).stdout
    body = bytes([2, 64, 3, 9, 2, 1]) + b"".join((100 + i).to_bytes(2, "little") for i in range(64))
    crc = 0xFFFF
    for byte in body:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    assert frame == b"KR" + body + crc.to_bytes(2, "little"), frame.hex()


def test_troubleshooting_page():
    with Scene("troubleshooting.md") as scene:
        scene.shell("kestrel demo --headless --speed max --out demo --log 0007.log")
        scene.devices()
        fly = f"kestrel fly --fc tcpclient://127.0.0.1:{scene.fc} --map plans/plan.yaml --headless --state-dir state"
        running = scene.start(f"{fly} --mavlink udpserver://127.0.0.1:{scene.mavlink}")
        ran = [scene.run(only=lambda line: "mav" in line)]
        running.send_signal(signal.SIGINT)
        assert running.wait(40.0) == 0
        ran.append(scene.run(only=lambda line: "mav" not in line, typed="correct horse battery\n", codes=(0, 1)))
        return ", ".join(ran)


def test_uquad_page():
    with Scene("uquad.md") as scene:
        data = Path(os.environ.get("KESTREL_DATA", WORKSPACE.parent / "shared/data")) / "uquad"
        has_data = (data / "imu_raw_still.log").exists()
        if has_data:
            (scene.folder / "imu_raw.log").symlink_to(data / "imu_raw_still.log")
            (scene.folder / "imu_calib.txt").symlink_to(data / "imu_calib_final.txt")
        return scene.run(only=lambda line: has_data or "imu_raw.log" not in line)


def test_diffs_of_contributing_apply():
    """What CONTRIBUTING.md shows as a change can be made to the tree as it is."""
    page = WORKSPACE / "CONTRIBUTING.md"
    diffs = [b for b in blocks(page) if b.language == "diff"]
    if not shutil.which("git"):
        raise Skipped("git is not here")
    for block in diffs:
        assert block.text.startswith("--- a/"), f"{block}: which file?"
        done = subprocess.run(
            ["git", "apply", "--check", "-"], cwd=WORKSPACE, input=block.text, capture_output=True, text=True, timeout=20
        )
        assert done.returncode == 0, f"{block}: {done.stderr}"
    return f"{len(diffs)} diffs"
