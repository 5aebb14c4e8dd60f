"""How probable it is that each joint of a hand is where it was found, fitted to hands whose truth was known.

The covariances of the hand's fit know nothing of wrong landmarks, nor of what a finger is behind.
"""

from __future__ import annotations

import numpy as np

from fungrasp.perception.estimates import HandEstimate
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.verdict_weights import JOINT_WEIGHTS

SURE = 0.95
"""Joints of a lower probability are not called sure: from here on 3 % of them were more than 20 mm off,
cross-validated over the hands of the fit."""

WITHIN = 0.02
"""A joint is where it was found if it is within this of there [m]."""

CUT = 0.8
"""Part of the joints called sure that were within 20 mm in hands that the image's edge cut off (402 of 504,
68 crops of renders): fingers beyond it are found inside."""

FARTHEST_LANDMARK = 0.15
"""Landmarks farther off, as a part of the hand's extent in the image, say nothing more."""

BEHIND, FARTHEST_DEPTH = 0.01, 0.04
"""Joints are so far behind the skin [m]; what is off by more than the second says nothing more."""


def joint_features(
    capture: Capture, fitted: HandEstimate, hand: HandEstimate, object_known: bool
) -> dict[str, np.ndarray]:
    """What the probabilities are made of, by the names of ``JOINT_WEIGHTS``, shape [21] each.

    Args:
        capture: the image.
        fitted: the hand before the object was known.
        hand: as it was refined.
        object_known: whether the object's pose was accepted, and the hand touches it.
    """
    lens, joints = capture.intrinsics, hand.joints_camera
    pixels = lens.project(joints)
    extent = max(float(np.linalg.norm(np.ptp(hand.pixels, axis=0))), 1.0)
    off = np.minimum(np.linalg.norm(pixels - hand.pixels, axis=1) / extent, FARTHEST_LANDMARK)
    of_finger = off.copy()
    of_finger[1:] = np.repeat(off[1:].reshape(5, 4).max(axis=1), 4)
    behind = joints[:, 2] - _seen(capture.depth, pixels) - BEHIND
    spread = np.sqrt(np.trace(fitted.covariance, axis1=1, axis2=2) / 3)
    return {
        "fit_spread": np.log(1000.0 * np.maximum(spread, 1e-4)),
        "landmark_finger": of_finger,
        "landmark_hand": np.full(21, off.mean()),
        "object_known": np.full(21, float(object_known)),
        "depth_off": np.minimum(np.abs(np.nan_to_num(behind, nan=BEHIND)), FARTHEST_DEPTH),
    }


def joint_confidences(features: dict[str, np.ndarray], cut: bool = False) -> np.ndarray:
    """Probability that each joint is within ``WITHIN`` of where it is, shape [21]. cut: whether the image's
    edge cuts the hand off."""
    found = [JOINT_WEIGHTS.probability({n: float(v[i]) for n, v in features.items()}) for i in range(21)]
    return np.array(found) * (CUT if cut else 1.0)


def _seen(depth: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Median depth of the pixels around some [m], NaN where there is hardly any. pixels: shape [N, 2]."""
    height, width = depth.shape
    found = np.full(len(pixels), np.nan)
    for i, (u, v) in enumerate(np.rint(np.nan_to_num(pixels, nan=-9.0)).astype(int).tolist()):
        if 0 <= u < width and 0 <= v < height:
            near = depth[max(0, v - 1) : v + 2, max(0, u - 1) : u + 2]
            near = near[near > 0]
            if near.size >= 3:
                found[i] = np.median(near)
    return found
