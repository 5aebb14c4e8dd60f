"""Statistics over many episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

NORMAL_QUANTILE = 1.959963984540054
"""97.5 % of a normal distribution lie below it."""

BOOTSTRAP_DRAWS = 10_000
"""Draws of ``paired_interval``: its ends are then good to about a hundredth of its width."""


def wilson_interval(successes: int, episodes: int) -> tuple[float, float]:
    """Two-sided 95 % confidence interval of a rate (Wilson, 1927): sound for few episodes and for rates near
    0 and 1.

    Args:
        successes: from 0 to ``episodes``.
        episodes: at least 1.

    Returns:
        lower and upper end, within [0, 1].
    """
    # SciPy has it in scipy.stats, whose import takes longer than that of all the rest of a command.
    rate, z = successes / episodes, NORMAL_QUANTILE
    middle = rate + z * z / (2 * episodes)
    half = z * float(np.sqrt(rate * (1 - rate) / episodes + z * z / (4 * episodes**2)))
    low, high = ((middle + side * half) / (1 + z * z / episodes) for side in (-1, 1))
    return max(low, 0.0) if successes else 0.0, min(high, 1.0) if successes < episodes else 1.0


def mean_over_groups(values: np.ndarray, groups: Sequence[str] | np.ndarray) -> float:
    """Mean of the groups' means, so that each object counts the same however many grasps it has.

    Args:
        values: shape [N].
        groups: name of each value's group, shape [N].
    """
    groups = np.asarray(groups)
    return float(np.mean([np.mean(values[groups == name]) for name in np.unique(groups)]))


def paired_interval(
    first: np.ndarray, second: np.ndarray, groups: Sequence[str] | np.ndarray, seed: int = 0
) -> tuple[float, float]:
    """Two-sided 95 % confidence interval of the mean of ``second - first``, measured in pairs.

    By the bootstrap over whole groups (percentiles of ``BOOTSTRAP_DRAWS`` draws): grasps of one object
    succeed or fail together, so that McNemar's test, for which all pairs are independent, would be too sure.

    Args:
        first, second: two values of each of N things, shape [N].
        groups: name of each thing's group, shape [N]; groups are independent of each other.
        seed: of the draws.

    Returns:
        lower and upper end.
    """
    number = np.unique(np.asarray(groups), return_inverse=True)[1]
    sums, sizes = np.bincount(number, np.asarray(second) - np.asarray(first)), np.bincount(number)
    count = len(sizes)
    chosen = np.random.default_rng(seed).multinomial(count, np.full(count, 1 / count), BOOTSTRAP_DRAWS)
    low, high = np.quantile((chosen @ sums) / (chosen @ sizes), (0.025, 0.975))
    return float(low), float(high)
