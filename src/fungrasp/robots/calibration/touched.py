"""Whether an arm stands where its cell says, and its hand is on the flange as it says: by points that the
robot has touched, which a file of JSON holds (``TouchedPoints``)."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.text_files import read_json
from fungrasp.core.records import record_from_json, record_to_json
from fungrasp.geometry.poses import compose, inverse_transform_points, invert, transform_points
from fungrasp.hands import Hand
from fungrasp.hands.arm import MOUNTING_GAP, mounting_pose
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

Point = tuple[float, float, float]


@dataclass(frozen=True)
class TouchedPoints:
    """Marked points, world frame [m], and postures of the arm in which they were touched [rad]."""

    joints: tuple[tuple[float, ...], ...] = ()
    """Postures in which the middle of the flange touched points."""
    flange: tuple[Point, ...] = ()
    """Those points."""
    hand_joints: tuple[tuple[float, ...], ...] = ()
    """Postures in which a point of the hand touched points."""
    hand: tuple[Point, ...] = ()
    """Those points."""
    hand_point: Point | None = None
    """That point of the hand, in the frame that ``mount.pose_flange_hand`` is the pose of [m]."""


@dataclass(frozen=True)
class TouchCheck:
    """How far what touched points is from where it was."""

    miss: float
    """Farthest [m]."""
    count: int
    """Number of points."""
    fault: str
    """What is wrong, as a phrase; "" for nothing."""


def check_touched_base(path: str | Path, cell: RobotCell, hand: Hand) -> TouchCheck:
    """Compare where the flange was with where the cell has it. Raises: FungraspError: the file can't be read,
    or has too few points, or too near to one another."""
    kinematics = ArmKinematics(cell, hand)
    known = load_touched(path, len(kinematics.lower))
    if len(known.flange) < LEAST_POINTS:
        raise FungraspError(f"{path}: the base is checked with {LEAST_POINTS} touched points or more")
    computed = np.array([kinematics.flange_position(np.array(q)) for q in known.joints])
    touched = np.array(known.flange)
    a, b = (points - points.mean(axis=0) for points in (computed, touched))
    if np.linalg.norm(b[:, :2], axis=1).max() < LEAST_SPREAD:
        raise FungraspError("the touched points are too near to one another: 30 cm apart and more")
    miss = float(np.linalg.norm(touched - computed, axis=1).max())
    if miss <= LARGEST_MISS:
        return TouchCheck(miss, len(touched), "")
    sine = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    degrees = round(np.rad2deg(np.arctan2(sine, np.sum(a[:, :2] * b[:, :2]))))
    x, y, z = 1e3 * (touched - computed).mean(axis=0)
    said = (
        f"the touched points are up to {1e3 * miss:.0f} mm from where 'arm.pose_world_base' has them: turned "
        f"by {degrees} degrees about z, and off by ({x:.0f}, {y:.0f}, {z:.0f}) mm at their middle"
    )
    if abs(abs(degrees) - 180) < 5:
        said += "; the pendant's Base is turned by 180 degrees from ours"
    return TouchCheck(miss, len(touched), said)


def check_touched_mount(path: str | Path, cell: RobotCell, hand: Hand) -> TouchCheck | None:
    """Compare where a point of the hand was with where the cell has it; None if the hand touched nothing.
    Raises: FungraspError: the file can't be read, or has too few points."""
    kinematics = ArmKinematics(cell, hand)
    known = load_touched(path, len(kinematics.lower))
    if known.hand_point is None:
        return None
    if len(known.hand) < LEAST_HAND_POINTS:
        raise FungraspError(
            f"{path}: the mount is checked with {LEAST_HAND_POINTS} points that the hand touched"
        )
    flange = _flange(np.array(known.hand_joints), kinematics, cell, hand)
    on_flange = _on_flange(np.array(known.hand_point), cell)
    touched = np.array(known.hand)[:, None]
    seen = np.concatenate([inverse_transform_points(f, t) for f, t in zip(flange, touched, strict=True)])
    miss = float(np.linalg.norm(seen - on_flange, axis=1).max())
    # Without a sign before zero.
    x, y, z = np.round(1e3 * (seen - on_flange).mean(axis=0)) + 0.0
    said = (
        f"the points that the hand touched are up to {1e3 * miss:.0f} mm from where 'mount.pose_flange_hand' "
        f"has them, in the mean by ({x:.0f}, {y:.0f}, {z:.0f}) mm in the frame of the flange"
    )
    return TouchCheck(miss, len(touched), said if miss > LARGEST_MISS else "")


def touched_point(
    joints: np.ndarray, hand_point: np.ndarray | None, cell: RobotCell, hand: Hand
) -> np.ndarray:
    """Where the cell has what touches, world frame [m], shape [3].

    Args:
        joints: of the arm [rad], shape [A].
        hand_point: of the hand, in the mount's frame [m], shape [3]; None for the middle of the flange.
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


def load_touched(path: str | Path, count: int) -> TouchedPoints:
    """Points of a file, as many as postures. count: joints of the arm. Raises: FungraspError: the file is
    none of these."""
    known = record_from_json(TouchedPoints, read_json(path, "touched points"), str(path))
    for what, points, postures in (
        ("joints", known.flange, known.joints),
        ("hand_joints", known.hand, known.hand_joints),
    ):
        if len(points) != len(postures) or any(len(posture) != count for posture in postures):
            raise FungraspError(f"{path}: '{what}' needs a posture of {count} joints for each point")
    if bool(known.hand) != (known.hand_point is not None):
        raise FungraspError(f"{path}: 'hand' and 'hand_point' go together")
    return known


def add_touched(
    path: str | Path, joints: np.ndarray, point: np.ndarray, hand_point: np.ndarray | None = None
) -> int:
    """Add a point to the file, or begin one; how many its list has then.

    Args:
        joints: posture of the arm [rad], shape [M].
        point: that was touched, world frame [m], shape [3].
        hand_point: the point of the hand that touched it, in the mount's frame [m], shape [3]; None for the
            middle of the flange.

    Raises:
        FungraspError: the file is none of these, has another point of the hand, or can't be written.
    """
    known = load_touched(path, len(joints)) if Path(path).exists() else TouchedPoints()
    posture, there = tuple(joints.tolist()), tuple(point.tolist())
    if hand_point is None:
        known = replace(known, joints=(*known.joints, posture), flange=(*known.flange, there))
    else:
        if known.hand_point is not None and not np.allclose(known.hand_point, hand_point):
            raise FungraspError(f"{path} is of another point of the hand: take another file")
        postures, points = (*known.hand_joints, posture), (*known.hand, there)
        known = replace(known, hand_joints=postures, hand=points, hand_point=tuple(hand_point.tolist()))
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(record_to_json(known), indent=1) + "\n", encoding="utf-8")
    return len(known.flange if hand_point is None else known.hand)
