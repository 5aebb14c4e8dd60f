"""Results of lift tests as tables of text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from fungrasp.core.text_table import table
from fungrasp.evaluation.lift_evaluation import LiftTestResult
from fungrasp.evaluation.results import result_json, summary
from fungrasp.evaluation.use_evaluation import use_json

HEAD = ("episodes", "success", "95 % interval", "contacts", "slip [mm/s]", "pushed [mm]")


def result_table(result: LiftTestResult) -> str:
    """Rates of success by object, or by condition where there are several; what else was measured."""
    parts = [robustness_table(result.conditions) if result.conditions else _object_table(result)]
    if result.use is not None:
        parts.append(use_table(result))
    if result.quality is not None:
        parts.append(result.quality.table())
    return "\n".join(parts)


def _object_table(result: LiftTestResult) -> str:
    """Objects and their rates of success, and why episodes failed."""
    numbers = result_json(result)
    rows = [("object", *HEAD)]
    rows += [_row(name, part) for name, part in numbers["by_object"].items()]
    rows.append(_row("all", numbers))
    rows.append(_row("mean over objects", numbers["mean_over_objects"]))
    lines = contact_estimate_lines(numbers["contact_estimate"])
    lines += attempt_lines(numbers.get("attempts"))
    reasons = Counter(reason for reason in result.outcomes.reason.tolist() if reason)
    lines += [f"failed: {count:3d} {reason}" for reason, count in reasons.most_common()]
    return "\n".join([table(rows), *lines])


def contact_estimate_lines(estimate: Mapping[str, Any] | None) -> list[str]:
    """How well a student knew what it touched, a line, or none."""
    if estimate is None:
        return []
    return [
        f"estimated contacts: F1 {estimate['f1']:.2f} (precision {estimate['precision']:.2f}, "
        f"recall {estimate['recall']:.2f}); forces off by {estimate['force_error_n']:.1f} N "
        f"of {estimate['force_n']:.1f} N"
    ]


def attempt_lines(attempts: Mapping[str, Any] | None) -> list[str]:
    """What further attempts were worth, two lines, or none."""
    if attempts is None:
        return []
    low, high = attempts["first_success_interval"]
    return [
        f"first attempt: {attempts['first_success_rate']:.1%} ({low:.1%} – {high:.1%}); "
        f"tried again: {attempts['tried_again']}, {attempts['most']} attempts at most",
        f"judged wrongly: {attempts['held_given_up']} held objects given up, "
        f"{attempts['misses_unnoticed']} failures not noticed; without another plan: {attempts['no_plan']}",
    ]


def use_table(result: LiftTestResult) -> str:
    """Tasks and how many of their held grasps passed the use test, and why the others failed."""
    assert result.use is not None
    numbers = use_json(result.use, result.task)
    if not numbers["count"]:
        return "no held grasp is for a task that has a use motion"
    rows = [("task", "held", "used", "95 % interval", "functional contact", "shift [mm]", "turn [deg]")]
    for name, part in (*numbers["by_task"].items(), ("all", numbers)):
        low, high = part["success_interval"]
        rows.append(
            (
                name,
                str(part["count"]),
                f"{part['success_rate']:.1%}",
                f"{low:.1%} – {high:.1%}",
                f"{part['functional_contact']:.2f}",
                f"{part['shift_mm_median']:.1f}",
                f"{part['turn_deg_median']:.1f}",
            )
        )
    reasons = Counter(reason for reason in result.use.reason.tolist() if reason)
    return "\n".join(
        [table(rows), *(f"failed: {count:3d} {reason}" for reason, count in reasons.most_common())]
    )


def robustness_table(results: Mapping[str, LiftTestResult]) -> str:
    """Conditions side by side, and the mean of their rates of success; the first is undisturbed."""
    rates = [float(result.outcomes.success.mean()) for result in results.values()]
    mean = f"mean over the {len(rates) - 1} disturbed conditions: {sum(rates[1:]) / (len(rates) - 1):.1%}"
    return "\n".join([_side_by_side("condition", results), mean])


def _side_by_side(first: str, results: Mapping[str, LiftTestResult]) -> str:
    return table([(first, *HEAD), *(_row(name, summary(result)) for name, result in results.items())])


def _row(name: str, part: Mapping[str, Any]) -> tuple[str, str, str, str, str, str, str]:
    low, high = part.get("success_interval", (None, None))
    return (
        name,
        str(part.get("count", "")),
        f"{part['success_rate']:.1%}",
        "" if low is None else f"{low:.1%} – {high:.1%}",
        f"{part['contact_ratio']:.2f}",
        f"{part['sim_distance_hand_mm_s']:.1f}",
        f"{1e3 * part['pushed_m']:.0f}",
    )
