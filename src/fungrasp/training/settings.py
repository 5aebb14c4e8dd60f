"""How policies learn: settings, without what learns. The command line reads them without torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Sees = Literal["contacts", "nothing", "history"]
"""What an actor knows of the contacts."""

HIDDEN = (256, 128)
"""Units of the hidden layers of a policy."""


@dataclass(frozen=True)
class PpoSettings:
    """Of PPO."""

    hidden: tuple[int, ...] = HIDDEN
    """Units of the hidden layers, of actor and value network."""
    sees: Sees = "contacts"
    """What the actor knows of the contacts: the truth (a teacher), nothing, or what an encoder infers from
    the last steps, learned along the way (a student from scratch)."""
    steps: int = 24
    """Control steps of each world between two updates."""
    epochs: int = 4
    """Over each batch."""
    minibatches: int = 4
    """Of each epoch."""
    gamma: float = 0.99
    """Discount per control step."""
    lam: float = 0.95
    """Of the generalised advantage estimate."""
    clip: float = 0.2
    """Of the ratio of probabilities."""
    entropy: float = 0.001
    """Weight of the entropy."""
    kl: float = 0.02
    """Change of the policy per update that the actor's learning rate adapts to."""
    learning_rate: float = 1e-4
    """Of the actor, to begin with."""
    value_learning_rate: float = 1e-3
    """Of the value network; it stays the same."""
    reward_scale: float = 0.1
    """Makes returns of the order of one."""
    noise: float = 0.15
    """Standard deviation of the actions, to begin with."""
    noise_correlation: float = 0.95
    """Of the noise from one control step to the next. White noise shakes the object out of the hand; noise
    that changes slowly tries out other grasps."""
    warm_up: int = 48
    """Control steps before learning, in which only the normalisation is learned."""


@dataclass(frozen=True)
class DistillSettings:
    """Of distillation."""

    steps: int = 24
    """Control steps of each world between two rounds of learning."""
    teacher_rounds: int = 3
    """Rounds at the beginning in which the teacher acts."""
    kept_rounds: int = 40
    """Rounds whose trials are learned from."""
    minibatch: int = 1024
    updates: int = 60
    """Minibatches in each round."""
    learning_rate: float = 1e-3
    """At the beginning; it falls to a tenth."""
    reconstruction: float = 1.0
    """Weight of L_re against L_act."""
    noise: float = 0.05
    """Standard deviation of the noise on the actions that are played."""


@dataclass(frozen=True)
class PredictorSettings:
    """Of the episodes that a success predictor learns from, and of its learning."""

    attempts: int = 24
    """Variations of each grasp, the unchanged one included."""
    timestep: float = 0.01
    """Physics step [s]."""
    hold_time: float = 2.0
    """Time that the object has to be held [s]; the lift test has 3."""
    early: int = 5
    """Control steps before the fingers close at which episodes begin."""
    chunk: int = 512
    """Episodes simulated together."""
    networks: int = 4
    """Networks whose mean is the predictor."""
    hidden: tuple[int, int] = (256, 128)
    """Units of a network's hidden layers."""
    dropout: float = 0.3
    weight_decay: float = 0.02
    learning_rate: float = 1e-3
    """At the beginning; it falls to zero."""
    epochs: int = 10
    minibatch: int = 256
