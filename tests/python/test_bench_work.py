"""What a station does to the flight controller on the ground: calibrate, turn a motor, restart; and what it may not do in the air."""

from kestrel_harness import Kestrel
from station import NAN, mav

CALIBRATE, MOTOR, ACTUATOR, REBOOT = 241, mav.MAV_CMD_DO_MOTOR_TEST, 310, 246


def test_calibration_motor_test_and_restart_on_the_ground_only():
    """PX4's words for calibrations; a motor test only with KST_MOTOR_TEST and never beside an arm; all refused in the air."""
    with Kestrel(seed=101, speed=2, name="bench") as kestrel:
        station = kestrel.station()
        station.wait_ready()
        for params, name in (((0, 0, 0, 0, 2), "level"), ((0, 0, 0, 0, 1), "accel")):
            began = station.now
            station.command(CALIBRATE, *params)
            # The controller says CALIBRATING: an arm is refused meanwhile.
            station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, expect=("TEMPORARILY_REJECTED",))
            station.wait_for(lambda name=name, since=began: station.has_said(f"[cal] calibration done: {name}", since_s=since - 1), 8.0, "done")
        station.command(CALIBRATE, 0, 1, expect="UNSUPPORTED")
        station.command(CALIBRATE, 0, 0, 0, 0, 0, 0, 0)

        station.command(MOTOR, 1, 0, 8, 1, expect="DENIED")
        station.wait_for(lambda: station.has_said("propellers off", "KST_MOTOR_TEST"), 3.0, "the reason")
        station.set_param("KST_MOTOR_TEST", 1)
        station.command(MOTOR, 1, 0, 8, 2)
        station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, expect="TEMPORARILY_REJECTED")
        station.command(MOTOR, 2, 1, 1100, 1)
        station.command(MOTOR, 1, 0, 80, 1, expect="DENIED")
        station.command(MOTOR, 1, 0, NAN, 1, expect=("ACCEPTED", "DENIED"))
        station.sleep(2.5)
        station.command(ACTUATOR, 0.1, 1, 0, 0, 3)
        station.command(ACTUATOR, NAN, 0, 0, 0, 3)
        station.sleep(1.0)
        station.set_param("KST_MOTOR_TEST", 0)

        station.command(REBOOT, 1)
        station.wait_for(lambda: not station.is_ready, 4.0, "the flight controller is away")
        station.wait_for(lambda: station.is_ready, 15.0, "it is back")
        station.take_off(1.0)
        station.command(CALIBRATE, 1, expect="DENIED")
        station.command(MOTOR, 1, 0, 8, 1, expect="DENIED")
        station.command(REBOOT, 1, expect="DENIED")
        station.land()
    truth = kestrel.truth()
    assert truth.contacts() == 0 and truth.landing_error() < 0.3
