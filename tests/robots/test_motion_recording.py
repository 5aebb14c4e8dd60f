"""Identification's recording on a twin's hand: both stamps, and what is left when it is broken off."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from robot_cells import cell_and_hand
from twin_robots import twin_robot

from fungrasp.core.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.robots.assembly import hand_driver
from fungrasp.robots.cell import load_cell
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import DeviceStatus, RobotError, SafetyStop
from fungrasp.robots.single_devices import GuardedDriver, record_motion
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.devices import TwinHand
from fungrasp.sim2real.identification.excitation import Excitation, ExcitationLimits, safe_motion
from fungrasp.sim2real.identification.motion_log import (
    MotionHeader,
    MotionLogWriter,
    MotionSample,
    load_motion_log,
)


def record(path: Path, switch: StopSwitch, after: Callable[[int, TwinHand], None]) -> TwinHand:
    """Record the index finger of a twin's hand, and call something after each row."""
    cell, hand = cell_and_hand()
    robot, _ = twin_robot(cell)
    twin, clock = robot.hand_driver, robot.clock
    assert isinstance(twin, TwinHand)
    driver = GuardedDriver(twin, cell, "hand", clock=clock, switch=switch)
    driver.connect()
    rest, limits = driver.read().positions, driver.limits
    e = Excitation(seconds=3.5)
    room = ExcitationLimits(limits.lower, limits.upper, limits.velocity, limits.torque)
    motion = safe_motion(e, hand, rest, room, np.zeros(3))
    with MotionLogWriter(path) as writer:

        def keep(header: MotionHeader, sample: MotionSample) -> None:
            writer.add(header, sample)
            after(writer.rows, twin)

        try:
            record_motion(driver, tuple(hand.actuators), motion, e.rate, np.zeros(3), clock=clock, keep=keep)
        except FungraspError as error:
            assert twin.read().status in (DeviceStatus.STOPPED, DeviceStatus.FAULT)
            raise error
        finally:
            # Whoever is killed now has written all that was recorded.
            assert len(load_motion_log(path).times) == writer.rows
    return twin


@pytest.mark.parametrize("what", ["stop file", "stop key", "fault", "Ctrl-C"])
def test_what_was_recorded_until_a_stop_can_be_fitted(what: str, tmp_path: Path) -> None:
    path, switch = tmp_path / "log.jsonl", StopSwitch(tmp_path / "stop")

    def after(rows: int, hand: TwinHand) -> None:
        if rows == 200 and what == "stop file":
            (tmp_path / "stop").touch()
        elif rows == 200 and what == "stop key":
            switch.press("the stop key was pressed")
        elif rows == 200 and what == "fault":
            hand.fault = "too hot"
        elif rows == 200:
            raise KeyboardInterrupt

    kinds = {"fault": RobotError, "Ctrl-C": KeyboardInterrupt}
    with pytest.raises(kinds.get(what, SafetyStop)):
        record(path, switch, after)
    log = load_motion_log(path).excited()
    assert len(log.times) == 200 and log.joints == ("ffj0", "ffj1", "ffj2", "ffj3")
    log.check_excitation()
    assert np.isfinite(log.speed).all() and (np.diff(log.measured) > 0).all()


def test_a_hand_is_told_to_make_less_torque() -> None:
    allegro, inspire = load_cell("ur5e-allegro-emulated"), load_cell("ur5e-inspire-emulated")
    for cell, name, value in ((allegro, "torque_share", 0.5), (inspire, "force", 250)):
        driver = hand_driver(cell, load_hand(cell.hand))
        assert isinstance(driver, LoopDriver)
        driver.torque_limit(0.5)
        assert getattr(driver._loop.settings, name) == value  # pyright: ignore
        with pytest.raises(RobotError, match="share of the torque"):
            driver.torque_limit(0.0)


def test_fingers_take_turns_and_stay_where_they_were() -> None:
    hand = load_hand("inspire")
    limits = np.array([hand.joint_limits[hand.joint_names.index(name)] for name in hand.actuators])
    rest, room = limits.mean(axis=1), ExcitationLimits(*limits.T, 2 * np.ones(6))
    motion = safe_motion(Excitation(seconds=4.0), hand, rest, room, np.zeros(3))
    fingers = np.unique(motion.moving, axis=0)
    assert len(fingers) == 5 and fingers.sum(axis=0).tolist() == [1] * 6
    assert (np.where(motion.moving, rest, motion.commands) == rest).all()
