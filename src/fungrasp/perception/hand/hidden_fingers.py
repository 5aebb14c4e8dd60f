"""Fingers that the image does not show, and what the prior says of them."""

from __future__ import annotations

import numpy as np

from fungrasp.perception.hand.anatomy_evidence import ToldPosture
from fungrasp.perception.hand.finger_prior import (
    FREE_ANGLES,
    FingerPrior,
    PostureMixture,
    surface_features,
    with_usual,
)
from fungrasp.perception.hand.hand_measurements import HandView
from fungrasp.perception.hand.skeleton import Skeleton

BEHIND = 0.018
"""A joint so far behind what is seen there [m] is hidden: more than skin and the errors of joints."""

TOLD = 0.5
"""Weight of the learned prior; that of what is usual in grasps has the rest."""


def hidden_fingers(hand: Skeleton, view: HandView) -> np.ndarray:
    """Fingers whose last two joints are both hidden, bool, shape [5]."""
    joints = hand.joints()
    behind = joints[:, 2] - view.depth_at(view.intrinsics.project(joints)) > BEHIND
    return np.asarray(behind[1:].reshape(5, 4)[:, 2:].all(axis=1))


def finger_mixture(
    prior: FingerPrior, hand: Skeleton, finger: int, known: np.ndarray, surface: np.ndarray
) -> PostureMixture:
    """What is probable for a finger: learned, or usual. Arguments as of ``FingerPrior.mixture``."""
    return with_usual(prior.mixture(finger, surface, hand.angles, known), TOLD)


def surface_of(hand: Skeleton, view: HandView) -> np.ndarray:
    """``surface_features`` of the hand at the object of a view."""
    return surface_features(hand, lambda points: view.surroundings.object_distance(points)[0])


def told_postures(prior: FingerPrior, hand: Skeleton, view: HandView) -> tuple[ToldPosture, ...]:
    """The components that the hidden fingers most probably belong to; none of a finger that is as usual."""
    hidden = hidden_fingers(hand, view)
    if not hidden.any():
        return ()
    told, surface = [], surface_of(hand, view)
    for finger in np.flatnonzero(hidden).tolist():
        mixture = finger_mixture(prior, hand, finger, ~hidden, surface)
        chosen = mixture.component(hand.angles[finger])
        if chosen < len(mixture.mean) - 1:
            joint, axis = np.transpose(FREE_ANGLES[finger])
            told.append(ToldPosture(finger, joint, axis, mixture.mean[chosen], mixture.factor[chosen]))
    return tuple(told)
