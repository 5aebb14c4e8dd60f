"""Plays an excitation on a hand and records its motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fungrasp.robots.device import Clock, DeviceStatus, JointDriver, RobotError, WallClock
from fungrasp.sim2real.identification.excitation import ExcitationMotion
from fungrasp.sim2real.identification.motion_log import (
    MotionHeader,
    MotionLog,
    MotionSample,
    motion_log,
)


def record_motion(
    driver: JointDriver,
    joints: tuple[str, ...],
    motion: ExcitationMotion,
    rate: float,
    gravity: np.ndarray,
    clock: Clock | None = None,
    weight: float = 0.0,
    keep: Callable[[MotionHeader, MotionSample], None] = lambda header, sample: None,
) -> MotionLog:
    """Command goals at a rate and record what was sent and measured at each; stop when anything is wrong. In
    the end, however it comes, the device is told to hold.

    Args:
        driver: connected.
        joints: names of its joints, length U.
        motion: of these.
        rate: [Hz].
        gravity: in the palm's frame [m/s^2], shape [3].
        clock: of the device; that of the wall if None.
        weight: mass that is fixed to each fingertip [kg].
        keep: called with each row at once.

    Raises:
        RobotError: the device stopped.
    """
    clock = clock or WallClock()
    header, samples = MotionHeader(joints, gravity, weight, driver.limits.velocity), []
    try:
        # A device that must be made ready first is not waited for while it moves.
        driver.take_control()
        began = clock.now()
        for row, goal in enumerate(motion.commands):
            clock.sleep_until(began + row / rate)
            now = clock.now()
            sent = driver.command(goal)
            state = driver.read()
            if state.status is not DeviceStatus.READY:
                raise RobotError(f"{driver.name} stopped while moving: {state.status} {state.message}")
            sample = MotionSample(
                now - began,
                state.device_time,
                state.received - began,
                tuple(np.flatnonzero(motion.moving[row]).tolist()),
                sent,
                state.positions,
            )
            keep(header, sample)
            samples.append(sample)
    finally:
        driver.stop()
    return motion_log(header, samples)
