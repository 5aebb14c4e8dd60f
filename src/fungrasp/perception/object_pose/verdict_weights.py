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
    1.7,
    {
        "told": 0.75,
        "explained": 9.82,
        "outline": 0.504,
        "visible": 0,
        "contradicted": 0,
        "hidden": 0,
        "pixels": 0,
        "residual": 0,
        "stretch_gain": -6.67,
        "stretch": -3.45,
        "color": 0.821,
        "rival": -3.51,
        "contact_m": 0,
        "penetration_m": -79,
        "edge_width": 0.469,
    },
    {
        "told": 0.5,
        "explained": 0.956,
        "outline": 0.898,
        "visible": 0.928,
        "contradicted": 0.00634,
        "hidden": 0.414,
        "pixels": 0.244,
        "residual": 0.259,
        "stretch_gain": 0,
        "stretch": 0,
        "color": 0,
        "rival": 0.7,
        "contact_m": 0.00542,
        "penetration_m": 0,
        "edge_width": 1,
    },
)
"""Of ``fungrasp.perception.object_pose.confidence.features``."""

HAND_WEIGHTS = Logistic(
    2.03,
    {
        "hand_score": 0,
        "reprojection_px": 0,
        "worst_finger_m": -69.3,
        "hand_in_object_m": -32.6,
    },
    {
        "hand_score": 0.875,
        "reprojection_px": 6.25,
        "worst_finger_m": 0.00621,
        "hand_in_object_m": 0.00957,
    },
)
"""Of ``fungrasp.perception.verdict.hand_features``."""
