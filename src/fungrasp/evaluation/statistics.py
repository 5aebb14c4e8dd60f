"""Statistics over many episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import binomtest


def wilson_interval(successes: int, episodes: int) -> tuple[float, float]:
    """Two-sided 95 % confidence interval of a rate (Wilson, 1927): sound for few episodes and for rates near
    0 and 1.

    Args:
        successes: from 0 to ``episodes``.
        episodes: at least 1.

    Returns:
        lower and upper end, within [0, 1].
    """
    interval = binomtest(successes, episodes).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)


def mean_over_groups(values: np.ndarray, groups: Sequence[str] | np.ndarray) -> float:
    """Mean of the groups' means, so that each object counts the same however many grasps it has.

    Args:
        values: shape [N].
        groups: name of each value's group, shape [N].
    """
    groups = np.asarray(groups)
    return float(np.mean([np.mean(values[groups == name]) for name in np.unique(groups)]))
