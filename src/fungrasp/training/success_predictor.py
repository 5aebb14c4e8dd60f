"""The success predictor: learns from many tried plans which of a grasp's variations will hold."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch

from fungrasp.errors import FungraspError
from fungrasp.files import atomic_path, digest
from fungrasp.formats.json_file import parse_json
from fungrasp.formats.numpy_files import read_npz
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner
from fungrasp.planning.selection.success_predictor import plan_features
from fungrasp.planning.selection.variations import VariationSpread, vary, with_settings
from fungrasp.policies import OpenLoopPolicy
from fungrasp.policies.checkpoint.checkpoint_file import hand_digest
from fungrasp.simulation import Scene, SceneSettings, build_scene
from fungrasp.task import GraspPlan, LiftEnvironment, LiftProtocol, play
from fungrasp.task.features import flatten, layout
from fungrasp.training.settings import PredictorSettings
from fungrasp.version import __version__

Layout = tuple[tuple[str, int], ...]
"""Names and sizes of the parts of a flat vector."""


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


def try_plans(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    settings: PredictorSettings | None = None,
    seed: int = 0,
    threads: int = 0,
    progress: Callable[[int], None] = lambda done: None,
    keep: Path | None = None,
) -> tuple[PlanOutcomes, Layout]:
    """Plan variations of grasps and try each once in physics, open loop.

    Args:
        grasps: of ``hand``.
        objects: by name.
        hand: the robot hand.
        settings: the defaults if None.
        seed: of the variations.
        threads: 0 means all processors.
        progress: called with the number of episodes done.
        keep: folder in which outcomes are kept as they come; those that an interrupted call has left there
            are not tried again.

    Returns:
        The outcomes, and the layout of their features.

    Raises:
        FungraspError: the folder can't be written to.
    """
    s = settings or PredictorSettings()
    scene = build_scene(hand, objects, SceneSettings(timestep=s.timestep))
    grasp = np.tile(np.arange(len(grasps)), s.attempts)
    attempt = np.repeat(np.arange(s.attempts), len(grasps))
    start = with_settings(grasps)
    key = _key(start, objects, hand, s, seed)
    parts, names = [], ()
    for first in range(0, len(grasp), s.chunk):
        rows = slice(first, first + s.chunk)
        path = None if keep is None else keep / f"episodes-{first:06d}.npz"
        kept = None if path is None else _kept(path, key)
        if kept is None:
            varied = vary(
                start.select(grasp[rows]), hand, grasp[rows], attempt[rows], seed, VariationSpread()
            )
            plans, success, ratio = _try(varied, objects, scene, s, threads)
            features = plan_features(plans, objects)
            flat = np.nan_to_num(flatten(features)).astype(np.float32)
            kept = PlanOutcomes(flat, grasp[rows], attempt[rows], success, ratio), layout(features)
            if path is not None:
                _keep(path, key, *kept)
        outcomes, names = kept
        parts.append(outcomes)
        progress(first + len(outcomes.success))
    whole = PlanOutcomes(
        *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(PlanOutcomes))
    )
    return whole, names


def _key(
    grasps: RobotGraspSet, objects: Mapping[str, ObjectModel], hand: Hand, s: PredictorSettings, seed: int
) -> str:
    """Digest of all that decides the outcomes, their number aside."""
    names = np.unique(grasps.object_name).tolist()
    return digest(
        __version__,
        {name: getattr(grasps, name) for name in grasps.FIELDS},
        grasps.extra,
        {name: objects[name].digest for name in names},
        hand_digest(hand),
        (s.timestep, s.hold_time, s.early, s.chunk, seed),
    )


def _kept(path: Path, key: str) -> tuple[PlanOutcomes, Layout] | None:
    """Outcomes from a file; None if there is none, it is damaged, or of other episodes."""
    try:
        data = read_npz(path, "kept episodes", largest=LARGEST)
        if str(data["key"]) != key:
            return None
        names = tuple((str(n), int(size)) for n, size in parse_json(str(data["layout"]), str(path)))
        return PlanOutcomes(*(data[f.name] for f in fields(PlanOutcomes))), names
    except (ValueError, KeyError, TypeError):
        return None


def _keep(path: Path, key: str, outcomes: PlanOutcomes, names: Layout) -> None:
    arrays = {f.name: getattr(outcomes, f.name) for f in fields(PlanOutcomes)}
    with atomic_path(path) as part, part.open("wb") as stream:
        np.savez(stream, key=np.array(key), layout=np.array(json.dumps(names)), **arrays)


def _try(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    scene: Scene,
    s: PredictorSettings,
    threads: int,
) -> tuple[GraspPlan, np.ndarray, np.ndarray]:
    """The plans, whether they held, and their contact ratio."""
    protocol = replace(LiftProtocol(), hold_time=s.hold_time)
    environment = LiftEnvironment(scene, len(grasps), protocol=protocol, threads=threads)
    plans = MotionPlanner(scene.hand, objects).plan(grasps, environment.settle(grasps))
    ids = np.arange(len(grasps))
    environment.begin(ids, plans, np.maximum(plans.closing_step - s.early, 0), environment.sample)
    outcomes = play(environment, OpenLoopPolicy(), plans, end_lost=True)
    lost = outcomes.reason == "lost before the hold"
    return plans, outcomes.success, np.where(lost, 0.0, np.nan_to_num(outcomes.contact_ratio))


LARGEST = 1 << 33
"""Bytes of the largest file of outcomes that is read."""


class PredictorNetwork(torch.nn.Module):
    """Mean of several networks' expected success."""

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
                torch.nn.Linear(b, 1),
            )
            for _ in range(s.networks)
        )

    def logits(self, features: torch.Tensor) -> torch.Tensor:
        """Logits of each network, shape [networks, N, 1]. features: shape [N, D]."""
        normal = (features - self.mean) / self.spread
        return torch.stack([network(normal) for network in self.networks])

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Expected success in [0, 1], shape [N, 1]."""
        return torch.sigmoid(self.logits(features)).mean(dim=0)


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
    features, truth = torch.from_numpy(outcomes.features), torch.from_numpy(outcomes.success).float()
    optimizer = torch.optim.AdamW(predictor.parameters(), lr=s.learning_rate, weight_decay=s.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, s.epochs)
    predictor.train()
    for _ in range(s.epochs):
        for rows in torch.randperm(len(truth)).split(s.minibatch):
            logits = predictor.logits(features[rows])[..., 0]
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
        Share that held of the grasps as they are ("first"), of all variations ("mean"), of those chosen
        ("chosen"), and of grasps with any variation that held ("any"); contact ratio of the chosen.
    """
    fold = np.random.default_rng(seed).integers(folds, size=int(outcomes.grasp.max()) + 1)[outcomes.grasp]
    expected = np.zeros(len(fold))
    for k in np.unique(fold):
        predictor = fit_predictor(outcomes.select(np.flatnonzero(fold != k)), settings, seed)
        rows = np.flatnonzero(fold == k)
        with torch.inference_mode():
            expected[rows] = predictor(torch.from_numpy(outcomes.features[rows]))[:, 0].numpy()
    groups = [np.flatnonzero(outcomes.grasp == g) for g in np.unique(outcomes.grasp)]
    chosen = np.array([rows[np.argmax(expected[rows])] for rows in groups])
    return {
        "first": float(outcomes.success[outcomes.attempt == 0].mean()),
        "mean": float(outcomes.success.mean()),
        "chosen": float(outcomes.success[chosen].mean()),
        "any": float(np.mean([outcomes.success[rows].any() for rows in groups])),
        "contact_ratio": float(outcomes.contact_ratio[chosen].mean()),
    }
