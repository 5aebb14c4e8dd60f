"""The success predictor: learns from many tried plans which of a grasp's variations will hold."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Self

import numpy as np
import torch

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.text_files import parse_json
from fungrasp.core.jobs import Arrays, Job, PartStore, part_key, run_job
from fungrasp.core.provenance import machine
from fungrasp.grasps import RobotGraspSet
from fungrasp.grasps.as_shown import ShownJudge
from fungrasp.hands import Hand, as_hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner
from fungrasp.planning.selection.candidates import VariationSpread, vary, with_settings
from fungrasp.planning.selection.success_predictor import plan_features, planned_contacts
from fungrasp.policies import OpenLoopPolicy
from fungrasp.policies.checkpoint.card import ActionPart, Budget, PolicyCard, TrainingData
from fungrasp.policies.checkpoint.checkpoint_file import save_policy
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.simulation import Scene, SceneSettings, build_scene
from fungrasp.task import GraspPlan, LiftEnvironment, LiftProtocol, play
from fungrasp.task.features import flatten, layout
from fungrasp.training.environment import Layout
from fungrasp.training.export import graph, make_card
from fungrasp.training.settings import PredictorSettings, PredictorSpec
from fungrasp.training.training_sets import TrainingSet

MEASURED = "cross-validated, no residual"
"""Entry of a predictor's card."""

LAYOUT = "layout"
"""Name of the layout of the features beside the arrays of a part."""


@dataclass(frozen=True, eq=False)
class PlanOutcomes:
    """N tried plans."""

    features: np.ndarray
    """``plan_features`` side by side, shape [N, D] float32."""
    grasp: np.ndarray
    """Which grasp each is a variation of, shape [N] int."""
    attempt: np.ndarray
    """Which variation, 0 for the grasp as it is, shape [N] int."""
    success: np.ndarray
    """Whether the object was held, shape [N] bool."""
    as_shown: np.ndarray
    """Whether it was held as shown, shape [N] bool; as ``success`` where the person's places are not
    known."""
    contact_ratio: np.ndarray
    """During the hold, shape [N]."""

    @classmethod
    def join(cls, *parts: PlanOutcomes) -> PlanOutcomes:
        """One after the other; the grasps of each part count on from those of the part before."""
        offsets = np.cumsum([0, *(int(part.grasp.max()) + 1 for part in parts)])
        moved = [replace(p, grasp=p.grasp + o) for p, o in zip(parts, offsets[:-1], strict=True)]
        return cls(*(np.concatenate([getattr(part, f.name) for part in moved]) for f in fields(cls)))

    def select(self, rows: np.ndarray) -> PlanOutcomes:
        """Some of the plans' outcomes."""
        return PlanOutcomes(*(getattr(self, f.name)[rows] for f in fields(self)))


@dataclass(frozen=True, eq=False)
class PlanTrials(Job[range]):
    """Variations of grasps that are planned and tried once in physics, open loop; a part is a range of the
    episodes, every grasp as it is before any variation."""

    grasps: RobotGraspSet
    """N grasps of ``hand``."""
    objects: Mapping[str, ObjectModel]
    """By name."""
    hand: Hand
    """The robot hand."""
    spec: PredictorSpec
    """How many variations, and how they are tried."""

    @cached_property
    def scene(self) -> Scene:
        """What is simulated."""
        return build_scene(self.hand, self.objects, SceneSettings(timestep=self.spec.settings.timestep))

    @cached_property
    def start(self) -> RobotGraspSet:
        """The grasps with the controller's settings that are varied."""
        return with_settings(self.grasps)

    def parts(self) -> list[range]:
        """So many episodes at most."""
        count, chunk = len(self.grasps) * self.spec.settings.attempts, self.spec.settings.chunk
        return [range(first, min(first + chunk, count)) for first in range(0, count, chunk)]

    def key(self, part: range) -> str:
        """Digest of all that decides the outcomes; the number of variations does not."""
        objects = {name: self.objects[name] for name in np.unique(self.grasps.object_name)}
        s = self.spec.settings
        numbers = (s.timestep, s.hold_time, s.early, self.spec.seed, part.start, part.stop)
        return part_key("plan trials", self.start, objects, self.hand, numbers)

    def size(self, part: range) -> float:
        """Number of episodes."""
        return len(part)

    def on_one_processor(self) -> Self:
        """With one thread."""
        return replace(self, spec=replace(self.spec, threads=1))

    def run(self, parts: Sequence[range], progress: Callable[[float], None]) -> list[Arrays]:
        """Fields of ``PlanOutcomes``, and the layout of their features as JSON."""
        results: list[Arrays] = []
        for part in parts:
            attempt, grasp = np.divmod(np.array(part), len(self.grasps))
            varied = vary(
                self.start.select(grasp), self.hand, grasp, attempt, self.spec.seed, VariationSpread()
            )
            plans, success, shown, ratio = _try(varied, self.objects, self.scene, self.spec)
            judge = ShownJudge(self.hand, self.objects)
            features = plan_features(plans, self.objects, planned_contacts(plans, judge))
            flat = np.nan_to_num(flatten(features)).astype(np.float32)
            outcomes = PlanOutcomes(flat, grasp, attempt, success, shown, ratio)
            arrays = {f.name: getattr(outcomes, f.name) for f in fields(PlanOutcomes)}
            results.append(arrays | {LAYOUT: np.array(json.dumps(layout(features)))})
        return results


def try_plans(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    spec: PredictorSpec,
    *,
    store: PartStore | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[PlanOutcomes, Layout]:
    """Plan variations of grasps and try each once in physics, open loop.

    Args:
        store: keeps outcomes as they come; those that an interrupted call, or one of fewer variations, has
            left there are not tried again.

    Returns:
        The outcomes, and the layout of their features.

    Raises:
        FungraspError: a part can't be written.
    """
    found = run_job(PlanTrials(grasps, objects, hand, spec), store, progress=progress)
    names = tuple((str(name), int(size)) for name, size in parse_json(str(found[-1][LAYOUT]), "kept layout"))
    columns = [np.concatenate([part[f.name] for part in found]) for f in fields(PlanOutcomes)]
    return PlanOutcomes(*columns), names


def _try(
    grasps: RobotGraspSet, objects: Mapping[str, ObjectModel], scene: Scene, spec: PredictorSpec
) -> tuple[GraspPlan, np.ndarray, np.ndarray, np.ndarray]:
    """The plans, whether they held, whether as shown, and their contact ratio."""
    protocol = replace(LiftProtocol(), hold_time=spec.settings.hold_time)
    environment = LiftEnvironment(scene, len(grasps), protocol=protocol, threads=spec.threads)
    plans = MotionPlanner(scene.hand, objects).plan(grasps, environment.settle(grasps))
    ids = np.arange(len(grasps))
    environment.begin(ids, plans, np.maximum(plans.closing_step - spec.settings.early, 0), environment.sample)
    outcomes = play(environment, OpenLoopPolicy(), plans, end_lost=True)
    lost = outcomes.reason == "lost before the hold"
    shown = outcomes.success if plans.shown_places is None else outcomes.held_as_shown
    return plans, outcomes.success, shown, np.where(lost, 0.0, np.nan_to_num(outcomes.contact_ratio))


class PredictorNetwork(torch.nn.Module):
    """Mean of several networks' expected success, and success as shown."""

    def __init__(self, features: np.ndarray, s: PredictorSettings):
        """features: of the plans it will learn from, shape [N, D]."""
        super().__init__()
        self.mean: torch.Tensor
        self.register_buffer("mean", torch.from_numpy(features.mean(axis=0)))
        self.spread: torch.Tensor
        self.register_buffer("spread", torch.from_numpy(features.std(axis=0) + 0.05))
        a, b = s.hidden
        self.networks = torch.nn.ModuleList(
            torch.nn.Sequential(
                torch.nn.Linear(features.shape[1], a),
                torch.nn.ELU(),
                torch.nn.Dropout(s.dropout),
                torch.nn.Linear(a, b),
                torch.nn.ELU(),
                torch.nn.Dropout(s.dropout),
                torch.nn.Linear(b, 2),
            )
            for _ in range(s.networks)
        )

    def logits(self, features: torch.Tensor) -> torch.Tensor:
        """Logits of each network, shape [networks, N, 2]. features: shape [N, D]."""
        normal = (features - self.mean) / self.spread
        return torch.stack([network(normal) for network in self.networks])

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Probabilities of success, and of success as shown, which is never more likely, shape [N, 2]."""
        success, shown = torch.sigmoid(self.logits(features)).mean(dim=0).unbind(dim=1)
        return torch.stack([success, torch.minimum(success, shown)], dim=1)


def fit_predictor(
    outcomes: PlanOutcomes, settings: PredictorSettings | None = None, seed: int = 0
) -> PredictorNetwork:
    """Learn from tried plans.

    Raises:
        FungraspError: all of them held, or none.
    """
    s = settings or PredictorSettings()
    if outcomes.success.all() or not outcomes.success.any():
        word = "all" if outcomes.success.any() else "none"
        raise FungraspError(f"a predictor can't learn from plans of which {word} held")
    torch.manual_seed(seed)
    predictor = PredictorNetwork(outcomes.features, s)
    features = torch.from_numpy(outcomes.features)
    truth = torch.from_numpy(np.stack([outcomes.success, outcomes.as_shown], axis=1)).float()
    optimizer = torch.optim.AdamW(predictor.parameters(), lr=s.learning_rate, weight_decay=s.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, s.epochs)
    predictor.train()
    for _ in range(s.epochs):
        for rows in torch.randperm(len(truth)).split(s.minibatch):
            logits = predictor.logits(features[rows])
            loss = torch.nn.functional.binary_cross_entropy_with_logits(logits, truth[rows].expand_as(logits))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        schedule.step()
    return predictor.eval()


def cross_validate(
    outcomes: PlanOutcomes, settings: PredictorSettings | None = None, folds: int = 5, seed: int = 0
) -> dict[str, float]:
    """What choosing would give on grasps that the predictor has not seen.

    Returns:
        Share held as shown of the grasps as they are ("first"), of all variations ("mean"), of those chosen
        ("chosen"), and of grasps with any such variation ("any"); success and contact ratio of the chosen.
    """
    fold = np.random.default_rng(seed).integers(folds, size=int(outcomes.grasp.max()) + 1)[outcomes.grasp]
    expected = np.zeros(len(fold))
    for k in np.unique(fold):
        predictor = fit_predictor(outcomes.select(np.flatnonzero(fold != k)), settings, seed)
        rows = np.flatnonzero(fold == k)
        with torch.inference_mode():
            expected[rows] = predictor(torch.from_numpy(outcomes.features[rows]))[:, 1].numpy()
    groups = [np.flatnonzero(outcomes.grasp == g) for g in np.unique(outcomes.grasp)]
    chosen = np.array([rows[np.argmax(expected[rows])] for rows in groups])
    return {
        "first": float(outcomes.as_shown[outcomes.attempt == 0].mean()),
        "mean": float(outcomes.as_shown.mean()),
        "chosen": float(outcomes.as_shown[chosen].mean()),
        "any": float(np.mean([outcomes.as_shown[rows].any() for rows in groups])),
        "success": float(outcomes.success[chosen].mean()),
        "contact_ratio": float(outcomes.contact_ratio[chosen].mean()),
    }


def train_predictor(
    path: str | Path,
    sets: Sequence[TrainingSet],
    hand: Hand | str | Path = "allegro",
    spec: PredictorSpec | None = None,
    *,
    progress: Callable[[float], None] = lambda done: None,
) -> Path:
    """Train a success predictor, or go on where this was interrupted.

    Args:
        sets: of grasps of ``hand``, at least one.

    Returns:
        The file. ``measured[MEASURED]`` of its card says how it does on grasps that it has not seen.

    Raises:
        FungraspError: a file can't be written.
    """
    start, spec, hand, path = perf_counter(), spec or PredictorSpec(), as_hand(hand), Path(path)
    settings, seed = spec.settings, spec.seed
    folder = path.with_suffix(".episodes") if spec.episodes is None else spec.episodes
    parts, names = [], ()
    for number, one in enumerate(sets):
        outcomes, names = try_plans(
            one.grasps,
            one.objects,
            hand,
            spec,
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
        Budget(len(outcomes.grasp), perf_counter() - start, machine()),
        training_data=tuple(TrainingData(s.name, s.terms, len(s.grasps)) for s in sets),
        seed=seed,
        licence=spec.licence,
        limits=("Its budget counts episodes where a policy of motions counts control steps.",),
        measured={MEASURED: measured},
    )
    export_predictor(predictor, path, card)
    return path


def export_predictor(predictor: PredictorNetwork, path: Path, card: PolicyCard) -> None:
    """Write a success predictor's file: its observation is ``plan_features``, its action the expected
    success, and success as shown."""
    card = replace(card, action=(ActionPart("success", 1, 1.0), ActionPart("as_shown", 1, 1.0)))
    example = torch.zeros(2, card.input_size)
    save_policy(path, graph(predictor, {"observation": example}, ("action",)), card)
