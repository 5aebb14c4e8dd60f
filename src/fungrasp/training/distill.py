"""Distillation: a student imitates its teacher on episodes that the student plays. Interrupted distillations
continue."""

from __future__ import annotations

import json
import logging
import shutil
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch.utils.tensorboard import SummaryWriter

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import digest
from fungrasp.core.provenance import git_revision, machine
from fungrasp.core.records import record_from_json, record_to_json
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel, load_object
from fungrasp.policies.checkpoint.card import Budget, TrainingData
from fungrasp.policies.checkpoint.checkpoint_file import hand_digest
from fungrasp.sim2real.joint_dynamics import identified_hand
from fungrasp.training.environment import HISTORY, Step, TrainingEnvironment
from fungrasp.training.export import export_policy, make_card
from fungrasp.training.folder import (
    RunFolder,
    check_environment,
    environment_state,
    read_checkpoint,
    restore_environment,
    write_checkpoint,
)
from fungrasp.training.imitation import imitated_round, learn_imitation
from fungrasp.training.networks import make_student
from fungrasp.training.ppo import Trainer
from fungrasp.training.settings import DistillSettings, StudentSpec, TrainSpec
from fungrasp.training.train import EXPLORING, PLANNED_FROM, PLANS, checkpoint_digest
from fungrasp.training.training_sets import PlanLibrary, kept_library

_log = logging.getLogger(__name__)

STUDENT = "student.onnx"

CHECKPOINT_ROUNDS = 10
"""Rounds between two checkpoints."""

LARGEST_GRADIENT = 1.0
"""Largest norm of the gradient of all weights; larger ones are scaled down."""

ROUNDS = "rounds"
"""Folder of the replayed episodes, beside the checkpoint."""

TRAINED_BY = ("seed", "variety", "environment", "ppo")
"""Fields of a teacher's ``TrainSpec`` that a student needs."""


@dataclass(frozen=True)
class DistillProgress:
    """Progress of a distillation."""

    steps: int
    """Control steps so far."""
    seconds: float
    """Duration of the training so far [s]."""
    success: float
    """Success rate of the last episodes, 0 to 1."""
    imitation: float
    """Loss L_act: mean squared difference from the teacher's actions."""
    reconstruction: float
    """Loss L_re of the estimated contacts."""


@dataclass(frozen=True, eq=False)
class TeacherRun:
    """A teacher's training, read from its folder."""

    folder: RunFolder
    """The training's folder."""
    hand: Hand
    """The robot hand."""
    spec: TrainSpec
    """Settings of the teacher's training; only the fields ``TRAINED_BY`` are read."""
    objects: Mapping[str, ObjectModel]
    """Objects of the plans, by name."""
    library: PlanLibrary
    """Training plans."""
    data: tuple[TrainingData, ...]
    """Training data."""
    licence: str
    """License of the teacher's policy."""
    plans: str
    """``SEARCH`` if students follow the best of many plans; "" if they follow one plan per grasp."""
    shrink: float
    """Factor on the corrections of the teacher and its students."""

    def environment(self, seed: int, history: bool, threads: int = 0) -> TrainingEnvironment:
        """Return an environment like that of the training. history: whether observations include a student's
        history."""
        given = self.spec.environment
        settings = replace(given, history=history, residual=given.residual.shrunk(self.shrink))
        return TrainingEnvironment(self.library, self.objects, self.hand, settings, seed, threads)


def read_teacher(folder: Path, objects: Path | None = None) -> TeacherRun:
    """Read the training of a teacher.

    Args:
        objects: folder of meshes; the folder used in training if None.

    Raises:
        FungraspError: the folder has no training, its plans are missing, or its hand or objects have changed.
    """
    run = RunFolder(folder)
    config = run.read_config()
    wanted = config["settings"]
    try:
        if config["kind"] != "teacher":
            raise FungraspError(f"{folder} holds a {config['kind']}, not a teacher")
        told = {name: wanted[name] for name in TRAINED_BY}
        spec = record_from_json(TrainSpec, told | {"steps": config["steps"]}, str(run.config))
        if any(record_to_json(getattr(spec, name)) != told[name] for name in TRAINED_BY):
            raise KeyError("a setting is missing")
        hand = load_hand(config["hand"])
        if hand_digest(hand) != wanted["hand_sha256"]:
            raise FungraspError(f"the hand '{hand.name}' has changed since {folder} was trained")
        identified = config["hand_dynamics"]
        if identified is not None:
            hand = _identified(hand, Path(identified), wanted.get("hand_dynamics_sha256"), folder)
        things: dict[str, ObjectModel] = {}
        for one, place in zip(wanted["sets"], config["object_folders"], strict=True):
            things |= _objects(one["objects"], None if place is None else objects or Path(place), folder)
        data = tuple(TrainingData(one["name"], one["terms"], one["count"]) for one in wanted["sets"])
        planned_from = {name: wanted[name] for name in PLANNED_FROM if name in wanted}
        plan_file = Path(config["plan_file"])
        licence, plans, shrink = config["licence"], config["plans"], float(config["shrink"])
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, FungraspError):
            raise
        raise FungraspError(f"{run.config} is damaged, or of another version of fungrasp") from error
    here = folder / PLANS
    key = digest(__version__, json.dumps(planned_from))
    library = kept_library(here if here.is_file() else plan_file, key, lambda: _lost(folder))
    return TeacherRun(run, hand, spec, things, library, data, licence, plans, shrink)


def train_student(
    teacher_folder: str | Path,
    folder: str | Path,
    spec: StudentSpec | None = None,
    *,
    progress: Callable[[DistillProgress], None] = lambda p: None,
) -> Path:
    """Distill a student, or continue a distillation.

    Returns:
        The student's file, ``student.onnx`` in the folder.

    Raises:
        FungraspError: the teacher is missing or sees no contacts, the folder is of another training, a
            checkpoint is damaged, or a file can't be written.
    """
    spec, folder = StudentSpec.given(spec), Path(folder)
    steps, seed = int(spec.steps), spec.seed
    teacher_folder = Path(teacher_folder)
    teacher = read_teacher(teacher_folder, spec.objects)
    if teacher.spec.ppo.sees != "contacts":
        raise FungraspError(
            f"{teacher_folder} holds a policy that sees {teacher.spec.ppo.sees}; "
            "a student needs a teacher that sees contacts"
        )
    weights = checkpoint_digest(teacher_folder)
    run = RunFolder(folder)
    run.claim(
        {"teacher_sha256": weights, "hand": teacher.hand.name, "seed": seed, "steps": steps}
        | {"distill": asdict(spec.settings)},
        kind="student",
        teacher=str(teacher_folder.absolute()),
    )
    environment = teacher.environment(seed, history=True, threads=spec.threads)
    trainer = Trainer(environment, teacher.spec.ppo, seed)
    trainer.load(teacher.folder.checkpoint)
    # The teacher's checkpoint also restores random states, including the generator of the sensors.
    environment.rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
    with SummaryWriter(str(folder)) as events:

        def report(p: DistillProgress) -> None:
            numbers = asdict(p)
            run.forget_progress_after(p.steps - 1)
            run.add_progress(numbers)
            for name, value in numbers.items():
                events.add_scalar(name, value, p.steps)
            progress(p)

        done = Distillation(trainer.actor, environment, steps, spec.settings, seed)
        done.learn(run.checkpoint, report)
    card = make_card(
        folder.absolute().name,
        "student",
        teacher.hand,
        environment.student_layout,
        (),
        environment.settings.residual,
        Budget(trainer.steps + done.steps, trainer.seconds + done.seconds, machine()),
        layout_name=environment.settings.layout,
        training_data=teacher.data,
        git_revision=git_revision(),
        seed=seed,
        measured={EXPLORING: {"success": done.success}},
        licence=teacher.licence,
        plans=teacher.plans,
    )
    export_policy(done.student, folder / STUDENT, card)
    return folder / STUDENT


class Distillation:
    """A student that learns from its teacher."""

    def __init__(
        self,
        teacher: MLPModel,
        environment: TrainingEnvironment,
        steps: int,
        settings: DistillSettings,
        seed: int,
    ):
        """
        Args:
            steps: control steps of all worlds together.
        """
        s = self._settings = settings
        self._teacher, self._environment = teacher, environment
        torch.manual_seed(seed)
        linear = [module for module in teacher.mlp.modules() if isinstance(module, torch.nn.Linear)]
        hidden = tuple(layer.out_features for layer in linear[:-1])
        self.student = make_student(environment, hidden, s.estimates_contacts)
        self.student.take_over(teacher)
        teacher.eval()
        self.student.eval()
        self._optimizer = torch.optim.Adam(self.student.parameters(), lr=s.learning_rate)
        self._round = s.steps * environment.settings.worlds
        """Control steps per round."""
        self._wanted = max(1, round(steps / self._round))
        lowest = 0.1 * s.learning_rate
        self._schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self._optimizer, self._wanted, lowest)
        self._kept: deque[TensorDict] = deque(maxlen=s.kept_rounds)
        self._recent: deque[bool] = deque(maxlen=1000)
        self._rounds = 0
        self.seconds = 0.0
        """Duration of the rounds so far [s]."""

    @property
    def steps(self) -> int:
        """Control steps so far."""
        return self._rounds * self._round

    @property
    def success(self) -> float:
        """Success rate of the last episodes; 0 before the first has ended."""
        return float(np.mean(self._recent)) if self._recent else 0.0

    def learn(self, checkpoint: Path, progress: Callable[[DistillProgress], None]) -> None:
        """Learn until the end.

        Args:
            checkpoint: file of the state, written atomically; if it exists, the training continues.

        Raises:
            FungraspError: the checkpoint is damaged, of another training, or can't be written.
        """
        s, folder = self._settings, checkpoint.with_name(ROUNDS)
        if checkpoint.exists():
            self._load(checkpoint)
            if self._rounds < self._wanted:
                first = max(0, self._rounds - s.kept_rounds)
                self._kept.extend(read_rounds(folder, range(first, self._rounds)))
        start = perf_counter() - self.seconds
        while self._rounds < self._wanted:
            batch, begun = self._played()
            self._kept.append(batch)
            write_round(folder / f"{self._rounds:06d}.pt", batch, begun)
            losses = learn_imitation(self.student, self._optimizer, self._kept, s, LARGEST_GRADIENT)
            self._schedule.step()
            self._rounds, self.seconds = self._rounds + 1, perf_counter() - start
            progress(DistillProgress(self.steps, self.seconds, self.success, *losses))
            if self._rounds % CHECKPOINT_ROUNDS == 0 or self._rounds == self._wanted:
                self._save(checkpoint)
                for path in sorted(folder.glob("*.pt"))[: -s.kept_rounds]:
                    path.unlink(missing_ok=True)
                # Restart as a continued distillation does, so that interruptions do not change the result.
                self._environment.restart()
        shutil.rmtree(folder, ignore_errors=True)

    def _played(self) -> tuple[TensorDict, torch.Tensor]:
        """Play a round. Return its steps, shape [S W], and whether each episode was new, shape [S, W]
        bool."""
        environment, s = self._environment, self._settings
        actor = self._teacher if self._rounds < s.teacher_rounds else self.student
        begun = [torch.zeros(environment.settings.worlds, dtype=torch.bool)]

        def choose(observations: TensorDict) -> tuple[torch.Tensor, torch.Tensor]:
            wanted = self._teacher(observations)
            return wanted if actor is self._teacher else actor(observations), wanted

        def done(step: Step) -> None:
            self._recent.extend(environment.ended.success.tolist())
            begun.append(torch.as_tensor(step.done))

        batch = imitated_round(environment, s.steps, s.noise, choose, done)
        return batch, torch.stack(begun[:-1])

    def _parts(self) -> dict[str, Any]:
        """Return the parts whose states are in a checkpoint, by name."""
        return {"student": self.student, "optimizer": self._optimizer, "schedule": self._schedule}

    def _save(self, path: Path) -> None:
        """Save everything except the replayed episodes (see ``write_round``)."""
        state = {name: part.state_dict() for name, part in self._parts().items()}
        state |= {"rounds": self._rounds, "seconds": self.seconds, "recent": torch.tensor(list(self._recent))}
        write_checkpoint(path, state | environment_state(self._environment))

    def _load(self, path: Path) -> None:
        state = read_checkpoint(path)
        check_environment(path, state, self._environment)
        try:
            for name, part in self._parts().items():
                part.load_state_dict(state[name])
            restore_environment(state, self._environment)
            self._rounds, self.seconds = int(state["rounds"]), float(state["seconds"])
            self._recent.extend(state["recent"].bool().tolist())
        except (RuntimeError, ValueError, KeyError) as error:
            words = " ".join(str(error).split())
            raise FungraspError(f"the checkpoint {path} is not of this distillation: {words}") from error


def write_round(path: Path, batch: TensorDict, begun: torch.Tensor) -> None:
    """Write the episodes of a round to a file, so that an interrupted distillation can continue. Histories,
    which are ten times as large as the rest, are reduced to the data needed to rebuild them.

    Args:
        batch: S control steps of W worlds, shape [S W].
        begun: whether each episode was new, shape [S, W] bool.

    Raises:
        FungraspError: the file can't be written.
        FungraspError: the file can't be written.
    """
    parts = {name: batch[name] for name in ("robot", "privileged", "action")}
    window = batch["history"].unflatten(0, begun.shape).unflatten(2, (HISTORY, -1))
    write_checkpoint(
        path, parts | {"begun": begun, "first": window[0].clone(), "seen": window[:, :, -1].clone()}
    )


def read_rounds(folder: Path, numbers: range) -> list[TensorDict]:
    """Read the existing rounds.

    Raises:
        FungraspError: a file is damaged.
    """
    found = []
    for path in (folder / f"{number:06d}.pt" for number in numbers):
        if not path.is_file():
            _log.warning("%s is missing: going on without these episodes", path)
            continue
        state = read_checkpoint(path)
        windows = [state.pop("first")]
        for last, new in zip(state.pop("seen")[1:], state.pop("begun")[1:], strict=True):
            window = torch.where(new[:, None, None], 0.0, windows[-1])
            windows.append(torch.cat([window[:, 1:], last[:, None]], dim=1))
        # Files of earlier versions have separate axes for steps and worlds.
        groups = {name: values.reshape(-1, values.shape[-1]) for name, values in state.items()}
        groups["history"] = torch.stack(windows).flatten(2).flatten(0, 1)
        found.append(TensorDict(groups, batch_size=[len(groups["robot"])]))
    return found


def _identified(hand: Hand, path: Path, sha256: str | None, folder: Path) -> Hand:
    found = identified_hand(hand, path)
    if digest(path.read_bytes()) != sha256:
        raise FungraspError(f"the hand dynamics {path} have changed since {folder} was trained")
    return found


def _lost(folder: Path) -> PlanLibrary:
    raise FungraspError(f"the plans of {folder} are lost or damaged: run fungrasp train on it again")


def _objects(digests: Mapping[str, str], place: Path | None, folder: Path) -> dict[str, ObjectModel]:
    """Load objects by name, and check that they have not changed."""
    # The mass is set in each episode.
    things = {name: load_object(name, 1.0, place) for name in digests}
    for name, obj in things.items():
        if obj.mesh_digest != digests[name]:
            raise FungraspError(f"the object '{name}' is not the one that {folder} was trained on")
    return things
