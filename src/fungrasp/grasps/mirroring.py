"""Human grasps in a mirror: those of right hands become those of left hands, and the other way round."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.human_hand import mirror_points, mirror_pose
from fungrasp.objects.mirroring import mirrored_name


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
