"""Functional contact: whether the hand touches an object where the person held it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.poses import relative
from fungrasp.hands.collision_spheres import collision_spheres
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects.part_lookup import nearest_parts
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
    engine, hand = environment.engine, environment.scene.hand
    spheres = collision_spheres(hand)
    kinematics = HandKinematics(hand, len(engine))
    kinematics.update(
        relative(engine.object_pose, engine.palm_pose), hand.independent(engine.joint_positions)
    )
    centers = kinematics.points(spheres.points)
    touched = np.full((len(engine), len(hand.links)), "", dtype=object)
    index, models = engine.object_index, environment.scene.models
    for number in np.unique(index):
        model, worlds = models[number], np.flatnonzero(index == number)
        if not model.parts:
            continue
        bank, first = SignedDistanceBank([model.signed_distance]), np.zeros(len(worlds), dtype=int)
        for link in range(len(hand.links)):
            members = np.flatnonzero(spheres.link == link)
            if not len(members):
                continue
            gap = bank.query(first, centers[worlds][:, members])[0] - spheres.radius[members]
            nearest = members[gap.argmin(axis=1)]
            touched[worlds, link] = nearest_parts(model, centers[worlds, nearest])
    parts = touched.astype(str)
    wanted, actual = environment.task.target_contacts, engine.link_contacts
    right = np.array(
        [
            [not allowed or part in allowed for allowed, part in zip(row, names, strict=True)]
            for row, names in zip(held_parts, parts, strict=True)
        ]
    ).reshape(wanted.shape)
    share = (wanted & actual & right).sum(axis=1) / np.maximum(wanted.sum(axis=1), 1)
    return share, parts
