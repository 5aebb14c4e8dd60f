"""The calibrated weights of the verdict; ``python -m benchmarks.perception verdict --fit`` prints them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Logistic:
    """Logistic regression in which each number counts for or against, as it must."""

    constant: float
    """Logarithm of the odds of a usual right answer."""
    weights: Mapping[str, float]
    """Change of the logarithm of the odds by each number."""
    usual: Mapping[str, float]
    """Each number's median among right answers."""

    def shares(self, features: Mapping[str, float]) -> dict[str, float]:
        """How much each number makes an answer more probable than a usual right one (logarithm of the odds),
        by name."""
        return {name: w * (features[name] - self.usual[name]) for name, w in self.weights.items()}

    def probability(self, features: Mapping[str, float]) -> float:
        """Of being right, 0 to 1."""
        return float(1.0 / (1.0 + np.exp(-self.constant - sum(self.shares(features).values()))))


OBJECT_WEIGHTS = Logistic(
    4.45,
    {
        "agreement": 0.709,
        "larger": -0.516,
        "off": -0.302,
        "left_over": -0.52,
        "mask_piece": -0.328,
        "told": 0.804,
        "other_size": -2.8,
        "other_side": -10.9,
        "rival": -2.6,
    },
    {
        "agreement": 2.78,
        "larger": 0.41,
        "off": 1.44,
        "left_over": -4.61,
        "mask_piece": 0,
        "told": 1,
        "other_size": -0.286,
        "other_side": -0.0276,
        "rival": 0,
    },
)
"""Of ``fungrasp.perception.object_pose.confidence.features``."""

HAND_WEIGHTS = Logistic(
    3.11,
    {
        "hand_score": 4.56,
        "joints": 1.11,
    },
    {
        "hand_score": 0.894,
        "joints": 1.83,
    },
)
"""Of ``fungrasp.perception.verdict.hand_features``."""

JOINT_WEIGHTS = Logistic(
    4.18,
    {
        "fit_spread": -3.57,
        "landmark_finger": -23.6,
        "landmark_hand": -49.0,
        "object_known": 3.16,
        "depth_off": -31.0,
    },
    {
        "fit_spread": 1.57,
        "landmark_finger": 0.0468,
        "landmark_hand": 0.0363,
        "object_known": 1.0,
        "depth_off": 0.0075,
    },
)
"""Of ``fungrasp.perception.hand.joint_confidence.joint_features``."""
