"""Hands of other proportions that hold the same object."""

from __future__ import annotations

import numpy as np

from fungrasp.grasps import HumanGrasp

LARGEST = 2.0
"""No hand and no finger is off by more than this many standard deviations."""

SKIN = 0.008
"""Half the thickness of a finger [m]."""


def vary_hand(grasp: HumanGrasp, spread: float, rng: np.random.Generator) -> np.ndarray:
    """Joints of a hand of another size and with other lengths of its fingers.

    The hand is scaled about the middle of the fingertips that touch, so that they stay on the object to
    within their own spread; each finger is then longer or shorter from its knuckle on, and its tip is
    brought back by a shift of the joints between, that grows from the knuckle to the tip.

    Args:
        grasp: of a right hand, world frame.
        spread: standard deviation of both, as a part.
        rng: random numbers.

    Returns:
        [m], world frame, shape [21, 3].
    """
    joints = grasp.hand_joints
    tips = np.array([4, 8, 12, 16, 20])
    touching = grasp.link_contacts[[3, 6, 9, 12, 15]]
    center = joints[tips[touching] if touching.any() else tips].mean(axis=0)
    draw = np.clip(rng.normal(size=6), -LARGEST, LARGEST) * spread
    scaled = center + (1 + draw[0]) * (joints - center)
    for finger in range(5):
        chain = slice(1 + 4 * finger, 5 + 4 * finger)
        knuckle, tip = scaled[1 + 4 * finger], joints[4 + 4 * finger]
        longer = knuckle + (1 + 0.6 * draw[1 + finger]) * (scaled[chain] - knuckle)
        if touching[finger]:
            longer = longer + np.linspace(0, 1, 4)[:, None] * (tip - longer[3])
        scaled[chain] = longer
    # Not lower than it was where skin would be in the table.
    floor = min(float(joints[:, 2].min()), SKIN)
    scaled[:, 2] += max(0.0, floor - float(scaled[:, 2].min()))
    return scaled
