"""Functional contact: whether the hand touches an object where the person held it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.poses import relative
from fungrasp.hands import Hand
from fungrasp.hands.collisions import collision_spheres
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import nearest_parts
from fungrasp.task.environment import LiftEnvironment


def functional_contact(
    environment: LiftEnvironment, held_parts: Sequence[Sequence[frozenset[str]]]
) -> tuple[np.ndarray, np.ndarray]:
    """Where hands touch the objects now.

    Args:
        environment: it is read.
        held_parts: of each world and contact link, the parts that the person held there, W x L; any part of
            an object counts for an empty set.

    Returns:
        share of the links that should touch that touch such a part, shape [W]; name of the part that each
        link touches or would touch first, shape [W, L] str.
    """
    engine, scene = environment.engine, environment.scene
    parts = touched_parts(
        scene.hand,
        [scene.models[i] for i in engine.object_index],
        relative(engine.object_pose, engine.palm_pose),
        scene.hand.independent(engine.joint_positions),
    )
    wanted, actual = environment.task.target_contacts, engine.link_contacts
    right = np.array(
        [
            [not allowed or part in allowed for allowed, part in zip(row, names, strict=True)]
            for row, names in zip(held_parts, parts, strict=True)
        ]
    ).reshape(wanted.shape)
    share = (wanted & actual & right).sum(axis=1) / np.maximum(wanted.sum(axis=1), 1)
    return share, parts


def touched_parts(
    hand: Hand, models: Sequence[ObjectModel], palm: np.ndarray, joints: np.ndarray
) -> np.ndarray:
    """Name of the part of the object that each link touches or would touch first, "" for an object without
    parts, shape [N, L] str.

    Args:
        hand: the robot hand.
        models: the objects, N of them.
        palm: object frame, shape [N, 7].
        joints: independent joints [rad], shape [N, U].
    """
    spheres = collision_spheres(hand)
    kinematics = HandKinematics(hand, len(models))
    kinematics.update(palm, joints)
    centers = kinematics.points(spheres.points)
    touched = np.full((len(models), len(hand.links)), "", dtype=object)
    different = {id(model): model for model in models if model.parts}
    for model in different.values():
        rows = np.flatnonzero([other is model for other in models])
        bank, first = SignedDistanceBank([model.signed_distance]), np.zeros(len(rows), dtype=int)
        for link in range(len(hand.links)):
            members = np.flatnonzero(spheres.link == link)
            if not len(members):
                continue
            gap = bank.query(first, centers[rows][:, members])[0] - spheres.radius[members]
            nearest = members[gap.argmin(axis=1)]
            touched[rows, link] = nearest_parts(model, centers[rows, nearest])
    return touched.astype(str)
