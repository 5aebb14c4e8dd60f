"""What a trial may differ in from what the policy was told: mass, friction, table, where the object is,
delays, pushes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import compose
from fungrasp.grasps import RobotGraspSet
from fungrasp.simulation import Scene, Worlds
from fungrasp.task import LiftTask, Protocol
from fungrasp.transfer import move_table, offset_pose, push_objects, pushes, shift_on_table

PUSHES = (0.5, 1.5, 2.5)
"""When the object is pushed, from the beginning of the hold [s]."""

LONGEST_LATENCY = Protocol.control_period
"""[s]."""


@dataclass(frozen=True)
class Disturbance:
    """Differences between the world and what the policy believes. The default is none."""

    mass_scale: float = 1.0
    """The object weighs this many times what its grasp says."""
    friction: float | None = None
    """Sliding friction of hand, object and table; the scene's if None."""
    position_noise: float = 0.0
    """The policy believes the object this far from where it is [m], in a random direction."""
    rotation_noise: float = 0.0
    """And turned by this angle [rad] about a random axis through its centre of mass."""
    table_height: float = 0.0
    """The table and what stands on it are this much higher than the policy believes the table to be [m]."""
    latency: float = 0.0
    """Actions take effect this late [s], rounded up to whole periods of the set points (20 ms)."""
    push: float = 0.0
    """Force of the pushes on the object during the hold, in multiples of its true weight. They act on its
    centre of mass, at ``PUSHES``, each in a random direction."""
    push_duration: float = 0.2
    """Of each push [s]."""
    object_shift: float = 0.0
    """The object was moved this far on the table [m], in a random direction, after the policy had planned for
    the old place. A policy that tracks the object sees it where it is."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is impossible.
        """
        for name in ("mass_scale", "friction", "push_duration"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise FungraspError(f"{name.replace('_', ' ')} must be positive and finite, not {value}")
        for name in ("position_noise", "rotation_noise", "push", "object_shift"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise FungraspError(f"{name.replace('_', ' ')} must be finite and not negative, not {value}")
        if not abs(self.table_height) <= 0.2:
            raise FungraspError(
                f"table height must be within 0.2 m of the usual one, not {self.table_height}"
            )
        if not 0 <= self.latency <= LONGEST_LATENCY:
            raise FungraspError(f"latency must be 0 to {LONGEST_LATENCY:g} s, not {self.latency}")

    @property
    def is_random(self) -> bool:
        """Whether the outcome depends on the seed."""
        return any((self.position_noise, self.rotation_noise, self.push, self.object_shift))

    def worlds(self, scene: Scene, grasps: RobotGraspSet, threads: int) -> Worlds:
        """Worlds for these grasps, with the true mass, friction and table.

        Args:
            scene: holds the grasps' objects.
            grasps: one per world.
            threads: 0 means all processors.
        """
        names = {name: i for i, name in enumerate(scene.objects)}
        friction = None if self.friction is None else np.full(len(grasps), self.friction)
        worlds = Worlds(
            scene,
            np.array([names[name] for name in grasps.object_name.tolist()]),
            mass=self.mass_scale * grasps.object_mass,
            friction=friction,
            threads=threads,
        )
        if self.table_height:
            move_table(worlds, self.table_height)
        return worlds

    def placed(self, grasps: RobotGraspSet) -> RobotGraspSet:
        """The grasps with their objects at rest on the true table."""
        if not self.table_height:
            return grasps
        rest = grasps.object_rest_pose.copy()
        rest[:, 2] += self.table_height
        return replace(grasps, object_rest_pose=rest)

    def disturb(self, task: LiftTask, centers: np.ndarray, seed: int, rows: np.ndarray) -> LiftTask:
        """Delay the actions and move the objects.

        Args:
            task: reset.
            centers: centres of mass, object frame [m], shape [W, 3].
            seed: of what is random.
            rows: a number for each trial, so that its numbers do not depend on the others, shape [W].

        Returns:
            The task as the policy sees it: object and grasp where it believes them to be when it plans. What
            it tracks later is wrong by the pose noise, and not by the shift.
        """
        task.latency[:] = self.latency
        drawn, believed = _drawn(seed, rows), task.settled_pose.copy()
        if self.object_shift:
            _move(task, self.object_shift * _unit(drawn[:, 2, :2]))
        elif not (self.position_noise or self.rotation_noise):
            return task
        noise = (self.position_noise * _unit(drawn[:, 0]), self.rotation_noise * _unit(drawn[:, 1]))
        return cast(LiftTask, _Believed(task, believed, np.concatenate(noise, axis=1), centers))

    def pusher(self, task: LiftTask, seed: int, rows: np.ndarray) -> Callable[[], None]:
        """Pushes the objects as they should be pushed at the task's time: to be called after each substep.

        Args:
            task: with the policy's beliefs of the masses.
            seed: of the directions.
            rows: a number for each trial, shape [W].
        """
        gravity = float(np.linalg.norm(task.scene.model.opt.gravity))
        weight = self.mass_scale * gravity * task.grasps.object_mass
        forces = self.push * weight[:, None, None] * _unit(_drawn(seed, rows)[:, 3:])

        def push() -> None:
            now = task.time - task.hold_time
            parts = [pushes(forces[:, i], start, self.push_duration, now) for i, start in enumerate(PUSHES)]
            push_objects(task.worlds, np.sum(parts, axis=0))

        return push if self.push else lambda: None


CONDITIONS: dict[str, Disturbance] = {
    "nominal": Disturbance(),
    "mass x0.5": Disturbance(mass_scale=0.5),
    "mass x2": Disturbance(mass_scale=2.0),
    "friction 0.6": Disturbance(friction=0.6),
    "table +2 cm": Disturbance(table_height=0.02),
    "table -2 cm": Disturbance(table_height=-0.02),
    "pose noise 1 cm, 10 deg": Disturbance(position_noise=0.01, rotation_noise=float(np.deg2rad(10))),
    "latency 50 ms": Disturbance(latency=0.05),
    "latency 100 ms": Disturbance(latency=0.1),
    "pushes": Disturbance(push=1.0),
    "hidden shift 2 cm": Disturbance(object_shift=0.02),
}
"""The robustness protocol: what is tried, by name."""


def _move(task: LiftTask, shift: np.ndarray) -> None:
    """Start the trials with the objects elsewhere, hands where they were. shift: on the table [m], [W, 2]."""
    moved = shift_on_table(task.settled_pose, np.pad(shift, ((0, 0), (0, 1))))
    task.begin(
        np.arange(len(moved)),
        moved,
        compose(moved, task.wrist_in_object),
        task.set_point.pose.copy(),
        task.finger_set_point.copy(),
        task.target_contacts.copy(),
    )


def _drawn(seed: int, rows: np.ndarray) -> np.ndarray:
    """Normal numbers of each trial: for position and rotation noise, the shift and the pushes, shape
    [W, 3 + number of pushes, 3]."""
    return np.array(
        [np.random.default_rng([seed, int(row)]).normal(size=(3 + len(PUSHES), 3)) for row in rows]
    )


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


class _Believed:
    """A task with other beliefs about the object."""

    def __init__(self, task: LiftTask, planned_for: np.ndarray, noise: np.ndarray, centers: np.ndarray):
        """
        Args:
            task: the true one.
            planned_for: object pose that the policy would plan for without noise, world frame, shape [W, 7].
            noise: of every pose that it sees: offset [m], world frame, and rotation vector [rad], shape
                [W, 6].
            centers: of mass, about which the rotation is, object frame [m], shape [W, 3].
        """
        self._task, self._noise, self._centers = task, noise, centers
        self.settled_pose = offset_pose(planned_for, noise, centers)
        self.target_pose = compose(self.settled_pose, task.wrist_in_object)

    @property
    def tracked_object_pose(self) -> np.ndarray:
        """Where the policy sees the objects, world frame, shape [W, 7]."""
        return offset_pose(self._task.tracked_object_pose, self._noise, self._centers)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._task, name)
