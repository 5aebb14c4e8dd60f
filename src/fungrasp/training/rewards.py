"""The reward's terms (``fungrasp.task.reward``) from what a tracker sees."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import compose, inverse_transform_points, invert, rotation_vector
from fungrasp.hands import Hand
from fungrasp.policies.plan_tracking import View, link_directions
from fungrasp.task import reward
from fungrasp.task.observation import Sensed

TIP_WEIGHT, THUMB_TIP_WEIGHT = 4.0, 6.0
"""Of fingertips among the key points; the others count 1 (the published set-up)."""


class LiftReward:
    """Terms for W worlds of a hand."""

    def __init__(self, hand: Hand, period: float, goal_height: float):
        """
        Args:
            hand: the robot hand.
            period: of control [s].
            goal_height: at which the object is lifted [m].
        """
        self._hand, self._period, self._goal = hand, period, goal_height
        names = hand.keypoint_names
        self._weights = np.ones(len(names))
        ends = [0]
        for finger in hand.fingers.values():
            tip = names.index(finger.tip)
            self._weights[tip] = THUMB_TIP_WEIGHT if finger.name == "thumb" else TIP_WEIGHT
            ends += [tip - len(finger.links) + 1 + i for i in range(len(finger.links))]
        self._link_ends = np.array(ends)

    def terms(
        self, view: View, sensed: Sensed, height: np.ndarray, previous_action: np.ndarray
    ) -> dict[str, np.ndarray]:
        """By name, each of shape [W].

        Args:
            view: after the step.
            sensed: likewise.
            height: of the object's centre of mass above where it settled [m], shape [W].
            previous_action: the one before the view's, shape [W, A].
        """
        now, wanted = view.now, view.wanted
        object_in_palm = compose(invert(now.palm_pose), now.object_pose)
        keypoints = inverse_transform_points(object_in_palm, now.keypoints)
        goal_in_palm = inverse_transform_points(wanted.palm_in_object, wanted.keypoints)
        lifting = wanted.since_lift >= 0
        weight = reward.dynamic_contact_weight(
            now.keypoints[:, self._link_ends], goal_in_palm[:, self._link_ends], wanted.contacts
        )
        contact = reward.contact_reward(sensed.contacts, wanted.contacts, sensed.forces, wanted.mass)
        slip, spin = self._relative_motion(view)
        drift = reward.stability_reward(sensed.object_velocity[:, :3], sensed.object_velocity[:, 3:])
        held = reward.stability_reward(slip, spin, velocity_unit=0.03, spin_unit=0.5)
        return {
            "position": reward.position_reward(keypoints, wanted.keypoints, self._weights),
            "contact": weight * contact,
            "safety": reward.safety_reward(sensed.table_forces, sensed.self_force),
            "posture": reward.posture_reward(
                link_directions(self._hand, keypoints), link_directions(self._hand, wanted.keypoints)
            ),
            "lift": np.where(lifting, reward.lift_reward(height, self._goal), 0.0),
            "stability": np.where(lifting, held, drift),
            "action": reward.action_reward(view.action, previous_action),
        }

    def _relative_motion(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """Velocity of the object in the palm's frame [m/s], [rad/s], shape [W, 3] each."""
        now = compose(invert(view.now.palm_pose), view.now.object_pose)
        before = compose(invert(view.before.palm_pose), view.before.object_pose)
        turn = compose(invert(before), now)
        return (now[:, :3] - before[:, :3]) / self._period, rotation_vector(turn[:, 3:]) / self._period
