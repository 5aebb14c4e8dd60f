"""The function ``train``: from grasps to a policy file. Interrupted trainings continue."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import digest
from fungrasp.core.provenance import git_revision, machine
from fungrasp.hands import Hand, as_hand, hand_files
from fungrasp.policies.checkpoint.card import SEARCH, Budget, PolicyCard, TrainingData
from fungrasp.policies.checkpoint.checkpoint_file import PolicyNetwork, hand_digest
from fungrasp.simulation import BufferSizes, SceneSettings, found_device
from fungrasp.training import check_packages
from fungrasp.training.settings import TrainSpec
from fungrasp.training.training_sets import (
    Trainable,
    TrainingSet,
    as_training_sets,
    joined_objects,
    kept_library,
    planned_sets,
    split_sets,
)

if TYPE_CHECKING:
    from fungrasp.training.ppo import Processes, Progress, Trainer

PLANS = "plans.npz"
HELD_OUT_PLANS = "held-out-plans.npz"
POLICY = "policy.onnx"

EXPLORING = "in training, exploring"
"""Key in a policy's card for the last episodes of its training."""

PLANNED_FROM = ("hand", "hand_sha256", "sets", "variety", "seed", "hand_dynamics_sha256")
"""Settings that the plans depend on."""


def train(
    folder: str | Path,
    sets: Trainable | Sequence[Trainable],
    hand: Hand | str | Path = "allegro",
    spec: TrainSpec | None = None,
    *,
    planning: Callable[[int], None] = lambda done: None,
    progress: Callable[[Progress], None] = lambda p: None,
) -> Path:
    """Train a policy, or continue, until ``spec.steps`` are done in total. With ``torchrun``, each process
    has its own worlds, and the first one writes the files.

    Args:
        sets: one or more sets of robot grasps of ``hand``, or of human grasps, which are retargeted:
            ``TrainingSet`` with the names and terms for the policy's card, or grasps with their objects.
        hand: robot hand, its name, or the path of its TOML file.
        spec: settings; defaults if None. To continue a training, pass the same settings.
        planning: called with the number of finished plans.
        progress: called after each update.

    Returns:
        The policy file, ``policy.onnx`` in the folder, for ``evaluate`` and ``deploy``.

    Raises:
        FungraspError: no grasp is usable, grasps are of another hand, the folder is of another training, a
            checkpoint is damaged, a package is missing, or a file can't be written.
    """
    check_packages()
    from fungrasp.training.ppo import joined

    spec, hand = TrainSpec.given(spec), as_hand(hand)
    sets = as_training_sets(sets, hand, spec.threads)
    # An actor that sees the history needs an environment that keeps it.
    history = spec.ppo.sees == "history"
    spec = replace(spec, environment=replace(spec.environment, history=history))
    device = found_device(spec.device)
    if device != "cpu":
        from fungrasp.simulation.warp_device import open_warp

        open_warp(device)
    with joined(device) as processes:
        if spec.ppo.imitate and processes.count > 1:
            raise FungraspError("ppo.imitate works in one process only: leave out torchrun or ppo.imitate")
        _train(Path(folder), sets, hand, spec, processes, planning, progress)
    return Path(folder) / POLICY


def _train(
    folder: Path,
    sets: Sequence[TrainingSet],
    hand: Hand,
    spec: TrainSpec,
    processes: Processes,
    planning: Callable[[int], None],
    progress: Callable[[Progress], None],
) -> None:
    from torch.utils.tensorboard import SummaryWriter

    from fungrasp.training.environment import TrainingEnvironment
    from fungrasp.training.export import export_policy, policy_graph
    from fungrasp.training.folder import RunFolder
    from fungrasp.training.learning_curve import LearningCurve
    from fungrasp.training.ppo import Trainer

    run, plan_file = RunFolder(folder), spec.plan_file or folder / PLANS
    objects = joined_objects(sets)
    curve = spec.curve
    sets, held_out = split_sets(sets, curve.held_out, curve.seed)
    about = [s.about() for s in sets]
    plans_name = SEARCH if spec.search else ""
    planned_from = {
        "hand": hand.name,
        "hand_sha256": hand_digest(hand),
        "sets": about,
        "variety": asdict(spec.variety),
        "seed": spec.seed,
    }
    if hand.dynamics_path is not None:
        planned_from["hand_dynamics_sha256"] = digest(hand.dynamics_path.read_bytes())
    if not processes.first:
        # The first process plans; the others read its plans.
        processes.wait()
    run.claim(
        planned_from
        | {"initial_sha256": "" if spec.initial is None else checkpoint_digest(spec.initial)}
        | {"environment": asdict(spec.environment), "ppo": asdict(spec.ppo)},
        kind="teacher",
        plans=plans_name,
        shrink=spec.shrink,
        steps=int(spec.steps),
        hand=hand.name if hand.name in hand_files() else str(hand.path.absolute()),
        hand_dynamics=None if hand.dynamics_path is None else str(hand.dynamics_path.absolute()),
        licence=spec.licence,
        plan_file=str(plan_file.absolute()),
        object_folders=[None if s.folder is None else str(s.folder.absolute()) for s in sets],
    )
    library = kept_library(
        plan_file,
        digest(__version__, json.dumps(planned_from)),
        lambda: planned_sets(sets, hand, spec, planning),
    )
    unseen = library
    if held_out:
        # The curve is measured on all held-out grasps, also on those that their plans do not hold.
        unseen_spec = replace(spec, variety=replace(spec.variety, held=False))
        planned_from["variety"] = asdict(unseen_spec.variety)
        planned_from["sets"] = [s.about() for s in held_out]
        before = sum(len(s.grasps) for s in sets) * spec.variety.copies
        unseen = kept_library(
            folder / HELD_OUT_PLANS,
            digest(__version__, json.dumps(planned_from)),
            lambda: planned_sets(held_out, hand, unseen_spec, lambda done: planning(before + done)),
        )
    if processes.first:
        processes.wait()
    seed = spec.seed + processes.number
    buffers = None if spec.buffers is None else BufferSizes(*spec.buffers)
    physics = SceneSettings(device=found_device(spec.device), buffers=buffers)
    environment = TrainingEnvironment(library, objects, hand, spec.environment, seed, spec.threads, physics)
    trainer = Trainer(environment, spec.ppo, spec.seed, processes)
    if run.checkpoint.exists():
        trainer.load(run.checkpoint)
    elif spec.initial is not None:
        trainer.begin_from(RunFolder(spec.initial).checkpoint)
    if not processes.first:
        trainer.learn_until(spec.steps)
        return
    run.forget_progress_after(trainer.steps)

    def card() -> PolicyCard:
        return replace(training_card(folder, trainer, sets, spec), plans=plans_name)

    def network() -> PolicyNetwork:
        now = card()
        return PolicyNetwork(policy_graph(trainer.actor, now), now)

    measured = None
    if curve.every:
        measured = LearningCurve(
            folder, unseen, objects, environment, int(curve.every), curve.seed, spec.threads
        )
        measured.resume(trainer.steps)
    with SummaryWriter(str(folder), purge_step=trainer.steps) as events:

        def report(p: Progress) -> None:
            numbers = flat(p) | {
                "success_of_groups": float(environment.success_of_group.mean()),
                "diverged": environment.diverged,
            }
            run.add_progress(numbers)
            for name, value in numbers.items():
                events.add_scalar(name, value, p.steps)
            if measured is not None:
                measured.update(p.steps, p.seconds, network, p.steps >= spec.steps)
            progress(p)

        trainer.learn_until(spec.steps, report, run.checkpoint)
    export_policy(trainer.actor, folder / POLICY, card())


def checkpoint_digest(folder: Path) -> str:
    """Return the SHA-256 of a training's checkpoint.

    Raises:
        FungraspError: there is no checkpoint.
    """
    from fungrasp.training.folder import RunFolder

    try:
        return hashlib.sha256(RunFolder(folder).checkpoint.read_bytes()).hexdigest()
    except OSError as error:
        raise FungraspError(f"{folder} has no checkpoint yet: train it first") from error


def training_card(folder: Path, trainer: Trainer, sets: Sequence[TrainingSet], spec: TrainSpec) -> PolicyCard:
    """Return the card of a trained policy."""
    from fungrasp.training.export import make_card

    environment = trainer.environment
    teacher = trainer.settings.sees == "contacts"
    return make_card(
        folder.absolute().name,
        "teacher" if teacher else "student",
        environment.hand,
        environment.student_layout if trainer.settings.sees == "history" else environment.layout,
        environment.privileged_layout if teacher else (),
        spec.environment.residual.shrunk(spec.shrink),
        Budget(trainer.steps, trainer.seconds, machine()),
        layout_name=environment.settings.layout,
        training_data=tuple(TrainingData(s.name, s.terms, len(s.grasps)) for s in sets),
        git_revision=git_revision(),
        seed=spec.seed,
        measured={EXPLORING: {"success": trainer.success}},
        licence=spec.licence,
    )


def flat(progress: Progress) -> dict[str, float]:
    """Flatten progress to numbers by name, nested ones as ``table/name``."""
    numbers: dict[str, float] = {}
    for name, value in asdict(progress).items():
        if isinstance(value, dict):
            numbers |= {f"{name}/{key}": number for key, number in value.items()}
        else:
            numbers[name] = value
    return numbers
