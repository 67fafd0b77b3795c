"""Operator control: of several ground stations one flies, if any has asked for that."""

import random
import threading
import time

from kestrel_harness import Kestrel
from station import mav, waypoint

CONTROL = 32100
CONTROL_STATUS = 512
NOT_IN_CONTROL = 10


def ask(station, action, takeover=0):
    """Result of MAV_CMD_REQUEST_OPERATOR_CONTROL."""
    return result(station, CONTROL, action, takeover, 10, 0)


def result(station, command, *params):
    """MAV_RESULT of a command, whatever it is."""
    values = [float(p) for p in params] + [0.0] * (7 - len(params))
    # Acknowledgements go to all links; this one is ours.
    ours = station.conn.mav.srcSystem
    with station.listen("COMMAND_ACK", when=lambda m: m.command == command and m.target_system == ours) as acks:
        with station.sending() as out:
            out.command_long_send(1, 1, command, 0, *values)
        while True:
            ack = station.take(acks, what=f"COMMAND_ACK of {command}")
            if ack.result != mav.MAV_RESULT_IN_PROGRESS:
                return ack.result


def test_one_pilot_at_a_time():
    """Nobody asks: all fly. One asks: only he. STOP works for all. Handed over, lost by silence."""
    with Kestrel(seed=31, servers=2) as kestrel:
        one = kestrel.station(0, system=255)
        two = kestrel.station(1, system=254)
        one.wait_ready()
        assert result(two, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mav.MAV_RESULT_ACCEPTED
        assert result(two, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0) == mav.MAV_RESULT_ACCEPTED
        assert ask(one, 1) == mav.MAV_RESULT_ACCEPTED
        assert result(two, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == NOT_IN_CONTROL
        assert result(two, mav.MAV_CMD_DO_PAUSE_CONTINUE, 0) != NOT_IN_CONTROL
        with one.listen("COMMAND_LONG", when=lambda m: m.command == CONTROL) as asked:
            assert ask(two, 1) == mav.MAV_RESULT_FAILED
            assert one.take(asked, what="the question to the owner").param4 == 254
        assert ask(one, 0) == mav.MAV_RESULT_ACCEPTED
        assert result(one, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == NOT_IN_CONTROL, "handed over without a gap"
        two.close()
        time.sleep(3.5)
        one.wait_ready()
        assert result(one, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mav.MAV_RESULT_ACCEPTED, "a silent owner is none"


def test_random_requests_have_one_owner():
    """Whoever asks for whatever: at every instant at most one of three stations is let through."""
    rng = random.Random(8)
    with Kestrel(seed=32, servers=3) as kestrel:
        stations = [kestrel.station(i, system=250 + i) for i in range(3)]
        stations[0].wait_ready()
        assert ask(stations[0], 1, 1) == mav.MAV_RESULT_ACCEPTED
        turns = 0
        for _ in range(30):
            ask(rng.choice(stations), 1, rng.choice([0, 1, 1]))
            # A command that changes nothing on the floor, but flies by its kind.
            through = [s for s in stations if result(s, mav.MAV_CMD_DO_CHANGE_SPEED, 0, -1) != NOT_IN_CONTROL]
            assert len(through) == 1, len(through)
            turns += 1
    return f"{turns} turns"


def upload(station, items):
    """Uploads a mission as one of several who do so at once; MAV_MISSION_RESULT of what was answered to us."""
    ours = station.conn.mav.srcSystem
    kinds = ("MISSION_REQUEST_INT", "MISSION_ACK")
    with station.listen(*kinds, when=lambda m: m.mission_type == 0 and m.target_system == ours) as mailbox:
        with station.sending() as out:
            out.mission_count_send(1, 1, len(items), 0)
        while True:
            message = station.take(mailbox, 10.0, "an answer to our plan")
            if message.get_type() == "MISSION_ACK":
                return message.type
            with station.sending() as out:
                out.mission_item_int_send(1, 1, message.seq, *items[message.seq], 0)


def test_four_stations_and_a_key_console_at_once():
    """Row 7: four plans at once end as one of them, whole; answers name their asker; the console's keys and words are its own."""
    with Kestrel(seed=33, servers=5) as kestrel:
        stations = [kestrel.station(i, system=251 + i) for i in range(4)]
        console = kestrel.station(4, system=250)
        stations[0].wait_ready()
        plans = [[waypoint(0.1 * k, 0.05 * s, -1.0 - 0.1 * s) for k in range(12)] for s in range(4)]
        # Nobody hears an answer to what he did not ask: an ACK names who asked, the console's words (the libraries here know no target
        # of SERIAL_CONTROL) go out on its link alone.
        boxes = [(box.__enter__(), box) for box in (s.listen("MISSION_ACK", "SERIAL_CONTROL") for s in stations)]

        results = [None] * 4

        def fly(s):
            results[s] = upload(stations[s], plans[s])

        threads = [threading.Thread(target=fly, args=(s,)) for s in range(4)]
        for thread in threads:
            thread.start()
        lines = []
        with console.listen("SERIAL_CONTROL") as replies:
            for word in (b"status\n", b"m\n"):
                with console.sending() as out:
                    out.serial_control_send(10, 6, 0, 0, len(word), list(word.ljust(70, b"\0")))
                said = b""
                while not said.endswith(b"kestrel> "):
                    part = console.take(replies, 5.0, "the console's answer")
                    said += bytes(part.data[: part.count])
                lines.append(said)
        for thread in threads:
            thread.join(30)
        allowed = {mav.MAV_MISSION_ACCEPTED, mav.MAV_MISSION_DENIED}
        assert set(results) <= allowed and mav.MAV_MISSION_ACCEPTED in results, results
        heights = {round(item.z, 3) for item in stations[0].download()}
        whole = {round(plans[s][0][-1], 3) for s in range(4) if results[s] == mav.MAV_MISSION_ACCEPTED}
        assert len(heights) == 1 and heights <= whole, f"a mixed plan: {heights}, accepted {whole}"
        for box, context in boxes:
            while not box.empty():
                message = box.get()
                assert message.get_type() == "MISSION_ACK" and message.target_system in {0, 251, 252, 253, 254}, message
            context.__exit__(None, None, None)
        assert b"mode Hold" in lines[0], lines
    accepted = sum(r == mav.MAV_MISSION_ACCEPTED for r in results)
    return f"{accepted} of 4 plans taken one after the other, {4 - accepted} denied meanwhile"
