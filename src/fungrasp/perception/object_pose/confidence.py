"""How sure a pose is, from what speaks for it and against it; and what makes it doubtful, in words."""

from __future__ import annotations

import numpy as np

from fungrasp.perception.object_pose.known_object import KnownObject
from fungrasp.perception.object_pose.pose_error import add_s
from fungrasp.perception.object_pose.scoring import Verdict

ACCEPT = 0.75
"""Answers with a score below are "not sure"."""

WEIGHTS = np.array([-15.57, 17.04, -13.4, 2.61, 1.51, 0.0, 0.0])
"""Logistic regression on ``features`` (the first is the constant), fitted to the best answers on 159 rendered
captures of 16 YCB objects, of which 18 were searched with the mesh of another object."""

RIVAL_DISTANCE = 0.01
"""A pose so far from another (ADD-S [m]) is a different answer."""


def rivals(known: KnownObject, poses: np.ndarray, quality: np.ndarray) -> np.ndarray:
    """Quality of the best different answer to each pose, 0 where there is none, shape [H].

    Args:
        known: the object.
        poses: shape [H, 7].
        quality: shape [H].
    """
    points = known.surface.samples[:300]
    result = np.zeros(len(poses))
    for i, pose in enumerate(poses):
        different = add_s(points, poses, pose) > RIVAL_DISTANCE
        result[i] = quality[different].max(initial=0.0)
    return result


FEATURES = ("explained", "contradicted", "visible", "pixels", "rival", "contact")
"""Names of what the score is made of: explained, contradicted and visible part, logarithm of the pixels,
quality of the best different answer in that of the pose, distance of the fingertips [cm]."""


def features(verdict: Verdict, rival: np.ndarray) -> np.ndarray:
    """What the score is made of, see ``FEATURES``; shape [H, 6]. rival: see ``rivals``."""
    return np.stack(
        [
            verdict.explained,
            np.minimum(verdict.contradicted, 0.5),
            verdict.visible,
            np.log10(np.maximum(verdict.pixels, 1.0)) - 3.0,
            np.minimum(rival / np.maximum(verdict.quality, 1e-6), 1.0),
            np.minimum(100 * verdict.contact, 5.0),
        ],
        axis=-1,
    )


def confidence(evidence: np.ndarray) -> np.ndarray:
    """Probability that ADD-S is below 10 mm and the mesh is the right one, shape [H]. evidence: see
    ``features``."""
    return 1.0 / (1.0 + np.exp(-(evidence @ WEIGHTS[1:] + WEIGHTS[0])))


def doubts(verdict: Verdict, rival: np.ndarray, masked: bool) -> str:
    """What makes the first pose doubtful."""
    reasons = []
    if verdict.explained[0] < 0.7:
        whose = "the mask" if masked else "what may be the object"
        reasons.append(f"the mesh explains {100 * verdict.explained[0]:.0f} % of {whose}; wrong mesh?")
    if verdict.contradicted[0] > 0.1:
        reasons.append("the mesh would hide things that were seen behind it")
    if verdict.contact[0] > 0.02:
        reasons.append(f"the fingertips are {1000 * verdict.contact[0]:.0f} mm from the object's surface")
    if rival[0] > 0.9 * verdict.quality[0]:
        reasons.append("another pose fits as well")
    if verdict.pixels[0] < 500:
        reasons.append(f"only {verdict.pixels[0]:.0f} pixels show the object")
    return "; ".join(reasons) or "too little of the object is seen for a clear answer"
