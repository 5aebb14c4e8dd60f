"""Motions of the arm's joints from rest to rest, within the limits of joints and palm, clear of what stands
around."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fungrasp.robots.cell import MotionLimits, Workspace
from fungrasp.robots.kinematics.arm_model import CLEAR, ArmKinematics, ClearanceModel, outside
from fungrasp.robots.kinematics.reach import random_starts

TRIES = 5000
"""Random postures that the trees of a path grow towards, at most. Most ways are straight; those that need a
tree take some hundreds, to another branch of solutions up to a few thousand: a second or two."""

SPACING = 0.05
"""Largest change of a joint between two postures that are checked for collisions [rad]."""


OBJECT_CLEAR = 0.02
"""Distance that it keeps from the convex hull of the object [m]; where a way begins or ends nearer, as near
as that. What is seen of an object is up to a centimeter off."""


def timed_leg(
    start: np.ndarray,
    end: np.ndarray,
    kinematics: ArmKinematics,
    limits: MotionLimits,
    period: float,
    speed: float = 1.0,
) -> np.ndarray:
    """Setpoints of the joints on a straight line, with the least jerk: ``s(u) = 10 u^3 - 15 u^4 + 6 u^5``.

    Args:
        start: joints [rad], shape [M].
        end: joints [rad], shape [M].
        period: time between two setpoints [s].
        speed: share of that speed, above 0.

    Returns:
        Shape [S, M], the last one ``end``; as fast as the limits allow, or slower.
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
    """Largest difference of an order, of any coordinate or of the vector as a whole."""
    change = np.diff(values, n=order, axis=0)
    return float(np.max(np.linalg.norm(change, axis=1) if whole else np.abs(change)))


class FreePath:
    """Finds postures between two that are clear of the table, of the robot itself and of an object: two trees
    of random postures that grow towards each other (RRT-Connect, Kuffner and LaValle, ICRA 2000)."""

    def __init__(self, kinematics: ArmKinematics, clearance: ClearanceModel, workspace: Workspace):
        self._kinematics, self._clearance, self._workspace = kinematics, clearance, workspace

    def clear(self, arm: np.ndarray, fingers: np.ndarray, keep: float | None = None) -> bool:
        """Whether a posture touches nothing, the palm in the workspace.

        Args:
            arm: joints of the arm [rad], shape [M].
            fingers: independent joints [rad], shape [U].
            keep: distance from the object at least [m]; None for no object.
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
        """Corners of a path, ``start`` left out; None if none was found.

        Args:
            start: joints of the arm [rad], shape [M].
            end: joints of the arm [rad], shape [M].
            fingers: independent joints [rad], shape [U].
            object_pose: of the clearance model's object, world frame, shape [7]; None for no object.
            rng: of the postures that are tried.
        """
        keep = None if object_pose is None else self._distance_kept([start, end], fingers, object_pose)

        def free(one: np.ndarray, other: np.ndarray) -> bool:
            count = max(2, int(np.ceil(np.abs(other - one).max() / SPACING)) + 1)
            return all(self.clear(q, fingers, keep) for q in np.linspace(one, other, count)[1:])

        if not (self.clear(start, fingers, keep) and self.clear(end, fingers, keep)):
            return None
        if free(start, end):
            return [end]
        # Each tree: postures and the row of each one's parent.
        trees: tuple[_Tree, _Tree] = ([start], [-1]), ([end], [-1])
        for number, goal in enumerate(random_starts(self._kinematics, TRIES, rng)):
            # By turns each tree grows a step, and the other one follows as far as it can.
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
        """Distance that a way between two postures keeps from the object [m]."""
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
    """Add a posture to a tree, a step towards a goal; None if something is in the way."""
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
    """From a posture of a tree to its root."""
    nodes, parents = tree
    row = next(i for i, node in enumerate(nodes) if np.array_equal(node, posture))
    way = []
    while row >= 0:
        way.append(nodes[row])
        row = parents[row]
    return way


def _shortcut(way: list[np.ndarray], free: Callable[[np.ndarray, np.ndarray], bool]) -> list[np.ndarray]:
    """Leave out corners that can be passed by."""
    result, here = [way[0]], 0
    while here < len(way) - 1:
        there = next(i for i in range(len(way) - 1, here, -1) if i == here + 1 or free(way[here], way[i]))
        result.append(way[there])
        here = there
    return result
