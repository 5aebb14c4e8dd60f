"""Set points of the servos, as a robot's computer makes them from an action in every control period."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fungrasp.geometry.poses import euler_angles, relative
from fungrasp.simulation import Scene
from fungrasp.task.protocol import Protocol
from fungrasp.task.wrist_limits import WristSetPoint

SET_POINT_PERIOD = 0.02
"""Time between two set points of the servos [s]."""


@dataclass(frozen=True, eq=False)
class SetPoints:
    """Of one control period, S of them, in W worlds."""

    goal: np.ndarray
    """Where the palm is to go in the end, world frame, shape [W, 7]."""
    commands: np.ndarray
    """Of all servos, in the order of ``Servos.actuators``, shape [S, W, 6 + U]."""
    palm: np.ndarray
    """Where the palm is told to be, world frame, shape [S, W, 7]."""
    fingers: np.ndarray
    """Where the independent joints are told to be [rad], shape [S, W, U]."""


class Servos:
    """The servos of W worlds: they move on from where they are, late where there is a latency."""

    def __init__(self, scene: Scene, count: int, protocol: Protocol):
        """
        Args:
            scene: of the worlds.
            count: W.
            protocol: with the limits of the wrist.
        """
        self.substeps = round(SET_POINT_PERIOD / scene.settings.timestep)
        """Physics steps between two set points."""
        self.period = self.substeps * scene.settings.timestep
        """What they take [s]."""
        self.number = round(protocol.control_period / self.period)
        """S, set points in a control period."""
        self.actuators = np.concatenate([scene.wrist_actuators, scene.finger_actuators])
        """Their numbers in the scene."""
        resting = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1))
        self.wrist = WristSetPoint(resting, protocol)
        self.fingers = np.zeros((count, len(scene.finger_actuators)))
        """Where the independent joints were last told to be [rad], shape [W, U]."""
        self.latency = np.zeros(count)
        """How late an action takes effect [s], at most a control period, rounded up to whole periods of the
        set points; shape [W]."""
        low, high = scene.model.actuator_ctrlrange[scene.finger_actuators].T
        self._lowest, self._highest = low, high
        self._lead = scene.settings.wrist_damping[0] / scene.settings.wrist_stiffness[0]
        self._reference = resting.copy()
        self._goal = resting.copy()
        self._finger_rate = np.zeros_like(self.fingers)

    def begin(
        self,
        ids: np.ndarray,
        reference: np.ndarray,
        pose: np.ndarray,
        velocity: np.ndarray,
        fingers: np.ndarray,
    ) -> None:
        """Start somewhere in some worlds, I of them.

        Args:
            ids: worlds, shape [I].
            reference: frame in which the wrist's joints count, world frame, shape [I, 7].
            pose: of the palm, world frame, shape [I, 7].
            velocity: of the wrist, world frame [m/s], shape [I, 3].
            fingers: independent joints [rad], shape [I, U].
        """
        self._reference[ids] = reference
        self.wrist.pose[ids], self.wrist.velocity[ids] = pose, velocity
        self.fingers[ids] = fingers
        self._goal[ids], self._finger_rate[ids] = pose, 0.0

    def plan(self, goal: np.ndarray, fingers: np.ndarray) -> SetPoints:
        """The set points of the next control period; the servos then are where it ends.

        Args:
            goal: of the palm, world frame, shape [W, 7].
            fingers: of the independent joints, to be there when the period ends [rad], shape [W, U].
        """
        fingers = np.minimum(np.maximum(fingers, self._lowest), self._highest)
        due = np.minimum(np.ceil(self.latency / self.period - 1e-9), self.number)
        times = set(due.tolist())
        parts: list[tuple[np.ndarray, ...]] = []
        for begin, end in pairwise(sorted({0, *times, self.number})):
            if begin in times:
                self._heed(due == begin, goal, fingers)
            parts.append(self._advance(int(end - begin)))
        if self.number in times:
            self._heed(due == self.number, goal, fingers)
        palm, velocity, joints = parts[0]
        if len(parts) > 1:
            palm, velocity, joints = (np.concatenate(part) for part in zip(*parts, strict=True))
        return SetPoints(goal, self._commands(palm, velocity, joints), palm, joints)

    def commands(self) -> np.ndarray:
        """Those of all servos now, shape [W, 6 + U]."""
        return self._commands(self.wrist.pose, self.wrist.velocity, self.fingers)

    def wrist_coordinates(self, pose: np.ndarray) -> np.ndarray:
        """Of the wrist's joints [m, rad], shape [..., W, 6]. pose: of the palm, world frame, shape [..., W,
        7]."""
        seen = relative(self._reference, pose)
        return np.concatenate([seen[..., :3], euler_angles(seen[..., 3:])], axis=-1)

    def _commands(self, palm: np.ndarray, velocity: np.ndarray, fingers: np.ndarray) -> np.ndarray:
        # A damped servo trails behind a set point that moves; it is told to be ahead by as much.
        ahead = palm.copy()
        ahead[..., :3] += self._lead * velocity
        return np.concatenate([self.wrist_coordinates(ahead), fingers], axis=-1)

    def _advance(self, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Make S more set points: palm, shape [S, W, 7], its velocity, [S, W, 3], fingers, [S, W, U]."""
        palm, velocity = self.wrist.advance(self._goal, self.period, steps)
        fingers = self.fingers + np.arange(1, steps + 1)[:, None, None] * self._finger_rate
        self.fingers = fingers[-1]
        return palm, velocity, fingers

    def _heed(self, which: np.ndarray, goal: np.ndarray, fingers: np.ndarray) -> None:
        """Go for an action from now on. which: shape [W] bool."""
        rate = (fingers - self.fingers) / self.number
        self._goal = np.where(which[:, None], goal, self._goal)
        self._finger_rate = np.where(which[:, None], rate, self._finger_rate)
