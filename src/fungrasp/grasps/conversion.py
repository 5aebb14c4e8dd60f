"""Human grasps in other conventions made ours, hands below the table mended, and grasps in a mirror."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from fungrasp.grasps.diagnosis import BELOW_TABLE, UNITS
from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.human_hand import joint_order, mirror_points, mirror_pose
from fungrasp.objects.object_variants import MIRRORED, mirrored_name

POSES = ("object_pose", "object_rest_pose")


def converted(
    arrays: Mapping[str, np.ndarray],
    order: str = "fungrasp",
    quaternion: Literal["wxyz", "xyzw"] = "wxyz",
    unit: Literal["m", "cm", "mm"] = "m",
    side: Literal["right", "left"] = "right",
) -> dict[str, np.ndarray]:
    """The fields of a file of human grasps in our conventions.

    Args:
        arrays: by name, as the file has them.
        order: of the joints, one of ``ORDERS``; joint rotations are left out if it is not ours.
        quaternion: order of the numbers of quaternions.
        side: of the hands; the scene of left ones is mirrored in the plane y = 0.
    """
    result = dict(arrays)
    result["hand_joints"] = result["hand_joints"][:, joint_order(order)] * UNITS[unit]
    for name in POSES:
        pose = result[name].astype(float)
        pose[:, :3] *= UNITS[unit]
        result[name] = pose[:, [0, 1, 2, 6, 3, 4, 5]] if quaternion == "xyzw" else pose
    if side == "left":
        result["hand_joints"] = mirror_points(result["hand_joints"])
        result |= {name: mirror_pose(result[name]) for name in POSES}
        result["object_name"] = np.char.add(result["object_name"].astype(str), MIRRORED)
    if order != "fungrasp" or unit != "m" or side == "left":
        result.pop("hand_qpos", None)
    return result


def mend_below_table(grasps: HumanGraspSet, how: Literal["keep", "lift", "drop"]) -> HumanGraspSet:
    """Grasps whose hands reach below the table: kept, left out, or lifted with their object until the hand
    does not."""
    depth = np.minimum(grasps.hand_joints[..., 2].min(axis=1, initial=np.inf), 0.0)
    below = depth < BELOW_TABLE
    if how == "keep" or not below.any():
        return grasps
    if how == "drop":
        return grasps.select(~below)
    up = np.where(below, -depth, 0.0)[:, None] * [0.0, 0.0, 1.0]
    pose, qpos = grasps.object_pose.copy(), grasps.hand_qpos
    pose[:, :3] += up
    if qpos is not None:
        qpos = np.concatenate([qpos[:, :3] + up, qpos[:, 3:]], axis=1)
    return replace(grasps, object_pose=pose, hand_joints=grasps.hand_joints + up[:, None], hand_qpos=qpos)


def mirrored_grasps(grasps: HumanGraspSet) -> HumanGraspSet:
    """The scenes reflected in the world's plane y = 0.

    The objects are reflected too: an object ``mug`` becomes ``mug_mirrored``, which
    ``fungrasp.objects.load_object`` knows, and back. ``hand_qpos`` is left out, as the angles of a left hand
    mean other rotations.
    """
    return replace(
        grasps,
        object_name=np.array([mirrored_name(str(name)) for name in grasps.object_name]),
        object_pose=mirror_pose(grasps.object_pose),
        object_rest_pose=mirror_pose(grasps.object_rest_pose),
        hand_joints=mirror_points(grasps.hand_joints),
        hand_qpos=None,
    )
