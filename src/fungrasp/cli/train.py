"""``fungrasp train``: a policy learns from grasps in simulation."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from fungrasp.errors import FungraspError
from fungrasp.sim2real import PRESETS, PresetName
from fungrasp.training.environment import EnvironmentSettings
from fungrasp.training.plan_library import Variety
from fungrasp.training.settings import PpoSettings

if TYPE_CHECKING:
    from fungrasp.hands import Hand
    from fungrasp.training.run import Log, TrainingSet

LINE_PERIOD = 10.0
"""Time between two lines of progress [s]."""

BUILTIN_TERMS = "Apache-2.0, part of fungrasp"


@dataclass(frozen=True)
class Train:
    """Train a policy: PPO on many perturbed copies of grasps, in many simulated worlds at once.

    Given again with the same settings, the command goes on where it was interrupted, or trains for more
    steps.
    """

    option_prefixes: ClassVar[bool] = True

    out: Path
    """Folder of the training; policy.onnx will be in it."""
    grasps: tuple[str, ...] = ("builtin",)
    """Files of human grasps (they are retargeted first) or of robot grasps of --hand, or "builtin"; several
    are trained on together."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    hand_dynamics: Path | None = None
    """Identified dynamics of the hand (`fungrasp identify fit`); the model's if not given."""
    method: str = "contact"
    """How human grasps are retargeted: contact, angle-copy or dexgraspnet."""
    steps: float = 3e6
    """Control steps of all worlds together, earlier runs of this training included."""
    plans: str | None = None
    """A success predictor that chooses the plans to follow, in training and at work: one that comes with the
    package ("predictor" is short for the hand's), or a file. The grasps' own plans by default."""
    initial: Path | None = None
    """Folder of another training, whose networks this one begins with."""
    shrink: float = 1.0
    """Factor on the finished policy's corrections, and on those of its students."""
    sees: Literal["contacts", "nothing", "history"] | None = None
    """Short for --ppo.sees."""
    worlds: PresetName | None = None
    """What episodes draw their worlds from, in the place of --environment.randomization: "reality" is what
    the reality protocol of evaluation draws from."""
    seed: int = 0
    """Seed of all random numbers."""
    seeds: tuple[int, ...] = ()
    """Several trainings, one with each of these seeds, in <out>/seed-<N>."""
    sweep: tuple[str, ...] = ()
    """Several trainings, one with each combination of values: --sweep ppo.noise=0.1,0.2 shrink=0.5,1 makes
    four, in <out>/ppo.noise=0.1,shrink=0.5 and so on, with --seeds each with every seed."""
    ray: tuple[str, ...] | None = None
    """The trainings of --seeds and --sweep at the same time on a Ray cluster: on that of this address
    ("auto": the one that this machine is part of), or on all processors of this machine where none is given.
    Every machine must see the same files."""
    threads: int = 0
    """Threads of the simulation; 0 means all processors. The result does not depend on it."""
    terms: tuple[str, ...] = ()
    """Under what terms each of --grasps may be used, for the policy's card."""
    licence: str = ""
    """Licence of the policy, for its card."""
    wandb: str | None = None
    """Log to this project of Weights & Biases too."""
    environment: EnvironmentSettings = field(default_factory=EnvironmentSettings)
    """Settings of the worlds that the policy is trained in."""
    ppo: PpoSettings = field(default_factory=PpoSettings)
    """Settings of PPO."""
    variety: Variety = field(default_factory=Variety)
    """How the grasps are varied that the policy is trained on."""

    def run(self) -> None:
        check_packages()
        if self.seeds or self.sweep:
            self._run_each()
            return
        if self.ray is not None:
            raise FungraspError("--ray spreads several trainings over a cluster: give --seeds or --sweep")
        import torch

        from fungrasp.cli.console import progress_bar
        from fungrasp.sim2real.joint_dynamics import identified_hand
        from fungrasp.training.run import POLICY, RunSettings, train

        check_numbers(self.steps, self.seed, self.threads)
        hand = identified_hand(self.hand, self.hand_dynamics)
        ppo = self.ppo if self.sees is None else replace(self.ppo, sees=self.sees)
        environment = self.environment
        if self.worlds is not None:
            environment = replace(environment, randomization=PRESETS[self.worlds])
        log = None if self.wandb is None else wandb_log(self.wandb, self.out)
        sets = training_sets(self.grasps, self.objects, hand, self.method, self.terms, self.threads)
        # More threads make the small networks slower.
        torch.set_num_threads(1)
        plans = None if self.plans is None else predictor_file(self.plans, hand)
        copies = sum(len(s.grasps) for s in sets) * self.variety.planned(plans is not None)
        with progress_bar("planning", copies) as show:
            card = train(
                self.out,
                sets,
                hand,
                RunSettings(self.seed, self.variety, environment, ppo),
                int(self.steps),
                licence=self.licence,
                threads=self.threads,
                plans=plans,
                initial=self.initial,
                shrink=self.shrink,
                planning=show,
                progress=progress_lines(int(self.steps)),
                log=log,
            )
        seconds = card.budget.seconds
        print(
            f"{self.out / POLICY}: {card.kind} of {card.hand}, {card.budget.steps:,} steps in "
            f"{seconds / 60:.1f} min"
        )

    def _run_each(self) -> None:
        from fungrasp.cli.on_cluster import train_on_cluster
        from fungrasp.cli.sweep import each_training, sweep_table

        each = each_training(self)
        for training in each:
            check_numbers(training.steps, training.seed, training.threads)
        if self.ray is not None:
            train_on_cluster(each, self.ray)
        else:
            for training in each:
                training.run()
        print(sweep_table(each, self.out))


COMMAND = Train


def predictor_file(name: str, hand: Hand) -> Path:
    """The file of a success predictor.

    Raises:
        FungraspError: there is none of this name, or it is another kind of policy.
    """
    from fungrasp.policies import policy_files

    files = policy_files(name, hand.name)
    if files.network is not None or files.predictor is None:
        raise FungraspError(f"--plans takes a success predictor, which '{name}' is not")
    return files.predictor


def check_packages() -> None:
    """Complain about missing ones.

    Raises:
        FungraspError: one that training needs is not installed.
    """
    try:
        for name in ("torch", "rsl_rl", "tensorboard"):
            importlib.import_module(name)
    except ImportError as error:
        raise FungraspError(
            f'training needs packages that are not installed ({error}): pip install "fungrasp[learning]"'
        ) from error


def check_numbers(steps: float, seed: int, threads: int) -> None:
    """Complain about impossible ones.

    Raises:
        FungraspError: one is.
    """
    if not 1 <= steps < 1e15:
        raise FungraspError(f"--steps must be at least 1, not {steps:g}")
    if seed < 0 or threads < 0:
        raise FungraspError("--seed and --threads must not be negative")


def training_sets(
    names: tuple[str, ...],
    folder: Path | None,
    hand: Hand,
    method: str = "contact",
    terms: tuple[str, ...] = (),
    threads: int = 0,
) -> list[TrainingSet]:
    """Grasps of a hand from files, retargeted where they are human.

    Args:
        names: of files, or "builtin".
        folder: of meshes.
        hand: the robot hand.
        method: of retargeting.
        terms: one for each name, or none.
        threads: 0 means all processors.

    Raises:
        FungraspError: a file or an object can't be read, grasps of another hand, or an unknown method.
    """
    from fungrasp.grasps import RobotGraspSet, load_grasps, load_objects
    from fungrasp.grasps.grasp_files import BUILTIN
    from fungrasp.retargeting import method_name, retarget
    from fungrasp.training.run import TrainingSet

    method = method_name(method)
    if not names or len(set(names)) < len(names):
        raise FungraspError("--grasps needs at least one set, and each once")
    if terms and len(terms) != len(names):
        raise FungraspError(f"--terms needs one text for each of the {len(names)} --grasps, not {len(terms)}")
    sets = []
    for number, name in enumerate(names):
        grasps = load_grasps(name)
        place = None if name == BUILTIN else folder
        objects = load_objects(grasps, place)
        if isinstance(grasps, RobotGraspSet):
            grasps.check_hand(hand)
            robot, label = grasps, ""
        else:
            robot = retarget(grasps, objects, hand, method, threads=threads)
            label = f", retargeted with {method}"
        said = terms[number] if terms else BUILTIN_TERMS if name == BUILTIN else "not stated"
        title = "built-in grasps" if name == BUILTIN else Path(name).name
        sets.append(TrainingSet(title + label, robot, objects, said, place))
    return sets


def progress_lines(steps: int) -> Callable[[Any], None]:
    """Prints steps, success and time left every now and then.

    Args:
        steps: at which training ends.

    Returns:
        To be called with what has ``steps``, ``seconds`` and ``success``.
    """
    last: tuple[float, Any] | None = None
    first: Any = None

    def show(p: Any) -> None:
        nonlocal last, first
        now = time.perf_counter()
        if first is None:
            first = p
        if p.steps < steps and last is not None and now - last[0] < LINE_PERIOD:
            return
        last = (now, p)
        done, seconds = p.steps - first.steps, p.seconds - first.seconds
        left = ""
        if done > 0 and seconds > 0 and p.steps < steps:
            rate = done / seconds
            left = f", {rate:,.0f} steps/s, {_duration((steps - p.steps) / rate)} left"
        print(f"{p.steps:,} of {steps:,} steps, success {p.success:.1%}{left}", flush=True)

    return show


def wandb_log(project: str, folder: Path) -> Log:
    """Sends numbers to Weights & Biases, to one run for each folder.

    Raises:
        FungraspError: the package is not installed.
    """
    import hashlib

    try:
        import wandb  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise FungraspError("--wandb needs the package wandb: pip install 'fungrasp[wandb]'") from error
    name = folder.absolute()
    key = hashlib.sha256(str(name).encode()).hexdigest()[:16]
    run = wandb.init(project=project, name=name.name, id=key, resume="allow")
    return lambda numbers, steps: run.log(dict(numbers), step=steps)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
