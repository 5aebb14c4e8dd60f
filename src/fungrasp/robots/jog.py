"""One joint of one device, slowly: what comes before anything is grasped."""

from __future__ import annotations

import numpy as np

from fungrasp.robots.clock import Clock, WallClock
from fungrasp.robots.device import DeviceStatus, JointState, RobotError
from fungrasp.robots.guarded_driver import GuardedDriver

PERIOD = 0.02
"""Between goals [s]."""

SPEED = 0.1
"""Of the joint [rad/s]."""

LARGEST = 0.2
"""A joint moves no farther at once [rad]."""


def jog(
    driver: GuardedDriver, joint: int, by: float, clock: Clock | None = None
) -> tuple[JointState, JointState]:
    """Move one joint slowly by an angle, then back; the others hold where they are.

    Args:
        driver: connected.
        joint: its number.
        by: angle [rad].
        clock: of the device; that of the wall if None.

    Returns:
        the state at the far end, and at the end.

    Raises:
        SafetyStop: the guard or the switch stopped the device.
        RobotError: the angle is too large or beyond the joint's limits, or the device follows no more.
    """
    if not 0 < abs(by) <= LARGEST:
        raise RobotError(f"a joint is moved by {LARGEST:g} rad at most, and not by nothing: {by:g}")
    rest = driver.read().positions
    far = rest.copy()
    far[joint] += by
    if not driver.limits.lower[joint] <= far[joint] <= driver.limits.upper[joint]:
        raise RobotError(f"{far[joint]:.2f} rad are beyond the limits of the joint")
    count = int(np.ceil(abs(by) / (SPEED * PERIOD)))
    share = np.linspace(0.0, 1.0, count + 1)[1:, None]
    # A fifth more, to arrive.
    there = np.concatenate([rest + share * (far - rest), np.tile(far, (count // 5 + 10, 1))])
    middle = follow(driver, there, clock)
    return middle, follow(driver, rest + far - there, clock)


def follow(driver: GuardedDriver, goals: np.ndarray, clock: Clock | None = None) -> JointState:
    """Command goals, ``PERIOD`` apart; the state after the last.

    Args:
        driver: connected.
        goals: [rad], shape [T, U].
        clock: of the device; that of the wall if None.

    Raises:
        SafetyStop: the guard or the switch stopped the device.
        RobotError: the device follows no more.
    """
    clock = clock or WallClock()
    began = clock.now()
    for row, goal in enumerate(goals):
        clock.sleep_until(began + row * PERIOD)
        driver.command(goal)
    state = driver.read()
    if state.status is not DeviceStatus.READY:
        raise RobotError(f"{driver.name} stopped while moving: {state.status} {state.message}")
    return state
