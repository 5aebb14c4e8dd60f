"""Check of base and mount of a cell by touched points, which a JSON file lists (``TouchedPoints``)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
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
"""Error of a touched point beyond which base or mount are wrong [m]."""

LEAST_POINTS = 3
"""Smallest number of points for the base: two determine its turn, a third reveals a mistake."""

LEAST_HAND_POINTS = 2
"""Smallest number of points for the mount. The hand must be turned differently, or an error along one axis
stays hidden."""

LEAST_SPREAD = 0.1
"""Smallest distance of the farthest point from the mean of the points [m]: closer points hardly determine the
turn."""

Point = tuple[float, float, float]


@dataclass(frozen=True)
class TouchedPoint:
    """A marked point that the robot touched."""

    joints: tuple[float, ...]
    """Joints of the arm [rad]."""
    point: Point
    """Marked point, world frame [m]."""
    hand_point: Point | None = None
    """Point of the hand that touched it, in the frame of ``mount.pose_flange_hand`` [m]; None for the center
    of the flange."""


@dataclass(frozen=True)
class TouchedPoints:
    """Content of the file."""

    touched: tuple[TouchedPoint, ...] = ()
    """Points in the order of touching."""


@dataclass(frozen=True)
class TouchCheck:
    """Distances between touched points and the cell's predictions."""

    miss: float
    """Largest distance [m]."""
    count: int
    """Number of points."""
    fault: str
    """What is wrong, as a phrase; "" if nothing."""


def check_touched(path: str | Path, cell: RobotCell, hand: Hand) -> dict[str, TouchCheck]:
    """Compare the points of a file with the cell: the "base" by points that the flange touched, the "mount"
    by points that the hand touched, if there are any. Raises: FungraspError: the file can't be read, or it
    has too few points, or points too close to each other."""
    known = load_touched(path, len(cell.arm.home))
    found = {"base": _check_base([t for t in known if t.hand_point is None], cell, hand)}
    by_hand = [t for t in known if t.hand_point is not None]
    return {**found, "mount": _check_mount(by_hand, cell, hand)} if by_hand else found


def _check_base(known: Sequence[TouchedPoint], cell: RobotCell, hand: Hand) -> TouchCheck:
    if len(known) < LEAST_POINTS:
        raise FungraspError(f"the base is checked with {LEAST_POINTS} touched points or more")
    computed, touched = _flange(known, cell, hand)[:, :3], np.array([t.point for t in known])
    a, b = (points - points.mean(axis=0) for points in (computed, touched))
    if np.linalg.norm(b[:, :2], axis=1).max() < LEAST_SPREAD:
        raise FungraspError("the touched points are too near to one another: 30 cm apart and more")
    sine = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    degrees = round(np.rad2deg(np.arctan2(sine, np.sum(a[:, :2] * b[:, :2]))))
    turned = "; the pendant's Base is turned by 180 degrees from ours" if abs(abs(degrees) - 180) < 5 else ""
    return _check(
        touched - computed,
        f"the touched points are up to {{miss}} mm from where 'arm.pose_world_base' has them: turned by "
        f"{degrees} degrees about z, and off by {{mean}} mm at their middle{turned}",
    )


def _check_mount(known: Sequence[TouchedPoint], cell: RobotCell, hand: Hand) -> TouchCheck:
    if len(known) < LEAST_HAND_POINTS:
        raise FungraspError(f"the mount is checked with {LEAST_HAND_POINTS} points that the hand touched")
    touched = np.array([t.point for t in known])[:, None]
    seen = inverse_transform_points(_flange(known, cell, hand), touched)[:, 0]
    return _check(
        seen - np.array([_on_flange(t, cell) for t in known]),
        "the points that the hand touched are up to {miss} mm from where 'mount.pose_flange_hand' has them, "
        "in the mean by {mean} mm in the frame of the flange",
    )


def _check(apart: np.ndarray, fault: str) -> TouchCheck:
    """apart: error of each point [m], shape [K, 3]; fault: message with the fields {miss} and {mean}."""
    miss = float(np.linalg.norm(apart, axis=1).max())
    # Adding zero avoids "-0".
    x, y, z = np.round(1e3 * apart.mean(axis=0)) + 0.0
    said = fault.format(miss=f"{1e3 * miss:.0f}", mean=f"({x:.0f}, {y:.0f}, {z:.0f})")
    return TouchCheck(miss, len(apart), said if miss > LARGEST_MISS else "")


def touched_place(touched: TouchedPoint, cell: RobotCell, hand: Hand) -> np.ndarray:
    """Return where the cell predicts the touched point, world frame [m], shape [3]."""
    return transform_points(_flange([touched], cell, hand)[0], _on_flange(touched, cell)[None])[0]


def _flange(known: Sequence[TouchedPoint], cell: RobotCell, hand: Hand) -> np.ndarray:
    """Return flange poses at K points, world frame, shape [K, 7]."""
    kinematics, on_palm = ArmKinematics(cell, hand), invert(mounting_pose(hand, cell.mount))
    return compose(np.array([kinematics.palm_pose(np.array(t.joints)) for t in known]), on_palm)


def _on_flange(touched: TouchedPoint, cell: RobotCell) -> np.ndarray:
    """Return the touching point, flange frame [m], shape [3]."""
    if touched.hand_point is None:
        return np.zeros(3)
    given = np.array(cell.mount.pose_flange_hand or (0.0, 0.0, MOUNTING_GAP, 1.0, 0.0, 0.0, 0.0))
    return transform_points(given, np.array([touched.hand_point]))[0]


def load_touched(path: str | Path, count: int) -> tuple[TouchedPoint, ...]:
    """Read the points of a file. count: joints of the arm. Raises: FungraspError: an invalid file."""
    known = record_from_json(TouchedPoints, read_json(path, "touched points"), str(path)).touched
    if any(len(touched.joints) != count for touched in known):
        raise FungraspError(f"{path}: 'joints' needs a posture of {count} joints for each point")
    return known


def add_touched(path: str | Path, touched: TouchedPoint) -> int:
    """Add a point to a file, which is created if missing. Return the number of its points of the same kind
    (flange or hand). Raises: FungraspError: the file is invalid or can't be written."""
    known = load_touched(path, len(touched.joints)) if Path(path).exists() else ()
    known = (*known, touched)
    with atomic_path(path) as temporary:
        text = json.dumps(record_to_json(TouchedPoints(known)), indent=1)
        temporary.write_text(text + "\n", encoding="utf-8")
    return sum((one.hand_point is None) == (touched.hand_point is None) for one in known)
