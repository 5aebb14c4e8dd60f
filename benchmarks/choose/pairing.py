"""Statistics of two variants on the same grasps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fungrasp.core.jobs import Arrays

ALL = "all"
"""Name of the row of all strata together."""

BOOTSTRAP_DRAWS = 10_000
"""Draws of ``paired_interval``: its ends are then good to about a hundredth of its width."""


@dataclass(frozen=True)
class PairedRates:
    """How many of some grasps each variant lifts."""

    stratum: str
    """Kind of objects, or ``ALL``."""
    grasps: int
    """Number of grasps."""
    objects: int
    """Number of objects."""
    first: float
    """Share that the first variant lifts."""
    second: float
    """Share that the second lifts."""
    interval: tuple[float, float]
    """95 % interval of the difference, second less first; objects, not grasps, count as independent."""
    only_first: int
    """Grasps that only the first lifts."""
    only_second: int
    """Grasps that only the second lifts."""


def paired_rates(a: Arrays, b: Arrays, names: np.ndarray, stratum: np.ndarray) -> list[PairedRates]:
    """Rates of success by stratum, and of all.

    Args:
        a, b: of both variants, N grasps each.
        names: of the objects, shape [N].
        stratum: kinds of the objects, shape [N].
    """
    rates = []
    for kind in [*np.unique(stratum).tolist(), ALL]:
        rows = np.ones(len(names), dtype=bool) if kind == ALL else stratum == kind
        first, second = a["success"][rows], b["success"][rows]
        rates.append(
            PairedRates(
                kind,
                len(first),
                len(np.unique(names[rows])),
                float(first.mean()),
                float(second.mean()),
                paired_interval(first.astype(float), second.astype(float), names[rows]),
                int((first & ~second).sum()),
                int((second & ~first).sum()),
            )
        )
    return rates


@dataclass(frozen=True)
class PairedMeans:
    """A number of both variants' grasps."""

    name: str
    """Of the number, its unit at the end."""
    first: float
    """Mean of the first variant."""
    second: float
    """Mean of the second."""
    interval: tuple[float, float]
    """95 % interval of the difference, second less first."""


def paired_means(a: Arrays, b: Arrays, names: np.ndarray) -> list[PairedMeans]:
    """Means of all numbers but the success, over the grasps for which both variants have one.

    Args:
        a, b: of both variants, N grasps each.
        names: of the objects, shape [N].
    """
    means = []
    for name in a:
        if name == "success":
            continue
        both = np.isfinite(a[name]) & np.isfinite(b[name])
        if both.any():
            first, second = a[name][both].astype(float), b[name][both].astype(float)
            interval = paired_interval(first, second, names[both])
            means.append(PairedMeans(name, float(first.mean()), float(second.mean()), interval))
    return means


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
