"""Statistics over many episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

NORMAL_QUANTILE = 1.959963984540054
"""97.5 % quantile of the standard normal distribution."""


def wilson_interval(successes: int, episodes: int) -> tuple[float, float]:
    """Return the two-sided 95 % confidence interval of a rate (Wilson, 1927), which is valid for few episodes
    and for rates near 0 and 1.

    Args:
        successes: from 0 to ``episodes``.
        episodes: at least 1.

    Returns:
        lower and upper bound, within [0, 1].
    """
    # Importing scipy.stats would take longer than the rest of a command.
    rate, z = successes / episodes, NORMAL_QUANTILE
    middle = rate + z * z / (2 * episodes)
    half = z * float(np.sqrt(rate * (1 - rate) / episodes + z * z / (4 * episodes**2)))
    low, high = ((middle + side * half) / (1 + z * z / episodes) for side in (-1, 1))
    return max(low, 0.0) if successes else 0.0, min(high, 1.0) if successes < episodes else 1.0


def mean_over_groups(values: np.ndarray, groups: Sequence[str] | np.ndarray) -> float:
    """Return the mean of the groups' means, so that each object has the same weight.

    Args:
        values: shape [N].
        groups: name of each value's group, shape [N].
    """
    groups = np.asarray(groups)
    return float(np.mean([np.mean(values[groups == name]) for name in np.unique(groups)]))
