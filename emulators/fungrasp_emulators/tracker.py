"""An object tracker that publishes poses of a truth it is told, late and noisy as a real one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fungrasp.geometry.poses import quaternion_from_rotation_vector, quaternion_multiply
from fungrasp.robots.device import TrackingStatus
from fungrasp.robots.pose.stream import PosePublisher
from fungrasp_emulators.emulator import Emulator, Fault


@dataclass(frozen=True)
class TrackerErrors:
    """How a tracker differs from the truth."""

    rate: float = 30.0
    """Answers per second."""
    delay: float = 0.05
    """From capture to answer [s]."""
    position: float = 0.002
    """Standard deviation of position [m]."""
    rotation: float = 0.01
    """Standard deviation of rotation [rad]."""
    dropped: float = 0.0
    """Share of images without an answer."""


class TrackerEmulator(Emulator):
    """Publishes what ``truth`` says, with errors."""

    supported = frozenset(
        {
            Fault.KILLED,
            Fault.STALLED,
            Fault.CORRUPT,
            Fault.FROZEN,
            Fault.JUMPING,
            Fault.GONE,
            Fault.CLOCK_JUMP,
        }
    )

    def __init__(
        self,
        truth: Callable[[float], np.ndarray],
        address: str = "tcp://127.0.0.1:5556",
        object_name: str = "object",
        errors: TrackerErrors | None = None,
        seed: int = 0,
    ):
        """
        Args:
            truth: pose of the object in the world, shape [7], at a host time [s].
            address: to publish on.
            object_name: of the object.
            errors: how the answers differ.
            seed: of the errors.
        """
        super().__init__()
        self.address = address
        self._truth, self._object = truth, object_name
        self._errors = errors or TrackerErrors()
        self._rng = np.random.default_rng(seed)
        self._publisher: PosePublisher | None = None
        self._queue: list[tuple[float, np.ndarray]] = []
        self._frozen: tuple[float, np.ndarray] | None = None

    def start(self) -> None:
        """See ``Emulator.start``."""
        self._ended.clear()
        self._publisher = PosePublisher(self.address, self._object)
        self._run(self._serve)

    def close(self) -> None:
        """See ``Emulator.close``."""
        self._end_threads()
        if self._publisher is not None:
            self._publisher.close()
            self._publisher = None

    def _serve(self) -> None:
        period, due = 1.0 / self._errors.rate, time.monotonic()
        while not self._ended.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            due = max(due + period, now)
            self._queue.append((now, self._measured(now)))
            while self._queue and self._queue[0][0] + self._errors.delay <= now:
                self._answer(*self._queue.pop(0))

    def _measured(self, now: float) -> np.ndarray:
        pose = np.array(self._truth(now), dtype=float)
        pose[:3] += self._errors.position * self._rng.normal(size=3)
        turn = quaternion_from_rotation_vector(self._errors.rotation * self._rng.normal(size=3))
        pose[3:] = quaternion_multiply(pose[3:], turn)
        return pose

    def _answer(self, captured: float, pose: np.ndarray) -> None:
        assert self._publisher is not None
        if self.shows(Fault.KILLED) or self.shows(Fault.STALLED):
            return
        if self._rng.random() < self._errors.dropped:
            return
        if self.shows(Fault.CORRUPT):
            self._publisher.send_bytes(self._rng.bytes(80))
            return
        if self.shows(Fault.FROZEN):
            self._frozen = self._frozen or (captured, pose)
            captured, pose = self._frozen
        else:
            self._frozen = None
        if self.shows(Fault.JUMPING):
            pose = pose + np.concatenate([self._rng.choice([-0.2, 0.2], 3), np.zeros(4)])
        if self.shows(Fault.CLOCK_JUMP):
            captured += 3600.0
        gone = self.shows(Fault.GONE)
        status = TrackingStatus.LOST if gone else TrackingStatus.TRACKING
        self._publisher.publish(pose, captured, 0.0 if gone else 0.9, status)
