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
    2.95,
    {
        "explained": 0.857,
        "other_size": -3.69,
        "other_length": -1.4,
        "other_side": -5.63,
        "stretch": -5.33,
        "color": 0.151,
        "rival": -3.11,
        "unexplained": -0.26,
    },
    {
        "explained": 2.5,
        "other_size": -0.322,
        "other_length": -0.245,
        "other_side": -0.0456,
        "stretch": 0,
        "color": 0,
        "rival": 0,
        "unexplained": 3.18,
    },
)
"""Of ``fungrasp.perception.object_pose.confidence.features``."""

HAND_WEIGHTS = Logistic(
    3.32,
    {
        "hand_score": 5.62,
        "worst_finger_m": -58.8,
    },
    {
        "hand_score": 0.875,
        "worst_finger_m": 0.00496,
    },
)
"""Of ``fungrasp.perception.verdict.hand_features``."""
