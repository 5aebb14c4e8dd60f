"""``python -m benchmarks.paper policies``: the free policies of any hands, from nothing."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from fungrasp.cli.distill import Distill
from fungrasp.cli.make_grasps import MakeGrasps
from fungrasp.cli.predictor import TrainPredictor
from fungrasp.cli.train import Train
from fungrasp.cli.training_options import check_numbers, check_packages
from fungrasp.files import atomic_path
from fungrasp.sim2real import PresetName
from fungrasp.training.plan_library import Variety
from fungrasp.training.settings import PredictorSettings

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
    worlds: PresetName | None = None
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
        from fungrasp.hands import load_hand

        check_numbers(min(self.steps, self.distill_steps), min((self.seed, *self.grasp_seeds)), self.threads)
        hands = [load_hand(name) for name in self.hands]
        files = [self.out / f"synthesized-{seed}.npz" for seed in self.grasp_seeds]
        for seed, file in zip(self.grasp_seeds, files, strict=True):
            if not file.is_file():
                MakeGrasps(file, seed=(seed,)).run()
        grasps = ("builtin", *map(str, files))
        for name, hand in zip(self.hands, hands, strict=True):
            self._train(name, hand, grasps)

    def _train(self, name: str, hand: Hand, grasps: tuple[str, ...]) -> None:
        """Train and keep what a hand lacks."""
        from fungrasp.training.run import POLICY
        from fungrasp.training.student_run import STUDENT
        from fungrasp.training.training_sets import BUILTIN_TERMS

        terms = (BUILTIN_TERMS, *(SYNTHESIZED_TERMS for _ in grasps[1:]))
        folder, done = self.out / hand.name, self.out / "policies"
        predictor, teacher, student = (
            folder / f"{hand.name}-{kind}-free" for kind in ("predictor", "teacher", "student")
        )
        predictor = predictor.with_suffix(".onnx")
        if not predictor.is_file():
            TrainPredictor(
                predictor,
                grasps,
                hand=name,
                seed=self.seed,
                threads=self.threads,
                terms=terms,
                licence=SYNTHESIZED_TERMS,
                settings=self.predictor,
            ).run()
        _copy(predictor, done / predictor.name)
        Train(
            teacher,
            grasps,
            hand=name,
            steps=self.steps,
            plans=str(predictor),
            shrink=self.shrink,
            worlds=self.worlds,
            seed=self.seed,
            threads=self.threads,
            terms=terms,
            licence=SYNTHESIZED_TERMS,
            variety=self.variety,
        ).run()
        _copy(teacher / POLICY, done / f"{teacher.name}.onnx")
        if not (student / STUDENT).is_file():
            Distill(teacher, student, self.distill_steps, seed=self.seed, threads=self.threads).run()
        _copy(student / STUDENT, done / f"{student.name}.onnx")


def _copy(source: Path, target: Path) -> None:
    """Copy a policy's file, whole or not at all.

    Raises:
        FungraspError: it can't be written.
    """
    with atomic_path(target) as part:
        part.write_bytes(source.read_bytes())
