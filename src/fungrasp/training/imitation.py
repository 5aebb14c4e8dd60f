"""Imitation of another network or of planned motions, on episodes that the learner plays itself (DAgger, Ross
et al., AISTATS 2011)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict

from fungrasp.training.environment import Step, TrainingEnvironment
from fungrasp.training.networks import StudentModel, played, tensors
from fungrasp.training.settings import DistillSettings

PLANNED_ROUNDS = 2
"""Rounds at the start in which the planned motions act."""

UPDATES = 240
"""Minibatches in each round. With 60, success after 70,000 control steps was 62 % instead of 66 %; learning
takes less time than simulation."""


def imitated_round(
    environment: TrainingEnvironment,
    steps: int,
    noise: float,
    choose: Callable[[TensorDict], tuple[torch.Tensor, torch.Tensor]],
    done: Callable[[Step], None],
) -> TensorDict:
    """Play S control steps in W worlds.

    Args:
        noise: standard deviation of the noise added to played actions.
        choose: returns, for observations, the actions to play and the target actions, shape [W, A] each.
        done: called after each step.

    Returns:
        training data, shape [S W]: observations, and target actions as the group "action".
    """
    batches = []
    with torch.no_grad():
        for _ in range(steps):
            observations = tensors(environment.observations)
            action, wanted = choose(observations)
            batches.append(observations.exclude("value").clone().update({"action": wanted}))
            step = environment.step(played(environment, action + noise * torch.randn_like(action)))
            done(step)
    return torch.cat(batches)  # type: ignore[arg-type]


def learn_imitation(
    model: MLPModel,
    optimizer: torch.optim.Optimizer,
    kept: Sequence[TensorDict],
    s: DistillSettings,
    largest_gradient: float | None = None,
) -> tuple[float, float]:
    """Learn from the last rounds. Return the mean squared difference of the actions and the mean loss L_re of
    a student's encoder."""
    losses = np.zeros(2)
    for _ in range(s.updates):
        part = kept[int(torch.randint(len(kept), ()))]
        batch = part[torch.randint(len(part), (s.minibatch,))].clone()
        imitation = ((model(batch) - batch["action"]) ** 2).mean()
        reconstruction = torch.zeros(())
        if isinstance(model, StudentModel):
            reconstruction = model.reconstruction_loss(batch)
        optimizer.zero_grad()
        (imitation + s.reconstruction * reconstruction).backward()
        if largest_gradient is not None:
            torch.nn.utils.clip_grad_norm_(model.parameters(), largest_gradient)
        optimizer.step()
        losses += [float(imitation.detach()), float(reconstruction.detach())]
    means = losses / s.updates
    return float(means[0]), float(means[1])


class MotionImitation:
    """Trains an actor to imitate planned motions in the states that it reaches itself; for policies that do
    not follow planned motions."""

    def __init__(self, actor: MLPModel, environment: TrainingEnvironment, steps: int):
        """
        Args:
            environment: environment whose actions do not correct planned motions.
            steps: control steps of each world in a round.
        """
        self._actor, self._environment, self._steps = actor, environment, steps
        self._settings = DistillSettings(updates=UPDATES)
        self._optimizer = torch.optim.Adam(actor.parameters(), lr=self._settings.learning_rate)
        self._kept: deque[TensorDict] = deque(maxlen=self._settings.kept_rounds)
        self._rounds = 0

    def round(self) -> tuple[float, float, list[bool]]:
        """Play and learn one round.

        Returns:
            mean reward, mean loss, and whether each ended episode succeeded.
        """
        environment, actor, s = self._environment, self._actor, self._settings
        rewards: list[float] = []
        ended: list[bool] = []

        def choose(observations: TensorDict) -> tuple[torch.Tensor, torch.Tensor]:
            actor.update_normalization(observations)
            wanted = torch.as_tensor(environment.tracker.planned_action()).float()
            return wanted if self._rounds < PLANNED_ROUNDS else actor(observations), wanted

        def done(step: Step) -> None:
            rewards.append(float(step.reward.mean()))
            ended.extend(environment.ended.success.tolist())

        self._kept.append(imitated_round(environment, self._steps, s.noise, choose, done))
        self._rounds += 1
        loss = sum(learn_imitation(actor, self._optimizer, self._kept, s))
        with torch.inference_mode():
            # Progress reports the noise of the last distribution.
            actor(tensors(environment.observations), stochastic_output=True)
        return float(np.mean(rewards)), loss, ended
