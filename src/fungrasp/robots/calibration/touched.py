"""Whether an arm stands where its cell says, and its hand is on the flange as it says: by points that the
robot has touched, which a file of JSON holds.

``flange`` are marked points that the middle of the flange has touched, world frame [m], and ``joints`` the
postures of the arm meanwhile [rad]; ``hand`` and ``hand_joints`` the same of a point of the hand, which is
``hand_point``, in the frame that ``mount.pose_flange_hand`` is the pose of [m].
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.text_files import read_json
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


POSTURES = {"flange": "joints", "hand": "hand_joints"}
"""Name of the postures in which something touched points."""


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
    or has too few points."""
    kinematics = ArmKinematics(cell, hand)
    joints, points = load_touched(path, "flange", len(kinematics.lower))
    return check_base(np.array([kinematics.flange_position(q) for q in joints]).reshape(-1, 3), points)


def check_base(computed: np.ndarray, touched: np.ndarray) -> TouchCheck:
    """Compare where the flange is by the cell with where it was. computed: by forward kinematics, world frame
    [m], shape [K, 3]; touched: the marked points, world frame [m], shape [K, 3]. Raises: FungraspError: too
    few points, or too near to one another."""
    if computed.shape != touched.shape or touched.ndim != 2 or len(touched) < LEAST_POINTS:
        raise FungraspError(
            f"the base is checked with {LEAST_POINTS} touched points or more, of 3 numbers each"
        )
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
    joints, touched = load_touched(path, "hand", len(kinematics.lower))
    if not len(joints):
        return None
    if len(joints) < LEAST_HAND_POINTS:
        raise FungraspError(
            f"{path}: the mount is checked with {LEAST_HAND_POINTS} points that the hand touched"
        )
    flange, on_flange = _flange(joints, kinematics, cell, hand), _on_flange(load_hand_point(path), cell)
    seen = np.array([inverse_transform_points(f, t[None])[0] for f, t in zip(flange, touched, strict=True)])
    miss = float(np.linalg.norm(seen - on_flange, axis=1).max())
    # Without a sign before zero.
    x, y, z = np.round(1e3 * (seen - on_flange).mean(axis=0)) + 0.0
    said = (
        f"the points that the hand touched are up to {1e3 * miss:.0f} mm from where 'mount.pose_flange_hand' "
        f"has them, in the mean by ({x:.0f}, {y:.0f}, {z:.0f}) mm in the frame of the flange"
    )
    return TouchCheck(miss, len(joints), said if miss > LARGEST_MISS else "")


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


def load_touched(path: str | Path, what: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Postures of the arm [rad], shape [K, M], and the points that were touched in them, world frame [m],
    shape [K, 3]; none where ``what`` has touched nothing. what: touched them: "flange" or "hand". Raises:
    FungraspError: the file is none of these."""
    tree, names = _read(path), (POSTURES[what], what)
    if what not in tree:
        return np.zeros((0, count)), np.zeros((0, 3))
    try:
        joints, points = (np.array(tree[name], dtype=float) for name in names)
    except (KeyError, TypeError, ValueError) as error:
        raise FungraspError(f"{path}: '{what}' needs '{names[0]}', both lists of lists of numbers") from error
    if not len(joints) == len(points) == 0 and (joints.ndim != 2 or points.shape != (len(joints), 3)):
        raise FungraspError(f"{path}: as many '{names[0]}' as points of 3 numbers in '{what}' are needed")
    if len(joints) and joints.shape[1] != count:
        raise FungraspError(f"{path}: a posture has {count} joints")
    if not (np.isfinite(joints).all() and np.isfinite(points).all()):
        raise FungraspError(f"{path}: numbers must be finite")
    return joints.reshape(-1, count), points.reshape(-1, 3)


def load_hand_point(path: str | Path) -> np.ndarray:
    """The point of the hand that has touched others, in the mount's frame [m], shape [3]. Raises:
    FungraspError: the file does not say it."""
    try:
        point = np.array(_read(path)["hand_point"], dtype=float)
    except (KeyError, TypeError, ValueError):
        point = np.zeros(0)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise FungraspError(f"{path}: 'hand' needs 'hand_point', 3 numbers")
    return point


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
    what = "flange" if hand_point is None else "hand"
    tree = _read(path) if Path(path).exists() else {}
    known, points = load_touched(path, what, len(joints)) if tree else (np.zeros((0, 0)), np.zeros((0, 3)))
    if hand_point is not None:
        if len(known) and not np.allclose(load_hand_point(path), hand_point):
            raise FungraspError(f"{path} is of another point of the hand: take another file")
        tree["hand_point"] = hand_point.tolist()
    tree[POSTURES[what]] = [*known.tolist(), joints.tolist()]
    tree[what] = [*points.tolist(), point.tolist()]
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(tree, indent=1) + "\n", encoding="utf-8")
    return len(tree[what])


def _read(path: str | Path) -> dict[str, Any]:
    tree = read_json(path, "touched points")
    if not isinstance(tree, dict) or not {*POSTURES} & set(tree):
        raise FungraspError(f"{path}: no touched points ('flange' with 'joints', 'hand' with 'hand_joints')")
    return tree
