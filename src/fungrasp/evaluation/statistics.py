"""Statistics over many episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import binomtest, bootstrap


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


def mean_interval(values: np.ndarray, groups: Sequence[int] | np.ndarray) -> tuple[float, float]:
    """Two-sided 95 % confidence interval of a mean whose values are independent between groups only: means of
    groups are drawn with replacement (percentile bootstrap, 10,000 times).

    Args:
        values: shape [N].
        groups: each value's group, shape [N]; groups are about equally large.

    Returns:
        lower and upper end; both the mean where there is one group.
    """
    groups = np.asarray(groups)
    means = np.array([np.mean(values[groups == one]) for one in np.unique(groups)])
    if len(means) == 1:
        return float(means[0]), float(means[0])
    drawn = bootstrap((means,), np.mean, n_resamples=10_000, method="percentile", rng=0)
    return float(drawn.confidence_interval.low), float(drawn.confidence_interval.high)


def mean_over_groups(values: np.ndarray, groups: Sequence[str] | np.ndarray) -> float:
    """Mean of the groups' means, so that each object counts the same however many grasps it has.

    Args:
        values: shape [N].
        groups: name of each value's group, shape [N].
    """
    groups = np.asarray(groups)
    return float(np.mean([np.mean(values[groups == name]) for name in np.unique(groups)]))
