"""``python -m benchmarks.paper policies``: the free policies of any hands, from nothing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from fungrasp.cli.training_options import check_numbers, check_packages, progress_lines

from fungrasp.cli.console import progress_bar
from fungrasp.core.files import atomic_path
from fungrasp.sim2real import preset
from fungrasp.training.environment import EnvironmentSettings
from fungrasp.training.plan_library import Variety
from fungrasp.training.settings import PpoSettings, PredictorSettings

if TYPE_CHECKING:
    from fungrasp.hands import Hand

SYNTHESIZED_TERMS = "Apache-2.0"
"""Terms of grasps that ``fungrasp grasps make`` has made."""


@dataclass(frozen=True)
class FreePolicies:
    """Train success predictor, teacher and student of hands from the built-in grasps and synthesized ones,
    and put their files beside each other: <out>/policies/<hand>-<kind>-free.onnx.

    Given again, the command goes on where it was interrupted. Remove a hand's folder to train it anew.
    """

    option_prefixes: ClassVar[bool] = True

    out: Path
    """Folder of grasps, trainings and policies."""
    hands: tuple[str, ...] = ("allegro", "shadow", "faive", "inspire", "leap")
    """Names of hands, or paths of hands' TOML files."""
    grasp_seeds: tuple[int, ...] = (1, 2, 3)
    """Seeds of the synthesized grasps, about 118 for each."""
    steps: float = 3.7e5
    """Control steps of each teacher's training."""
    distill_steps: float = 6.8e4
    """Control steps of each student's distillation."""
    shrink: float = 0.25
    """Factor on the corrections of teachers and students."""
    worlds: str | None = None
    """What the episodes of teachers and students draw their worlds from, as for `fungrasp train`."""
    seed: int = 0
    """Seed of all random numbers but those of the grasps."""
    threads: int = 0
    """Threads of the simulation; 0 means all processors. The result does not depend on it."""
    predictor: PredictorSettings = field(default_factory=lambda: PredictorSettings(attempts=12))
    """Settings of the success predictors."""
    variety: Variety = field(default_factory=Variety)
    """How the grasps are varied that teachers are trained on."""

    def run(self) -> None:
        check_packages()
        import torch

        from fungrasp.hands import load_hand

        check_numbers(min(self.steps, self.distill_steps), min((self.seed, *self.grasp_seeds)), self.threads)
        hands = [load_hand(name) for name in self.hands]
        files = [self.out / f"synthesized-{seed}.npz" for seed in self.grasp_seeds]
        for seed, file in zip(self.grasp_seeds, files, strict=True):
            if not file.is_file():
                _synthesize(seed, file)
        # More threads make the small networks slower.
        torch.set_num_threads(1)
        for hand in hands:
            self._train(hand, files)

    def _train(self, hand: Hand, files: list[Path]) -> None:
        """Train and keep what a hand lacks."""
        from fungrasp.training.success_predictor import train_predictor
        from fungrasp.training.train import POLICY, RunSettings, train
        from fungrasp.training.distill import STUDENT, train_student

        from fungrasp.training.training_sets import BUILTIN_TERMS, load_training_sets

        terms = (BUILTIN_TERMS, *(SYNTHESIZED_TERMS for _ in files))
        names = ("builtin", *map(str, files))
        sets = load_training_sets(names, None, hand, terms=terms, threads=self.threads)
        folder, done = self.out / hand.name, self.out / "policies"
        predictor, teacher, student = (
            folder / f"{hand.name}-{kind}-free" for kind in ("predictor", "teacher", "student")
        )
        predictor = predictor.with_suffix(".onnx")
        if not predictor.is_file():
            with progress_bar(f"{hand.name}: trying plans", 1.0) as show:
                train_predictor(
                    predictor,
                    sets,
                    hand,
                    self.predictor,
                    self.seed,
                    licence=SYNTHESIZED_TERMS,
                    threads=self.threads,
                    progress=show,
                )
        _copy(predictor, done / predictor.name)
        environment = EnvironmentSettings()
        if self.worlds is not None:
            environment = replace(environment, randomization=preset(self.worlds))
        train(
            teacher,
            sets,
            hand,
            RunSettings(self.seed, self.variety, environment, PpoSettings()),
            int(self.steps),
            licence=SYNTHESIZED_TERMS,
            threads=self.threads,
            plans=predictor,
            shrink=self.shrink,
            progress=progress_lines(int(self.steps)),
        )
        _copy(teacher / POLICY, done / f"{teacher.name}.onnx")
        if not (student / STUDENT).is_file():
            steps = int(self.distill_steps)
            train_student(
                teacher, student, steps, None, self.seed, threads=self.threads, progress=progress_lines(steps)
            )
        _copy(student / STUDENT, done / f"{student.name}.onnx")


def _synthesize(seed: int, path: Path) -> None:
    """Grasps of the built-in objects, in a file."""
    from fungrasp.core.jobs import PartStore
    from fungrasp.grasps import save_human_grasps
    from fungrasp.synthesis import synthesize_grasps
    from fungrasp.synthesis.builtin_specifications import BUILTIN_SPECIFICATIONS

    with PartStore.beside(path) as store, progress_bar("synthesizing grasps", 1.0) as show:
        grasps = synthesize_grasps(BUILTIN_SPECIFICATIONS, (seed,), store=store, progress=show)
        save_human_grasps(path, grasps)


def _copy(source: Path, target: Path) -> None:
    """Copy a policy's file, whole or not at all.

    Raises:
        FungraspError: it can't be written.
    """
    with atomic_path(target) as part:
        part.write_bytes(source.read_bytes())
