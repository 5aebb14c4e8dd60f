"""Result of a lift test: record, JSON and tables (docs/evaluate.md)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core import __version__
from fungrasp.core.formats.text_files import finite
from fungrasp.core.provenance import run_record
from fungrasp.core.records import record_to_json
from fungrasp.core.text_table import table
from fungrasp.evaluation.contact_estimate import ContactEstimates
from fungrasp.evaluation.grasp_quality import StaticQuality
from fungrasp.evaluation.lift_test_spec import LiftTestSpec
from fungrasp.evaluation.result_files import data_frame, save_result
from fungrasp.evaluation.statistics import mean_over_groups, wilson_interval
from fungrasp.evaluation.use_evaluation import use_json
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.objects import ObjectModel
from fungrasp.planning.attempts import AttemptRecord
from fungrasp.sim2real import Randomization, protocol_name
from fungrasp.task import DIVERGED, Outcomes
from fungrasp.task.outcome import HoldMiddle
from fungrasp.task.use import UseOutcomes

LEGACY_PERIOD = 0.0289
"""Control period of earlier published code, its unit of time for displacement [s]."""

MEANS = (
    "contact_ratio",
    "contact_precision",
    "contact_f1",
    "sim_distance_world_mm_s",
    "sim_distance_hand_mm_s",
    "pushed_m",
)
"""Fields of ``Outcomes`` that are averaged."""
SHOWN_MEANS = ("shown_share", "place_error_mm", "other_side", "strays")
"""Fields of ``Outcomes`` that are averaged over held objects with known contacts of the person."""
CONDITION_COLUMNS = ("success", "held_as_shown", "reason", "not_as_shown")
"""Fields of ``Outcomes`` that are stored per episode for several conditions."""
UNLIKELY = 0.5
"""Expected probability below which a plan is not likely to hold as shown."""
HEAD = (
    "episodes",
    "held as shown",
    "95 % interval",
    "success",
    "95 % interval",
    "place [mm]",
    "contacts",
    "slip [mm/s]",
    "pushed [mm]",
)


@dataclass(frozen=True, eq=False, repr=False)
class LiftTestResult:
    """Outcomes of N episodes under one condition. With several conditions, this is the first one, and
    ``conditions`` has all."""

    hand: str
    """Name of the hand."""
    spec: LiftTestSpec
    """Settings of the test."""
    randomization: Randomization
    """Differences of the worlds from the nominal worlds of the plans."""
    index: np.ndarray
    """Row of each episode's grasp in the set, shape [N]."""
    seed: np.ndarray
    """Seed of each episode, shape [N]."""
    object_name: np.ndarray
    """Name of each object, shape [N] str."""
    task: np.ndarray
    """Task of each grasp, shape [N] str."""
    outcomes: Outcomes
    """Outcomes of the N episodes."""
    rollouts: np.ndarray
    """Episodes simulated to plan each grasp, shape [N] int."""
    contact_estimates: ContactEstimates
    """Accuracy of the policy's contact estimates, N rows."""
    expected_as_shown: np.ndarray | None = None
    """Planner's estimate of the probability to hold as shown, shape [N]; NaN or None without estimate."""
    hold: HoldMiddle | None = None
    """State in the middle of the hold, N rows; not written to files."""
    use: UseOutcomes | None = None
    """Outcomes of the use tests; None without use tests."""
    attempts: AttemptRecord | None = None
    """Records of the attempts; None for a single attempt."""
    quality: StaticQuality | None = None
    """Static quality of the grasps, if requested and the human grasps are known."""
    conditions: Mapping[str, LiftTestResult] = field(default_factory=dict)
    """Results by condition, including this one; empty for a single condition."""
    grasps: RobotGraspSet | None = None
    """The tested grasps; not written to files."""
    human: HumanGraspSet | None = None
    """Their human grasps, if known; not written to files."""
    objects: Mapping[str, ObjectModel] = field(default_factory=dict)
    """Their objects by name; not written to files."""
    seconds: float = 0.0
    """Duration without earlier, interrupted runs [s]."""

    @property
    def policy(self) -> str:
        """Name or file of the policy."""
        return self.spec.policy

    @property
    def success(self) -> np.ndarray:
        """Whether the object was lifted and held, shape [N] bool."""
        return self.outcomes.success

    @property
    def episodes(self) -> int:
        """Number of episodes of all conditions."""
        return sum(len(each.index) for each in self.conditions.values()) or len(self.index)

    def table(self) -> str:
        """Return success rates by object or condition, and reasons of failures, as text."""
        parts = [robustness_table(self.conditions) if self.conditions else _object_table(self)]
        parts += not_found_lines(self)
        if self.use is not None:
            parts.append(_use_table(self.use, self.task))
        if self.quality is not None:
            parts.append(self.quality.table())
        return "\n".join(parts)

    def json(self) -> dict[str, Any]:
        """Return all numbers, settings and provenance, without NaN or infinity."""
        numbers = result_json(self)
        return run_record(numbers["seed"]) | numbers | {"seconds": self.seconds}

    def save(self, path: str | Path, compact: bool = False) -> None:
        """Write the result to a ``.json`` file for ``fungrasp.evaluation.read_result``.

        Args:
            compact: write the episodes to a CSV file next to it, one row each.

        Raises:
            FungraspError: the suffix is wrong, or a file can't be written.
        """
        save_result(path, self.json(), compact)

    def frame(self) -> Any:
        """Return a data frame with one row per episode, of pandas or, if it is not installed, Polars.

        Raises:
            FungraspError: neither is installed.
        """
        return data_frame(self.json()["trials"])

    @property
    def knows_places(self) -> bool:
        """Whether the person's contacts are known; otherwise nothing counts as held as shown."""
        return bool(np.isfinite(self.outcomes.strays).any())

    def count(self, which: np.ndarray | None = None) -> str:
        """Return the number of held episodes and, if known, of those held as shown, as text. which: shape [N]
        bool; all if None."""
        flags = np.ones(len(self.index), dtype=bool) if which is None else which
        held = f"{int(self.success[flags].sum())} of {int(flags.sum())} held"
        return (
            f"{held}, {int(self.outcomes.held_as_shown[flags].sum())} as shown" if self.knows_places else held
        )

    def __repr__(self) -> str:
        return f"<LiftTestResult: hand {self.hand!r}, policy {self.policy!r}, {self.count()}>"


def summary(result: LiftTestResult, which: np.ndarray | None = None) -> dict[str, Any]:
    """Return rates and means over episodes. which: shape [N] bool, all if None."""
    which = np.ones(len(result.index), dtype=bool) if which is None else which
    count, successes = int(which.sum()), int(result.outcomes.success[which].sum())
    values: dict[str, Any] = {
        "count": count,
        "success_rate": successes / count,
        "success_interval": list(wilson_interval(successes, count)),
        "unstable": int((result.outcomes.reason[which] == DIVERGED).sum()),
    }
    values |= {name: float(np.mean(getattr(result.outcomes, name)[which])) for name in MEANS}
    held = which & result.outcomes.success
    values |= shown_summary(result.outcomes, which)
    for name in ("sim_distance_world_mm_s", "sim_distance_hand_mm_s"):
        distance = getattr(result.outcomes, name)[held]
        values[f"{name}_held"] = float(np.mean(distance)) if len(distance) else None
    values["contact_estimate"] = result.contact_estimates.summary(which)
    if result.attempts is not None:
        values["attempts"] = {"most": result.spec.attempts, **attempts_json(result.attempts, which)}
    displacement = values["sim_distance_world_mm_s"] * LEGACY_PERIOD
    values["legacy"] = {
        "success_rate": float(np.mean(result.outcomes.legacy_success[which])),
        "sim_distance_mm_per_28.9_ms": displacement,
    }
    return values


def shown_summary(outcomes: Outcomes, which: np.ndarray) -> dict[str, Any]:
    """Return the rate of episodes held as shown, and means over held objects; None if the person's contacts
    are unknown. which: shape [N] bool."""
    known = which & np.isfinite(outcomes.place_error_mm)
    if not np.isfinite(outcomes.strays[which]).any():
        return dict.fromkeys(("held_as_shown", "held_as_shown_interval", *SHOWN_MEANS, "place_error_p90_mm"))
    count, shown = int(which.sum()), int(outcomes.held_as_shown[which].sum())
    held = known & outcomes.success
    values: dict[str, Any] = {
        "held_as_shown": shown / count,
        "held_as_shown_interval": list(wilson_interval(shown, count)),
    }
    for name in SHOWN_MEANS:
        values[name] = float(np.mean(getattr(outcomes, name)[held])) if held.any() else None
    error = outcomes.place_error_mm[held]
    return values | {"place_error_p90_mm": float(np.percentile(error, 90)) if held.any() else None}


def by_task(result: LiftTestResult) -> dict[str, dict[str, int]]:
    """Return the numbers of episodes, held objects, and objects held as shown, by task."""
    rows = {name: result.task == name for name in np.unique(result.task).tolist() if name}
    return {
        name: {
            "count": int(which.sum()),
            "held": int(result.outcomes.success[which].sum()),
            "held_as_shown": int(result.outcomes.held_as_shown[which].sum()),
        }
        for name, which in rows.items()
    }


def mean_over_objects(result: LiftTestResult) -> dict[str, float]:
    """Return success rate and means, in which each object has the same weight."""
    columns = {"success_rate": result.outcomes.success} | {
        name: getattr(result.outcomes, name) for name in MEANS
    }
    if result.knows_places:
        columns = {"held_as_shown": result.outcomes.held_as_shown} | columns
    return {name: mean_over_groups(values, result.object_name) for name, values in columns.items()}


def result_json(result: LiftTestResult) -> dict[str, Any]:
    """Return the result as JSON values without NaN and infinity; None if not measured."""
    seeds = np.unique(result.seed).tolist()
    names = np.unique(result.object_name).tolist()
    columns = {field.name: getattr(result.outcomes, field.name) for field in fields(result.outcomes)}
    expected = result.expected_as_shown
    attempt_columns = {} if result.attempts is None else result.attempts.arrays()
    use_columns = {} if result.use is None else result.use.arrays()
    episodes = [
        {
            "index": int(result.index[i]),
            "object": str(result.object_name[i]),
            "task": str(result.task[i]),
            "seed": int(result.seed[i]),
            **{name: values[i] for name, values in columns.items()},
            **({} if expected is None else {"expected_as_shown": expected[i]}),
            **{name: values[i] for name, values in attempt_columns.items()},
            **{f"use_{name}": values[i] for name, values in use_columns.items()},
        }
        for i in range(len(result.index))
    ]
    return finite(
        {
            "version": __version__,
            "hand": result.hand,
            "policy": result.policy,
            "rollouts_per_grasp": float(np.mean(result.rollouts)),
            "seed": seeds[0] if len(seeds) == 1 else seeds,
            "protocol": result.spec.protocol if result.conditions else protocol_name(result.randomization),
            "lift_test": asdict(result.spec.lift),
            "physics": asdict(result.spec.physics),
            "randomization": asdict(result.randomization),
            **summary(result),
            "mean_over_objects": mean_over_objects(result),
            "by_object": {name: summary(result, result.object_name == name) for name in names},
            "by_task": by_task(result),
            **({} if result.use is None else {"use": use_json(result.use, result.task)}),
            **({} if result.quality is None else {"quality": result.quality.summary()}),
            **({} if not result.conditions else {"robustness": robustness_json(result.conditions)}),
            "spec": record_to_json(result.spec),
            "trials": episodes,
        }
    )


def robustness_json(results: Mapping[str, LiftTestResult]) -> dict[str, Any]:
    """Return rates and means under each condition, and the outcome of each episode.

    Args:
        results: by condition, of the same policy and grasps.
    """
    return {
        name: finite(
            {
                "randomization": asdict(result.randomization),
                **summary(result),
                "mean_over_objects": mean_over_objects(result),
                "trials": [
                    {"index": int(result.index[i]), "seed": int(result.seed[i])}
                    | {name: getattr(result.outcomes, name)[i] for name in CONDITION_COLUMNS}
                    for i in range(len(result.index))
                ],
            }
        )
        for name, result in results.items()
    }


def attempts_json(attempts: AttemptRecord, which: np.ndarray) -> dict[str, Any]:
    """Return rates and counts of episodes. which: shape [N] bool."""
    count, first = int(which.sum()), int(attempts.first_success[which].sum())
    again = which & (attempts.attempts > 1)
    return {
        "first_success_rate": first / count,
        "first_success_interval": list(wilson_interval(first, count)),
        "tried_again": int(again.sum()),
        "held_given_up": int(attempts.held_given_up[which].sum()),
        "misses_unnoticed": int(attempts.misses_unnoticed[which].sum()),
        "no_plan": int(attempts.no_plan[which].sum()),
    }


def _object_table(result: LiftTestResult) -> str:
    numbers = result_json(result)
    rows = [("object", *HEAD)]
    rows += [_row(name, part) for name, part in numbers["by_object"].items()]
    rows.append(_row("all", numbers))
    rows.append(_row("mean over objects", numbers["mean_over_objects"]))
    lines = contact_estimate_lines(numbers["contact_estimate"])
    if numbers["held_as_shown"] is not None and numbers["by_task"]:
        tasks = (
            f"{name} {part['held_as_shown']}/{part['held']}/{part['count']}"
            for name, part in numbers["by_task"].items()
        )
        lines.append(f"held as shown / held / all by task: {', '.join(tasks)}")
    lines += attempt_lines(numbers.get("attempts"))
    for what, column in (("failed", result.outcomes.reason), ("not as shown", result.outcomes.not_as_shown)):
        reasons = Counter(reason for reason in column.tolist() if reason)
        lines += [f"{what}: {count:3d} {reason}" for reason, count in reasons.most_common()]
    return "\n".join([table(rows), *lines])


def not_found_lines(result: LiftTestResult) -> list[str]:
    """Return a line with the grasps that have no plan likely to hold as shown, or no line."""
    if result.expected_as_shown is None or result.spec.other_places:
        return []
    rows = np.unique(result.index[result.expected_as_shown < UNLIKELY]).tolist()
    if not rows:
        return []
    some = ", ".join(map(str, rows[:8])) + (", ..." if len(rows) > 8 else "")
    return [
        f"no firm grasp as shown found for {len(rows)} grasps (rows {some}): the setting other_places "
        "(--other-places) plays plans that hold them in another way"
    ]


def contact_estimate_lines(estimate: Mapping[str, Any] | None) -> list[str]:
    """Return a line with the accuracy of a student's contact estimates, or no line."""
    if estimate is None:
        return []
    return [
        f"estimated contacts: F1 {estimate['f1']:.2f} (precision {estimate['precision']:.2f}, "
        f"recall {estimate['recall']:.2f}); forces off by {estimate['force_error_n']:.1f} N "
        f"of {estimate['force_n']:.1f} N"
    ]


def attempt_lines(attempts: Mapping[str, Any] | None) -> list[str]:
    """Return two lines on the further attempts, or none."""
    if attempts is None:
        return []
    low, high = attempts["first_success_interval"]
    return [
        f"first attempt: {attempts['first_success_rate']:.1%} ({low:.1%} – {high:.1%}); "
        f"tried again: {attempts['tried_again']}, {attempts['most']} attempts at most",
        f"judged wrongly: {attempts['held_given_up']} held objects given up, "
        f"{attempts['misses_unnoticed']} failures not noticed; without another plan: {attempts['no_plan']}",
    ]


def _use_table(use: UseOutcomes, task: np.ndarray) -> str:
    numbers = use_json(use, task)
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
    reasons = Counter(reason for reason in use.reason.tolist() if reason)
    return "\n".join(
        [table(rows), *(f"failed: {count:3d} {reason}" for reason, count in reasons.most_common())]
    )


def robustness_table(results: Mapping[str, LiftTestResult]) -> str:
    """Return a table of conditions and the mean success rate of all but the first, which is undisturbed."""
    disturbed = list(results.values())[1:]
    mean = f"mean over the {len(disturbed)} disturbed conditions: success "
    mean += f"{np.mean([each.success.mean() for each in disturbed]):.1%}"
    if all(each.knows_places for each in disturbed):
        mean += f", held as shown {np.mean([each.outcomes.held_as_shown.mean() for each in disturbed]):.1%}"
    return "\n".join([_side_by_side("condition", results), mean])


def _side_by_side(first: str, results: Mapping[str, LiftTestResult]) -> str:
    return table([(first, *HEAD), *(_row(name, summary(result)) for name, result in results.items())])


def _interval(bounds: tuple[float, float] | None) -> str:
    return "" if bounds is None else f"{bounds[0]:.1%} – {bounds[1]:.1%}"


def _row(name: str, part: Mapping[str, Any]) -> tuple[str, ...]:
    shown, place = part.get("held_as_shown"), part.get("place_error_mm")
    return (
        name,
        str(part.get("count", "")),
        "–" if shown is None else f"{shown:.1%}",
        _interval(part.get("held_as_shown_interval")),
        f"{part['success_rate']:.1%}",
        _interval(part.get("success_interval")),
        "–" if place is None else f"{place:.0f}",
        f"{part['contact_ratio']:.2f}",
        f"{part['sim_distance_hand_mm_s']:.1f}",
        f"{1e3 * part['pushed_m']:.0f}",
    )
