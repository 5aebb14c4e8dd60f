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
    2.04,
    {
        "told": 0.754,
        "explained": 9.45,
        "outline": 0.954,
        "visible": 0,
        "contradicted": 0,
        "hidden": 0,
        "pixels": 0,
        "residual": 0,
        "stretch_gain": -6.48,
        "stretch": -3.82,
        "color": 0.873,
        "rival": -4.09,
        "contact_m": 0,
        "penetration_m": -59.7,
        "edge_width": 0.423,
    },
    {
        "told": 0.75,
        "explained": 0.953,
        "outline": 0.898,
        "visible": 0.928,
        "contradicted": 0.00428,
        "hidden": 0.404,
        "pixels": 0.263,
        "residual": 0.261,
        "stretch_gain": 0,
        "stretch": 0,
        "color": 0,
        "rival": 0.7,
        "contact_m": 0.00541,
        "penetration_m": 0,
        "edge_width": 1,
    },
)
"""Of ``fungrasp.perception.object_pose.confidence.features``."""

HAND_WEIGHTS = Logistic(
    2.91,
    {
        "hand_score": 2.75,
        "reprojection_px": 0,
        "worst_finger_m": -50,
        "hand_in_object_m": 0,
    },
    {
        "hand_score": 0.875,
        "reprojection_px": 5.85,
        "worst_finger_m": 0.00715,
        "hand_in_object_m": 0.00988,
    },
)
"""Of ``fungrasp.perception.verdict.hand_features``."""
