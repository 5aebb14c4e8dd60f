"""``fungrasp train``: a policy learns from grasps in simulation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

from fungrasp.cli.console import Answer, Answering, progress_bar
from fungrasp.cli.training_options import (
    check_numbers,
    check_packages,
    predictor_file,
    progress_lines,
)
from fungrasp.sim2real import preset
from fungrasp.task.features import LayoutName
from fungrasp.training.environment import EnvironmentSettings
from fungrasp.training.plan_library import Variety
from fungrasp.training.settings import CurveSettings, PpoSettings


@dataclass(frozen=True)
class Train(Answering):
    """Train a policy: PPO on many perturbed copies of grasps, in many simulated worlds at once.

    Given again with the same settings, the command goes on where it was interrupted, or trains for more
    steps.
    """

    option_prefixes: ClassVar[bool] = True

    out: Path | None = None
    """Folder of the training; policy.onnx will be in it. runs/<hand> if not given."""
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
    layout: LayoutName | None = None
    """Short for --environment.layout."""
    worlds: str | None = None
    """What episodes draw their worlds from, in the place of --environment.randomization: "nominal",
    "moderate", "wide", or "reality", what the reality protocol of evaluation draws from."""
    seed: int = 0
    """Seed of all random numbers."""
    threads: int = 0
    """Threads of the simulation; 0 means all processors. The result does not depend on it."""
    device: Literal["cuda", "cpu-warp", "cpu"] | None = None
    """Where the worlds are simulated: a GPU of NVIDIA's, the GPU's code on the processor (slow), or the
    processor. By default a GPU if there is one with the extra "gpu"."""
    buffers: tuple[int, int] | None = None
    """Room on a GPU for contacts of a world (on average) and rows of constraints (at most); found by a probe
    by default."""
    terms: tuple[str, ...] = ()
    """Under what terms each of --grasps may be used, for the policy's card."""
    licence: str = ""
    """Licence of the policy, for its card."""
    curve: CurveSettings = field(default_factory=CurveSettings)
    """Of the learning curve, curve.csv and its drawing curve.svg in the training's folder."""
    environment: EnvironmentSettings = field(default_factory=EnvironmentSettings)
    """Settings of the worlds that the policy is trained in."""
    ppo: PpoSettings = field(default_factory=PpoSettings)
    """Settings of PPO."""
    variety: Variety = field(default_factory=Variety)
    """How the grasps are varied that the policy is trained on."""

    @property
    def folder(self) -> Path:
        """Folder of the training."""
        return self.out or Path("runs") / Path(self.hand).stem

    def run(self) -> Answer:
        check_packages()
        import torch

        from fungrasp.cli.options import device_and_buffers
        from fungrasp.sim2real.joint_dynamics import identified_hand
        from fungrasp.training.processes import joined
        from fungrasp.training.run import POLICY, RunSettings, consistent, train
        from fungrasp.training.training_sets import load_training_sets

        check_numbers(self.steps, self.seed, self.threads)
        device, buffers = device_and_buffers(self.device, self.buffers)
        hand = identified_hand(self.hand, self.hand_dynamics)
        ppo = self.ppo if self.sees is None else replace(self.ppo, sees=self.sees)
        environment = self.environment
        if self.layout is not None:
            environment = replace(environment, layout=self.layout)
        if self.worlds is not None:
            environment = replace(environment, randomization=preset(self.worlds))
        settings = consistent(RunSettings(self.seed, self.variety, environment, ppo))
        sets = load_training_sets(self.grasps, self.objects, hand, self.method, self.terms, self.threads)
        # More threads make the small networks slower.
        torch.set_num_threads(1)
        plans = None if self.plans is None else predictor_file(self.plans, hand)
        copies = sum(len(s.grasps) for s in sets) * self.variety.planned(plans is not None)
        with joined(device) as processes, progress_bar("planning", copies) as show:
            card = train(
                self.folder,
                sets,
                hand,
                settings,
                int(self.steps),
                licence=self.licence,
                threads=self.threads,
                device=device,
                buffers=buffers,
                plans=plans,
                initial=self.initial,
                shrink=self.shrink,
                curve=self.curve,
                processes=processes,
                planning=show,
                progress=progress_lines(int(self.steps)),
            )
        if not processes.first:
            # Only the first of several processes answers.
            raise SystemExit(0)
        seconds = card.budget.seconds
        return Answer(
            {"policy": self.folder / POLICY, "card": card.to_json()},
            f"{self.folder / POLICY}: {card.kind} of {card.hand}, {card.budget.steps:,} steps in "
            f"{seconds / 60:.1f} min",
        )


COMMAND = Train
