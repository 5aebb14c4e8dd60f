"""Motions of the arm from rest to rest in joint space: free paths, and their timing within the limits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fungrasp.robots.cell import MotionLimits, Workspace
from fungrasp.robots.kinematics.arm_model import CLEAR, ArmKinematics, ClearanceModel, outside
from fungrasp.robots.kinematics.reach import random_starts

TRIES = 5000
"""Largest number of random postures for the trees of a path. Most paths are straight; others take some
hundreds, or a few thousand (a second or two) to another branch of solutions."""

SPACING = 0.05
"""Largest change of a joint between two postures that are checked for collisions [rad]."""

OBJECT_CLEAR = 0.02
"""Distance of paths from the convex hull of the object [m], smaller if they begin or end nearer: tracked
poses are off by up to a centimeter."""


def timed_leg(
    start: np.ndarray,
    end: np.ndarray,
    kinematics: ArmKinematics,
    limits: MotionLimits,
    period: float,
    speed: float = 1.0,
) -> np.ndarray:
    """Return minimum-jerk setpoints on a straight line in joint space, ``s(u) = 10 u^3 - 15 u^4 + 6 u^5``.

    Args:
        start: joints [rad], shape [M].
        end: joints [rad], shape [M].
        period: time between two setpoints [s].
        speed: share of the fastest speed within the limits, above 0.

    Returns:
        setpoints [rad], shape [S, M], without ``start``, with ``end``.
    """

    def line(count: int) -> np.ndarray:
        u = np.arange(1, count + 1)[:, None] / count
        return start + (10 * u**3 - 15 * u**4 + 6 * u**5) * (end - start)

    duration = 10 * period
    for _ in range(20):
        path = line(max(1, round(duration / period)))
        joints = np.concatenate([start[None], start[None], path, end[None]])
        palm = np.array([kinematics.palm_pose(q)[:3] for q in joints])
        excess = max(
            _largest(joints, 1) / period / limits.arm_speed,
            np.sqrt(_largest(joints, 2) / period**2 / limits.arm_acceleration),
            _largest(palm, 1, whole=True) / period / limits.palm_speed,
            np.sqrt(_largest(palm, 2, whole=True) / period**2 / limits.palm_acceleration),
        )
        if excess <= 1.0:
            break
        duration *= 1.02 * excess
    return path if speed == 1.0 else line(int(np.ceil(len(path) / speed)))


def _largest(values: np.ndarray, order: int, whole: bool = False) -> float:
    """Return the largest finite difference of an order, of any coordinate or of the whole vector's norm."""
    change = np.diff(values, n=order, axis=0)
    return float(np.max(np.linalg.norm(change, axis=1) if whole else np.abs(change)))


class FreePath:
    """Plans paths that are free of collisions with table, obstacles, the robot itself and an object, by
    RRT-Connect (Kuffner and LaValle, ICRA 2000)."""

    def __init__(self, kinematics: ArmKinematics, clearance: ClearanceModel, workspace: Workspace):
        self._kinematics, self._clearance, self._workspace = kinematics, clearance, workspace

    def clear(self, arm: np.ndarray, fingers: np.ndarray, keep: float | None = None) -> bool:
        """Return whether a posture is free of collisions, with the palm in the workspace.

        Args:
            arm: joints of the arm [rad], shape [M].
            fingers: independent joints [rad], shape [U].
            keep: smallest distance from the object [m]; None without object.
        """
        if outside(self._kinematics.palm_pose(arm), self._workspace):
            return False
        gap = self._clearance.measure(arm, fingers)
        if min(gap.table, gap.hand, gap.itself, gap.obstacle) < CLEAR:
            return False
        return keep is None or self._clearance.distance_to_object() >= keep

    def find(
        self,
        start: np.ndarray,
        end: np.ndarray,
        fingers: np.ndarray,
        object_pose: np.ndarray | None,
        rng: np.random.Generator,
    ) -> list[np.ndarray] | None:
        """Return the corners of a path without ``start``, with ``end``; None if no path was found.

        Args:
            start: joints of the arm [rad], shape [M].
            end: joints of the arm [rad], shape [M].
            fingers: independent joints [rad], shape [U].
            object_pose: pose of the clearance model's object, world frame, shape [7]; None without object.
            rng: source of random postures.
        """
        keep = None if object_pose is None else self._distance_kept([start, end], fingers, object_pose)

        def free(one: np.ndarray, other: np.ndarray) -> bool:
            count = max(2, int(np.ceil(np.abs(other - one).max() / SPACING)) + 1)
            return all(self.clear(q, fingers, keep) for q in np.linspace(one, other, count)[1:])

        if not (self.clear(start, fingers, keep) and self.clear(end, fingers, keep)):
            return None
        if free(start, end):
            return [end]
        # Each tree has its postures and the rows of their parents.
        trees: tuple[_Tree, _Tree] = ([start], [-1]), ([end], [-1])
        for number, goal in enumerate(random_starts(self._kinematics, TRIES, rng)):
            # In turn, each tree grows a step, and the other one follows as far as it can.
            near, far = trees[number % 2], trees[1 - number % 2]
            reached = _grow(near, goal, free)
            if reached is None:
                continue
            while (met := _grow(far, reached, free)) is not None:
                if np.array_equal(met, reached):
                    first, second = (trees[0], trees[1])
                    way = [*_branch(first, reached)[::-1], *_branch(second, reached)[1:]]
                    return _shortcut(way, free)[1:]
        return None

    def _distance_kept(self, ends: list[np.ndarray], fingers: np.ndarray, object_pose: np.ndarray) -> float:
        """Return the distance from the object for a path between two postures [m]."""
        self._clearance.place_object(object_pose)
        kept = OBJECT_CLEAR
        for arm in ends:
            self._clearance.measure(arm, fingers)
            kept = min(kept, self._clearance.distance_to_object())
        return max(kept, 0.0)


_Tree = tuple[list[np.ndarray], list[int]]

_STEP = 0.4
"""Length of a branch [rad]."""


def _grow(tree: _Tree, goal: np.ndarray, free: Callable[[np.ndarray, np.ndarray], bool]) -> np.ndarray | None:
    """Add a posture to a tree, a step towards a goal, and return it; None if the step collides."""
    nodes, parents = tree
    row = int(np.argmin(np.linalg.norm(np.array(nodes) - goal, axis=1)))
    way = goal - nodes[row]
    length = float(np.linalg.norm(way))
    new = goal if length <= _STEP else nodes[row] + _STEP / length * way
    if not free(nodes[row], new):
        return None
    nodes.append(new)
    parents.append(row)
    return new


def _branch(tree: _Tree, posture: np.ndarray) -> list[np.ndarray]:
    """Return the postures from one of a tree to its root."""
    nodes, parents = tree
    row = next(i for i, node in enumerate(nodes) if np.array_equal(node, posture))
    way = []
    while row >= 0:
        way.append(nodes[row])
        row = parents[row]
    return way


def _shortcut(way: list[np.ndarray], free: Callable[[np.ndarray, np.ndarray], bool]) -> list[np.ndarray]:
    """Leave out corners that are not needed."""
    result, here = [way[0]], 0
    while here < len(way) - 1:
        there = next(i for i in range(len(way) - 1, here, -1) if i == here + 1 or free(way[here], way[i]))
        result.append(way[there])
        here = there
    return result
