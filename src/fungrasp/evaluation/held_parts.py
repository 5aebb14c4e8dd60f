"""On which parts of an object a person's hand lies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.grasps import HumanGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.correspondence import HUMAN_FINGER_JOINTS, HUMAN_FINGER_LINKS, correspond
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import nearest_parts

PALM_JOINTS = (0, 1, 5, 9, 13)
"""Human joints around the palm: wrist and the four knuckles."""


def held_parts(
    human: HumanGraspSet, objects: Mapping[str, ObjectModel], hand: Hand
) -> list[tuple[frozenset[str], ...]]:
    """The parts that the person touches with what each contact link of a robot hand stands for.

    Args:
        human: N grasps.
        objects: by name.
        hand: the robot hand, L contact links.

    Returns:
        N tuples of L sets, empty where the person does not touch, or the object has no parts.
    """
    ends = {0: PALM_JOINTS}
    for finger, links in HUMAN_FINGER_LINKS.items():
        joints = HUMAN_FINGER_JOINTS[finger]
        ends |= {link: (joints[i], joints[i + 1]) for i, link in enumerate(links)}
    groups = ((0,), *correspond(hand).human_links)
    joints = inverse_transform_points(human.object_pose, human.hand_joints)
    touched: list[tuple[frozenset[str], ...]] = []
    for row, name in enumerate(human.object_name.tolist()):
        # Of each human link the middle and the far end: where its pad is.
        places = np.stack(
            [
                (joints[row, list(e)].mean(axis=0), joints[row, e[-1] if link else 9])
                for link, e in ends.items()
            ]
        )
        parts = nearest_parts(objects[name], places.reshape(-1, 3)).reshape(-1, 2)
        contact = human.link_contacts[row]
        touched.append(
            tuple(
                frozenset(str(p) for link in links if contact[link] for p in parts[link] if p)
                for links in groups
            )
        )
    return touched
