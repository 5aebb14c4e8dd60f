"""Summary of use tests on many grasps."""

from __future__ import annotations

from typing import Any

import numpy as np

from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.task import DIVERGED
from fungrasp.task.use import UseOutcomes


def use_json(use: UseOutcomes, task: np.ndarray) -> dict[str, Any]:
    """Return rates over held grasps whose task has a motion: in total and by task.

    Args:
        use: N outcomes.
        task: task of each grasp, shape [N] str.
    """
    tested = use.motion != ""
    names = np.unique(task[tested]).tolist()
    return {
        **_rates(use, tested),
        "by_task": {name: _rates(use, tested & (task == name)) for name in names},
        "functional_contact": float(np.nanmean(use.functional_contact))
        if np.isfinite(use.functional_contact).any()
        else None,
    }


def _rates(use: UseOutcomes, which: np.ndarray) -> dict[str, Any]:
    count, passed = int(which.sum()), int(use.success[which].sum())
    if not count:
        return {"count": 0, "success_rate": None}
    return {
        "count": count,
        "success_rate": passed / count,
        "success_interval": list(wilson_interval(passed, count)),
        "unstable": int((use.reason[which] == DIVERGED).sum()),
        "functional_contact": float(np.mean(use.functional_contact[which])),
        "shift_mm_median": 1e3 * float(np.median(use.shift_m[which])),
        "turn_deg_median": float(np.rad2deg(np.median(use.turn_rad[which]))),
    }
