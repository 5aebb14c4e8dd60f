"""Devices and clock of a twin, in the same process."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from threading import Event, Thread
from typing import Self

import numpy as np

from fungrasp.hands import Hand
from fungrasp.hands.arm import arm_spec
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.device import (
    Clock,
    DeviceStatus,
    JointDriver,
    JointLimits,
    JointState,
    PoseSource,
    RobotError,
    StopKind,
    TrackedPose,
)
from fungrasp.robots.twin.parameters import twin_torque_limits
from fungrasp.robots.twin.world import TwinWorld

WALL_STEP = 0.002
"""Time between two advances of a real-time twin [s]."""

LARGEST_LAG = 0.02
"""Lag beyond which a real-time twin loses time [s]: on a slow or busy computer, it moves in slow motion
instead of jumping."""


class TwinClock(Clock):
    """A clock that advances the twin while it waits, and stands still while the robot's computer works. Runs
    are reproducible to the last bit."""

    def __init__(self, world: TwinWorld):
        self._world = world

    def now(self) -> float:
        return self._world.time

    def sleep_until(self, when: float) -> None:
        self._world.advance(when)


class RealTimeTwin:
    """Advances a twin in real time, in a thread; a context manager."""

    def __init__(self, world: TwinWorld):
        """world: its time becomes that of ``time.monotonic``."""
        self._world, self._end = world, Event()
        self._thread = Thread(target=self._run, name="twin", daemon=True)
        self.latest = 0.0
        """Largest lag of the twin behind the clock [s]."""
        self.lost = 0.0
        """Total time that the twin has lost [s]."""

    def __enter__(self) -> Self:
        # Garbage collection of everything made so far would stop the twin for 0.1 s.
        gc.freeze()
        with self._world.lock:
            self._world.offset = time.monotonic() - self._world.data.time
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._end.set()
        self._thread.join()
        gc.unfreeze()

    def _run(self) -> None:
        while not self._end.is_set():
            with self._world.lock:
                lag = time.monotonic() - self._world.time
                self.latest = max(self.latest, lag)
                if lag > LARGEST_LAG:
                    self._world.offset += lag - LARGEST_LAG
                    self.lost += lag - LARGEST_LAG
            self._world.advance(self._world.time + min(lag, LARGEST_LAG))
            time.sleep(WALL_STEP)


class _TwinJoints(JointDriver):
    """Common part of the twin's arm and hand."""

    name: str
    limits: JointLimits
    takes_feedforward = False
    lets_go = ""

    def __init__(
        self,
        world: TwinWorld,
        measured: Callable[[], tuple[np.ndarray, np.ndarray, np.ndarray]],
        send: Callable[[np.ndarray, np.ndarray | None], None],
    ):
        """measured: returns positions, velocities, torques; send: takes targets and feed-forward torques."""
        self.world, self._measured, self._send = world, measured, send
        """World of the twin."""
        self._status = DeviceStatus.DISCONNECTED
        self._last: np.ndarray | None = None
        self.fault = ""
        """Reported fault, set in tests of faults."""
        self.frozen = False
        """Whether the time stamp stands still, set in tests of faults."""
        self._frozen_at: JointState | None = None

    def connect(self) -> None:
        self._status, self._last = DeviceStatus.READY, None

    def read(self) -> JointState:
        if self.frozen and self._frozen_at is not None:
            return self._frozen_at
        with self.world.lock:
            now = self.world.time
            q, v, torque = self._measured()
        status = DeviceStatus.FAULT if self.fault else self._status
        self._frozen_at = JointState(q, v, torque, now, now, status, self.fault)
        return self._frozen_at

    def command(self, positions: np.ndarray, feedforward: np.ndarray | None = None) -> np.ndarray:
        if self._status is not DeviceStatus.READY or self.fault:
            state = self.fault or self._status
            raise RobotError(f"{self.name} follows no commands ({state}): connect to it again")
        if not np.isfinite(positions).all():
            raise RobotError(f"{self.name}: a goal is not finite")
        sent = np.clip(positions, self.limits.lower, self.limits.upper)
        self._last = sent
        self._send(sent, feedforward)
        return sent

    def take_control(self) -> None:
        """See ``JointDriver.take_control``. A twin is always ready."""

    def stop(self, kind: StopKind = StopKind.HOLD) -> None:
        if self._status is DeviceStatus.READY:
            self._status = DeviceStatus.STOPPED

    def close(self) -> None:
        if self._status is not DeviceStatus.DISCONNECTED:
            self.stop()
        self._status = DeviceStatus.DISCONNECTED


class TwinArm(_TwinJoints):
    """The twin's arm."""

    def __init__(self, world: TwinWorld, cell: RobotCell):
        super().__init__(world, world.arm_state, lambda positions, _: world.command_arm(positions))
        model = arm_spec(cell.arm.model).compile()
        speed = np.full(model.nu, cell.limits.arm_speed)
        self.name = f"twin of {cell.arm.model}"
        low, high = model.jnt_range.T
        self.limits = JointLimits(low, high, speed, model.actuator_forcerange[:, 1])

    def stop(self, kind: StopKind = StopKind.HOLD) -> None:
        super().stop(kind)
        # Brake: a joint can come to rest at a position shortly ahead.
        q, v, _ = self.world.arm_state()
        self.world.command_arm(q + 0.05 * v)


class TwinHand(_TwinJoints):
    """The twin's hand."""

    def __init__(self, world: TwinWorld, cell: RobotCell, hand: Hand):
        super().__init__(world, world.hand_state, world.command_hand)
        self.name = f"twin of {hand.name}"
        # Most hands take positions only.
        self.takes_feedforward = bool(cell.hand_device.options.get("torque", False))
        rows = [hand.joint_names.index(name) for name in hand.actuators]
        low, high = hand.joint_limits[rows].T
        torque = np.array([servo.force_limit for servo in hand.actuators.values()])
        torque = np.minimum(torque, twin_torque_limits(cell, hand))
        self.limits = JointLimits(low, high, np.full(len(rows), cell.limits.hand_speed), torque)
        self._open = hand.open_joints

    def connect(self) -> None:
        super().connect()
        self.world.powered = True

    def stop(self, kind: StopKind = StopKind.HOLD) -> None:
        super().stop(kind)
        if kind is StopKind.POWER_OFF:
            self.world.powered = False
        elif kind is StopKind.OPEN:
            self.world.command_hand(self._open)
        # To hold, the servos keep their last targets, and the hand keeps its grip.


class TwinTracker(PoseSource):
    """The twin's tracker."""

    name = "twin's tracker"

    def __init__(self, world: TwinWorld):
        self._world = world

    def connect(self) -> None: ...

    def read(self) -> TrackedPose | None:
        return self._world.tracked()

    def close(self) -> None: ...
