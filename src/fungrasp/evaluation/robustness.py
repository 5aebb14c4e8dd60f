"""What a trial may differ in from what the policy was told: mass, friction, table, where the object is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector
from fungrasp.grasps import RobotGraspSet
from fungrasp.simulation import Scene, Worlds
from fungrasp.task import LiftTask


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

    def __post_init__(self) -> None:
        for name in ("mass_scale", "friction"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise FungraspError(f"{name.replace('_', ' ')} must be positive and finite, not {value}")
        for name in ("position_noise", "rotation_noise"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise FungraspError(f"{name.replace('_', ' ')} must be finite and not negative, not {value}")
        if not abs(self.table_height) <= 0.2:
            raise FungraspError(
                f"table height must be within 0.2 m of the usual one, not {self.table_height}"
            )

    @property
    def is_random(self) -> bool:
        """Whether the outcome depends on the seed."""
        return self.position_noise > 0 or self.rotation_noise > 0

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

    def seen_by_policy(self, task: LiftTask, centers: np.ndarray, seed: int, rows: np.ndarray) -> LiftTask:
        """The task as the policy sees it: object and grasp where the policy believes them to be.

        Args:
            task: reset.
            centers: centres of mass, object frame [m], shape [W, 3].
            seed: of the noise.
            rows: a number for each trial, so that its noise does not depend on the others, shape [W].
        """
        if not self.is_random:
            return task
        return cast(LiftTask, _Believed(task, self._noise(centers, seed, rows)))

    def _noise(self, centers: np.ndarray, seed: int, rows: np.ndarray) -> np.ndarray:
        """True object frame to believed one, shape [W, 7]: a turn about the centre of mass, and a shift."""
        directions = np.array([np.random.default_rng([seed, int(row)]).normal(size=(2, 3)) for row in rows])
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        turn = np.zeros((len(rows), 7))
        turn[:, 3:] = quaternion_from_rotation_vector(self.rotation_noise * directions[:, 1])
        turn[:, :3] = centers + self.position_noise * directions[:, 0]
        back = np.concatenate([-centers, np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1))], axis=1)
        return compose(turn, back)


def move_table(worlds: Worlds, height: float) -> None:
    """Put the table's top at this height [m] in all worlds."""
    table = worlds.model.geom("table").id
    worlds.batch.expand("geom_pos")[:, table, 2] = height
    # MuJoCo skips the position of a geom that the compiler found at its body's origin.
    worlds.batch.expand("geom_sameframe")[:, table] = 0


class _Believed:
    """A task with other beliefs about the object."""

    def __init__(self, task: LiftTask, error: np.ndarray):
        """error: true object frame to believed one, shape [W, 7]."""
        self._task, self._error = task, error
        self.settled_pose = compose(task.settled_pose, error)
        self.target_pose = compose(self.settled_pose, task.wrist_in_object)

    @property
    def tracked_object_pose(self) -> np.ndarray:
        """Where the policy sees the objects, world frame, shape [W, 7]."""
        return compose(self._task.tracked_object_pose, self._error)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._task, name)
