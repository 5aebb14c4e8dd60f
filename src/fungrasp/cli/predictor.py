"""``fungrasp predictor``: learns which variations of a grasp will hold."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from fungrasp.cli.training_options import check_numbers, check_packages
from fungrasp.training.settings import PredictorSettings


@dataclass(frozen=True)
class TrainPredictor:
    """Try many variations of grasps in physics, and train a success predictor that chooses among such
    variations.

    Its file is a policy: `fungrasp evaluate --policy predictor.onnx` plays the plans that it chooses.
    """

    out: Path
    """The predictor's file (.onnx)."""
    grasps: tuple[str, ...] = ("builtin",)
    """Files of human grasps (they are retargeted first) or of robot grasps of --hand, or "builtin"; several
    are learned from together."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    hand_dynamics: Path | None = None
    """Identified dynamics of the hand (`fungrasp identify fit`); the model's if not given."""
    method: str = "contact"
    """How human grasps are retargeted: contact, angle-copy or dexgraspnet."""
    episodes: Path | None = None
    """Folder in which the episodes' outcomes are kept, so that an interrupted command goes on where it was,
    and more --attempts add to them; beside --out by default."""
    seed: int = 0
    """Seed of all random numbers."""
    threads: int = 0
    """Threads of the simulation; 0 means all processors. The result does not depend on it."""
    terms: tuple[str, ...] = ()
    """Under what terms each of --grasps may be used, for the predictor's card."""
    licence: str = ""
    """Licence of the predictor, for its card."""
    settings: PredictorSettings = field(default_factory=PredictorSettings)
    """Settings of the episodes and of the learning."""

    def run(self) -> None:
        check_packages()
        from time import perf_counter

        import torch

        from fungrasp.cli.console import progress_bar
        from fungrasp.jobs import PartStore
        from fungrasp.policies.checkpoint.card import Budget, TrainingData
        from fungrasp.policies.residual_action import ResidualSettings
        from fungrasp.provenance import machine
        from fungrasp.sim2real.joint_dynamics import identified_hand
        from fungrasp.task import LiftProtocol
        from fungrasp.training.export import export_predictor, make_card
        from fungrasp.training.success_predictor import PlanOutcomes, cross_validate, fit_predictor, try_plans
        from fungrasp.training.training_sets import load_training_sets

        check_numbers(1, self.seed, self.threads)
        start, hand = perf_counter(), identified_hand(self.hand, self.hand_dynamics)
        sets = load_training_sets(self.grasps, self.objects, hand, self.method, self.terms, self.threads)
        torch.set_num_threads(1)
        folder = self.out.with_suffix(".episodes") if self.episodes is None else self.episodes
        parts, names = [], ()
        for number, one in enumerate(sets):
            with progress_bar(one.name, 1.0) as show:
                outcomes, names = try_plans(
                    one.grasps,
                    one.objects,
                    hand,
                    self.settings,
                    self.seed,
                    self.threads,
                    store=PartStore(folder / str(number)),
                    progress=show,
                )
            parts.append(outcomes)
        outcomes = PlanOutcomes.join(*parts)
        measured = cross_validate(outcomes, self.settings, seed=self.seed)
        predictor = fit_predictor(outcomes, self.settings, self.seed)
        card = make_card(
            self.out.stem,
            "predictor",
            hand,
            names,
            (),
            ResidualSettings(),
            1 / LiftProtocol().control_period,
            Budget(len(outcomes.grasp), perf_counter() - start, machine()),
            training_data=tuple(TrainingData(s.name, s.terms, len(s.grasps)) for s in sets),
            seed=self.seed,
            licence=self.licence,
            limits=("Its budget counts episodes where a policy of motions counts control steps.",),
            measured={"cross-validated, no residual": measured},
        )
        export_predictor(predictor, self.out, card)
        print(
            f"{self.out}: of grasps it has not seen, {measured['first']:.1%} hold as they are, "
            f"{measured['chosen']:.1%} of those it chooses, {measured['any']:.1%} in some variation "
            f"({len(outcomes.grasp)} episodes in {(perf_counter() - start) / 60:.1f} min)"
        )


COMMAND = TrainPredictor
