"""Whether an arm stands where its cell says, and its hand is on the flange as it says: by points that were
touched."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, inverse_transform_points, invert, transform_points
from fungrasp.hands import Hand
from fungrasp.hands.arm import MOUNTING_GAP, mounting_pose
from fungrasp.robots.calibration.touched_file import load_hand_point, load_touched
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.kinematics.arm_model import ArmKinematics

LARGEST_MISS = 0.005
"""A point that is farther from a touched one than this means another base, or another mount [m]."""

LEAST_POINTS = 3
"""Two tell the turn of a base; a third tells a slip."""

LEAST_HAND_POINTS = 2
"""In postures that turn the hand differently, or an error of the mount along one axis hides."""

LEAST_SPREAD = 0.1
"""Points nearer to their middle than this say little of the turn [m]."""


@dataclass(frozen=True, eq=False)
class BaseCheck:
    """How far the flange is from where points were touched."""

    miss: float
    """Farthest [m]."""
    offset: np.ndarray
    """From where the cell has the points to where they are, at their middle, world frame [m], shape [3]."""
    turn: float
    """By which the base is turned about the vertical from what the cell says [rad]."""
    count: int
    """Number of points."""

    @property
    def fault(self) -> str:
        """What is wrong, as a phrase; "" for nothing."""
        if self.miss <= LARGEST_MISS:
            return ""
        x, y, z = 1e3 * self.offset
        degrees = round(np.rad2deg(self.turn))
        said = (
            f"the touched points are up to {1e3 * self.miss:.0f} mm from where 'arm.pose_world_base' has "
            f"them: turned by {degrees} degrees about z, and off by ({x:.0f}, {y:.0f}, {z:.0f}) mm at their "
            "middle"
        )
        if abs(abs(degrees) - 180) < 5:
            said += "; the pendant's Base is turned by 180 degrees from ours"
        return said


def check_base(computed: np.ndarray, touched: np.ndarray) -> BaseCheck:
    """Compare where the flange is by the cell with where it was.

    Args:
        computed: by forward kinematics, world frame [m], shape [K, 3].
        touched: the marked points, world frame [m], shape [K, 3].

    Raises:
        FungraspError: too few points, or too near to one another.
    """
    if computed.shape != touched.shape or touched.ndim != 2 or len(touched) < LEAST_POINTS:
        raise FungraspError(
            f"the base is checked with {LEAST_POINTS} touched points or more, of 3 numbers each"
        )
    a, b = (points - points.mean(axis=0) for points in (computed, touched))
    if np.linalg.norm(b[:, :2], axis=1).max() < LEAST_SPREAD:
        raise FungraspError("the touched points are too near to one another: 30 cm apart and more")
    sine = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    turn = float(np.arctan2(sine, np.sum(a[:, :2] * b[:, :2])))
    miss = float(np.linalg.norm(touched - computed, axis=1).max())
    return BaseCheck(miss, touched.mean(axis=0) - computed.mean(axis=0), turn, len(touched))


@dataclass(frozen=True, eq=False)
class MountCheck:
    """How far a point of the hand is from where points were touched with it."""

    miss: float
    """Farthest [m]."""
    offset: np.ndarray
    """Mean, from where the cell has the point to where it was, frame of the flange [m], shape [3]."""
    count: int
    """Number of points."""

    @property
    def fault(self) -> str:
        """What is wrong, as a phrase; "" for nothing."""
        if self.miss <= LARGEST_MISS:
            return ""
        # Without a sign before zero.
        x, y, z = np.round(1e3 * self.offset) + 0.0
        return (
            f"the points that the hand touched are up to {1e3 * self.miss:.0f} mm from where "
            f"'mount.pose_flange_hand' has them, in the mean by ({x:.0f}, {y:.0f}, {z:.0f}) mm in the "
            "frame of the flange"
        )


def check_touched_base(path: str | Path, cell: RobotCell, hand: Hand) -> BaseCheck:
    """Compare where the flange was with where the cell has it.

    Args:
        path: of the touched points (``touched_file``).
        cell: the robot.
        hand: on its arm.

    Raises:
        FungraspError: the file can't be read, or has too few points.
    """
    kinematics = ArmKinematics(cell, hand)
    joints, points = load_touched(path, "flange", len(kinematics.lower))
    return check_base(np.array([kinematics.flange_position(q) for q in joints]).reshape(-1, 3), points)


def check_touched_mount(path: str | Path, cell: RobotCell, hand: Hand) -> MountCheck | None:
    """Compare where a point of the hand was with where the cell has it; None if the hand touched nothing.

    Args:
        path: of the touched points (``touched_file``).
        cell: the robot.
        hand: on its arm.

    Raises:
        FungraspError: the file can't be read, or has too few points.
    """
    kinematics = ArmKinematics(cell, hand)
    joints, touched = load_touched(path, "hand", len(kinematics.lower))
    if not len(joints):
        return None
    if len(joints) < LEAST_HAND_POINTS:
        raise FungraspError(
            f"{path}: the mount is checked with {LEAST_HAND_POINTS} points that the hand touched"
        )
    flange, on_flange = _flange(joints, kinematics, cell, hand), _on_flange(load_hand_point(path), cell)
    seen = np.array([inverse_transform_points(f, t[None])[0] for f, t in zip(flange, touched, strict=True)])
    apart = seen - on_flange
    return MountCheck(float(np.linalg.norm(apart, axis=1).max()), apart.mean(axis=0), len(joints))


def touched_point(
    joints: np.ndarray, hand_point: np.ndarray | None, cell: RobotCell, hand: Hand
) -> np.ndarray:
    """Where the cell has what touches, world frame [m], shape [3].

    Args:
        joints: of the arm [rad], shape [A].
        hand_point: of the hand, in the mount's frame [m], shape [3]; None for the middle of the flange.
        cell: the robot.
        hand: on its arm.
    """
    kinematics = ArmKinematics(cell, hand)
    if hand_point is None:
        return kinematics.flange_position(joints)
    flange = _flange(joints[None], kinematics, cell, hand)[0]
    return transform_points(flange, _on_flange(hand_point, cell)[None])[0]


def _flange(joints: np.ndarray, kinematics: ArmKinematics, cell: RobotCell, hand: Hand) -> np.ndarray:
    """Poses of the flange, world frame, shape [K, 7]. joints: of the arm [rad], shape [K, A]."""
    on_palm = invert(mounting_pose(hand, cell.mount))
    return compose(np.array([kinematics.palm_pose(q) for q in joints]), on_palm)


def _on_flange(hand_point: np.ndarray, cell: RobotCell) -> np.ndarray:
    """A point of the hand in the frame of the flange [m], shape [3]."""
    given = np.array(cell.mount.pose_flange_hand or (0.0, 0.0, MOUNTING_GAP, 1.0, 0.0, 0.0, 0.0))
    return transform_points(given, hand_point[None])[0]
