"""The paper's tables of simulation: what is compared, the paper's numbers, and ours beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.stats import bootstrap, permutation_test

from fungrasp.core.errors import UnknownNameError
from fungrasp.core.plots import PlotLine, PlotPanel, panels_svg

CONDITIONS = ("nominal", "nominal, not adapted", "reality")
"""What each policy is tried in: worlds as believed; the same with grasps that are not adapted to the settled
object; and the reality protocol."""


@dataclass(frozen=True)
class PaperNumbers:
    """A row of the paper's table, by its own, laxer test (docs/evaluate.md)."""

    success: float
    """Share of episodes that succeeded."""
    displacement: float
    """Displacement of the object in simulation, SimD [mm per control step of 28.9 ms]."""
    contact_ratio: float
    """Share of the wanted contacts that were made."""


@dataclass(frozen=True)
class Variant:
    """What one row trains and tests."""

    name: str
    """Stem of the names of its files."""
    title: str
    """Name of the variant in the paper."""
    paper: PaperNumbers | None
    """What the paper reports for it; None where it has no such row."""
    method: Literal["contact", "dexgraspnet", "angle-copy"] = "contact"
    """How grasps are retargeted, for training and test."""
    sees: Literal["contacts", "nothing", "history"] = "contacts"
    """What the actor knows of the contacts while it is trained by PPO."""
    student: Literal["", "with estimate", "without estimate"] = ""
    """Whether what is tested is a student of that policy, and whether it infers the contacts."""
    hand: str | None = None
    """Name of its hand; that of the command if None."""


_OURS = PaperNumbers(0.85, 1.6, 0.79)

TABLES: Mapping[str, tuple[Variant, ...]] = {
    "retargeting": (
        Variant("dexgraspnet", "DexGraspNet+*", PaperNumbers(0.65, 1.6, 0.68), "dexgraspnet"),
        Variant("angle-copy", "Angle Reset+*", PaperNumbers(0.62, 1.6, 0.65), "angle-copy"),
        Variant("teacher", "Ours", _OURS),
    ),
    "privileged": (
        Variant("without", "w/o Priv. Info.", PaperNumbers(0.61, 1.6, 0.56), sees="nothing"),
        Variant("scratch", "w/o Priv. Learn.", PaperNumbers(0.40, 1.7, 0.24), sees="history"),
        Variant("teacher", "Teacher", _OURS),
        Variant("student", "Student (Ours)", _OURS, student="with estimate"),
        Variant("student-without", "Student, no contact estimate", None, student="without estimate"),
    ),
    "hands": (
        Variant("student", "Shadow", PaperNumbers(0.75, 1.6, 0.75), student="with estimate", hand="shadow"),
        Variant("student", "Faive P0", PaperNumbers(0.81, 1.9, 0.80), student="with estimate", hand="faive"),
        Variant("student", "Allegro", _OURS, student="with estimate", hand="allegro"),
    ),
}
"""Variants by the name of the table. Those of the same name and hand are the same in all tables."""


def table_variants(table: str, only: Sequence[str] = ()) -> tuple[Variant, ...]:
    """The variants of a table.

    Args:
        table: its name.
        only: names of policies or hands; all variants if empty.

    Raises:
        FungraspError: the table has none of a name.
    """
    variants = TABLES[table]
    names = [variant.hand or variant.name for variant in variants]
    for name in only:
        if name not in names:
            raise UnknownNameError("row", name, names)
    return tuple(v for v, name in zip(variants, names, strict=True) if not only or name in only)


HEAD = (
    "policy",
    "as shown",
    "nominal",
    "95 %",
    "contacts",
    "slip [mm/s]",
    "not adapted",
    "reality, as shown",
    "reality",
    "95 %",
    "contacts",
    "paper",
    "contacts",
)


def pooled(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Means over trainings that differ in their seed, in one condition.

    Args:
        results: what ``result_json`` gave for each seed, on the same grasps.

    Returns:
        ``held_as_shown`` (None where earlier results do not know it), ``success_rate`` and
        ``contact_ratio`` with the 95 % interval of the success (grasps drawn with replacement: the same grasp
        under several seeds is not several grasps), success by seed, and the mean speed with which objects
        slip in the hand [mm/s].
    """
    trials = [trial for result in results for trial in result["trials"]]
    success = np.array([trial["success"] for trial in trials], dtype=float)
    low, high = mean_interval(success, [trial["index"] for trial in trials])
    shown = [trial.get("held_as_shown") for trial in trials]
    return {
        "held_as_shown": None if None in shown else float(np.mean(shown)),
        "success_rate": float(success.mean()),
        "success_interval": [low, high],
        "success_by_seed": [result["success_rate"] for result in results],
        "contact_ratio": float(np.mean([trial["contact_ratio"] for trial in trials])),
        "slip_mm_s": float(np.mean([trial["sim_distance_hand_mm_s"] for trial in trials])),
    }


def comparison_rows(
    variants: Sequence[Variant], results: Sequence[Mapping[str, Mapping[str, Any]]]
) -> list[tuple[str, ...]]:
    """Head and rows of a table, ours beside the paper's.

    Args:
        variants: of the table.
        results: of each variant what ``pooled`` gave, by condition.
    """
    return [HEAD, *(_row(variant, each) for variant, each in zip(variants, results, strict=True))]


TESTED = (
    ("success", "nominal"),
    ("held_as_shown", "nominal"),
    ("success", "reality"),
    ("held_as_shown", "reality"),
)
"""Measure and condition in which rows are compared."""


def paired_tests(
    variants: Sequence[Variant], kept: Sequence[Sequence[Mapping[str, Any]]]
) -> list[dict[str, Any]]:
    """Each row against the paper's own method, on the same grasps.

    A grasp's value is its mean over the seeds, since the same grasp under several seeds is not several
    grasps. P-values are by sign flips of the differences, two-sided, and adjusted for the number of
    comparisons (Holm, 1979).

    Args:
        variants: of a table; the last one with the paper's numbers of its own method is compared with the
            others.
        kept: of each variant and seed, by condition, what ``result_json`` gave.

    Returns:
        A dict for each comparison: ``policy``, ``than``, ``measure``, ``condition``, ``difference``,
        ``interval`` (95 %) and ``p``.
    """
    own = next((i for i in reversed(range(len(variants))) if variants[i].paper is _OURS), None)
    others = [i for i in range(len(variants)) if i != own]
    if own is None or not others:
        return []
    tests = []
    for i in others:
        for measure, condition in TESTED:
            one, other = (_by_grasp([r[condition] for r in kept[k]], measure) for k in (own, i))
            difference = one - other
            low, high = mean_interval(difference, np.arange(len(difference)))
            p = 1.0
            if difference.any():
                p = permutation_test(
                    (difference,), np.mean, permutation_type="samples", n_resamples=9_999, rng=0
                ).pvalue
            tests.append(
                {
                    "policy": variants[own].title,
                    "than": variants[i].title,
                    "measure": measure,
                    "condition": condition,
                    "difference": float(difference.mean()),
                    "interval": [low, high],
                    "p": float(p),
                }
            )
    adjusted = 0.0
    for rank, test in enumerate(sorted(tests, key=lambda test: test["p"])):
        adjusted = test["p"] = max(adjusted, min(1.0, (len(tests) - rank) * test["p"]))
    return tests


def _by_grasp(results: Sequence[Mapping[str, Any]], measure: str) -> np.ndarray:
    """Means of a measure over seeds, by grasp; zeros where earlier results do not know it, shape [N]."""
    return np.mean([[float(trial.get(measure) or 0) for trial in r["trials"]] for r in results], axis=0)


def paired_rows(tests: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Head and rows of a table of ``paired_tests``."""
    head = ("comparison", "measure", "difference", "95 %", f"p, adjusted for {len(tests)}")
    rows = [
        (
            f"{test['policy']} - {test['than']}",
            f"{test['measure'].replace('_', ' ')}, {test['condition']}",
            f"{100 * test['difference']:+.1f}",
            f"{100 * test['interval'][0]:+.0f} – {100 * test['interval'][1]:+.0f}",
            f"{test['p']:.3f}",
        )
        for test in tests
    ]
    return [head, *rows]


def curves_svg(curves: Mapping[str, Sequence[np.ndarray]]) -> str:
    """Success and share held as shown over control steps: mean over the seeds, and a band from the lowest to
    the highest.

    Args:
        curves: of each row, by title, one array a seed with columns steps, success and share, shape [N, 3].
    """
    panels = []
    for column, title in ((1, "success"), (2, "held as shown")):
        lines = []
        for name, seeds in curves.items():
            steps = seeds[0][:, 0]
            values = np.array([np.interp(steps, one[:, 0], one[:, column]) for one in seeds])
            band = np.array([values.min(axis=0), values.max(axis=0)])
            # One legend stands for both panels.
            label = f"{name} ({len(seeds)})" if column == 2 else ""
            lines.append(PlotLine(1e-6 * steps, values.mean(axis=0), label, band=band))
        panels.append(PlotPanel(title, "control steps [millions]", title, lines, limits=(0.0, 1.0)))
    return panels_svg(panels, columns=2, height=3.2)


def _row(variant: Variant, results: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    nominal, unadapted, reality = (results[name] for name in CONDITIONS)
    paper = variant.paper
    return (
        variant.title,
        _share(nominal["held_as_shown"]),
        f"{nominal['success_rate']:.1%}",
        _interval(nominal),
        f"{nominal['contact_ratio']:.2f}",
        f"{nominal['slip_mm_s']:.1f}",
        f"{unadapted['success_rate']:.1%}",
        _share(reality["held_as_shown"]),
        f"{reality['success_rate']:.1%}",
        _interval(reality),
        f"{reality['contact_ratio']:.2f}",
        "" if paper is None else f"{paper.success:.0%}",
        "" if paper is None else f"{paper.contact_ratio:.2f}",
    )


def _share(value: float | None) -> str:
    return "–" if value is None else f"{value:.1%}"


def _interval(result: Mapping[str, Any]) -> str:
    low, high = result["success_interval"]
    return f"{100 * low:.0f} – {100 * high:.0f}"


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
