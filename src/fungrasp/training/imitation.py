"""Imitation of planned motions: how a policy that follows none begins to learn (DAgger, Ross et al., AISTATS
2011)."""

from __future__ import annotations

from collections import deque

import numpy as np
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict

from fungrasp.training.environment import TrainingEnvironment
from fungrasp.training.networks import StudentModel, played, tensors

PLANNED_ROUNDS = 2
"""Rounds at the beginning in which the planned motions act."""
KEPT_ROUNDS = 40
"""Number of last rounds that are learned from."""
UPDATES, MINIBATCH = 60, 1024
"""Minibatches in each round, and control steps in one."""
NOISE = 0.05
"""Standard deviation of the noise on the actions that are played."""
LEARNING_RATE = 1e-3
"""Of Adam."""


class MotionImitation:
    """An actor learns to do what the planned motions would, where its own actions lead."""

    def __init__(self, actor: MLPModel, environment: TrainingEnvironment, steps: int):
        """
        Args:
            actor: that learns.
            environment: whose actions change something else than planned motions.
            steps: control steps of each world in a round.
        """
        self._actor, self._environment, self._steps = actor, environment, steps
        self._optimizer = torch.optim.Adam(actor.parameters(), lr=LEARNING_RATE)
        self._kept: deque[TensorDict] = deque(maxlen=KEPT_ROUNDS)
        self._rounds = 0

    def round(self) -> tuple[float, float, list[bool]]:
        """Play and learn once.

        Returns:
            mean reward, mean loss, and whether each episode that ended succeeded.
        """
        environment, actor = self._environment, self._actor
        batches, rewards, ended = [], [], []
        with torch.no_grad():
            for _ in range(self._steps):
                observations = tensors(environment.observations)
                actor.update_normalization(observations)
                wanted = torch.as_tensor(environment.tracker.planned_action()).float()
                action = wanted if self._rounds < PLANNED_ROUNDS else actor(observations)
                batches.append(observations.clone().update({"action": wanted}))
                noisy = action + NOISE * torch.randn_like(action)
                step = environment.step(played(environment, noisy))
                rewards.append(step.reward.mean())
                ended.extend(environment.ended.success.tolist())
        self._kept.append(torch.cat(batches))  # type: ignore[arg-type]
        self._rounds += 1
        loss = self._learn()
        with torch.inference_mode():
            # What is reported of the noise is of the last actions.
            actor(tensors(environment.observations), stochastic_output=True)
        return float(np.mean([float(reward) for reward in rewards])), loss, ended

    def _learn(self) -> float:
        losses = 0.0
        for _ in range(UPDATES):
            part = self._kept[int(torch.randint(len(self._kept), ()))]
            batch = part[torch.randint(len(part), (MINIBATCH,))].clone()
            loss = ((self._actor(batch) - batch["action"]) ** 2).mean()
            if isinstance(self._actor, StudentModel):
                loss = loss + self._actor.reconstruction_loss(batch)
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()
            losses += float(loss.detach())
        return losses / UPDATES
