"""A third pilot for the test of two browsers: asks for control and gives it back at random, and tries to fly when it is told to.

    pilot.py HOST:PORT SYSTEM SEED

One line of JSON for each word on standard input: `ask` (asks, or gives back), `probe` (a command that flies by its kind), `end`. Needs
pymavlink.
"""

import json
import random
import select
import sys
import time

from pymavlink.dialects.v20 import common as mav
from pymavlink import mavutil

CONTROL = 32100
NOT_IN_CONTROL = 10


def main():
    where, system, seed = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    rng = random.Random(seed)
    conn = mavutil.mavlink_connection(f"udpout:{where}", source_system=system, source_component=190, dialect="common")
    beat = 0.0
    waiting = None  # what is asked, its command, until when

    def say(**words):
        print(json.dumps({"at": time.time() * 1e3, **words}), flush=True)

    def command(number, *params):
        values = [float(p) for p in params] + [0.0] * (7 - len(params))
        conn.mav.command_long_send(1, 1, number, 0, *values)

    while True:
        now = time.monotonic()
        if now - beat >= 0.5:
            beat = now
            conn.mav.heartbeat_send(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE)
        ready, _, _ = select.select([sys.stdin, conn.fd], [], [], 0.05)
        if sys.stdin in ready:
            word = sys.stdin.readline().strip()
            if word in ("", "end"):
                return
            if word == "ask":
                number, params = CONTROL, (rng.choice([0, 1, 1]), rng.choice([0, 1, 1]), 10, 0)
            else:
                number, params = mav.MAV_CMD_DO_CHANGE_SPEED, (0, -1)
            command(number, *params)
            waiting = (word, number, now + 3.0)
        while (message := conn.recv_match(blocking=False)) is not None:
            if message.get_srcSystem() != 1:
                continue
            if message.get_type() != "COMMAND_ACK" or waiting is None:
                continue
            # Acknowledgements go to all links; this one is ours.
            if message.command == waiting[1] and message.target_system == system and message.result != mav.MAV_RESULT_IN_PROGRESS:
                say(kind=waiting[0], result=message.result, through=message.result != NOT_IN_CONTROL)
                waiting = None
        if waiting is not None and now > waiting[2]:
            say(kind=waiting[0], result=None, through=None)
            waiting = None


if __name__ == "__main__":
    main()
