"""Trains a success predictor: variations of grasps are tried in physics, then learned from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter

from fungrasp.core.jobs import PartStore
from fungrasp.core.provenance import machine
from fungrasp.hands import Hand
from fungrasp.policies.checkpoint.card import Budget, PolicyCard, TrainingData
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.task import LiftProtocol
from fungrasp.training.export import export_predictor, make_card
from fungrasp.training.settings import PredictorSettings
from fungrasp.training.success_predictor import PlanOutcomes, cross_validate, fit_predictor, try_plans
from fungrasp.training.training_sets import TrainingSet

MEASURED = "cross-validated, no residual"
"""Entry of a predictor's card."""


def train_predictor(
    path: Path,
    sets: Sequence[TrainingSet],
    hand: Hand,
    settings: PredictorSettings | None = None,
    seed: int = 0,
    *,
    episodes: Path | None = None,
    licence: str = "",
    threads: int = 0,
    progress: Callable[[float], None] = lambda done: None,
) -> PolicyCard:
    """Train a success predictor, or go on where this was interrupted.

    Args:
        path: of its file (.onnx).
        sets: of grasps of ``hand``, at least one.
        hand: the robot hand.
        settings: the defaults if None.
        seed: of everything random.
        episodes: folder in which the episodes' outcomes are kept; beside the file if None. More attempts add
            to them.
        licence: of the predictor, for its card.
        threads: 0 means all processors. The result does not depend on it.
        progress: called with the share of the episodes that is done.

    Returns:
        The predictor's card; ``measured[MEASURED]`` says how it does on grasps that it has not seen.

    Raises:
        FungraspError: a file can't be written.
    """
    start, settings = perf_counter(), settings or PredictorSettings()
    folder = path.with_suffix(".episodes") if episodes is None else episodes
    parts, names = [], ()
    for number, one in enumerate(sets):
        outcomes, names = try_plans(
            one.grasps,
            one.objects,
            hand,
            settings,
            seed,
            threads,
            store=PartStore(folder / str(number)),
            progress=lambda done, before=number: progress((before + done) / len(sets)),
        )
        parts.append(outcomes)
    outcomes = PlanOutcomes.join(*parts)
    measured = cross_validate(outcomes, settings, seed=seed)
    predictor = fit_predictor(outcomes, settings, seed)
    card = make_card(
        path.stem,
        "predictor",
        hand,
        names,
        (),
        ResidualSettings(),
        1 / LiftProtocol().control_period,
        Budget(len(outcomes.grasp), perf_counter() - start, machine()),
        training_data=tuple(TrainingData(s.name, s.terms, len(s.grasps)) for s in sets),
        seed=seed,
        licence=licence,
        limits=("Its budget counts episodes where a policy of motions counts control steps.",),
        measured={MEASURED: measured},
    )
    export_predictor(predictor, path, card)
    return card
