"""Numbers over many trials."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

Z95 = 1.959963984540054
"""Quantile of the normal distribution of a two-sided 95 % interval."""


def wilson_interval(successes: int, trials: int, z: float = Z95) -> tuple[float, float]:
    """Confidence interval of a rate (Wilson, 1927): sound for few trials and for rates near 0 and 1.

    (p + z²/2n ± z sqrt(p (1 - p)/n + z²/4n²)) / (1 + z²/n) with p = successes / n, n = trials.

    Args:
        successes: from 0 to ``trials``.
        trials: at least 1.
        z: how many standard deviations; 95 % by default.

    Returns:
        lower and upper end, within [0, 1].
    """
    p, n = successes / trials, trials
    middle = p + z * z / (2 * n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    return max(0.0, (middle - half) / scale), min(1.0, (middle + half) / scale)


def mean_over_groups(values: np.ndarray, groups: Sequence[str] | np.ndarray) -> float:
    """Mean of the groups' means, so that each object counts the same however many grasps it has.

    Args:
        values: shape [N].
        groups: name of each value's group, shape [N].
    """
    groups = np.asarray(groups)
    return float(np.mean([np.mean(values[groups == name]) for name in np.unique(groups)]))
