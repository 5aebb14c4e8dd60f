"""Adaptation of grasps to the settled object.

Measured rest poses are noisy: while the object settles it tilts a little, and round objects roll, which would
move the grasp below the table. The grasp is therefore moved as little as needed to be above the table and in
contact again. It starts from its pose relative to the object or, if that gives a better result, from its pose
before the object rolled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import partial

import numpy as np

from fungrasp.core.parallel import in_chunks
from fungrasp.core.records import CheckedRecord
from fungrasp.geometry.poses import compose, invert
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import GRAVITY
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.problem import CollisionScene, RetargetingProblem


@dataclass(frozen=True)
class AdaptSettings(CheckedRecord):
    """Settings of the adaptation."""

    table_margin: float = 0.001
    """Distance to keep from the table [m]."""
    joint_unit: float = 0.3
    """Change of a joint that counts as one unit [rad]."""
    position_unit: float = 0.01
    """Shift of the wrist that counts as one unit [m]."""
    rotation_unit: float = 0.15
    """Turn of the wrist that counts as one unit [rad]."""
    place_unit: float = 0.007
    """Distance of a contact from the person's contact that counts as one unit [m]."""
    closure_unit: float = 0.06
    """Unbalanced fraction of the contact forces that counts as one unit."""
    closure_friction: float = 0.2
    """Friction coefficient assumed for the force balance."""
    iterations: int = 15
    """Iterations of the optimizer."""
    switch_penalty: float = 3.0
    """Smallest decrease of the objective for which the pose before the object rolled is used."""


def adapt_to_settled_object(
    hand: Hand,
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    settled_pose: np.ndarray,
    wrist_in_object: np.ndarray,
    grasp: np.ndarray,
    settings: AdaptSettings | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return adapted palm poses, frame of the settled object, shape [N, 7], and independent joints [rad],
    shape [N, U].

    Args:
        grasps: N grasps.
        settled_pose: poses of the objects, world frame, shape [N, 7].
        wrist_in_object: palm poses in the grasps, object frame, shape [N, 7].
        grasp: independent joints in the grasps [rad], shape [N, U].
        settings: defaults if None.
    """
    s = AdaptSettings.given(settings)
    names = grasps.object_name.tolist()
    around = CollisionScene.settled(names, settled_pose, objects)
    count, shared = len(grasps), HandPoints(HandKinematics(hand, 1))
    surface, normals = grasps.shown_places, grasps.shown_normals
    known = surface is not None and normals is not None
    if surface is None or normals is None:
        surface = normals = np.zeros((count, len(shared.match.far), 3))
    problem = RetargetingProblem(
        **{f.name: getattr(around, f.name) for f in fields(around)},
        joints=np.zeros((count, 21, 3)),
        contacts=grasps.link_contacts,
        surface=surface,
        normals=normals,
        center=np.array([objects[name].center_of_mass for name in names]),
        extent=np.array([0.5 * np.linalg.norm(objects[name].size) for name in names]),
        weight=GRAVITY * grasps.object_mass,
    )
    before = np.concatenate([settled_pose[:, :3], grasps.object_rest_pose[:, 3:]], axis=1)
    unrolled = compose(invert(settled_pose), compose(before, wrist_in_object))

    def run(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        part = problem.rows(rows)
        points = shared.for_hands(len(rows))
        solutions = []
        for wrist in (wrist_in_object[rows], unrolled[rows]):
            stay = partial(
                terms.stay_near,
                start=(wrist, grasp[rows]),
                unit=s.joint_unit,
                position_unit=s.position_unit,
                rotation_unit=s.rotation_unit,
            )
            collisions = [
                partial(terms.object_penetration, unit=0.0007),
                partial(terms.table_penetration, unit=0.0007, margin=s.table_margin),
                partial(terms.self_penetration, unit=0.001),
            ]
            grip = [
                partial(terms.contact_gap, unit=0.002),
                partial(terms.force_closure, unit=s.closure_unit, friction=s.closure_friction),
            ]
            if known:
                grip.append(partial(terms.contact_position, unit=s.place_unit))
            solutions.append(
                minimize(points, part, [*collisions, *grip, stay], wrist, grasp[rows], s.iterations)
            )
        (on_object, joints, cost), (around_object, other_joints, other_cost) = solutions
        leave = (other_cost + s.switch_penalty < cost)[:, None]
        return np.where(leave, around_object, on_object), np.where(leave, other_joints, joints)

    wrist, joints = (np.concatenate(parts) for parts in zip(*in_chunks(run, count), strict=True))
    return wrist, joints
