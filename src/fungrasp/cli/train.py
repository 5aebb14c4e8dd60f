"""``fungrasp train`` and ``distill``: policies learn from reward, students from their teacher.
Options are the fields of the verb's spec, which a command holds as ``spec`` without a name of its own.
"""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tyro

from fungrasp.cli.console import Answering, CommandResult, progress_bar
from fungrasp.cli.options import ObjectsOption
from fungrasp.core.errors import FungraspError
from fungrasp.sim2real import preset
from fungrasp.task.features import LayoutName
from fungrasp.training.settings import StudentSpec, TrainSpec

LINE_PERIOD = 10.0
"""Time between two lines of progress [s]."""


@dataclass(frozen=True, kw_only=True)
class TrainingGrasps(ObjectsOption):
    """Options that say what is trained on."""

    grasps: tuple[str, ...] = ("builtin",)
    """Files of human grasps (they are retargeted first) or of robot grasps of --hand, or "builtin"; several
    are trained on together."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    hand_dynamics: Path | None = None
    """Identified dynamics of the hand (`fungrasp identify fit`); the model's if not given."""
    method: str = "contact"
    """How human grasps are retargeted: contact, angle-copy or dexgraspnet."""
    terms: tuple[str, ...] = ()
    """Under what terms each of --grasps may be used, for the policy's card."""

    def load(self, threads: int) -> tuple[Any, Any]:
        """The sets, and the hand."""
        from fungrasp.sim2real.joint_dynamics import identified_hand
        from fungrasp.training.training_sets import load_training_sets

        hand = identified_hand(self.hand, self.hand_dynamics)
        sets = load_training_sets(self.grasps, self.objects, hand, self.method, self.terms, threads)
        return sets, hand


@dataclass(frozen=True)
class Train(TrainingGrasps, Answering):
    """Train a policy on grasps with PPO, many worlds at once.

    Given again with the same settings, the command goes on where it was interrupted, or trains for more
    steps.
    """

    option_prefixes: ClassVar[bool] = True

    out: Path | None = None
    """Folder of the training; policy.onnx will be in it. runs/<hand> if not given."""
    sees: Literal["contacts", "nothing", "history"] | None = None
    """Short for --ppo.sees."""
    layout: LayoutName | None = None
    """Short for --environment.layout."""
    worlds: str | None = None
    """What episodes draw their worlds from, in the place of --environment.randomization: "nominal",
    "moderate", "wide", or "reality", what the reality protocol of evaluation draws from."""
    spec: Annotated[TrainSpec, tyro.conf.arg(name="")] = field(default_factory=TrainSpec)
    """How."""

    @property
    def folder(self) -> Path:
        """Folder of the training."""
        return self.out or Path("runs") / Path(self.hand).stem

    def run(self) -> CommandResult:
        prepare_torch()
        from fungrasp.training.train import train

        ppo, environment = self.spec.ppo, self.spec.environment
        if self.sees is not None:
            ppo = replace(ppo, sees=self.sees)
        if self.layout is not None:
            environment = replace(environment, layout=self.layout)
        if self.worlds is not None:
            environment = replace(environment, randomization=preset(self.worlds))
        spec = replace(self.spec, ppo=ppo, environment=environment)
        sets, hand = self.load(spec.threads)
        copies = sum(len(s.grasps) for s in sets) * spec.variety.copies
        with progress_bar("planning", copies) as show:
            policy = train(
                self.folder, sets, hand, spec, planning=show, progress=progress_lines(int(spec.steps))
            )
        if int(os.environ.get("RANK", "0")) > 0:
            # Only the first of several processes answers.
            raise SystemExit(0)
        return _trained(policy)


@dataclass(frozen=True)
class Distill(Answering):
    """Train a student from a teacher: it sees what a robot has, and infers the contacts from how the joints
    move.

    Given again with the same settings, the command goes on where it was interrupted.
    """

    option_prefixes: ClassVar[bool] = True

    teacher: Path
    """Folder of a teacher's training (fungrasp train)."""
    out: Path
    """Folder of the student's training; student.onnx will be in it."""
    spec: Annotated[StudentSpec, tyro.conf.arg(name="")] = field(default_factory=StudentSpec)
    """How."""

    def run(self) -> CommandResult:
        prepare_torch()
        from fungrasp.training.distill import train_student

        lines = progress_lines(int(self.spec.steps))
        return _trained(train_student(self.teacher, self.out, self.spec, progress=lines))


COMMAND = Train


def prepare_torch() -> None:
    """See that what training needs is there, and keep torch to one thread: more make small networks slower.

    Raises:
        FungraspError: a package is not installed.
    """
    try:
        for name in ("torch", "rsl_rl", "tensorboard"):
            importlib.import_module(name)
    except ImportError as error:
        raise FungraspError(
            f'training needs packages that are not installed ({error}): pip install "fungrasp[learning]"'
        ) from error
    importlib.import_module("torch").set_num_threads(1)


def progress_lines(steps: int) -> Callable[[Any], None]:
    """Prints steps, success and time left every now and then.

    Returns:
        To be called with what has ``steps``, ``seconds`` and ``success``.
    """
    last: float | None = None
    first: Any = None

    def show(p: Any) -> None:
        nonlocal last, first
        now = time.perf_counter()
        if first is None:
            first = p
        if p.steps < steps and last is not None and now - last < LINE_PERIOD:
            return
        last = now
        done, seconds = p.steps - first.steps, p.seconds - first.seconds
        left = ""
        if done > 0 and seconds > 0 and p.steps < steps:
            rate = done / seconds
            left = f", {rate:,.0f} steps/s, {_duration((steps - p.steps) / rate)} left"
        print(f"{p.steps:,} of {steps:,} steps, success {p.success:.1%}{left}", flush=True)

    return show


def _trained(policy: Path) -> CommandResult:
    """A policy's file, its card, and what it took."""
    from fungrasp.policies.checkpoint.checkpoint_file import load_policy

    card = load_policy(policy).card
    return CommandResult(
        {"policy": policy, "card": card.to_json()},
        f"{policy}: {card.kind} of {card.hand}, {card.budget.steps:,} steps in "
        f"{card.budget.seconds / 60:.1f} min",
    )


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
