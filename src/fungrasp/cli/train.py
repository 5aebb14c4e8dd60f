"""``fungrasp train`` and ``distill``: train teachers by reinforcement learning, and distill students."""

from __future__ import annotations

import importlib
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tyro

from fungrasp.cli.console import Answering, CommandResult, progress_bar
from fungrasp.cli.options import ObjectsOption
from fungrasp.sim2real import preset
from fungrasp.task.features import LayoutName
from fungrasp.training import check_packages
from fungrasp.training.settings import StudentSpec, TrainSpec

LINE_PERIOD = 10.0
"""Time between two progress lines [s]."""


@dataclass(frozen=True, kw_only=True)
class Train(ObjectsOption, Answering):
    """Train a policy with PPO in many parallel worlds.

    Run the same command again to continue an interrupted training, or with more --steps to extend it.
    """

    option_prefixes: ClassVar[bool] = True

    grasps: tuple[str, ...] = ("builtin",)
    """One or more grasp files: human grasps (retargeted first) or robot grasps of --hand; or "builtin"."""
    hand: str = "allegro"
    """Name of a hand, or the path of its TOML file."""
    hand_dynamics: Path | None = None
    """Identified dynamics of the hand (`fungrasp identify fit`). Default: the model's."""
    method: str = "contact"
    """Retargeting method: contact, angle-copy or dexgraspnet."""
    terms: tuple[str, ...] = ()
    """License terms of each grasp file, for the policy card."""
    out: Path | None = None
    """Folder for the training and its policy.onnx. Default: runs/<hand>."""
    sees: Literal["contacts", "nothing", "history"] | None = None
    """Short form of --ppo.sees."""
    layout: LayoutName | None = None
    """Short form of --environment.layout."""
    worlds: str | None = None
    """Randomization preset that replaces --environment.randomization: "nominal", "moderate", "wide", or
    "reality" (as in the reality protocol of evaluation)."""
    spec: Annotated[TrainSpec, tyro.conf.arg(name="")] = field(default_factory=TrainSpec)
    """Settings of the training."""

    @property
    def folder(self) -> Path:
        """Output folder."""
        return self.out or Path("runs") / Path(self.hand).stem

    def run(self) -> CommandResult:
        prepare_torch()
        from fungrasp.sim2real.joint_dynamics import identified_hand
        from fungrasp.training.train import train
        from fungrasp.training.training_sets import load_training_sets

        ppo, environment = self.spec.ppo, self.spec.environment
        if self.sees is not None:
            ppo = replace(ppo, sees=self.sees)
        if self.layout is not None:
            environment = replace(environment, layout=self.layout)
        if self.worlds is not None:
            environment = replace(environment, randomization=preset(self.worlds))
        spec = replace(self.spec, ppo=ppo, environment=environment)
        hand = identified_hand(self.hand, self.hand_dynamics)
        sets = load_training_sets(self.grasps, self.objects, hand, self.method, self.terms, spec.threads)
        copies = sum(len(s.grasps) for s in sets) * spec.variety.copies
        with progress_bar("planning", copies) as show:
            policy = train(
                self.folder, sets, hand, spec, planning=show, progress=progress_lines(int(spec.steps))
            )
        if int(os.environ.get("RANK", "0")) > 0:
            # Of several processes, only the first prints the result.
            raise SystemExit(0)
        return _trained(policy)


@dataclass(frozen=True)
class Distill(Answering):
    """Distill a student that uses only a robot's measurements, and infers contacts from joint motion.

    Run the same command again to continue an interrupted run.
    """

    option_prefixes: ClassVar[bool] = True

    teacher: Path
    """Folder of the teacher's training (fungrasp train)."""
    out: Path
    """Folder for the student's training and its student.onnx."""
    spec: Annotated[StudentSpec, tyro.conf.arg(name="")] = field(default_factory=StudentSpec)
    """Settings of the distillation."""

    def run(self) -> CommandResult:
        prepare_torch()
        from fungrasp.training.distill import train_student

        lines = progress_lines(int(self.spec.steps))
        return _trained(train_student(self.teacher, self.out, self.spec, progress=lines))


COMMAND = Train


def prepare_torch() -> None:
    """Set torch to one thread, which is faster for small networks.

    Raises:
        FungraspError: a package for training is missing.
    """
    check_packages()
    importlib.import_module("torch").set_num_threads(1)


def progress_lines(steps: int) -> Callable[[Any], None]:
    """Return a function that regularly prints steps, success rate and remaining time to stderr. Its argument
    has the attributes ``steps``, ``seconds`` and ``success``."""
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
        done = f"{p.steps:,} of {steps:,} steps, success while exploring {p.success:.1%}"
        print(f"{done}{left}", file=sys.stderr, flush=True)

    return show


def _trained(policy: Path) -> CommandResult:
    """Return the policy file, its card and the training time."""
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
