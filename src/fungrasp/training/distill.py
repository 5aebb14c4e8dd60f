"""Distillation: the student imitates its teacher on episodes that it plays itself."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict

from fungrasp.core.errors import FungraspError
from fungrasp.training.checkpoint import (
    check_environment,
    environment_state,
    read_checkpoint,
    restore_environment,
    write_checkpoint,
)
from fungrasp.training.environment import TrainingEnvironment
from fungrasp.training.kept_rounds import KeptRounds, Round
from fungrasp.training.networks import played, tensors
from fungrasp.training.settings import HIDDEN, DistillSettings
from fungrasp.training.student import StudentModel

CHECKPOINT_ROUNDS = 10
"""Rounds between two checkpoints."""

ROUNDS = "rounds"
"""Folder beside the checkpoint with the episodes that are learned from."""


@dataclass(frozen=True)
class DistillProgress:
    """Where a distillation stands."""

    steps: int
    """Control steps so far."""
    seconds: float
    """Time that the training has taken so far [s]."""
    success: float
    """Share of the last episodes that succeeded, 0 to 1."""
    imitation: float
    """Loss L_act: squared difference from the teacher's actions."""
    reconstruction: float
    """Loss L_re of the inferred contacts."""


def make_student(
    environment: TrainingEnvironment, hidden: tuple[int, ...] = HIDDEN, estimates: bool = True
) -> StudentModel:
    """An untrained student for an environment that keeps a history.

    Args:
        environment: whose observations it sees.
        hidden: units of its hidden layers.
        estimates: whether it infers the contacts.
    """
    observations = tensors(environment.observations)
    return StudentModel(
        observations,
        {},
        "actor",
        environment.actions,
        layout=environment.student_layout,
        encoder=environment.encoder_layout,
        estimates=estimates,
        hidden_dims=list(hidden),
        activation="elu",
        obs_normalization=True,
    )


def distill(
    teacher: MLPModel,
    environment: TrainingEnvironment,
    steps: int,
    settings: DistillSettings | None = None,
    seed: int = 0,
    progress: Callable[[DistillProgress], None] = lambda p: None,
    checkpoint: Path | None = None,
    student: StudentModel | None = None,
) -> Distillation:
    """Train a student.

    Args:
        teacher: whose actions are imitated.
        environment: that keeps a history.
        steps: control steps of all worlds together.
        settings: the defaults if None.
        seed: of networks and noise.
        progress: called after each round.
        checkpoint: where the state is kept, written atomically; if it is there, the training goes on.
        student: to go on with; a new one that takes over the teacher's network if None.

    Raises:
        FungraspError: the checkpoint is damaged or of another training, or can't be written.
    """
    s = settings or DistillSettings()
    torch.manual_seed(seed)
    if student is None:
        hidden = tuple(layer.out_features for layer in _linear(teacher)[:-1])
        student = make_student(environment, hidden, s.estimates_contacts)
        student.take_over(teacher)
    teacher.eval()
    student.eval()
    optimizer = torch.optim.Adam(student.parameters(), lr=s.learning_rate)
    rounds = max(1, round(steps / (s.steps * environment.settings.worlds)))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, rounds, 0.1 * s.learning_rate)
    kept = KeptRounds(s.kept_rounds, None if checkpoint is None else checkpoint.with_name(ROUNDS))
    recent: deque[bool] = deque(maxlen=1000)
    state = Distillation(student, optimizer, schedule, environment, recent)
    if checkpoint is not None and checkpoint.exists():
        state.load(checkpoint)
        if state.rounds < rounds:
            kept.load(state.rounds)
    start = perf_counter() - state.seconds
    for index in range(state.rounds, rounds):
        actor = teacher if index < s.teacher_rounds else student
        kept.add(index, _collect(actor, teacher, environment, s, recent))
        imitation, reconstruction = _learn(student, optimizer, list(kept.batches), s)
        schedule.step()
        state.rounds, state.seconds = index + 1, perf_counter() - start
        progress(
            DistillProgress(
                (index + 1) * s.steps * environment.settings.worlds,
                state.seconds,
                state.success,
                imitation,
                reconstruction,
            )
        )
        if index % CHECKPOINT_ROUNDS == CHECKPOINT_ROUNDS - 1 or index == rounds - 1:
            if checkpoint is not None:
                state.save(checkpoint)
                kept.forget_before(state.rounds - s.kept_rounds)
            # As a distillation that goes on from here does: it ends as one that was never interrupted.
            environment.restart()
    kept.remove()
    return state


@dataclass
class Distillation:
    """Where a distillation stands, with all it needs to go on."""

    student: StudentModel
    """The network that learns."""
    optimizer: torch.optim.Optimizer
    """Optimizer of its weights."""
    schedule: torch.optim.lr_scheduler.LRScheduler
    """Schedule of its learning rate, one step per round."""
    environment: TrainingEnvironment
    """The worlds whose episodes are learned from."""
    recent: deque[bool]
    """Whether the last episodes succeeded."""
    rounds: int = 0
    """Rounds of learning so far."""
    seconds: float = 0.0
    """Time of the rounds so far [s]."""

    @property
    def success(self) -> float:
        """Share of the last episodes that succeeded; 0 before any has ended."""
        return float(np.mean(self.recent)) if self.recent else 0.0

    def save(self, path: Path) -> None:
        """Keep everything but the episodes that are learned from (see ``KeptRounds``).

        Raises:
            FungraspError: the file can't be written.
        """
        parts = {name: getattr(self, name).state_dict() for name in ("student", "optimizer", "schedule")}
        counts = {"rounds": self.rounds, "seconds": self.seconds, "recent": torch.tensor(list(self.recent))}
        write_checkpoint(path, parts | counts | environment_state(self.environment))

    def load(self, path: Path) -> None:
        """Go on from what was kept.

        Raises:
            FungraspError: it can't be read, is damaged, or belongs to another distillation.
        """
        state = read_checkpoint(path)
        check_environment(path, state, self.environment)
        try:
            for name in ("student", "optimizer", "schedule"):
                getattr(self, name).load_state_dict(state[name])
            restore_environment(state, self.environment)
            self.rounds, self.seconds = int(state["rounds"]), float(state["seconds"])
            self.recent.extend(state["recent"].bool().tolist())
        except (RuntimeError, ValueError, KeyError) as error:
            words = " ".join(str(error).split())
            raise FungraspError(f"the checkpoint {path} is not of this distillation: {words}") from error


def _collect(
    actor: MLPModel,
    teacher: MLPModel,
    environment: TrainingEnvironment,
    s: DistillSettings,
    recent: deque[bool],
) -> Round:
    """Let one act, and ask the teacher what it would have done."""
    batches, begun = [], [torch.zeros(environment.settings.worlds, dtype=torch.bool)]
    with torch.no_grad():
        for _ in range(s.steps):
            observations = tensors(environment.observations)
            wanted = teacher(observations)
            action = wanted if actor is teacher else actor(observations)
            batches.append(observations.exclude("value").clone().update({"action": wanted}))
            noisy = action + s.noise * torch.randn_like(action)
            step = environment.step(played(environment, noisy))
            recent.extend(environment.ended.success.tolist())
            begun.append(torch.as_tensor(step.done))
    return Round(torch.cat(batches), torch.stack(begun[:-1]))  # type: ignore[arg-type]


def _learn(
    student: StudentModel, optimizer: torch.optim.Optimizer, kept: list[TensorDict], s: DistillSettings
) -> tuple[float, float]:
    """Mean losses."""
    losses = np.zeros(2)
    for _ in range(s.updates):
        part = kept[int(torch.randint(len(kept), ()))]
        batch = part[torch.randint(len(part), (s.minibatch,))].clone()
        imitation = ((student(batch) - batch["action"]) ** 2).mean()
        reconstruction = student.reconstruction_loss(batch)
        optimizer.zero_grad()
        (imitation + s.reconstruction * reconstruction).backward()
        torch.nn.utils.clip_grad_norm_(student.parameters(), 1.0)
        optimizer.step()
        losses += [float(imitation.detach()), float(reconstruction.detach())]
    imitation_loss, reconstruction_loss = losses / s.updates
    return float(imitation_loss), float(reconstruction_loss)


def _linear(model: MLPModel) -> list[torch.nn.Linear]:
    return [m for m in model.mlp.modules() if isinstance(m, torch.nn.Linear)]
