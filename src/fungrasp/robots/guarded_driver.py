"""One device of a cell, an arm or a hand alone, behind the stop switch and its share of the safety filter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Self

import numpy as np

from fungrasp.robots.cell import RobotCell
from fungrasp.robots.clock import Clock, WallClock
from fungrasp.robots.device import JointDriver, JointState, RobotError, StopKind
from fungrasp.robots.robot_state import SafetyStop
from fungrasp.robots.safety import (
    TOLERANCE,
    StandingStamp,
    joint_state_finite,
    torque_beyond,
    warn_unguarded,
)
from fungrasp.robots.stop_switch import StopSwitch

LONGEST_STEP = 0.1
"""A goal is as far from the one before as the joints get within this time, however long ago that was [s]."""


class GuardedDriver:
    """A ``JointDriver`` around another one: what it is told passes the switch, the limits of speed and of
    torque, the watchdog, and a check of the posture if there is one. Whatever is wrong stops the device."""

    def __init__(
        self,
        driver: JointDriver,
        cell: RobotCell,
        part: str,
        *,
        clear: Callable[[np.ndarray], str] = lambda positions: "",
        clock: Clock | None = None,
        switch: StopSwitch | None = None,
    ):
        """
        Args:
            driver: of the device.
            cell: limits and watchdog.
            part: "arm" or "hand".
            clear: what is wrong with a posture [rad], shape [U], as a phrase; "" for nothing.
            clock: of the device; that of the wall if None.
            switch: stops the device; that of the cell's stop file if None.
        """
        self.name, self.limits, self.takes_feedforward = driver.name, driver.limits, driver.takes_feedforward
        self.lets_go = driver.lets_go
        self.switch = StopSwitch(cell.stop_file) if switch is None else switch
        """Stops the device."""
        arm, limits, dog = part == "arm", cell.limits, cell.watchdog
        self._driver, self._cell, self._part, self._clear = driver, cell, part, clear
        self._clock = clock or WallClock()
        self._speed = np.minimum(driver.limits.velocity, limits.arm_speed if arm else limits.hand_speed)
        self._torque = limits.arm_torque if arm else limits.hand_torque
        self._most = dog.arm_silence if arm else dog.hand_silence
        self._stamp, self._last, self._when = StandingStamp(), np.zeros(0), -np.inf

    def connect(self) -> None:
        """See ``JointDriver.connect``. A cell without a guard is warned of."""
        warn_unguarded(self._cell)
        self._driver.connect()
        self._stamp, self._last, self._when = StandingStamp(), np.zeros(0), -np.inf

    def take_control(self) -> None:
        """See ``JointDriver.take_control``."""
        self._driver.take_control()

    def read(self) -> JointState:
        """See ``JointDriver.read``."""
        return self._driver.read()

    def command(self, positions: np.ndarray, feedforward: np.ndarray | None = None) -> np.ndarray:
        """See ``JointDriver.command``.

        Raises:
            SafetyStop: the guard or the switch stopped the device.
            RobotError: the device follows no more, or a value is not finite.
        """
        try:
            goal = np.asarray(positions, dtype=float)
            if self.switch.reason:
                raise SafetyStop(self.switch.reason, StopKind.HOLD)
            if self._cell.guard != "off" and np.isfinite(goal).all():
                goal = self._allowed(goal)
            self._last = self._driver.command(goal, feedforward)
        except SafetyStop as stop:
            self.stop(stop.kind)
            raise
        except RobotError:
            self.stop()
            raise
        return self._last

    def stop(self, kind: StopKind = StopKind.HOLD) -> None:
        """See ``JointDriver.stop``."""
        self._driver.stop(kind)

    def close(self) -> None:
        """See ``JointDriver.close``."""
        self._driver.close()

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()
        self.close()

    def _allowed(self, goal: np.ndarray) -> np.ndarray:
        """The goal within the limits of speed. Raises: SafetyStop: it may not be sent."""
        state, now = self._driver.read(), self._clock.now()
        if not joint_state_finite(state):
            raise SafetyStop(f"what the {self._part} says is not finite", StopKind.HOLD)
        silence = self._stamp.age(state.device_time, now)
        # Between commands nothing is read, so that an old stamp says nothing.
        if silence > self._most and now - self._when < self._most:
            raise SafetyStop(f"the {self._part} has been silent for {1e3 * silence:.0f} ms", StopKind.HOLD)
        if torque_beyond(state.torques, self._torque):
            kind = StopKind.HOLD if self._part == "arm" else StopKind.OPEN
            raise SafetyStop(f"the torque of a joint of the {self._part} is beyond its limit", kind)
        last = self._last if len(self._last) else state.positions
        reach = TOLERANCE * self._speed * min(now - self._when, LONGEST_STEP)
        allowed = np.clip(goal, last - reach, last + reach)
        self._when = now
        problem = self._clear(allowed)
        if problem:
            raise SafetyStop(problem, StopKind.HOLD)
        return allowed
