"""A hand mounted on the flange of a robot arm."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.errors import UnknownNameError
from fungrasp.hands.hand import Hand
from fungrasp.hands.self_contained_mjcf import self_contained_xml

FLANGE_SITE = "tool0"
"""Site of an arm's model where a hand is mounted; z points out of the flange."""

PALM_SITE = "mounted_palm"
"""Site that ``mount`` puts at the origin of the palm body."""

MOUNTING_GAP = 0.001
"""Clearance between the flange and the palm [m]."""

_PREFIX = "mounted/"


def arm_files() -> dict[str, Path]:
    """Model of every arm we ship, by name."""
    return {path.stem: path for path in sorted((Path(__file__).parent / "arms").glob("*.xml"))}


def arm_spec(arm: str) -> mujoco.MjSpec:
    """A fresh model of a bare arm: base at the world's origin, one position actuator per joint, named as it.

    Raises:
        UnknownNameError: no such arm.
    """
    if arm not in arm_files():
        raise UnknownNameError("arm", arm, arm_files())
    return mujoco.MjSpec.from_file(str(arm_files()[arm]))


def mounting_pose(hand: Hand) -> np.ndarray:
    """Pose of the palm body on a flange whose z axis points out of it.

    The fingers point along the flange's z axis and the palm faces its x axis; the shapes of the palm are
    centered on the z axis and begin ``MOUNTING_GAP`` above the flange.

    Returns:
        ``pose_flange_palm``, shape [7].
    """
    z = hand.palm_fingers
    x = hand.palm_normal - (hand.palm_normal @ z) * z
    x = x / np.linalg.norm(x)
    rows = np.stack([x, np.cross(z, x), z])
    lower, upper = _palm_bounds(hand, rows)
    position = -np.array([*(0.5 * (lower + upper))[:2], lower[2] - MOUNTING_GAP])
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rows.ravel())
    return np.concatenate([position, quaternion])


def mount(hand: Hand, arm: str = "ur5e") -> mujoco.MjSpec:
    """The hand on the flange of an arm, the arm's base at the world's origin.

    Names of both stay as they are; meshes are held in the spec itself. The weight of the palm is compensated
    by the arm (as a payload known to its controller), that of the fingers is not. A site ``PALM_SITE`` marks
    the frame of the palm body.

    Raises:
        UnknownNameError: no such arm.
        FungraspError: the hand and the arm don't make one model, for example because they share a name.
    """
    spec = arm_spec(arm)
    child = hand.spec()
    palm = child.body(hand.palm)
    palm.gravcomp = 1.0
    palm.add_site(name=PALM_SITE, size=[0.001, 0, 0])
    pose = mounting_pose(hand)
    flange = spec.site(FLANGE_SITE)
    frame = flange.parent.add_frame(pos=pose[:3], quat=pose[3:])
    spec.attach(child, prefix=_PREFIX, frame=frame)
    # Default classes keep the prefix, since both models have a class "main"; all else gets its name back.
    return mujoco.MjSpec.from_string(re.sub(f'(?<!class)="{_PREFIX}', '="', self_contained_xml(spec)))


def _palm_bounds(hand: Hand, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Extent of the palm body's shapes [m] along unit vectors of the palm frame.

    rows: the unit vectors, shape [3, 3]. Returns lower and upper end, each of shape [3].
    """
    model = hand.model
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for geom in np.flatnonzero(model.geom_bodyid == model.body(hand.palm).id):
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        rotation = rotation.reshape(3, 3)
        center = rows @ (model.geom_pos[geom] + rotation @ model.geom_aabb[geom, :3])
        half = np.abs(rows @ rotation) @ model.geom_aabb[geom, 3:]
        lower, upper = np.minimum(lower, center - half), np.maximum(upper, center + half)
    if not np.isfinite(lower).all():
        return np.zeros(3), np.zeros(3)
    return lower, upper
