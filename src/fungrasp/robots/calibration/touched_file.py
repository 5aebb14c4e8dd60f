"""The file of points that a robot has touched, by which base and mount are checked.

JSON: ``flange`` are marked points that the middle of the flange has touched, world frame [m], and ``joints``
the postures of the arm meanwhile [rad]; ``hand`` and ``hand_joints`` the same of a point of the hand, which
is ``hand_point``, in the frame that ``mount.pose_flange_hand`` is the pose of [m].
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.text_files import read_json

POSTURES = {"flange": "joints", "hand": "hand_joints"}
"""Name of the postures in which something touched points."""


def load_touched(path: str | Path, what: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Postures of the arm [rad], shape [K, M], and the points that were touched in them, world frame [m],
    shape [K, 3]; none where ``what`` has touched nothing.

    Args:
        path: the file.
        what: touched them: "flange" or "hand".
        count: of the arm's joints, M.

    Raises:
        FungraspError: the file is none of these.
    """
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
    """The point of the hand that has touched others, in the mount's frame [m], shape [3].

    Raises:
        FungraspError: the file does not say it.
    """
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
        path: the file.
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
