"""``fungrasp reproduce``: train and test what the paper's tables compare, and train the free policies."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from fungrasp.cli.console import progress_bar, table, write_json
from fungrasp.cli.reproduce_policies import FreePolicies
from fungrasp.cli.train import check_numbers, check_packages, progress_lines, training_sets
from fungrasp.errors import FungraspError
from fungrasp.provenance import run_record
from fungrasp.training.environment import EnvironmentSettings
from fungrasp.training.plan_library import Variety
from fungrasp.training.settings import DistillSettings, PpoSettings

if TYPE_CHECKING:
    from fungrasp.evaluation import LiftTestResult
    from fungrasp.evaluation.tables import Variant
    from fungrasp.hands import Hand

DISTILLED = 6
"""A student is distilled with one control step for so many of its teacher's."""


@dataclass(frozen=True)
class Ablation:
    """Train every policy of a table with the same budget, try each on other grasps, and print the table
    beside the paper's.

    Given again, the command goes on where it was interrupted; both tables may share a folder.
    """

    option_prefixes: ClassVar[bool] = True

    grasps: tuple[str, ...]
    """Files of grasps to train on, or "builtin"; human ones where retargeting is compared."""
    test: str
    """File of grasps to test on, or "builtin"; human ones where retargeting is compared."""
    out: Path
    """Folder of the trainings; <policy>.json will be in it."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    steps: float = 3e6
    """Control steps that each policy is trained for."""
    distill_steps: float | None = None
    """Control steps for which a student is distilled; a sixth of --steps by default."""
    seed: int = 0
    """Seed of all random numbers."""
    threads: int = 0
    """Threads of the simulation; 0 means all processors."""
    environment: EnvironmentSettings = field(default_factory=EnvironmentSettings)
    """Settings of the worlds that policies are trained in."""
    ppo: PpoSettings = field(default_factory=PpoSettings)
    """Settings of the training of every policy but the distilled student."""
    variety: Variety = field(default_factory=Variety)
    """How the grasps are varied that policies are trained on."""
    distill: DistillSettings = field(default_factory=DistillSettings)
    """Settings of the student's distillation."""

    def reproduce(self, name: str) -> None:
        """Make the table of this name."""
        check_packages()
        import torch

        from fungrasp.evaluation.tables import TABLES, comparison_rows
        from fungrasp.hands import load_hand

        check_numbers(self.steps, self.seed, self.threads)
        check_numbers(self._distill_steps(), self.seed, self.threads)
        hand = load_hand(self.hand)
        torch.set_num_threads(1)
        results = {variant.name: self._result(variant, hand) for variant in TABLES[name]}
        print(table(comparison_rows(TABLES[name], results)))
        first = next(iter(results.values()))
        print(
            f"{int(self.steps):,} steps each, seed {self.seed}, tested on {first['count']} grasps; "
            "the paper's numbers are by its own test, ours by docs/evaluation.md"
        )

    def _distill_steps(self) -> float:
        return self.steps / DISTILLED if self.distill_steps is None else self.distill_steps

    def _result(self, variant: Variant, hand: Hand) -> dict[str, Any]:
        """Result of a variant: from its file, or trained and tested now."""
        from fungrasp.evaluation.result_files import LARGEST
        from fungrasp.formats.json_file import read_json

        path = self.out / f"{variant.name}.json"
        budget = self._budget(variant)
        if path.is_file():
            try:
                kept = read_json(path, "result", LARGEST)
                same, result = kept["budget"] == json.loads(json.dumps(budget)), kept["result"]
            except (FungraspError, KeyError, TypeError) as error:
                raise FungraspError(f"{path} is damaged: remove it to test again") from error
            if not same:
                raise FungraspError(f"{path} was made with other settings: give another --out")
            return result
        policy = self._trained(variant, hand)
        result = self._tested(variant, hand, policy)
        made = run_record(self.seed)
        write_json(path, {**made, "variant": asdict(variant), "budget": budget, "result": result})
        return result

    def _budget(self, variant: Variant) -> dict[str, Any]:
        """All that a variant's result depends on, in short."""
        values = {
            "grasps": [_identity(name) for name in self.grasps],
            "test": _identity(self.test),
            "hand": self.hand,
            "steps": int(self.steps),
            "seed": self.seed,
            "environment": asdict(self.environment),
            "ppo": asdict(self.ppo) | {"sees": variant.sees},
            "variety": asdict(self.variety),
        }
        if variant.distilled:
            values |= {"distill_steps": int(self._distill_steps()), "distill": asdict(self.distill)}
        return values

    def _trained(self, variant: Variant, hand: Hand) -> Path:
        """The policy file of a variant."""
        from fungrasp.training.run import POLICY, RunSettings, train
        from fungrasp.training.student_run import STUDENT, train_student

        if variant.distilled:
            print(f"{variant.title}: distilling")
            train_student(
                self.out / "teacher",
                self.out / variant.name,
                int(self._distill_steps()),
                self.distill,
                self.seed,
                objects=self.objects,
                threads=self.threads,
                progress=progress_lines(int(self._distill_steps())),
            )
            return self.out / variant.name / STUDENT
        print(f"{variant.title}: training")
        sets = training_sets(self.grasps, self.objects, hand, variant.method, threads=self.threads)
        copies = sum(len(s.grasps) for s in sets) * self.variety.copies
        with progress_bar("planning", copies) as show:
            train(
                self.out / variant.name,
                sets,
                hand,
                RunSettings(self.seed, self.variety, self.environment, replace(self.ppo, sees=variant.sees)),
                int(self.steps),
                threads=self.threads,
                plan_file=self.out / f"references-{variant.method}.npz",
                planning=show,
                progress=progress_lines(int(self.steps)),
            )
        return self.out / variant.name / POLICY

    def _tested(self, variant: Variant, hand: Hand, policy: Path) -> dict[str, Any]:
        """The lift test of a policy, as JSON can hold it."""
        from fungrasp.evaluation import evaluate, result_json
        from fungrasp.evaluation.results import summary
        from fungrasp.planning import MotionSettings
        from fungrasp.policies import make_planner

        (test,) = training_sets((self.test,), self.objects, hand, variant.method, threads=self.threads)
        grasps, objects = test.grasps, test.objects

        def tested(words: str, motions: MotionSettings) -> LiftTestResult:
            planner = make_planner(str(policy), hand, objects, threads=self.threads, motions=motions)
            with progress_bar(f"testing {variant.title}{words}", len(grasps)) as show:
                return evaluate(
                    grasps, objects, hand, str(policy), planner=planner, threads=self.threads, progress=show
                )

        adapted = result_json(tested("", MotionSettings()))
        without = summary(tested(" without adaptation", MotionSettings(adapt=None)))
        # The name in place of the path of the policy's file, which means nothing on another machine.
        return adapted | {"policy": variant.name, "without_adaptation": without}


@dataclass(frozen=True)
class RetargetingAblation(Ablation):
    """Compare retargeting methods: a teacher trained on the grasps of each, tested on grasps of the same
    method.

    Given again, the command goes on where it was interrupted; both tables may share a folder.
    """

    def run(self) -> None:
        from fungrasp.grasps import HumanGraspSet, load_grasps

        for name in (*self.grasps, self.test):
            if not isinstance(load_grasps(name), HumanGraspSet):
                raise FungraspError(f"{name} holds robot grasps; to compare retargeting takes human ones")
        self.reproduce("retargeting")


@dataclass(frozen=True)
class PrivilegedAblation(Ablation):
    """Compare what is known of the contacts: nothing, what an encoder learns along the way, the truth, and
    what a student has learned from a teacher.

    Given again, the command goes on where it was interrupted; both tables may share a folder.
    """

    def run(self) -> None:
        self.reproduce("privileged")


def _identity(name: str) -> dict[str, str]:
    """Tells a file of grasps from others, wherever it lies."""
    import hashlib

    from fungrasp.grasps.grasp_files import BUILTIN, BUILTIN_PATH

    path = BUILTIN_PATH if name == BUILTIN else Path(name)
    try:
        return {"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    except OSError as error:
        raise FungraspError(f"cannot read {path}: {error.strerror or error}") from error


COMMAND = {"retargeting": RetargetingAblation, "privileged": PrivilegedAblation, "policies": FreePolicies}
