"""The table of lab/perception.md: what is found in captures of objects kept aside, and targets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fungrasp.evaluation.result_files import ResultFile

SOURCES = ("perception-kept", "perception-kept-noise", "perception-contacts")
"""Results that it is made from."""


def perception_rows(read: Callable[[str], ResultFile]) -> list[tuple[str, str, str]]:
    """Figure, target and what was measured.

    Args:
        read: gives a result by its name, one of ``SOURCES``.
    """
    kept, noise = read("perception-kept"), read("perception-kept-noise")
    figures, hand, sure = kept.header, kept.header["hand"], kept.header["hand"]["sure"]
    masked, unmasked, seconds = figures["object_masked"], figures["object_unmasked"], figures["seconds"]
    count = len(kept.rows)
    refined, tips = hand["refined_joint_error_mm"], hand["tip_error_mm"]
    noisy = noise.header["hand"]["refined_joint_error_mm"]
    found = hand["found"]
    true = {
        "sure": sum(row["sure"] for row in kept.rows),
        "found": round(found["rate"] * found["count"]),
        "side": round(hand["right_side"]["rate"] * hand["right_side"]["count"]),
    }
    (labels,) = read("perception-contacts").rows
    worst = max(kept.rows, key=lambda row: row["hand.refined_joint_error_mm"] or 0.0)
    doubted = "" if worst["sure"] else " (marked *low confidence*)"
    return [
        (
            "hand found",
            "95 %",
            f"{100 * found['rate']:.0f} % ({true['found']} of {count}), {100 * true['sure'] / count:.0f} % "
            f"({true['sure']}) with confidence in hand and object",
        ),
        ("right or left hand told right, of those found", "", f"{true['side']} of {true['found']}"),
        ("landmarks, median", "7 px", f"{hand['pixel_error']['median']:.1f} px"),
        (
            "joints after refinement, mean / median of those found, worst",
            "12 mm",
            f"{_pair(refined, 1)}, {refined['max']:.0f} mm{doubted}",
        ),
        (
            "the same of the confident ones, worst",
            "12 mm",
            f"{_pair(sure['refined_joint_error_mm'], 1)}, {sure['refined_joint_error_mm']['max']:.0f} mm",
        ),
        (
            "touching fingertips, mean / median; of the confident ones",
            "8 mm",
            f"{_pair(tips, 0)}; {_pair(sure['tip_error_mm'], 0)}",
        ),
        (
            "true landmarks with 6 px of noise, no detector: joints after refinement, mean / median, worst",
            "12 mm",
            f"{_pair(noisy, 1)}, {noisy['max']:.0f} mm",
        ),
        ("the same, touching fingertips", "8 mm", _pair(noise.header["hand"]["tip_error_mm"], 1)),
        ("object right (ADD-S below 10 mm), with mask", "98 %", _share(masked["right"])),
        ("object right, without mask", "90 %", _share(unmasked["right"])),
        ("ADD-S with mask, median", "2 mm", _pose(masked)),
        ("ADD-S without mask, median", "2 mm", _pose(unmasked)),
        ("accepted poses that are right", "97 %", _share(figures["accepted"]["right"])),
        ("wrong meshes accepted", "", _count(figures["wrong_mesh"]["accepted"])),
        ("accepted although the object is not there", "", _count(figures["no_object"]["accepted"])),
        ("hand sure although there is none", "", _count(figures["no_hand"]["sure"])),
        (
            "time to find the hand, CPU; the whole of `perceive`",
            "0.2 s",
            f"{seconds['hand']['median_cpu']:.2f} s; {seconds['perceive']['median_cpu']:.1f} s",
        ),
        (
            "time for the object with mask, without, CPU",
            "3 s, 6 s",
            ", ".join(f"{seconds[f'object_{how}']['median_cpu']:.1f} s" for how in ("masked", "unmasked")),
        ),
        ("memory", "2 GB", f"{figures['peak_memory_gb']:.1f} GB, rendering included"),
        (
            "links in contact, F1 against D-Grasp's labels, of an earlier version",
            "",
            f"{labels['contact_f1']:.2f} ({labels['captures']} captures of {labels['objects']} YCB objects)",
        ),
    ]


def _pair(spread: dict[str, float], digits: int) -> str:
    return f"{spread['mean']:.{digits}f} / {spread['median']:.{digits}f} mm"


def _share(rate: dict[str, Any]) -> str:
    return f"{100 * rate['rate']:.0f} % ({_count(rate)})"


def _count(rate: dict[str, Any]) -> str:
    return f"{round(rate['rate'] * rate['count'])} of {rate['count']}"


def _pose(part: dict[str, Any]) -> str:
    return f"{part['add_s_mm']['median']:.1f} mm, turned by {part['rotation_deg']['median']:.1f}°"
