"""Variations of human grasps: more demonstrations for learning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.grasps.contacts import link_contacts
from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.human_hand import FINGERTIPS
from fungrasp.objects import ObjectModel, check_objects

SHIFT, TURN = 0.008, 0.15
"""Standard deviations of the hand's shift along each axis [m] and turn about each axis [rad]. A quarter of
the plans of such variations hold the object as shown (Allegro, 6,594 grasps)."""

FEWEST_LINKS = 3
"""Smallest number of finger links that touch in a variation."""


def varied_grasps(
    human: HumanGraspSet, objects: Mapping[str, ObjectModel], count: int, seed: int = 0
) -> HumanGraspSet:
    """Return grasps followed by variations of them. In a variation, the hand is shifted, and turned about the
    mean fingertip, relative to the object; contacts are computed again.

    Variations are left out if a hand is below the table or fewer than ``FEWEST_LINKS`` finger links touch.

    Args:
        human: N grasps.
        objects: their objects by name.
        count: variations of each grasp.

    Raises:
        FungraspError: the count is negative, or an object is missing.
    """
    if count < 0:
        raise FungraspError(f"the number of variations must not be negative, not {count}")
    names = human.object_name.astype(str)
    check_objects(names.tolist(), objects)
    rng, sets = np.random.default_rng(seed), [human]
    for _ in range(count):
        joints = human.hand_joints.astype(float)
        center = joints[:, FINGERTIPS].mean(axis=1, keepdims=True)
        turn = Rotation.from_rotvec(rng.normal(0.0, TURN, (len(human), 3))).as_matrix()
        shift = rng.normal(0.0, SHIFT, (len(human), 1, 3))
        joints = (joints - center) @ np.swapaxes(turn, 1, 2) + center + shift
        contacts = np.zeros_like(human.link_contacts)
        for name in set(names.tolist()):
            rows, mesh = np.flatnonzero(names == name), objects[name]
            contacts[rows] = link_contacts(joints[rows], human.object_pose[rows], mesh.vertices, mesh.faces)
        kept = (contacts[:, 1:].sum(axis=1) >= FEWEST_LINKS) & (joints[..., 2].min(axis=1) > 0)
        varied = replace(human, hand_joints=joints.astype(human.hand_joints.dtype), link_contacts=contacts)
        sets.append(varied.select(kept))
    return HumanGraspSet.concatenate(sets)
