"""``fungrasp predictor``: learns which variations of a grasp will hold."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from fungrasp.cli.console import Answer, Answering
from fungrasp.cli.training_options import check_numbers, check_packages
from fungrasp.training.settings import PredictorSettings


@dataclass(frozen=True)
class TrainPredictor(Answering):
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

    def run(self) -> Answer:
        check_packages()
        import torch

        from fungrasp.cli.console import progress_bar
        from fungrasp.sim2real.joint_dynamics import identified_hand
        from fungrasp.training.predictor_run import MEASURED, train_predictor
        from fungrasp.training.training_sets import load_training_sets

        check_numbers(1, self.seed, self.threads)
        hand = identified_hand(self.hand, self.hand_dynamics)
        sets = load_training_sets(self.grasps, self.objects, hand, self.method, self.terms, self.threads)
        torch.set_num_threads(1)
        with progress_bar("trying plans", 1.0) as show:
            card = train_predictor(
                self.out,
                sets,
                hand,
                self.settings,
                self.seed,
                episodes=self.episodes,
                licence=self.licence,
                threads=self.threads,
                progress=show,
            )
        measured, budget = card.measured[MEASURED], card.budget
        return Answer(
            {"policy": self.out, "card": card.to_json()},
            f"{self.out}: of grasps it has not seen, {measured['first']:.1%} hold as they are, "
            f"{measured['chosen']:.1%} of those it chooses, {measured['any']:.1%} in some variation "
            f"({budget.steps} episodes in {budget.seconds / 60:.1f} min)",
        )


COMMAND = TrainPredictor
