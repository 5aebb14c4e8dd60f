"""Distilling a student in a folder, from the folder of its teacher, with any number of interruptions."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
from torch.utils.tensorboard import SummaryWriter

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import digest
from fungrasp.core.provenance import git_revision, machine
from fungrasp.core.records import record_from_json, record_to_json
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel, load_object
from fungrasp.policies.checkpoint.card import Budget, PolicyCard, TrainingData
from fungrasp.policies.checkpoint.checkpoint_file import SUFFIX, hand_digest
from fungrasp.sim2real.joint_dynamics import identified_hand
from fungrasp.training.distill import DistillProgress, distill
from fungrasp.training.environment import TrainingEnvironment
from fungrasp.training.export import export_policy, make_card
from fungrasp.training.folder import RunFolder, kept_library
from fungrasp.training.plan_library import PlanLibrary
from fungrasp.training.ppo import Trainer
from fungrasp.training.run import (
    EXPLORING,
    PLANNED_FROM,
    PLANS,
    RunSettings,
    checkpoint_digest,
    keep_beside,
)
from fungrasp.training.settings import DistillSettings

STUDENT = "student.onnx"


@dataclass(frozen=True, eq=False)
class TeacherRun:
    """A teacher's training, as found in its folder."""

    folder: RunFolder
    """The training's folder."""
    hand: Hand
    """The robot hand."""
    settings: RunSettings
    """Settings of the teacher's training."""
    objects: Mapping[str, ObjectModel]
    """Objects of the plans, by name."""
    library: PlanLibrary
    """Plans that it was trained on."""
    data: tuple[TrainingData, ...]
    """What it was trained on."""
    licence: str
    """Licence of the teacher's policy."""
    plans: str
    """Name of the success predictor whose plans it follows, a file beside it; none if empty."""
    shrink: float
    """Factor on its corrections, and on those of its students."""

    def environment(self, seed: int, history: bool, threads: int = 0) -> TrainingEnvironment:
        """Worlds like those that it was trained in. history: whether observations hold a student's."""
        given = self.settings.environment
        settings = replace(given, history=history, residual=given.residual.shrunk(self.shrink))
        return TrainingEnvironment(self.library, self.objects, self.hand, settings, seed, threads)


def read_teacher(folder: Path, objects: Path | None = None) -> TeacherRun:
    """The training in a folder.

    Args:
        folder: that ``train`` made.
        objects: folder of meshes; where they were when it was trained if None.

    Raises:
        FungraspError: no training is there, its plans are lost, or its hand or objects have changed.
    """
    run = RunFolder(folder)
    config = run.read_config()
    wanted = config["settings"]
    try:
        if config["kind"] != "teacher":
            raise FungraspError(f"{folder} holds a {config['kind']}, not a teacher")
        told = {f.name: wanted[f.name] for f in fields(RunSettings)}
        settings = record_from_json(RunSettings, told, str(run.config))
        if record_to_json(settings) != told:
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
    return TeacherRun(run, hand, settings, things, library, data, licence, plans, shrink)


def train_student(
    teacher_folder: Path,
    folder: Path,
    steps: int,
    settings: DistillSettings | None = None,
    seed: int = 0,
    *,
    objects: Path | None = None,
    threads: int = 0,
    progress: Callable[[DistillProgress], None] = lambda p: None,
) -> PolicyCard:
    """Distil a student, or go on distilling it; its file is ``student.onnx``.

    Args:
        teacher_folder: of a teacher that sees contacts.
        folder: of the student.
        steps: control steps of all worlds together.
        settings: the defaults if None.
        seed: of everything random.
        objects: folder of meshes; where they were when the teacher was trained if None.
        threads: 0 means all processors.
        progress: called after each round.

    Returns:
        The student's card.

    Raises:
        FungraspError: no such teacher, a folder of another training, a damaged checkpoint, or a file that
            can't be written.
    """
    s = settings or DistillSettings()
    teacher = read_teacher(teacher_folder, objects)
    if teacher.settings.ppo.sees != "contacts":
        raise FungraspError(
            f"{teacher_folder} holds a policy that sees {teacher.settings.ppo.sees}; "
            "a student needs a teacher that sees contacts"
        )
    weights = checkpoint_digest(teacher_folder)
    run = RunFolder(folder)
    run.claim(
        {"teacher_sha256": weights, "hand": teacher.hand.name, "seed": seed, "steps": steps}
        | {"distill": asdict(s)},
        kind="student",
        teacher=str(teacher_folder.absolute()),
    )
    environment = teacher.environment(seed, history=True, threads=threads)
    trainer = Trainer(environment, teacher.settings.ppo, seed)
    trainer.load(teacher.folder.checkpoint)
    # The teacher's checkpoint holds its random numbers, too; the sensors draw from the same generator.
    environment.rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
    with SummaryWriter(str(folder)) as events:

        def report(p: DistillProgress) -> None:
            numbers = asdict(p)
            run.forget_progress_after(p.steps - 1)
            run.add_progress(numbers)
            for name, value in numbers.items():
                events.add_scalar(name, value, p.steps)
            progress(p)

        done = distill(trainer.actor, environment, steps, s, seed, report, run.checkpoint)
    played = done.rounds * s.steps * environment.settings.worlds
    card = make_card(
        folder.absolute().name,
        "student",
        teacher.hand,
        environment.student_layout,
        (),
        environment.settings.residual,
        1 / environment.protocol.control_period,
        Budget(trainer.steps + played, trainer.seconds + done.seconds, machine()),
        layout_name=environment.settings.layout,
        training_data=teacher.data,
        git_revision=git_revision(),
        seed=seed,
        measured={EXPLORING: {"success": done.success}},
        licence=teacher.licence,
        plans=teacher.plans,
    )
    if teacher.plans:
        keep_beside(folder, teacher_folder / (teacher.plans + SUFFIX))
    export_policy(done.student, folder / STUDENT, card)
    return card


def _identified(hand: Hand, path: Path, sha256: str | None, folder: Path) -> Hand:
    found = identified_hand(hand, path)
    if digest(path.read_bytes()) != sha256:
        raise FungraspError(f"the hand dynamics {path} have changed since {folder} was trained")
    return found


def _lost(folder: Path) -> PlanLibrary:
    raise FungraspError(f"the plans of {folder} are lost or damaged: run fungrasp train on it again")


def _objects(digests: Mapping[str, str], place: Path | None, folder: Path) -> dict[str, ObjectModel]:
    """Objects by name, if they still are what they were."""
    # The mass is set in each episode.
    things = {name: load_object(name, 1.0, place) for name in digests}
    for name, thing in things.items():
        if thing.mesh_digest != digests[name]:
            raise FungraspError(f"the object '{name}' is not the one that {folder} was trained on")
    return things
