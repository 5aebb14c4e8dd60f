"""Whether an arm can carry the palm along a path, and with which posture it should begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.robots.cell import RobotCell, plan_speed
from fungrasp.robots.kinematics.arm_model import MARGIN, ArmKinematics, ClearanceModel, outside
from fungrasp.robots.kinematics.inverse import PalmFollower, arm_postures, random_starts
from fungrasp.robots.kinematics.joint_path import CLEAR

STARTS = 48
"""Random postures from which the solutions of a pose are sought; 32 find all eight of a UR5e."""

LEAST_MANIPULABILITY = 0.04
"""Nearer to a singularity the arm is not taken."""

TABLE_ROOM = 0.005
"""The arm of a plan stays so much farther from the table than the arm that moves must [m]: policies correct
the palm by some millimeters."""

LARGEST_ERROR = 0.002
"""Error of the palm on the path beyond which it does not follow [m, and rad for ten times as much]."""

PATIENT = 50
"""An arm that gets there in so many times the time is too slow, not too short."""

OUT_OF_REACH = "the start is out of the arm's reach"


@dataclass(frozen=True, eq=False)
class PalmPath:
    """Where palm and fingers are to be, T steps."""

    palm: np.ndarray
    """Poses of the palm, world frame, shape [T, 7]."""
    fingers: np.ndarray
    """Independent joints [rad], shape [T, U]."""
    period: float
    """Time between two steps [s]."""


@dataclass(frozen=True, eq=False)
class Reach:
    """How well an arm follows a path from one posture."""

    start: np.ndarray
    """Posture at the beginning [rad], shape [M]."""
    end: np.ndarray
    """Posture at the end [rad], shape [M]."""
    margin: float
    """Least of clearance, manipulability and distance from the joints' limits on the way, each as a share of
    what is plenty."""
    obstacle: str
    """What is in the way, as a phrase; "" for nothing."""


class ReachChecker:
    """Checks paths of one robot."""

    def __init__(
        self, cell: RobotCell, kinematics: ArmKinematics, clearance: ClearanceModel, rng: np.random.Generator
    ):
        """rng: of the postures that solutions are sought from."""
        self._cell, self._kinematics, self._clearance, self._rng = cell, kinematics, clearance, rng
        # A plan that takes longer moves the arm more slowly.
        self._follower = PalmFollower(kinematics, cell.limits.arm_speed / plan_speed(cell.limits))

    def possible(self, path: PalmPath, home: np.ndarray) -> str:
        """What is in the way of a path from every posture, whatever the hand does to the table, as a phrase;
        "" if it can be followed from some posture. Quicker than ``best``. home: a posture that solutions are
        sought from beside random ones [rad], shape [M]."""
        beyond = outside(path.palm, self._cell.workspace)
        if beyond:
            return beyond
        nearest = Reach(np.zeros(0), np.zeros(0), -2.0, OUT_OF_REACH)
        for posture in self._postures(path, home, STARTS // 2):
            reach = self.follow(path, posture, hand_matters=False)
            if not reach.obstacle:
                return ""
            nearest = max(nearest, reach, key=lambda r: r.margin)
        return nearest.obstacle

    def best(self, path: PalmPath, home: np.ndarray) -> tuple[list[Reach], str]:
        """The postures from which the path can be followed, the best first. home: where the arm is now [rad],
        shape [M]; of two that do as well, the nearer is better. Returns: those that can, and what is in the
        way of the best of the others, "" if some can."""
        beyond = outside(path.palm, self._cell.workspace)
        if beyond:
            return [], beyond
        tried = [self.follow(path, posture) for posture in self._postures(path, home)]
        free = [reach for reach in tried if not reach.obstacle]
        free.sort(key=lambda r: min(r.margin, 0.5) - 0.05 * float(np.abs(r.start - home).max()), reverse=True)
        if free:
            return free, ""
        return [], max(tried, key=lambda reach: reach.margin).obstacle if tried else OUT_OF_REACH

    def followed(self, paths: Sequence[PalmPath], home: np.ndarray) -> np.ndarray:
        """Whether the arm can follow paths that begin at the same pose, a bool array, one for each: from any
        posture. home: where the arm is now [rad], shape [M]."""
        postures = list(self._postures(paths[0], home))
        can = np.zeros(len(paths), dtype=bool)
        for i, path in enumerate(paths):
            if outside(path.palm, self._cell.workspace):
                continue
            for number, posture in enumerate(postures):
                if not self.follow(path, posture).obstacle:
                    # What serves one serves most of the others.
                    postures.insert(0, postures.pop(number))
                    can[i] = True
                    break
        return can

    def _postures(self, path: PalmPath, home: np.ndarray, count: int = STARTS) -> np.ndarray:
        """Postures at the beginning of a path, sought from home and ``count`` random ones."""
        starts = np.concatenate([home[None], random_starts(self._kinematics, count, self._rng)])
        return arm_postures(self._kinematics, path.palm[0], starts)

    def follow(self, path: PalmPath, posture: np.ndarray, hand_matters: bool = True) -> Reach:
        """Follow a path from a posture. posture: at its beginning [rad], shape [M]; hand_matters: whether the
        hand must not press into the table."""
        k, c, box = self._kinematics, self._cell, self._cell.workspace
        follower, margin, joints = self._follower, np.inf, posture
        follower.begin(posture)
        for step, (palm, fingers) in enumerate(zip(path.palm, path.fingers, strict=True)):
            joints, place, turn = follower.follow(palm, path.period)
            gap = self._clearance.measure(joints, fingers)
            share = k.manipulability(joints)
            ends = float(np.minimum(joints - k.lower, k.upper - joints).min())
            obstacle = ""
            if place > LARGEST_ERROR or turn > 10 * LARGEST_ERROR:
                _, place, turn = follower.follow(palm, PATIENT * path.period)
                far = place > LARGEST_ERROR or turn > 10 * LARGEST_ERROR
                speed = f"a joint of the arm would move faster than limits.arm_speed = {c.limits.arm_speed:g}"
                obstacle = "the arm doesn't reach so far" if far else speed
            elif near := (gap if hand_matters else replace(gap, hand=MARGIN)).fault(box, TABLE_ROOM, CLEAR):
                obstacle = near
            elif share < LEAST_MANIPULABILITY:
                obstacle = "the arm would be singular"
            if obstacle:
                return Reach(posture, joints, step / len(path.palm) - 1.0, obstacle)
            margin = min(margin, gap.itself / MARGIN, share / 0.2, ends / 0.5)
        return Reach(posture, joints, margin, "")
