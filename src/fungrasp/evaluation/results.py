"""Results of the lift test as JSON-ready numbers (docs/evaluate.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from fungrasp.core import __version__
from fungrasp.core.formats.text_files import finite
from fungrasp.core.provenance import run_record
from fungrasp.core.records import record_to_json
from fungrasp.evaluation.lift_evaluation import LiftTestResult
from fungrasp.evaluation.statistics import mean_over_groups, wilson_interval
from fungrasp.evaluation.use_evaluation import use_json
from fungrasp.sim2real import protocol_name
from fungrasp.task import DIVERGED

LEGACY_PERIOD = 0.0289
"""Control period of earlier published code, per which it counts the displacement [s]."""

MEANS = (
    "contact_ratio",
    "contact_precision",
    "contact_f1",
    "sim_distance_world_mm_s",
    "sim_distance_hand_mm_s",
    "pushed_m",
)
"""Fields of ``Outcomes`` that are averaged."""


def summary(result: LiftTestResult, which: np.ndarray | None = None) -> dict[str, Any]:
    """Rates and means over the episodes. which: shape [N] bool, all if None."""
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
    for name in ("sim_distance_world_mm_s", "sim_distance_hand_mm_s"):
        distance = getattr(result.outcomes, name)[held]
        values[f"{name}_held"] = float(np.mean(distance)) if len(distance) else None
    values["contact_estimate"] = result.contact_estimates.summary(which)
    if result.attempts is not None:
        values["attempts"] = {"most": result.spec.attempts, **result.attempts.summary(which)}
    displacement = values["sim_distance_world_mm_s"] * LEGACY_PERIOD
    values["legacy"] = {
        "success_rate": float(np.mean(result.outcomes.legacy_success[which])),
        "sim_distance_mm_per_28.9_ms": displacement,
    }
    return values


def mean_over_objects(result: LiftTestResult) -> dict[str, float]:
    """Rate of success and means, each object counted once."""
    columns = {"success_rate": result.outcomes.success} | {
        name: getattr(result.outcomes, name) for name in MEANS
    }
    return {name: mean_over_groups(values, result.object_name) for name, values in columns.items()}


def result_json(result: LiftTestResult) -> dict[str, Any]:
    """All of a result; nothing in it is NaN or infinite (None stands for what was not measured)."""
    seeds = np.unique(result.seed).tolist()
    names = np.unique(result.object_name).tolist()
    columns = {field.name: getattr(result.outcomes, field.name) for field in fields(result.outcomes)}
    attempt_columns = {} if result.attempts is None else result.attempts.arrays()
    use_columns = {} if result.use is None else result.use.arrays()
    episodes = [
        {
            "index": int(result.index[i]),
            "object": str(result.object_name[i]),
            "task": str(result.task[i]),
            "seed": int(result.seed[i]),
            **{name: values[i] for name, values in columns.items()},
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
            **({} if result.use is None else {"use": use_json(result.use, result.task)}),
            **({} if result.quality is None else {"quality": result.quality.summary()}),
            **({} if not result.conditions else {"robustness": robustness_json(result.conditions)}),
            "spec": record_to_json(result.spec),
            "trials": episodes,
        }
    )


def result_record(numbers: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    """Numbers of one result or of several, with command, versions, machine and date."""
    return run_record(numbers.get("seed", 0)) | dict(numbers) | {"seconds": seconds}


def robustness_json(results: Mapping[str, LiftTestResult]) -> dict[str, Any]:
    """Rates and means of a policy under each condition, and whether each episode succeeded.

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
                    {"index": index, "seed": seed, "success": success, "reason": reason}
                    for index, seed, success, reason in zip(
                        result.index.tolist(),
                        result.seed.tolist(),
                        result.outcomes.success.tolist(),
                        result.outcomes.reason.tolist(),
                        strict=True,
                    )
                ],
            }
        )
        for name, result in results.items()
    }
