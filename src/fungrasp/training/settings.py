"""Settings of training, without importing torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import CheckedRecord
from fungrasp.planning.selection.settings import VariationSpread
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.sim2real import MODERATE, Randomization
from fungrasp.task.features import LayoutName
from fungrasp.task.reward import RewardWeights

Sees = Literal["contacts", "nothing", "history"]
"""Contact information of an actor."""

HIDDEN = (256, 128)
"""Hidden layer sizes of a policy."""


@dataclass(frozen=True)
class EnvironmentSettings(CheckedRecord):
    """Settings of training episodes."""

    worlds: int = 512
    """Number of parallel worlds."""
    timestep: float = 0.01
    """Physics step [s]; 0.005 in the lift test."""
    hold_time: float = 1.5
    """Duration of the hold [s]; 3 in the lift test."""
    early: tuple[int, int] = (4, 14)
    """Start of episodes on the planned path: fewest and most control steps before the fingers close. The hand
    is open, a few centimeters from the grasp."""
    whole: float = 0.1
    """Share of episodes that start like the lift test."""
    widen: tuple[int, int] | None = None
    """Range of training steps in which this share grows to 1. Default: it stays constant."""
    lift_goal: float = 0.14
    """Height for the full lift reward [m]; above the test's 0.1, because swinging objects hang lower."""
    randomization: Randomization = MODERATE
    """Randomization of worlds in each episode."""
    layout: LayoutName = "full"
    """Network inputs. "paper": as in the paper (section IV.B.1). "full": also distances from the object's
    surface, errors of servos and joints, phase of the plan, size and mass of the object."""
    history: bool = False
    """Whether observations include a student's history."""
    residual: ResidualSettings = field(default_factory=ResidualSettings)
    """Scale of corrections to the plan."""
    reward: RewardWeights = field(default_factory=RewardWeights)
    """Weights of the reward terms."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is invalid.
        """
        super().__post_init__()
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
class Variety(CheckedRecord):
    """Variations of each grasp."""

    copies: int = 8
    """Copies of each grasp: the original and its variations."""
    spread: VariationSpread = field(default_factory=VariationSpread)
    """Spread of the variations."""
    held: bool = False
    """Train only on plans that hold the object as shown in the believed world. This suits imitation; policies
    that correct plans also learn from plans that fail."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.copies < 1:
            raise FungraspError(f"training needs at least one copy of each grasp, not {self.copies}")


@dataclass(frozen=True)
class PpoSettings(CheckedRecord):
    """Settings of PPO."""

    hidden: tuple[int, ...] = HIDDEN
    """Hidden layer sizes of actor and value network."""
    sees: Sees = "contacts"
    """Contact information of the actor: the truth (a teacher), nothing, or estimates of an encoder from the
    last steps, trained at the same time (a student from scratch)."""
    steps: int = 24
    """Control steps per world between two updates."""
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
    """Target KL divergence per update; the actor's learning rate adapts to it."""
    learning_rate: float = 1e-4
    """Initial learning rate of the actor."""
    value_learning_rate: float = 1e-3
    """Constant learning rate of the value network."""
    reward_scale: float = 0.1
    """Factor on the reward, for returns around one."""
    noise: float = 0.15
    """Initial standard deviation of the exploration noise, in action units."""
    noise_correlation: float | None = None
    """Correlation of the noise between control steps. Default: 0.95 for corrections of planned motions,
    because white noise shakes the object out of the hand; 0 without a planned motion, where noise accumulates
    by itself."""
    warm_up: int = 48
    """Control steps before learning, which only set the normalization."""
    imitate: float = 0.0
    """Control steps at the start in which the actor imitates planned motions (only for "guided" actions)."""


@dataclass(frozen=True)
class CurveSettings(CheckedRecord):
    """Learning curve. It does not affect the training, except for held-out grasps."""

    every: float = 1e5
    """Control steps between two points; 0 for no curve."""
    held_out: float = 0.0
    """Share of grasps held out from training to measure the curve on. 0: use the training grasps."""
    seed: int = 0
    """Seed of the grasps and worlds of the curve. It is independent of the training seed, so runs can be
    compared."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is invalid.
        """
        super().__post_init__()
        if not 0 <= self.every < 1e15 or not 0 <= self.held_out < 1 or self.seed < 0:
            raise FungraspError(
                "a curve needs every of 0 (no curve) or more, held_out from 0 to below 1 and a seed of 0 or "
                f"more, not {self.every:g}, {self.held_out:g} and {self.seed}"
            )
        if self.held_out and not self.every:
            raise FungraspError("curve.held_out needs a learning curve, but curve.every is 0")


@dataclass(frozen=True)
class DistillSettings(CheckedRecord):
    """Settings of distillation."""

    steps: int = 24
    """Control steps per world between two rounds of learning."""
    teacher_rounds: int = 3
    """Rounds at the start in which the teacher acts."""
    kept_rounds: int = 40
    """Number of recent rounds to learn from."""
    minibatch: int = 1024
    """Control steps in a minibatch."""
    updates: int = 60
    """Minibatches in each round."""
    learning_rate: float = 1e-3
    """Initial learning rate; it falls to a tenth."""
    reconstruction: float = 1.0
    """Weight of L_re against L_act."""
    noise: float = 0.05
    """Standard deviation of the action noise."""
    estimates_contacts: bool = True
    """Whether the student infers contacts. If not, it assumes no contacts (an ablation)."""


@dataclass(frozen=True)
class TrainSpec(CheckedRecord):
    """Settings of ``train``. To continue a training, use the same spec; only ``steps``, ``licence``,
    ``shrink``, the curve, and settings without effect on the result may change."""

    steps: float = 3e6
    """Control steps of all worlds together, including earlier runs of this training."""
    search: bool = False
    """After training, let the policy follow the best of many plans, selected by rollouts, instead of one plan
    per grasp."""
    plan_file: Path | None = None
    """File of the plans to train on, which several trainings can share. Default: in the training's folder."""
    initial: Path | None = None
    """Folder of another training; start from its networks."""
    shrink: float = 1.0
    """Factor on the corrections of the finished policy and its students. After little training, their
    direction is more reliable than their size."""
    seed: int = 0
    """Seed of all random numbers."""
    threads: int = 0
    """Threads of the simulation; 0 for all processors. Results do not depend on it."""
    device: Literal["cuda", "cpu-warp", "cpu"] | None = None
    """Device of the simulation: an NVIDIA GPU, the GPU code on the CPU (slow), or the CPU.
    Default: a GPU if one is found and the extra "gpu" is installed."""
    buffers: tuple[int, int] | None = None
    """GPU buffers per world: contacts (mean) and constraint rows (maximum). Default: found by a
    probe."""
    licence: str = ""
    """License of the policy, for its card."""
    curve: CurveSettings = field(default_factory=CurveSettings)
    """Settings of the learning curve (curve.csv and curve.svg in the training's folder)."""
    environment: EnvironmentSettings = field(default_factory=EnvironmentSettings)
    """Settings of the training worlds."""
    ppo: PpoSettings = field(default_factory=PpoSettings)
    """Settings of PPO."""
    variety: Variety = field(default_factory=Variety)
    """Variations of the training grasps."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is invalid, or corrections of planned motions are combined with imitation.
        """
        super().__post_init__()
        check_numbers(self.steps, self.seed, self.threads)
        if self.ppo.imitate and self.environment.residual.base == "plan":
            raise FungraspError(
                "corrections follow the planned motion from the start: ppo.imitate needs "
                "environment.residual.base 'guided'"
            )
        if self.steps < self.ppo.imitate:
            raise FungraspError(
                f"{self.ppo.imitate:g} control steps of imitation do not fit into a training of "
                f"{self.steps:g}"
            )


@dataclass(frozen=True)
class StudentSpec(CheckedRecord):
    """Settings of the distillation of a student."""

    steps: float = 5e5
    """Control steps of all worlds together."""
    objects: Path | None = None
    """Folder of meshes <name>.obj. Default: the folder used to train the teacher."""
    seed: int = 0
    """Seed of all random numbers."""
    threads: int = 0
    """Threads of the simulation; 0 for all processors."""
    settings: DistillSettings = field(default_factory=DistillSettings)
    """Settings of the learning."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self.steps, self.seed, self.threads)


def check_numbers(steps: float, seed: int, threads: int) -> None:
    """Check numbers that several commands share.

    Raises:
        FungraspError: a number is out of range.
    """
    if not 1 <= steps < 1e15:
        raise FungraspError(f"steps must be at least 1, not {steps:g}")
    if seed < 0 or threads < 0:
        raise FungraspError("seed and threads must not be negative")
