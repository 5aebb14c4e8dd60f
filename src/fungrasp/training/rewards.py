"""Reward terms (``fungrasp.task.reward``) from the state of a plan tracker."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.arrays import constant
from fungrasp.geometry.poses import (
    Array,
    array_namespace,
    compose,
    inverse_transform_points,
    invert,
    rotation_vector,
)
from fungrasp.hands import Hand
from fungrasp.policies.plan_tracking import TrackingState, link_directions_of
from fungrasp.task import reward
from fungrasp.task.policy import Privileged

TIP_WEIGHT, THUMB_TIP_WEIGHT = 4.0, 6.0
"""Weights of fingertips among the key points; the other weights are 1 (as published)."""


class LiftReward:
    """Reward terms in W worlds."""

    def __init__(self, hand: Hand, period: float, goal_height: float, start_distance: float | None = None):
        """
        Args:
            goal_height: height of the full lift reward [m].
            start_distance: initial distance of the wrist from the object's center [m]; None if a planned
                motion leads to the object.
        """
        self._hand, self._period, self._goal = hand, period, goal_height
        self._start_distance = start_distance
        names = hand.keypoint_names
        self._weights = np.ones(len(names))
        ends = [0]
        for finger in hand.fingers.values():
            tip = names.index(finger.tip)
            self._weights[tip] = THUMB_TIP_WEIGHT if finger.name == "thumb" else TIP_WEIGHT
            ends += [tip - len(finger.links) + 1 + i for i in range(len(finger.links))]
        self._link_ends = np.array(ends)

    def terms(self, state: TrackingState, privileged: Privileged, previous_action: Array) -> dict[str, Array]:
        """Return reward terms by name, shape [W] each; "shown" counts only at a successful end.

        Args:
            previous_action: action before the state's, shape [W, A].
        """
        now, target, p = state.now, state.target, privileged
        object_in_palm = compose(invert(now.palm_pose), now.object_pose)
        keypoints = inverse_transform_points(object_in_palm, now.keypoints)
        goal_in_palm = inverse_transform_points(target.palm_in_object, target.keypoints)
        lifting, where = target.since_lift >= 0, array_namespace(keypoints).where
        weights, ends = (constant(keypoints, values) for values in (self._weights, self._link_ends))
        weight = reward.dynamic_contact_weight(now.keypoints[:, ends], goal_in_palm[:, ends], target.contacts)
        close = reward.closeness(keypoints[:, ends], target.keypoints[:, ends])
        contact = reward.contact_reward(p.contacts, target.contacts, p.forces, target.mass, close)
        slip, spin = self._relative_motion(state)
        drift = reward.stability_reward(p.object_velocity[:, :3], p.object_velocity[:, 3:])
        held = reward.stability_reward(slip, spin, velocity_unit=0.03, spin_unit=0.5)
        terms = {
            "position": reward.position_reward(keypoints, target.keypoints, weights),
            "contact": weight * contact,
            "safety": reward.safety_reward(p.table_forces, p.self_force),
            "posture": reward.posture_reward(
                link_directions_of(self._hand, keypoints), link_directions_of(self._hand, target.keypoints)
            ),
            "lift": where(lifting, reward.lift_reward(p.lifted_height, self._goal), 0.0),
            "stability": where(lifting, held, drift),
            "action": reward.action_reward(state.action, previous_action),
            "shown": reward.shown_share(p.contacts, target.contacts, close),
        }
        if self._start_distance is not None:
            terms["approach"] = reward.approach_reward(keypoints, target.keypoints, self._start_distance)
        return terms

    def _relative_motion(self, state: TrackingState) -> tuple[Array, Array]:
        """Return velocity [m/s] and angular velocity [rad/s] of the object in the palm frame, shape [W, 3]
        each."""
        now = compose(invert(state.now.palm_pose), state.now.object_pose)
        before = compose(invert(state.before.palm_pose), state.before.object_pose)
        turn = compose(invert(before), now)
        return (now[:, :3] - before[:, :3]) / self._period, rotation_vector(turn[:, 3:]) / self._period
