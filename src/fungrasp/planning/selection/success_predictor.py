"""How likely a planned grasp is to hold, before it is tried: the predictor's inputs, and what it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.poses import compose, invert, rotate, rotation_matrix, transform_points
from fungrasp.grasps.as_shown import NEAR, AsShown, ShownContacts, ShownJudge
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.policies.checkpoint.checkpoint_file import PolicyNetwork, check_fits
from fungrasp.task import GraspPlan
from fungrasp.task.features import POSITION_UNIT, flatten, layout

NOT_AS_SHOWN = 0.3
"""Share of the plans that are not as shown, and hold, that are held as shown: of 80 rollouts a third."""


class SuccessPredictor(Protocol):
    """Expects how likely plans are to hold."""

    digest: str
    """Tells predictors apart: SHA-256 of the file."""

    def __call__(self, plans: GraspPlan) -> np.ndarray:
        """Probabilities of success and of success as shown, shape [N, 2]. plans: N of them."""
        ...


def planned_contacts(plans: GraspPlan, judge: ShownJudge) -> AsShown | None:
    """How the hands of N plans hold as planned; None where the person's places are not known."""
    shown = ShownContacts.of(plans)
    if shown is None:
        return None
    return judge(plans.grasp_palm_pose, judge.hand.all_joints(plans.grasp_joints), shown)


def plan_features(
    plans: GraspPlan, objects: Mapping[str, ObjectModel], contacts: AsShown | None
) -> dict[str, np.ndarray]:
    """What a predictor sees of plans, by name, each of shape [N, number]; palm frame, scaled to be of the
    order of one.

    Args:
        plans: N planned grasps.
        contacts: ``planned_contacts``; all links count as being at the person's places if None.
    """
    names = sorted(set(plans.object_name.tolist()))
    index = np.array([names.index(name) for name in plans.object_name.tolist()])
    bank = SignedDistanceBank([objects[name].signed_distance for name in names])
    center = np.array([objects[name].center_of_mass for name in names])[index]
    size = np.array([objects[name].size for name in names])[index]
    distance, normal = bank.query(index, plans.keypoints)
    to_palm = invert(plans.grasp_palm_pose)
    count = len(plans)
    keypoints = transform_points(to_palm, plans.keypoints)
    normals = rotate(to_palm[:, None, 3:], normal)
    up = rotate(to_palm[:, 3:], rotate(invert(plans.object_pose)[:, 3:], np.array([0.0, 0.0, 1.0])))
    axes = np.abs(rotation_matrix(to_palm[:, 3:]))
    press = compose(to_palm, plans.palm_goal_object[:, -1])[:, :3]
    wanted = plans.link_contacts[:, 1:]
    errors = np.zeros(wanted.shape) if contacts is None else wanted * contacts.errors
    turned = np.zeros(wanted.shape) if contacts is None else wanted & contacts.turned
    height = compose(plans.object_pose, plans.grasp_palm_pose)[:, 2:3]
    return {
        "keypoints": keypoints.reshape(count, -1) / POSITION_UNIT,
        "surface_distances": np.clip(distance / 0.02, -1.0, 2.5),
        "surface_normals": normals.reshape(count, -1),
        "grasp": plans.grasp_joints,
        "squeeze": plans.finger_targets[:, -1] - plans.grasp_joints,
        "press": press / 0.01,
        "object_center": transform_points(to_palm, center[:, None])[:, 0] / (2 * POSITION_UNIT),
        "object_extents": (axes * size[:, None]).sum(axis=-1) / (2 * POSITION_UNIT),
        "up": up,
        "palm_height": height / (2 * POSITION_UNIT),
        "target_contacts": plans.link_contacts.astype(float),
        "place_errors": np.clip(errors / NEAR, 0.0, 2.5),
        "other_side": turned.astype(float),
        "mass": np.log(plans.object_mass[:, None] / 0.3),
        "collision": plans.path_collision[:, None] / 0.01,
    }


class NetworkPredictor:
    """A ``SuccessPredictor`` from a policy file."""

    def __init__(self, network: PolicyNetwork, hand: Hand, objects: Mapping[str, ObjectModel]):
        """
        Args:
            network: of a policy file of the kind "predictor".
            objects: by name, all that plans may be for.
        """
        self._network, self._hand, self._objects = network, hand, objects
        self._judge = ShownJudge(hand, objects)
        self.digest = network.card.sha256

    def __call__(self, plans: GraspPlan) -> np.ndarray:
        """Probabilities of success and of success as shown, shape [N, 2].

        A predictor of success alone expects ``NOT_AS_SHOWN`` of it of plans whose contacts are not as shown.

        Raises:
            FungraspError: the network was made for another hand, other features or another rate.
        """
        card, contacts = self._network.card, planned_contacts(plans, self._judge)
        parts = plan_features(plans, self._objects, contacts)
        if card.action_size == 1:
            parts = {name: part for name, part in parts.items() if name not in ("place_errors", "other_side")}
        check_fits(card, self._hand, layout(parts), (), 1 / plans.control_period)
        value, _, _ = self._network(np.nan_to_num(flatten(parts)).astype(np.float32))
        if card.action_size > 1:
            return value[:, :2] if contacts is not None else value[:, [0, 0]]
        shown = 1.0 if contacts is None else np.where(contacts.holds, 1.0, NOT_AS_SHOWN)
        return np.stack([value[:, 0], shown * value[:, 0]], axis=1)
