"""Devices of a cell one by one, before anything is grasped: whether each answers, what it measures, whether
it holds where it is, whether a joint moves as asked."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.hands.arm import arm_spec
from fungrasp.robots.assembly import (
    arm_driver,
    guarded_arm,
    guarded_hand,
    hand_driver,
    is_twin,
    pose_source,
)
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.clock import Clock, WallClock
from fungrasp.robots.device import DeviceStatus, JointDriver, JointState, RobotError
from fungrasp.robots.guarded_driver import GuardedDriver
from fungrasp.robots.stop_switch import StopSwitch

PARTS = ("arm", "hand")
"""Devices of a cell that move."""

READ_PERIOD = 0.5
"""Between two states that are shown [s]."""

AT_REST = 0.002
"""An arm whose joints move by less within a second stands still [rad]: 2 mm at its full reach."""


GOAL_PERIOD = 0.02
"""Between goals [s]."""

JOG_SPEED = 0.1
"""Of a joint that is jogged [rad/s]."""

LARGEST_JOG = 0.2
"""It moves no farther at once [rad]."""


@dataclass(frozen=True)
class DeviceReport:
    """What a device says when it is connected to."""

    words: str
    """In a line, its part first."""
    well: bool
    """Whether it can be used."""


def check_wired(cell: RobotCell) -> None:
    """Raises: FungraspError: the cell is a twin, which has no devices."""
    if is_twin(cell):
        raise FungraspError(f"cell '{cell.name}' is a twin: it has no devices to connect to")


def bare_driver(part: str, cell: RobotCell, hand: Hand) -> JointDriver:
    """The driver of an arm or a hand without a guard, to look at. part: one of ``PARTS``."""
    return arm_driver(cell) if part == "arm" else hand_driver(cell, hand)


def guarded_driver(part: str, cell: RobotCell, hand: Hand, switch: StopSwitch) -> GuardedDriver:
    """The driver of an arm or a hand behind guard and switch, to move. part: one of ``PARTS``."""
    return (guarded_arm if part == "arm" else guarded_hand)(cell, hand, switch)


def joint_names(part: str, cell: RobotCell, hand: Hand) -> list[str]:
    """Joints of an arm or a hand in the order of its driver. part: one of ``PARTS``."""
    if part == "hand":
        return list(hand.actuators)
    return [actuator.name for actuator in arm_spec(cell.arm.model).actuators]


def examine_devices(cell: RobotCell, hand: Hand) -> Iterator[DeviceReport]:
    """Connect to arm, hand and tracker in turn. Nothing moves.

    Args:
        cell: the robot; no twin.
        hand: on its arm.
    """
    for part in PARTS:
        try:
            with bare_driver(part, cell, hand) as driver:
                state = driver.read()
            held = f"; lets go of an object {driver.lets_go}" if driver.lets_go else ""
            said = f"{part}: {driver.name}, {state.status} {state.message}".rstrip() + held
            yield DeviceReport(said, state.status is DeviceStatus.READY)
        except FungraspError as error:
            yield DeviceReport(f"{part}: {error}", False)
    try:
        with pose_source(cell) as tracker:
            seen = tracker.read()
        yield DeviceReport(
            f"tracker: {tracker.name}, {'nothing seen' if seen is None else seen.status}", True
        )
    except FungraspError as error:
        yield DeviceReport(f"tracker: {error}", False)


def read_joints(driver: JointDriver, seconds: float) -> Iterator[JointState]:
    """States of a connected device, twice a second. seconds: for so long; one state at least [s]."""
    end = time.monotonic() + seconds
    while True:
        yield driver.read()
        if time.monotonic() + READ_PERIOD > end:
            return
        time.sleep(READ_PERIOD)


def arm_at_rest(cell: RobotCell, hand: Hand) -> np.ndarray:
    """Joints of a cell's arm, which is looked at until it is known to stand still [rad], shape [A].

    Args:
        cell: the robot; no twin.
        hand: on its arm.

    Raises:
        FungraspError: no arm answers, or it moves.
    """
    with arm_driver(cell) as driver:
        rows = np.array([state.positions for state in read_joints(driver, 2 * READ_PERIOD)])
    if np.ptp(rows, axis=0).max() > AT_REST:
        raise FungraspError("the arm moves: hold it still, and try again")
    return rows.mean(axis=0)


def hold_in_place(driver: GuardedDriver, seconds: float) -> float:
    """Hold a connected device where it is; by how much a joint has moved at the end, the largest [rad].

    Args:
        driver: connected.
        seconds: for so long [s].

    Raises:
        SafetyStop: the guard or the switch stopped the device.
        RobotError: the device follows no more.
    """
    rest = driver.read().positions
    state = follow(driver, np.tile(rest, (max(1, int(seconds / GOAL_PERIOD)), 1)))
    return float(np.abs(state.positions - rest).max())


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
    if not 0 < abs(by) <= LARGEST_JOG:
        raise RobotError(f"a joint is moved by {LARGEST_JOG:g} rad at most, and not by nothing: {by:g}")
    rest = driver.read().positions
    far = rest.copy()
    far[joint] += by
    if not driver.limits.lower[joint] <= far[joint] <= driver.limits.upper[joint]:
        raise RobotError(f"{far[joint]:.2f} rad are beyond the limits of the joint")
    count = int(np.ceil(abs(by) / (JOG_SPEED * GOAL_PERIOD)))
    share = np.linspace(0.0, 1.0, count + 1)[1:, None]
    # A fifth more, to arrive.
    there = np.concatenate([rest + share * (far - rest), np.tile(far, (count // 5 + 10, 1))])
    middle = follow(driver, there, clock)
    return middle, follow(driver, rest + far - there, clock)


def follow(driver: GuardedDriver, goals: np.ndarray, clock: Clock | None = None) -> JointState:
    """Command goals, ``GOAL_PERIOD`` apart; the state after the last.

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
        clock.sleep_until(began + row * GOAL_PERIOD)
        driver.command(goal)
    state = driver.read()
    if state.status is not DeviceStatus.READY:
        raise RobotError(f"{driver.name} stopped while moving: {state.status} {state.message}")
    return state
