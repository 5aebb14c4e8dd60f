"""Plays commands on a hand and records its motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fungrasp.robots.clock import Clock, WallClock
from fungrasp.robots.device import DeviceStatus, JointDriver, RobotError
from fungrasp.sim2real.identification.motion_log import MotionLog


def record_motion(
    driver: JointDriver,
    joints: tuple[str, ...],
    commands: np.ndarray,
    rate: float,
    gravity: np.ndarray,
    stopped: Callable[[], bool] = lambda: False,
    clock: Clock | None = None,
    weight: float = 0.0,
) -> MotionLog:
    """Command goals at a rate and record what was sent and measured at each; stop when anything is wrong.

    Args:
        driver: connected.
        joints: names of its joints, length U.
        commands: goals [rad], shape [T, U].
        rate: [Hz].
        gravity: in the palm's frame [m/s^2], shape [3].
        stopped: whether to end early.
        clock: of the device; that of the wall if None.
        weight: mass that is fixed to each fingertip [kg].

    Raises:
        RobotError: the device stopped.
    """
    times, sent, measured = [], [], []
    clock = clock or WallClock()
    began = clock.now()
    try:
        for row, goal in enumerate(commands):
            clock.sleep_until(began + row / rate)
            if stopped():
                break
            now = clock.now()
            sent.append(driver.command(goal))
            state = driver.read()
            if state.status is not DeviceStatus.READY:
                raise RobotError(f"{driver.name} stopped while moving: {state.status} {state.message}")
            times.append(now - began)
            measured.append(state.positions)
    finally:
        driver.stop()
    return MotionLog(joints, np.array(times), np.array(sent), np.array(measured), gravity, weight)
