"""Whether a hand is on the flange as its cell says: by points that one of its own points has touched."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.formats.json_file import read_json
from fungrasp.geometry.poses import compose, inverse_transform_points, invert, transform_points
from fungrasp.hands import Hand
from fungrasp.hands.arm import MOUNTING_GAP, mounting_pose
from fungrasp.robots.calibration.base_check import LARGEST_MISS, BaseCheck, check_base, load_touched
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.kinematics.arm_model import ArmKinematics

LEAST_POINTS = 2
"""In postures that turn the hand differently, or an error along one axis hides."""


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
        path: of the touched points (``load_touched``).
        cell: the robot.
        hand: on its arm.

    Raises:
        FungraspError: the file can't be read, or has too few points.
    """
    kinematics = ArmKinematics(cell, hand)
    joints, points = load_touched(path)
    _check_joints(path, joints, kinematics)
    return check_base(np.array([kinematics.flange_position(q) for q in joints]), points)


def check_touched_mount(path: str | Path, cell: RobotCell, hand: Hand) -> MountCheck | None:
    """Compare where a point of the hand was with where the cell has it; None if the hand touched nothing.

    Args:
        path: JSON file with ``hand_joints``, postures of the arm [rad]; ``hand``, the marked points that were
            touched in each, world frame [m]; and ``hand_point``, the point of the hand that touched them, in
            the frame that ``mount.pose_flange_hand`` is the pose of [m].
        cell: the robot.
        hand: on its arm.

    Raises:
        FungraspError: the file can't be read, or has too few points.
    """
    tree = read_json(path, "touched points")
    if not isinstance(tree, dict) or "hand" not in tree:
        return None
    try:
        names = ("hand_joints", "hand", "hand_point")
        joints, touched, point = (np.array(tree[name], dtype=float) for name in names)
    except (KeyError, TypeError, ValueError) as error:
        raise FungraspError(
            f"{path}: 'hand' needs 'hand_joints' and 'hand_point', lists of numbers"
        ) from error
    finite = all(np.isfinite(values).all() for values in (joints, touched, point))
    if joints.ndim != 2 or touched.shape != (len(joints), 3) or point.shape != (3,) or not finite:
        raise FungraspError(f"{path}: as many 'hand_joints' as points of 3 numbers in 'hand' are needed")
    if len(joints) < LEAST_POINTS:
        raise FungraspError(f"{path}: the mount is checked with {LEAST_POINTS} points that the hand touched")
    kinematics = ArmKinematics(cell, hand)
    _check_joints(path, joints, kinematics)
    on_palm = invert(mounting_pose(hand, cell.mount))
    flange = compose(np.array([kinematics.palm_pose(q) for q in joints]), on_palm)
    given = np.array(cell.mount.pose_flange_hand or (0.0, 0.0, MOUNTING_GAP, 1.0, 0.0, 0.0, 0.0))
    on_flange = transform_points(given, point[None])[0]
    seen = np.array([inverse_transform_points(f, t[None])[0] for f, t in zip(flange, touched, strict=True)])
    apart = seen - on_flange
    return MountCheck(float(np.linalg.norm(apart, axis=1).max()), apart.mean(axis=0), len(joints))


def _check_joints(path: str | Path, joints: np.ndarray, kinematics: ArmKinematics) -> None:
    if joints.shape[1] != len(kinematics.lower):
        raise FungraspError(f"{path}: a posture has {len(kinematics.lower)} joints")
