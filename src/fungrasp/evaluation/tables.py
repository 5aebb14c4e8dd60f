"""The paper's simulation ablations: what is compared, the paper's numbers, and ours beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class PaperNumbers:
    """A row of the paper's table, by its own, laxer test (docs/evaluation.md)."""

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
    method: Literal["ours", "dexgraspnet", "angle-copy"]
    """How grasps are retargeted, for training and test."""
    sees: Literal["contacts", "nothing", "history"]
    """What the actor knows of the contacts while it is trained by PPO."""
    distilled: bool
    """Whether what is tested is a student of that policy."""
    paper: PaperNumbers
    """What the paper reports for it."""


_TEACHER = PaperNumbers(0.85, 1.6, 0.79)

TABLES: Mapping[str, tuple[Variant, ...]] = {
    "retargeting": (
        Variant(
            "dexgraspnet", "DexGraspNet+*", "dexgraspnet", "contacts", False, PaperNumbers(0.65, 1.6, 0.68)
        ),
        Variant(
            "angle-copy", "Angle Reset+*", "angle-copy", "contacts", False, PaperNumbers(0.62, 1.6, 0.65)
        ),
        Variant("teacher", "Ours", "ours", "contacts", False, _TEACHER),
    ),
    "privileged": (
        Variant("without", "w/o Priv. Info.", "ours", "nothing", False, PaperNumbers(0.61, 1.6, 0.56)),
        Variant("scratch", "w/o Priv. Learn.", "ours", "history", False, PaperNumbers(0.40, 1.7, 0.24)),
        Variant("teacher", "Teacher", "ours", "contacts", False, _TEACHER),
        Variant("student", "Student (Ours)", "ours", "contacts", True, PaperNumbers(0.85, 1.6, 0.79)),
    ),
}
"""Variants by the name of the table; those of the same name are the same."""

HEAD = (
    "policy",
    "success",
    "unadapted",
    "95 % interval",
    "paper",
    "contacts",
    "paper",
    "SimD [mm/s]",
    "slip [mm/s]",
    "SimD [mm/step]",
    "paper",
)


def comparison_rows(
    variants: Sequence[Variant], results: Mapping[str, Mapping[str, Any]]
) -> list[tuple[str, ...]]:
    """Head and rows of a table, ours beside the paper's.

    Args:
        variants: of the table.
        results: what ``result_json`` gave for each, by name.
    """
    return [HEAD, *(_row(variant, results[variant.name]) for variant in variants)]


def _row(variant: Variant, result: Mapping[str, Any]) -> tuple[str, ...]:
    low, high = result["success_interval"]
    without = result.get("without_adaptation")
    paper = variant.paper
    return (
        variant.title,
        f"{result['success_rate']:.1%}",
        f"{without['success_rate']:.1%}" if without else "",
        f"{low:.1%} – {high:.1%}",
        f"{paper.success:.0%}",
        f"{result['contact_ratio']:.2f}",
        f"{paper.contact_ratio:.2f}",
        f"{result['sim_distance_world_mm_s']:.1f}",
        f"{result['sim_distance_hand_mm_s']:.1f}",
        f"{result['legacy']['sim_distance_mm_per_28.9_ms']:.2f}",
        f"{paper.displacement:.1f}",
    )
