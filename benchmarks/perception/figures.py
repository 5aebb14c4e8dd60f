"""Figures over many captures, and how they stand to what perception is to reach."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.perception.measurements import CaptureResult, PoseResult
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.formats.json_file import finite
from fungrasp.perception.perceived import StageSeconds
from fungrasp.perception.verdict import ACCEPTED_HAND


@dataclass(frozen=True)
class Target:
    """What a figure is to reach."""

    words: str
    """What the figure measures, as text to print."""
    path: tuple[str, ...]
    """Where in the figures it is."""
    bound: float
    """The value to reach, in the unit of the figure."""
    at_least: bool
    """Whether the figure must be at least the bound; else at most."""
    unit: str = ""
    """Unit that is printed after the figure."""

    def value(self, figures: Mapping[str, Any]) -> float | None:
        """The figure, None where it was not measured."""
        found: Any = figures
        for name in self.path:
            found = None if found is None else found.get(name)
        return found

    def met(self, value: float) -> bool:
        """Whether the figure is good enough."""
        return value >= self.bound if self.at_least else value <= self.bound


TARGETS = (
    Target("hand found", ("hand", "found", "rate"), 0.95, True, "%"),
    Target("landmarks, median", ("hand", "pixel_error", "median"), 7.0, False, "px"),
    Target("joints, refined, mean", ("hand", "refined_joint_error_mm", "mean"), 12.0, False, "mm"),
    Target("touching fingertips, mean", ("hand", "tip_error_mm", "mean"), 8.0, False, "mm"),
    Target("object right, with mask", ("object_masked", "right", "rate"), 0.98, True, "%"),
    Target("object right, no mask", ("object_unmasked", "right", "rate"), 0.90, True, "%"),
    Target("ADD-S with mask, median", ("object_masked", "add_s_mm", "median"), 2.0, False, "mm"),
    Target("ADD-S without mask, median", ("object_unmasked", "add_s_mm", "median"), 2.0, False, "mm"),
    Target("accepted poses that are right", ("accepted", "right", "rate"), 0.97, True, "%"),
    Target("hand, median", ("seconds", "hand", "median"), 0.2, False, "s"),
    Target("object with mask, median", ("seconds", "object_masked", "median"), 3.0, False, "s"),
    Target("object without mask, median", ("seconds", "object_unmasked", "median"), 6.0, False, "s"),
    Target("peak memory", ("peak_memory_gb",), 2.0, False, "GB"),
    Target("success of the chain, in that of the true grasps", ("chain", "share"), 0.85, True, "%"),
)
"""The targets; times are those of 2 cores."""


def perception_figures(results: Sequence[CaptureResult]) -> dict[str, Any]:
    """Rates and errors over the captures.

    Where ``perceive`` finds no hand it gives no pose either, which is then not right. ``hand.sure`` has the
    errors of those that perception was confident of. ``accepted`` takes every answer that was accepted: with
    mask, without, and those of wrong meshes and absent objects, which are never right.
    """
    hands = [result.hand for result in results if result.hand.found]
    sure = [result.hand for result in results if result.hand.found and result.sure]
    masked = [result.masked for result in results]
    unmasked = [result.unmasked for result in results]
    wrong = [result.wrong_mesh for result in results if result.wrong_mesh is not None]
    absent = [result.absent for result in results if result.absent is not None]
    nowhere = [part.pose for part in absent]
    accepted = [answer.right for answer in (*masked, *unmasked, *wrong, *nowhere) if answer.accepted]
    names = (
        "pixel_error",
        "joint_error_mm",
        "refined_joint_error_mm",
        "tip_error_mm",
        "hidden_joint_error_mm",
        "hidden_tip_error_mm",
        "hidden_contacts_right",
    )
    return finite(
        {
            "captures": len(results),
            "hand": {
                "found": rate_of([result.hand.found for result in results]),
                "right_side": rate_of([hand.right_side for hand in hands]),
                **{name: _spread([getattr(hand, name) for hand in hands]) for name in names},
                "sure": {
                    "count": len(sure),
                    **{name: _spread([getattr(hand, name) for hand in sure]) for name in names},
                },
            },
            "object_masked": _pose_figures(masked),
            "object_unmasked": _pose_figures(unmasked),
            "wrong_mesh": {"accepted": rate_of([answer.accepted for answer in wrong])},
            "no_hand": {"sure": rate_of([part.hand_score >= ACCEPTED_HAND for part in absent])},
            "no_object": {"accepted": rate_of([answer.accepted for answer in nowhere])},
            "accepted": {"right": rate_of(accepted)},
            "seconds": {
                stage: {
                    **(_spread([one.wall for one in times]) or {}),
                    "median_cpu": np.median([one.cpu for one in times]),
                }
                for stage, times in _by_stage(results).items()
            },
        }
    )


def _by_stage(results: Sequence[CaptureResult]) -> dict[str, list[StageSeconds]]:
    stages = dict.fromkeys(stage for result in results for stage in result.seconds)
    return {
        stage: [result.seconds[stage] for result in results if stage in result.seconds] for stage in stages
    }


def _pose_figures(answers: Sequence[PoseResult]) -> dict[str, Any]:
    return {
        "right": rate_of([answer.right for answer in answers]),
        "add_s_mm": _spread([answer.add_s_mm for answer in answers]),
        "rotation_deg": _spread([answer.rotation_deg for answer in answers]),
        "accepted": rate_of([answer.accepted for answer in answers]),
        "accepted_and_right": rate_of([answer.right for answer in answers if answer.accepted]),
    }


def rate_of(flags: Sequence[bool]) -> dict[str, Any] | None:
    """Share of the flags that are set, its count and interval; None where there is nothing to count."""
    if not flags:
        return None
    count = sum(flags)
    return {
        "count": len(flags),
        "rate": count / len(flags),
        "interval": wilson_interval(count, len(flags)),
    }


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    """Mean, median, 90th percentile and maximum of the finite values; None where there are none."""
    known = np.array([value for value in values if np.isfinite(value)])
    if not len(known):
        return None
    return {
        "mean": float(known.mean()),
        "median": float(np.median(known)),
        "p90": float(np.quantile(known, 0.9)),
        "max": float(known.max()),
    }


def capture_rows(results: Sequence[CaptureResult]) -> list[dict[str, Any]]:
    """Each capture's numbers, ready for JSON."""
    return finite([asdict(result) for result in results])


def target_rows(figures: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """Words, value, target and verdict of every figure that was measured, for a table."""
    rows = []
    for target in TARGETS:
        value = target.value(figures)
        if value is None:
            continue
        show = _shown(target.unit)
        sign = "\u2265" if target.at_least else "\u2264"
        met = "yes" if target.met(value) else "no"
        rows.append((target.words, show(value), f"{sign} {show(target.bound)}", met))
    return rows


def _shown(unit: str) -> Callable[[float], str]:
    if unit == "%":
        return lambda value: f"{100 * value:.1f} %"
    return lambda value: f"{value:.2f} {unit}"
