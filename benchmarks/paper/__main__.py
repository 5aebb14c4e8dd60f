"""``python -m benchmarks.paper TABLE``: train and test what the paper's tables III to V compare."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import tyro

from benchmarks.command import main
from fungrasp.cli.console import progress_bar, table
from fungrasp.cli.train import prepare_torch, progress_lines
from fungrasp.core.errors import FungraspError
from fungrasp.core.provenance import run_record
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.sim2real import preset
from fungrasp.training.settings import (
    CurveSettings,
    DistillSettings,
    EnvironmentSettings,
    PpoSettings,
    StudentSpec,
    TrainSpec,
    Variety,
    check_numbers,
)

if TYPE_CHECKING:
    from benchmarks.paper.variants import Variant
    from fungrasp.evaluation import LiftTestResult
    from fungrasp.hands import Hand

DISTILLED = 6
"""A student is distilled with one control step for so many of its teacher's."""


EARLY = (-4, 10)
"""Control steps before the fingers close at which episodes begin: from 9 cm away to a hand that has all but
closed, whose lifts are paid for from the beginning."""

WIDEN = (0, 300_000)
"""Control steps between which these starts give way to those of the lift test: closing is learned near the
grasp within some 100,000 (lab/measurements.md)."""

IMITATE = 2e5
"""Control steps in which actors imitate planned motions before PPO. PPO from nothing learns in half a million
to lift (64 % of new grasps), but to hold as shown only 20 % (lab/measurements.md)."""


def without_plans() -> EnvironmentSettings:
    """The paper's setting (docs/train.md): policies follow no planned motion, networks get what the paper
    names, and two thirds of the first episodes begin near the grasp."""
    return EnvironmentSettings(
        worlds=128,
        early=EARLY,
        whole=0.3,
        widen=WIDEN,
        layout="paper",
        residual=ResidualSettings(base="guided"),
    )


@dataclass(frozen=True)
class PaperTable:
    """Make a table of the paper. Every policy is trained in the paper's setting, where it follows no planned
    motion, with the same budget, with each of several seeds, and tried on other grasps, in nominal worlds
    (with and without adaptation of the grasps) and in the reality protocol; the table stands beside the
    paper's.

    Given again, the command goes on where it was interrupted; all tables may share a folder.
    """

    option_prefixes: ClassVar[bool] = True

    table: Annotated[Literal["hands", "retargeting", "privileged"], tyro.conf.Positional]
    """hands (Table III): a student of Shadow, Faive P0 and Allegro each, on the same human grasps;
    retargeting (Table IV): a teacher for each method, trained and tested on its grasps; privileged
    (Table V): what is known of the contacts: nothing, what an encoder learns along the way, the truth, and
    what a student has learned from a teacher."""
    grasps: tuple[str, ...]
    """Files of grasps to train on, or "builtin"; human ones where retargeting or hands are compared."""
    test: str
    """File of grasps to test on, or "builtin"; human ones where retargeting or hands are compared."""
    out: Path
    """Folder of the trainings, <hand>/seed-<N>/<policy>, of what was tested, and of the table,
    <table>.json."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    only: tuple[str, ...] = ()
    """Rows of the table to train and test, by the names of their policies or hands; all by default."""
    steps: float = 3e6
    """Control steps that each policy is trained for."""
    worlds: str = "nominal"
    """What episodes of the trainings draw their worlds from."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of trainings and tests."""
    threads: int = 0
    """Threads of the simulation; 0 means all processors."""
    environment: EnvironmentSettings = field(default_factory=without_plans)
    """Settings of the worlds that policies are trained in, but for what --worlds says."""
    ppo: PpoSettings = field(
        default_factory=lambda: PpoSettings(noise=0.3, epochs=8, kl=0.04, imitate=IMITATE)
    )
    """Settings of the training of every policy but the students."""
    variety: Variety = field(default_factory=lambda: Variety(copies=8))
    """How the grasps are varied that policies are trained on."""
    distill: DistillSettings = field(default_factory=DistillSettings)
    """Settings of the students' distillation."""
    curve: CurveSettings = field(default_factory=CurveSettings)
    """Of the learning curve of every policy but the students, curve.csv in its folder."""

    def run(self) -> None:
        prepare_torch()
        from benchmarks.paper.variants import (
            CONDITIONS,
            comparison_rows,
            curves_svg,
            paired_rows,
            paired_tests,
            pooled,
            table_variants,
        )
        from fungrasp.evaluation.result_files import write_result

        self._check()
        variants = table_variants(self.table, self.only)
        # All rows with one seed before the next seed: an interrupted table has whole columns.
        by_seed = [[self._result(variant, seed) for variant in variants] for seed in self.seeds]
        kept = [list(each) for each in zip(*by_seed, strict=True)]
        numbers = [{which: pooled([one[which] for one in each]) for which in CONDITIONS} for each in kept]
        tests = paired_tests(variants, kept)
        header = {
            **run_record(list(self.seeds)),
            "table": self.table,
            "budget": self._budget(),
            "policies": [
                {**asdict(variant), "conditions": each}
                for variant, each in zip(variants, numbers, strict=True)
            ],
            "paired_tests": tests,
        }
        rows = [
            {"policy": variant.title, "condition": which, "training_seed": seed, **_row(trial)}
            for variant, each in zip(variants, kept, strict=True)
            for seed, one in zip(self.seeds, each, strict=True)
            for which in CONDITIONS
            for trial in one[which]["trials"]
        ]
        write_result(self.out / f"{self.table}.json", header, rows)
        curves = {v.title: self._curves(v) for v in variants if not v.student}
        if curves and all(curves.values()):
            (self.out / f"{self.table}.svg").write_text(curves_svg(curves))
        print(table(comparison_rows(variants, numbers)))
        if tests:
            print(table(paired_rows(tests)))
        count = len(kept[0][0][CONDITIONS[0]]["trials"])
        print(
            f"{int(self.steps):,} steps each, {len(self.seeds)} seeds, tested on {count} grasps; "
            "the paper's numbers are by its own test, ours by docs/evaluate.md"
        )

    def _check(self) -> None:
        from fungrasp.grasps import HumanGraspSet, load_grasps

        check_numbers(self.steps, min(self.seeds, default=-1), self.threads)
        check_numbers(self.steps / DISTILLED, 0, self.threads)
        if len(set(self.seeds)) < len(self.seeds):
            raise FungraspError("--seeds must be different ones")
        if self.table != "privileged":
            for name in (*self.grasps, self.test):
                if not isinstance(load_grasps(name), HumanGraspSet):
                    raise FungraspError(f"{name} holds robot grasps; this table takes human ones")

    def _hand(self, variant: Variant) -> str:
        return variant.hand or self.hand

    def _folder(self, variant: Variant, seed: int) -> Path:
        """Where the trainings of a hand with a seed are."""
        return self.out / Path(self._hand(variant)).stem / f"seed-{seed}"

    def _curves(self, variant: Variant) -> list[np.ndarray]:
        """Learning curves of a variant, one a seed, where there is one: columns steps, success and share held
        as shown."""
        from fungrasp.training.learning_curve import CURVE, read_curve

        files = [self._folder(variant, seed) / variant.name / CURVE for seed in self.seeds]
        return [
            np.array([(p.steps, p.success, p.held_as_shown) for p in read_curve(file)])
            for file in files
            if file.is_file()
        ]

    def _result(self, variant: Variant, seed: int) -> dict[str, Any]:
        """Results of a variant by condition: kept ones, or trained and tested now."""
        from fungrasp.core.jobs import PartStore, part_key
        from fungrasp.hands import load_hand

        def made() -> dict[str, np.ndarray]:
            hand = load_hand(self._hand(variant))
            policy = self._trained(variant, hand, seed)
            return {"results": np.array(json.dumps(self._tested(variant, hand, policy, seed)))}

        # Rows of two tables that train and test the same share it, whatever their titles.
        key = part_key(
            self._budget(), variant.method, variant.sees, variant.student, self._hand(variant), seed
        )
        return json.loads(str(PartStore(self.out / "tested").kept(key, made)["results"]))

    def _budget(self) -> dict[str, Any]:
        """All that results depend on but hand and seed, in short."""
        return {
            "grasps": [_identity(name) for name in self.grasps],
            "test": _identity(self.test),
            "steps": int(self.steps),
            "distill_steps": int(self.steps / DISTILLED),
            "worlds": self.worlds,
            "environment": asdict(self.environment),
            "ppo": asdict(self.ppo),
            "variety": asdict(self.variety),
            "distill": asdict(self.distill),
        }

    def _trained(self, variant: Variant, hand: Hand, seed: int) -> Path:
        """The policy file of a variant."""
        if variant.student:
            return self._distilled(variant, hand, seed)
        return self._taught(variant.name, variant, hand, seed)

    def _taught(self, name: str, variant: Variant, hand: Hand, seed: int) -> Path:
        """The policy file of a training by PPO: of a variant, or of its teacher. name: of its folder."""
        from fungrasp.training.train import train
        from fungrasp.training.training_sets import load_training_sets

        folder = self._folder(variant, seed)
        print(f"{variant.title}, seed {seed}: training {name}")
        sets = load_training_sets(self.grasps, self.objects, hand, variant.method, threads=self.threads)
        count = sum(len(s.grasps) for s in sets) * self.variety.copies
        environment = replace(self.environment, randomization=preset(self.worlds))
        spec = TrainSpec(
            self.steps,
            plan_file=folder / f"plans-{variant.method}.npz",
            seed=seed,
            threads=self.threads,
            device="cpu",
            curve=self.curve,
            environment=environment,
            ppo=replace(self.ppo, sees=variant.sees),
            variety=self.variety,
        )
        lines = progress_lines(int(self.steps))
        with progress_bar("planning", count) as show:
            return train(folder / name, sets, hand, spec, planning=show, progress=lines)

    def _distilled(self, variant: Variant, hand: Hand, seed: int) -> Path:
        """The policy file of a student."""
        from fungrasp.training.distill import train_student

        teacher = self._taught("teacher", variant, hand, seed).parent
        folder = self._folder(variant, seed) / variant.name
        print(f"{variant.title}, seed {seed}: distilling")
        settings = replace(self.distill, estimates_contacts=variant.student == "with estimate")
        spec = StudentSpec(self.steps / DISTILLED, self.objects, seed, self.threads, settings)
        return train_student(teacher, folder, spec, progress=progress_lines(int(spec.steps)))

    def _tested(self, variant: Variant, hand: Hand, policy: Path, seed: int) -> dict[str, Any]:
        """The lift tests of a policy by condition, as JSON can hold them."""
        from benchmarks.paper.variants import CONDITIONS
        from fungrasp.evaluation import LiftTestSpec, evaluate, result_json
        from fungrasp.training.training_sets import load_training_sets

        (test,) = load_training_sets((self.test,), self.objects, hand, variant.method, threads=self.threads)
        grasps, objects = test.grasps, test.objects

        def tested(condition: str) -> LiftTestResult:
            spec = LiftTestSpec(
                policy=str(policy),
                protocol="reality" if condition == "reality" else "nominal",
                seeds=(seed,),
                adapt="not adapted" not in condition,
                rollouts=False,
            )
            with progress_bar(f"{variant.title}, seed {seed}: {condition}", 1.0) as show:
                return evaluate(grasps, objects, spec=spec, hand=hand, threads=self.threads, progress=show)

        # No more than tables need: what was asked for names the path of the policy's file.
        results = {name: result_json(tested(name)) for name in CONDITIONS}
        return {name: {key: one[key] for key in ("success_rate", "trials")} for name, one in results.items()}


def _row(trial: dict[str, Any]) -> dict[str, Any]:
    """What is kept of an episode."""
    names = (
        "index",
        "object",
        "success",
        "held_as_shown",
        "reason",
        "contact_ratio",
        "sim_distance_hand_mm_s",
    )
    return {name: trial[name] for name in names}


def _identity(name: str) -> dict[str, str]:
    """Tells a file of grasps from others, wherever it lies."""
    import hashlib

    from fungrasp.grasps.grasp_files import BUILTIN, BUILTIN_PATH

    path = BUILTIN_PATH if name == BUILTIN else Path(name)
    try:
        return {"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    except OSError as error:
        raise FungraspError(f"cannot read {path}: {error.strerror or error}") from error


COMMAND = PaperTable


if __name__ == "__main__":
    main("paper", PaperTable)
