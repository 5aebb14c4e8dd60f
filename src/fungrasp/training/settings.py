"""How policies learn: settings, without what learns. The command line reads them without torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fungrasp.core.errors import FungraspError
from fungrasp.planning.selection.settings import VariationSpread
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.sim2real import MODERATE, Randomization
from fungrasp.task.features import LayoutName
from fungrasp.task.reward import RewardWeights

Sees = Literal["contacts", "nothing", "history"]
"""What an actor knows of the contacts."""

HIDDEN = (256, 128)
"""Units of the hidden layers of a policy."""


@dataclass(frozen=True)
class EnvironmentSettings:
    """How training episodes run."""

    worlds: int = 512
    """Episodes that run at once."""
    timestep: float = 0.01
    """Physics step [s]; the lift test has 0.005."""
    hold_time: float = 1.5
    """Time that the object has to be held [s]; the lift test has 3."""
    early: tuple[int, int] = (4, 14)
    """Fewest and most control steps before the fingers close at which episodes begin, on the planned path:
    with an open hand, a few centimeters from the grasp."""
    whole: float = 0.1
    """Share of episodes that begin where the lift test does."""
    widen: tuple[int, int] | None = None
    """Control steps of the training between which this share grows to all; it stays if not given."""
    lift_goal: float = 0.14
    """Height of the object that is paid in full [m]; above the test's 0.1, as what swings hangs lower."""
    randomization: Randomization = MODERATE
    """How worlds differ from the nominal ones, drawn anew in each episode."""
    layout: LayoutName = "full"
    """What networks get of what a robot has. "paper": what the paper names (section IV.B.1); "full": besides,
    distances from the object's surface, errors of servos and joints, the plan's phase, size and mass of the
    object."""
    history: bool = False
    """Whether observations hold a student's history."""
    residual: ResidualSettings = field(default_factory=ResidualSettings)
    """How far actions may depart from the plan."""
    reward: RewardWeights = field(default_factory=RewardWeights)
    """Weights of the reward's terms."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is impossible.
        """
        if self.worlds < 1:
            raise FungraspError(f"a training needs at least one world, not {self.worlds}")
        if self.early[0] > self.early[1]:
            raise FungraspError("episodes begin FEWEST to MOST steps early, not {} to {}".format(*self.early))
        if not 0 <= self.whole <= 1:
            raise FungraspError(f"the share of whole episodes is from 0 to 1, not {self.whole:g}")
        if self.widen is not None and not 0 <= self.widen[0] <= self.widen[1]:
            raise FungraspError(
                "starts widen from one control step to a later one, not {} to {}".format(*self.widen)
            )


@dataclass(frozen=True)
class Variety:
    """How many variations of a grasp there are, and how they differ."""

    copies: int = 8
    """Of each grasp: as it is, and variations of it."""
    spread: VariationSpread = field(default_factory=VariationSpread)
    """How far the variations differ from the grasp."""

    def __post_init__(self) -> None:
        if self.copies < 1:
            raise FungraspError(f"training needs at least one copy of each grasp, not {self.copies}")


@dataclass(frozen=True)
class PpoSettings:
    """Settings of PPO."""

    hidden: tuple[int, ...] = HIDDEN
    """Units of the hidden layers, of actor and value network."""
    sees: Sees = "contacts"
    """What the actor knows of the contacts: the truth (a teacher), nothing, or what an encoder infers from
    the last steps, learned along the way (a student from scratch)."""
    steps: int = 24
    """Control steps of each world between two updates."""
    epochs: int = 4
    """Passes over each batch."""
    minibatches: int = 4
    """Minibatches of each epoch."""
    gamma: float = 0.99
    """Discount per control step."""
    lam: float = 0.95
    """Decay lambda of the generalized advantage estimate."""
    clip: float = 0.2
    """Clipping range of the ratio of new to old action probabilities."""
    entropy: float = 0.001
    """Weight of the entropy bonus."""
    kl: float = 0.02
    """Change of the policy per update that the actor's learning rate adapts to."""
    learning_rate: float = 1e-4
    """Learning rate of the actor at the beginning."""
    value_learning_rate: float = 1e-3
    """Learning rate of the value network; it stays the same."""
    reward_scale: float = 0.1
    """Factor on the reward, which makes returns of the order of one."""
    noise: float = 0.15
    """Standard deviation of the exploration noise at the beginning, in units of the action."""
    noise_correlation: float | None = None
    """Correlation of the noise from one control step to the next. By default 0.95 where planned motions are
    corrected: white noise shakes the object out of the hand, slowly changing noise tries out other grasps.
    0 without a planned motion: fingers move from where they are, so that their noise adds up by itself."""
    warm_up: int = 48
    """Control steps before learning, in which only the normalisation is learned."""
    imitate: float = 0.0
    """Control steps at the beginning in which the actor imitates the planned motions, where its actions
    change something else."""


@dataclass(frozen=True)
class CurveSettings:
    """What a training's learning curve is measured on, and how often. It does not change the training, but
    for the grasps that are held out."""

    every: float = 1e5
    """Control steps between two points of the curve; 0 for no curve."""
    held_out: float = 0.0
    """Share of the grasps that are not trained on, and that the curve is measured on; without, those that are
    trained on."""
    seed: int = 0
    """Seed of the grasps and worlds that it is measured on; not of the training, so that trainings with other
    seeds can be compared."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is impossible.
        """
        if not 0 <= self.every < 1e15 or not 0 <= self.held_out < 1 or self.seed < 0:
            raise FungraspError(
                "a curve has a point in every so many steps (0: none), a share held out of 0 to below 1 and "
                f"a seed of 0 or more, not {self.every:g}, {self.held_out:g} and {self.seed}"
            )
        if self.held_out and not self.every:
            raise FungraspError("grasps are held out for the curve, which is switched off")


@dataclass(frozen=True)
class DistillSettings:
    """Settings of distillation."""

    steps: int = 24
    """Control steps of each world between two rounds of learning."""
    teacher_rounds: int = 3
    """Rounds at the beginning in which the teacher acts."""
    kept_rounds: int = 40
    """Number of last rounds whose episodes are learned from."""
    minibatch: int = 1024
    """Control steps in a minibatch."""
    updates: int = 60
    """Minibatches in each round."""
    learning_rate: float = 1e-3
    """Learning rate at the beginning; it falls to a tenth."""
    reconstruction: float = 1.0
    """Weight of L_re against L_act."""
    noise: float = 0.05
    """Standard deviation of the noise on the actions that are played."""
    estimates_contacts: bool = True
    """Whether the student infers the contacts; if not, it acts as if nothing touched, which shows what the
    inference is worth."""


@dataclass(frozen=True)
class TrainSpec:
    """How ``train`` trains a policy. A folder's training goes on with the same spec, but for ``steps``,
    ``licence``, ``shrink``, the curve and what the result does not depend on."""

    steps: float = 3e6
    """Control steps of all worlds together, earlier runs of this training included."""
    search: bool = False
    """Whether the finished policy follows, at work, the best of many plans, which rollouts decide
    (``planning.selection``), and not the grasp's own."""
    plan_file: Path | None = None
    """File of the plans to train on, which several trainings may share; in the training's folder by
    default."""
    initial: Path | None = None
    """Folder of another training, whose networks this one begins with."""
    shrink: float = 1.0
    """Factor on the finished policy's corrections, and on those of its students. A policy that has seen
    little is right about their direction more often than about their size."""
    seed: int = 0
    """Seed of all random numbers."""
    threads: int = 0
    """Threads of the simulation; 0 means all processors. The result does not depend on it."""
    device: Literal["cuda", "cpu-warp", "cpu"] | None = None
    """Where the worlds are simulated: an NVIDIA GPU, the GPU code on the CPU (slow), or the CPU.
    Default: a GPU if one is found and the extra "gpu" is installed."""
    buffers: tuple[int, int] | None = None
    """GPU buffers per world: contacts (mean) and constraint rows (maximum). Default: found by a probe."""
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

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is impossible, or actions that change planned motions, which are to be
                imitated.
        """
        check_numbers(self.steps, self.seed, self.threads)
        if self.ppo.imitate and self.environment.residual.base == "plan":
            raise FungraspError(
                "actions that change planned motions follow them from the first step: to imitate them, give "
                "--environment.residual.base guided"
            )
        if self.steps < self.ppo.imitate:
            raise FungraspError(
                f"{self.ppo.imitate:g} control steps of imitation do not fit into a training of "
                f"{self.steps:g}"
            )


@dataclass(frozen=True)
class StudentSpec:
    """How ``train_student`` distills a student from a teacher."""

    steps: float = 5e5
    """Control steps of all worlds together."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; where they were when the teacher was trained by default."""
    seed: int = 0
    """Seed of all random numbers."""
    threads: int = 0
    """Threads of the simulation; 0 means all processors."""
    settings: DistillSettings = field(default_factory=DistillSettings)
    """Settings of the learning."""

    def __post_init__(self) -> None:
        check_numbers(self.steps, self.seed, self.threads)


def check_numbers(steps: float, seed: int, threads: int) -> None:
    """Complain about impossible ones.

    Raises:
        FungraspError: one is.
    """
    if not 1 <= steps < 1e15:
        raise FungraspError(f"--steps must be at least 1, not {steps:g}")
    if seed < 0 or threads < 0:
        raise FungraspError("--seed and --threads must not be negative")
