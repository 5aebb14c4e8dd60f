"""Training a policy in a folder, from grasps to policy file, with any number of interruptions."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from torch.utils.tensorboard import SummaryWriter

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, digest
from fungrasp.core.provenance import git_revision, machine
from fungrasp.core.version import __version__
from fungrasp.hands import Hand, hand_files
from fungrasp.planning.selection.success_predictor import NetworkPredictor, SuccessPredictor
from fungrasp.policies.checkpoint.card import Budget, PolicyCard, TrainingData
from fungrasp.policies.checkpoint.checkpoint_file import SUFFIX, hand_digest, load_policy
from fungrasp.policies.checkpoint.network import PolicyNetwork
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.simulation import BufferSizes, Device
from fungrasp.task import GraspPlan
from fungrasp.training.environment import EnvironmentSettings, TrainingEnvironment
from fungrasp.training.export import export_policy, make_card, policy_graph
from fungrasp.training.folder import RunFolder, kept_library
from fungrasp.training.learning_curve import LearningCurve
from fungrasp.training.plan_library import PlanLibrary, Variety, build_plan_library
from fungrasp.training.ppo import ALONE, Progress, Trainer
from fungrasp.training.processes import Processes
from fungrasp.training.settings import CurveSettings, PpoSettings
from fungrasp.training.training_sets import TrainingSet, joined_objects, split_sets

PLANS = "plans.npz"
HELD_OUT_PLANS = "held-out-plans.npz"
POLICY = "policy.onnx"

EXPLORING = "in training, exploring"
"""Name of what a policy's card says of the last episodes of its training."""

PLANNED_FROM = ("hand", "hand_sha256", "sets", "variety", "seed", "plans_sha256", "hand_dynamics_sha256")
"""Settings that the plans depend on."""


@dataclass(frozen=True)
class RunSettings:
    """Settings of a teacher's training."""

    seed: int = 0
    """Seed of all random numbers."""
    variety: Variety = field(default_factory=Variety)
    """How the grasps are varied."""
    environment: EnvironmentSettings = field(default_factory=EnvironmentSettings)
    """How the worlds run."""
    ppo: PpoSettings = field(default_factory=PpoSettings)
    """How the networks learn."""


def train(
    folder: Path,
    sets: Sequence[TrainingSet],
    hand: Hand,
    settings: RunSettings,
    steps: int,
    *,
    licence: str = "",
    threads: int = 0,
    device: Device = "cpu",
    buffers: BufferSizes | None = None,
    plans: Path | None = None,
    initial: Path | None = None,
    shrink: float = 1.0,
    plan_file: Path | None = None,
    curve: CurveSettings | None = None,
    processes: Processes = ALONE,
    planning: Callable[[int], None] = lambda done: None,
    progress: Callable[[Progress], None] = lambda p: None,
) -> PolicyCard:
    """Train a policy, or go on training it, until ``steps`` have been made in all; its file is
    ``policy.onnx``.

    Args:
        folder: of the training.
        sets: of grasps of ``hand``, at least one.
        hand: the robot hand.
        settings: those that the folder was begun with, if it was.
        steps: control steps of all worlds together, earlier calls included.
        licence: of the policy, for its card.
        threads: 0 means all processors. The result does not depend on it.
        device: where the worlds that it learns in are simulated.
        buffers: room for contacts on a GPU; found by a probe if None.
        plans: file of a success predictor that chooses the plans to follow, in training and at work; a copy
            of it is kept beside the policy. The grasps' own plans if None.
        initial: folder of a training whose networks this one begins with; fresh ones if None.
        shrink: factor on the finished policy's corrections, and on those of its students. A policy that has
            seen little is right about their direction more often than about their size.
        plan_file: file of the plans to train on; one in the folder if None.
        curve: of the learning curve, ``curve.csv`` and ``curve.svg``; none if None.
        processes: that learn together, each in as many worlds; the first one writes the files.
        planning: called with the number of plans that are made.
        progress: called after each update.

    Returns:
        The policy's card.

    Raises:
        FungraspError: no usable grasp, a folder of another training, a damaged checkpoint, or a file that
            can't be written.
    """
    run = RunFolder(folder)
    settings = consistent(settings)
    if steps < settings.ppo.imitate:
        raise FungraspError(
            f"{settings.ppo.imitate:g} control steps of imitation do not fit into a training of {steps:g}"
        )
    if settings.ppo.imitate and processes.count > 1:
        raise FungraspError("motions are imitated by one process: leave torchrun or --ppo.imitate out")
    residual = settings.environment.residual.shrunk(shrink)
    objects = joined_objects(sets)
    curve = curve or CurveSettings(every=0)
    sets, held_out = split_sets(sets, curve.held_out, curve.seed)
    about = [s.about() for s in sets]
    predictor = None if plans is None else NetworkPredictor(load_policy(plans), hand, objects)
    planned_from = {
        "hand": hand.name,
        "hand_sha256": hand_digest(hand),
        "sets": about,
        "variety": asdict(settings.variety),
        "seed": settings.seed,
        "plans_sha256": "" if predictor is None else predictor.digest,
    }
    if hand.dynamics_path is not None:
        planned_from["hand_dynamics_sha256"] = digest(hand.dynamics_path.read_bytes())
    if not processes.first:
        # The first one plans, the others read.
        processes.wait()
    run.claim(
        planned_from
        | {"initial_sha256": "" if initial is None else checkpoint_digest(initial)}
        | {"environment": asdict(settings.environment), "ppo": asdict(settings.ppo)},
        kind="teacher",
        plans="" if plans is None else plans.stem,
        shrink=shrink,
        steps=steps,
        hand=hand.name if hand.name in hand_files() else str(hand.path.absolute()),
        hand_dynamics=None if hand.dynamics_path is None else str(hand.dynamics_path.absolute()),
        licence=licence,
        plan_file=str((plan_file or folder / PLANS).absolute()),
        object_folders=[None if s.folder is None else str(s.folder.absolute()) for s in sets],
    )
    library = kept_library(
        plan_file or folder / PLANS,
        digest(__version__, json.dumps(planned_from)),
        lambda: plan_library(sets, hand, settings, threads, planning, predictor),
    )
    unseen = library
    if held_out:
        planned_from["sets"] = [s.about() for s in held_out]
        before = sum(len(s.grasps) for s in sets) * settings.variety.planned(predictor is not None)
        unseen = kept_library(
            folder / HELD_OUT_PLANS,
            digest(__version__, json.dumps(planned_from)),
            lambda: plan_library(
                held_out, hand, settings, threads, lambda done: planning(before + done), predictor
            ),
        )
    if plans is not None:
        keep_beside(folder, plans)
    if processes.first:
        processes.wait()
    seed = settings.seed + processes.number
    environment = TrainingEnvironment(
        library, objects, hand, settings.environment, seed, threads, device, buffers
    )
    trainer = Trainer(environment, settings.ppo, settings.seed, processes)
    if run.checkpoint.exists():
        trainer.load(run.checkpoint)
    elif initial is not None:
        trainer.begin_from(RunFolder(initial).checkpoint)
    if not processes.first:
        trainer.learn(steps)
        return training_card(folder, trainer, sets, residual, settings.seed, licence)
    run.forget_progress_after(trainer.steps)

    def card() -> PolicyCard:
        made = training_card(folder, trainer, sets, residual, settings.seed, licence)
        return replace(made, plans="" if plans is None else plans.stem)

    def network() -> PolicyNetwork:
        now = card()
        return PolicyNetwork(policy_graph(trainer.actor, now), now)

    measured = None
    if curve.every:
        measured = LearningCurve(folder, unseen, objects, environment, int(curve.every), curve.seed, threads)
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
                measured.update(p.steps, p.seconds, network, p.steps >= steps)
            progress(p)

        trainer.learn(steps, report, run.checkpoint)
    finished = card()
    export_policy(trainer.actor, folder / POLICY, finished)
    return finished


def checkpoint_digest(folder: Path) -> str:
    """SHA-256 of the checkpoint of a training.

    Raises:
        FungraspError: there is none.
    """
    try:
        return hashlib.sha256(RunFolder(folder).checkpoint.read_bytes()).hexdigest()
    except OSError as error:
        raise FungraspError(f"{folder} has no checkpoint yet: train it first") from error


def consistent(settings: RunSettings) -> RunSettings:
    """An actor that sees the history needs an environment that keeps it.

    Raises:
        FungraspError: impossible settings of the worlds, or actions that change planned motions, which are to
            be imitated.
    """
    settings.environment.check()
    if settings.ppo.imitate and settings.environment.residual.base == "plan":
        raise FungraspError(
            "actions that change planned motions follow them from the first step: to imitate them, give "
            "--environment.residual.base guided"
        )
    history = settings.ppo.sees == "history"
    return replace(settings, environment=replace(settings.environment, history=history))


def keep_beside(folder: Path, predictor: Path) -> None:
    """Copy a success predictor's file into the folder of a policy that follows its plans.

    Raises:
        FungraspError: it can't be written.
    """
    copy = folder / (predictor.stem + SUFFIX)
    if copy.resolve() != predictor.resolve():
        with atomic_path(copy) as part:
            part.write_bytes(predictor.read_bytes())


def plan_library(
    sets: Sequence[TrainingSet],
    hand: Hand,
    settings: RunSettings,
    threads: int = 0,
    progress: Callable[[int], None] = lambda done: None,
    predictor: SuccessPredictor | None = None,
) -> PlanLibrary:
    """The plans of several sets, each grasp a group of its own.

    Raises:
        FungraspError: a set without any usable grasp; the message names it.
    """
    parts: list[PlanLibrary] = []
    groups = done = 0
    for number, one in enumerate(sets):
        try:
            part = build_plan_library(
                one.grasps,
                one.objects,
                hand,
                settings.variety,
                settings.seed + number,
                threads,
                lambda count, before=done: progress(before + count),
                predictor,
            )
        except FungraspError as error:
            raise FungraspError(f"{one.name}: {error}") from error
        parts.append(PlanLibrary(part.plans, part.group + groups))
        groups += len(one.grasps)
        done += len(one.grasps) * settings.variety.planned(predictor is not None)
    return PlanLibrary(
        GraspPlan.join([part.plans for part in parts]), np.concatenate([part.group for part in parts])
    )


def training_card(
    folder: Path,
    trainer: Trainer,
    sets: Sequence[TrainingSet],
    residual: ResidualSettings,
    seed: int,
    licence: str = "",
) -> PolicyCard:
    """What a trained policy's file should say about it."""
    environment = trainer.environment
    teacher = trainer.settings.sees == "contacts"
    return make_card(
        folder.absolute().name,
        "teacher" if teacher else "student",
        environment.hand,
        environment.student_layout if trainer.settings.sees == "history" else environment.layout,
        environment.privileged_layout if teacher else (),
        residual,
        1 / environment.protocol.control_period,
        Budget(trainer.steps, trainer.seconds, machine()),
        layout_name=environment.settings.layout,
        training_data=tuple(TrainingData(s.name, s.terms, len(s.grasps)) for s in sets),
        git_revision=git_revision(),
        seed=seed,
        measured={EXPLORING: {"success": trainer.success}},
        licence=licence,
    )


def flat(progress: Progress) -> dict[str, float]:
    """Its numbers by name, those of a table as ``table/name``."""
    numbers: dict[str, float] = {}
    for name, value in asdict(progress).items():
        if isinstance(value, dict):
            numbers |= {f"{name}/{key}": number for key, number in value.items()}
        else:
            numbers[name] = value
    return numbers
