"""True and perceived grasps, retargeted and tried in simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.perception.capture_job import MeasuredCapture
from benchmarks.perception.figures import rate_of
from fungrasp.cli.console import progress_bar
from fungrasp.formats.json_file import finite
from fungrasp.grasps import HumanGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel


def run_chain(
    measured: Sequence[MeasuredCapture],
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    policies: Sequence[str],
    threads: int = 0,
) -> dict[str, Any]:
    """Figures of the first policy, and of all of them by name where there are several.

    Args:
        measured: captures.
        objects: by name.
        hand: the robot's.
        policies: what moves it.
        threads: 0 means all processors.
    """
    from fungrasp.evaluation import evaluate
    from fungrasp.retargeting import retarget

    true, perceived, rows = chain_sets(measured, objects)
    humans = {"true grasps": true, "perceived grasps": perceived}
    robots = {
        words: None if human is None else retarget(human, objects, hand, threads=threads)
        for words, human in humans.items()
    }
    sure = np.array([one.result.sure for one in measured])
    each = {}
    for policy in policies:
        success = {}
        for words, robot in robots.items():
            if robot is None:
                success[words] = np.zeros(0, dtype=bool)
                continue
            with progress_bar(f"{policy}, {words}", 1.0) as show:
                tried = evaluate(robot, objects, policy, threads=threads, progress=show)
            success[words] = tried.outcomes.success
        each[policy] = chain_figures(success["true grasps"], success["perceived grasps"], rows, sure)
    figures = {"hand": hand.name, "policy": policies[0]} | each[policies[0]]
    return figures if len(policies) == 1 else figures | {"policies": each}


def chain_sets(
    measured: Sequence[MeasuredCapture], objects: Mapping[str, Any]
) -> tuple[HumanGraspSet, HumanGraspSet | None, np.ndarray]:
    """True and perceived grasps, for retargeting both.

    Args:
        measured: captures.
        objects: by name: a grasp taken for a left hand's is of a mirrored object and is left out.

    Returns:
        the true grasps, all; the perceived ones that are grasps at all (None if there are none); the capture
        of each of those, shape [P] int.
    """
    sets, rows = [], []
    for row, one in enumerate(measured):
        if one.perceived is None or one.perceived.object_name[0] not in objects:
            continue
        sets.append(one.perceived)
        rows.append(row)
    perceived = HumanGraspSet.concatenate(sets) if sets else None
    return HumanGraspSet.concatenate([one.true for one in measured]), perceived, np.array(rows, dtype=int)


def chain_figures(
    true: np.ndarray, perceived: np.ndarray, rows: np.ndarray, sure: np.ndarray
) -> dict[str, Any]:
    """Success of the chain against that of the true grasps.

    Args:
        true: whether each capture's true grasp lifts its object, shape [N] bool.
        perceived: the same of the perceived ones, shape [P] bool.
        rows: capture of each of those, shape [P]; captures without one have failed.
        sure: whether perception was confident of a capture, shape [N] bool.
    """
    success = np.zeros(len(true), dtype=bool)
    success[rows] = perceived
    rate = float(true.mean())
    return finite(
        {
            "true": rate_of(true.tolist()),
            "perceived": rate_of(success.tolist()),
            "perceived_where_sure": rate_of(success[sure].tolist()),
            "true_where_sure": rate_of(true[sure].tolist()),
            "share": float(success.mean()) / rate if rate else None,
            "successes": {"true": true, "perceived": success},
        }
    )
