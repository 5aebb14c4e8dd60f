"""Tests of single devices: connect, read, hold, move a joint, and record the excitation of a hand."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.hands.arm import arm_spec
from fungrasp.robots.assembly import arm_driver, hand_driver, pose_source
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import (
    Clock,
    DeviceStatus,
    JointDriver,
    JointState,
    RobotError,
    SafetyStop,
    StopKind,
    WallClock,
)
from fungrasp.robots.kinematics.arm_model import ArmKinematics, ClearanceModel
from fungrasp.robots.safety import SafetyGuard, check_posture
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.sim2real.identification.excitation import ExcitationMotion
from fungrasp.sim2real.identification.motion_log import MotionHeader, MotionLog, MotionSample, motion_log

PARTS = ("arm", "hand")
"""Devices of a cell that move."""

READ_PERIOD = 0.5
"""Time between two readings [s]."""

AT_REST = 0.002
"""Largest motion of a resting arm's joints within a second [rad]: 2 mm at full reach."""

SLOW, LONGEST_REST = 0.02, 1.0
"""Largest speed of a joint at rest [rad/s], and longest time to come to rest after a stop [s]."""

STAYS = "it stays stopped"
"""Phrase for a device that takes no command after a stop."""

GOAL_PERIOD = 0.02
"""Time between two goals [s]."""

JOG_SPEED = 0.1
"""Speed of a jogged joint [rad/s]."""

LARGEST_JOG = 0.2
"""Largest motion of a jogged joint [rad]."""


@dataclass(frozen=True)
class DeviceReport:
    """State of a device after connecting."""

    words: str
    """Description in one line, beginning with the part."""
    well: bool
    """Whether the device can be used."""


def bare_driver(part: str, cell: RobotCell, hand: Hand) -> JointDriver:
    """Make the driver of an arm or a hand without safety filter, for reading. part: one of ``PARTS``."""
    return arm_driver(cell) if part == "arm" else hand_driver(cell, hand)


class GuardedDriver(JointDriver):
    """Driver of an arm or a hand that moves alone, with stop switch and safety filter. Any error stops the
    device."""

    def __init__(
        self,
        driver: JointDriver,
        cell: RobotCell,
        part: str,
        *,
        clearance: Callable[[np.ndarray], str] = lambda joints: "",
        clock: Clock | None = None,
        switch: StopSwitch | None = None,
    ):
        """
        Args:
            part: one of ``PARTS``.
            clearance: returns what is wrong with a posture [rad], shape [U], as a phrase; "" if nothing.
            clock: clock of the device; ``WallClock`` if None.
            switch: stop switch; None: one that watches the cell's stop file.
        """
        self.name, self.limits, self.takes_feedforward = driver.name, driver.limits, driver.takes_feedforward
        self.lets_go = driver.lets_go
        self.switch = StopSwitch(cell.stop_file) if switch is None else switch
        """Stop switch."""
        self._driver, self._part, self._clear = driver, part, clearance
        self._clock = clock or WallClock()
        self._guard = SafetyGuard(cell, {part: driver.limits})

    def connect(self) -> None:
        self._driver.connect()
        self._guard.reset()

    def take_control(self) -> None:
        self._driver.take_control()

    def read(self) -> JointState:
        return self._driver.read()

    def command(self, positions: np.ndarray, feedforward: np.ndarray | None = None) -> np.ndarray:
        """See ``JointDriver.command``.

        Raises:
            SafetyStop: the safety filter or the switch stopped the device.
            RobotError: the device no longer follows, or a value is not finite.
        """
        goal = np.asarray(positions, dtype=float)
        try:
            if self.switch.reason:
                raise SafetyStop(self.switch.reason)
            if np.isfinite(goal).all():
                goal = self._guard.joints(self._part, self._driver.read(), goal, self._clock.now())
                problem = self._clear(goal)
                if problem:
                    raise SafetyStop(problem)
            return self._driver.command(goal, feedforward)
        except RobotError as error:
            self.stop(error.kind if isinstance(error, SafetyStop) else StopKind.HOLD)
            raise

    def stop(self, kind: StopKind = StopKind.HOLD) -> None:
        self._driver.stop(kind)

    def close(self) -> None:
        self._driver.close()


def guarded_driver(
    part: str,
    cell: RobotCell,
    hand: Hand,
    switch: StopSwitch | None = None,
    torque_limit: float = 1.0,
    clock: Clock | None = None,
) -> GuardedDriver:
    """Make a guarded driver, not connected. The other device may be off; the arm takes the hand to be open.

    Args:
        part: one of ``PARTS``.
        cell: the robot; no twin.
        switch: stop switch; None: one that watches the cell's stop file.
        torque_limit: largest torque of a hand, as a share of its torque in the cell.
        clock: clock of the device; ``WallClock`` if None.

    Raises:
        FungraspError: an unknown driver, bad options, or another hand.
    """
    driver = bare_driver(part, cell, hand)
    if part == "hand":
        if isinstance(driver, LoopDriver):
            driver.torque_limit(torque_limit)
        return GuardedDriver(driver, cell, part, clock=clock, switch=switch)
    kinematics, clearance = ArmKinematics(cell, hand), ClearanceModel(cell, hand)

    def wrong(joints: np.ndarray) -> str:
        gap = clearance.measure(joints, hand.open_joints)
        return check_posture(kinematics.palm_pose(joints), gap, cell.workspace)

    return GuardedDriver(driver, cell, part, clearance=wrong, clock=clock, switch=switch)


def joint_names(part: str, cell: RobotCell, hand: Hand) -> list[str]:
    """Return the joints of an arm or a hand in the order of its driver. part: one of ``PARTS``."""
    if part == "hand":
        return list(hand.actuators)
    return [actuator.name for actuator in arm_spec(cell.arm.model).actuators]


def examine_devices(cell: RobotCell, hand: Hand) -> Iterator[DeviceReport]:
    """Connect to arm, hand and tracker in turn. Nothing moves. cell: the robot; no twin."""
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
    """Yield states of a connected device twice a second for a time [s], at least one state."""
    end = time.monotonic() + seconds
    while True:
        yield driver.read()
        if time.monotonic() + READ_PERIOD > end:
            return
        time.sleep(READ_PERIOD)


def arm_at_rest(cell: RobotCell, hand: Hand) -> np.ndarray:
    """Read the joints of a cell's arm for a second, and return their mean [rad], shape [A]. cell: the robot;
    no twin. Raises: FungraspError: no arm answers, or it moves."""
    with arm_driver(cell) as driver:
        rows = np.array([state.positions for state in read_joints(driver, 2 * READ_PERIOD)])
    if np.ptp(rows, axis=0).max() > AT_REST:
        raise FungraspError("the arm moves: hold it still, and try again")
    return rows.mean(axis=0)


def hold_in_place(driver: GuardedDriver, seconds: float) -> float:
    """Hold a connected device for a time [s], and return the largest displacement of a joint at the end
    [rad]. Raises what ``follow`` raises."""
    rest = driver.read().positions
    state = follow(driver, np.tile(rest, (max(1, int(seconds / GOAL_PERIOD)), 1)))
    return float(np.abs(state.positions - rest).max())


def jog(driver: GuardedDriver, joint: int, by: float) -> tuple[JointState, JointState]:
    """Move one joint of a connected device slowly by an angle [rad] and back, while the others hold. Returns:
    states at the far end and at the end. Raises: RobotError: the angle is zero, too large or beyond the
    joint's limits, and what ``follow`` raises."""
    if not 0 < abs(by) <= LARGEST_JOG:
        raise RobotError(f"a joint is moved by {LARGEST_JOG:g} rad at most, and not by zero: {by:g}")
    rest = driver.read().positions
    far = rest.copy()
    far[joint] += by
    if not driver.limits.lower[joint] <= far[joint] <= driver.limits.upper[joint]:
        raise RobotError(f"{far[joint]:.2f} rad are beyond the limits of the joint")
    count = int(np.ceil(abs(by) / (JOG_SPEED * GOAL_PERIOD)))
    share = np.linspace(0.0, 1.0, count + 1)[1:, None]
    # A fifth more time, to arrive.
    there = np.concatenate([rest + share * (far - rest), np.tile(far, (count // 5 + 10, 1))])
    middle = follow(driver, there)
    return middle, follow(driver, rest + far - there)


def after_stop(driver: GuardedDriver) -> str:
    """Return in words whether a stopped device comes to rest and refuses commands."""
    begun, place = time.monotonic(), driver.read().positions.copy()
    while np.abs((state := driver.read()).velocities).max() > SLOW:
        if time.monotonic() > begun + LONGEST_REST:
            return "it does not come to rest"
        time.sleep(0.002)
    waited, further = time.monotonic() - begun, float(np.abs(state.positions - place).max())
    try:
        driver.command(state.positions)
    except RobotError:
        return f"at rest {1e3 * waited:.0f} ms later and {further:.4f} rad further; {STAYS}"
    return "it takes commands again without a new start"


def follow(driver: GuardedDriver, goals: np.ndarray) -> JointState:
    """Command goals [rad], shape [T, U], ``GOAL_PERIOD`` apart, and return the last state. Raises:
    RobotError: the device no longer follows, or the safety filter or the switch stopped it."""
    *_, (_, _, state) = _commanded(driver, goals, GOAL_PERIOD, WallClock())
    return state


def _commanded(
    driver: JointDriver, goals: np.ndarray, period: float, clock: Clock
) -> Iterator[tuple[float, np.ndarray, JointState]]:
    """Command goals [rad], shape [T, U], a period [s] apart. Yield the time since the first [s], the goal as
    sent, and the state. Raises what ``follow`` raises."""
    began = clock.now()
    for row, goal in enumerate(goals):
        clock.sleep_until(began + row * period)
        now = clock.now()
        sent = driver.command(goal)
        state = driver.read()
        if state.status is not DeviceStatus.READY:
            raise RobotError(f"{driver.name} stopped while moving: {state.status} {state.message}")
        yield now - began, sent, state


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
    """Command goals at a rate, and record goals as sent and measurements. At the end and after errors, the
    device holds.

    Args:
        driver: connected.
        joints: names of its joints, length U.
        rate: goals per second [Hz].
        gravity: gravity in the palm frame [m/s^2], shape [3].
        clock: clock of the device; ``WallClock`` if None.
        weight: mass fixed to each fingertip [kg].
        keep: called with each sample at once.

    Raises:
        RobotError: the device stopped.
    """
    clock = clock or WallClock()
    header, samples = MotionHeader(joints, gravity, weight, driver.limits.velocity), []
    try:
        # Taking control may take seconds, which must not delay the first goals.
        driver.take_control()
        origin = clock.now()
        rows = _commanded(driver, motion.commands, 1.0 / rate, clock)
        for moving, (when, sent, state) in zip(motion.moving, rows, strict=True):
            joined = tuple(np.flatnonzero(moving).tolist())
            received = state.received - origin
            sample = MotionSample(when, state.device_time, received, joined, sent, state.positions)
            keep(header, sample)
            samples.append(sample)
    finally:
        driver.stop()
    return motion_log(header, samples)
