"""Operator control: of several ground stations one flies, if any has asked for that."""

import random
import time

from kestrel_harness import Kestrel
from station import mav

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
