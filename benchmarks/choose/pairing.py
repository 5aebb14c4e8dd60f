"""Statistics of two variants on the same grasps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.evaluation.statistics import paired_interval
from fungrasp.jobs import Arrays

ALL = "all"
"""Name of the row of all strata together."""


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
