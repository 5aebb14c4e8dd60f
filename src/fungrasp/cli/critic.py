"""``fungrasp critic``: learns which variations of a grasp will hold."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from fungrasp.cli.train import check_numbers, check_packages, training_sets
from fungrasp.training.settings import PlanSettings


@dataclass(frozen=True)
class Critic:
    """Try many variations of grasps in physics, and train a critic that chooses among such variations.

    Its file is a policy: `fungrasp evaluate --policy critic.onnx` plays the plans that it chooses.
    """

    out: Path
    """The critic's file (.onnx)."""
    grasps: tuple[str, ...] = ("builtin",)
    """Files of human grasps (they are retargeted first) or of robot grasps of --hand, or "builtin"; several
    are learned from together."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    method: str = "ours"
    """How human grasps are retargeted: ours, angle-copy or dexgraspnet."""
    trials: Path | None = None
    """Folder in which the trials' outcomes are kept, so that an interrupted command goes on where it was, and
    more --attempts add to them; beside --out by default."""
    seed: int = 0
    """Of everything that is random."""
    threads: int = 0
    """Of the simulation; 0 means all processors. The result does not depend on it."""
    terms: tuple[str, ...] = ()
    """Under what terms each of --grasps may be used, for the critic's card."""
    licence: str = ""
    """Of the critic, for its card."""
    settings: PlanSettings = field(default_factory=PlanSettings)

    def run(self) -> None:
        check_packages()
        from time import perf_counter

        import torch

        from fungrasp.cli.console import progress_bar
        from fungrasp.hands import load_hand
        from fungrasp.policies.checkpoint.card import Budget, TrainingData
        from fungrasp.policies.residual_action import ResidualSettings
        from fungrasp.provenance import machine
        from fungrasp.task import Protocol
        from fungrasp.training.export import export_critic, make_card
        from fungrasp.training.plans import Outcomes, cross_validate, fit_critic, try_plans

        check_numbers(1, self.seed, self.threads)
        start, hand = perf_counter(), load_hand(self.hand)
        sets = training_sets(self.grasps, self.objects, hand, self.method, self.terms, self.threads)
        torch.set_num_threads(1)
        folder = self.out.with_suffix(".trials") if self.trials is None else self.trials
        parts, names = [], ()
        for number, one in enumerate(sets):
            with progress_bar(one.name, len(one.grasps) * self.settings.attempts) as show:
                outcomes, names = try_plans(
                    one.grasps,
                    one.objects,
                    hand,
                    self.settings,
                    self.seed,
                    self.threads,
                    show,
                    folder / str(number),
                )
            parts.append(outcomes)
        outcomes = Outcomes.join(*parts)
        measured = cross_validate(outcomes, self.settings, seed=self.seed)
        critic = fit_critic(outcomes, self.settings, self.seed)
        card = make_card(
            self.out.stem,
            "critic",
            hand,
            names,
            (),
            ResidualSettings(),
            1 / Protocol().control_period,
            Budget(len(outcomes.grasp), perf_counter() - start, machine()),
            training_data=tuple(TrainingData(s.name, s.terms, len(s.grasps)) for s in sets),
            seed=self.seed,
            licence=self.licence,
            limits=("Its budget counts trials where a policy of motions counts control steps.",),
            measured={"cross-validated, no residual": measured},
        )
        export_critic(critic, self.out, card)
        print(
            f"{self.out}: of grasps it has not seen, {measured['first']:.1%} hold as they are, "
            f"{measured['chosen']:.1%} of those it chooses, {measured['any']:.1%} in some variation "
            f"({len(outcomes.grasp)} trials in {(perf_counter() - start) / 60:.1f} min)"
        )


COMMAND = Critic
