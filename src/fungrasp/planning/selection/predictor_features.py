"""What a planned grasp looks like before it is tried: the input of the plan critic."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.poses import compose, invert, rotate, rotation_matrix, transform_points
from fungrasp.objects import ObjectModel
from fungrasp.planning.references import References, object_tables
from fungrasp.task.observation import POSITION_UNIT


def plan_features(references: References, objects: Mapping[str, ObjectModel]) -> dict[str, np.ndarray]:
    """By name, each of shape [N, number]; palm frame, scaled to be of the order of one.

    Args:
        references: N planned grasps.
        objects: by name.
    """
    motion = references.motion
    names = sorted(set(references.object_name.tolist()))
    index = np.array([names.index(name) for name in references.object_name.tolist()])
    bank = SignedDistanceBank([objects[name].signed_distance for name in names])
    center, size = object_tables(names, objects)
    distance, normal = bank.query(index, references.keypoints)
    to_palm = invert(motion.wrist)
    count = len(references)
    keypoints = transform_points(to_palm, references.keypoints)
    normals = rotate(to_palm[:, None, 3:], normal)
    up = rotate(to_palm[:, 3:], rotate(invert(references.settled_pose)[:, 3:], np.array([0.0, 0.0, 1.0])))
    axes = np.abs(rotation_matrix(to_palm[:, 3:]))
    press = compose(to_palm, motion.wrist_goal[:, -1])[:, :3]
    height = compose(references.settled_pose, motion.wrist)[:, 2:3]
    return {
        "keypoints": keypoints.reshape(count, -1) / POSITION_UNIT,
        "surface_distances": np.clip(distance / 0.02, -1.0, 2.5),
        "surface_normals": normals.reshape(count, -1),
        "grasp": motion.grasp,
        "squeeze": motion.finger_targets[:, -1] - motion.grasp,
        "press": press / 0.01,
        "object_center": transform_points(to_palm, center[index][:, None])[:, 0] / (2 * POSITION_UNIT),
        "object_extents": (axes * size[index][:, None]).sum(axis=-1) / (2 * POSITION_UNIT),
        "up": up,
        "palm_height": height / (2 * POSITION_UNIT),
        "target_contacts": references.contacts.astype(float),
        "mass": np.log(references.mass[:, None] / 0.3),
        "collision": motion.collision[:, None] / 0.01,
    }
