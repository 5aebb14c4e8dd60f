"""The teacher: PPO, through rsl-rl-lib."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import Array, array_namespace
from fungrasp.policies.residual_action import Base
from fungrasp.task.environment import report_problems
from fungrasp.training.checkpoint import (
    check_environment,
    environment_state,
    read_checkpoint,
    restore_environment,
    write_checkpoint,
)
from fungrasp.training.environment import TrainingEnvironment
from fungrasp.training.imitation import MotionImitation
from fungrasp.training.networks import ColoredGaussian, make_networks, played, tensors
from fungrasp.training.processes import Processes
from fungrasp.training.settings import PpoSettings
from fungrasp.training.student import StudentModel

ALONE = Processes()
VALUE_UPDATES = 5
"""Updates after an imitation in which the value network alone learns: the actor would unlearn what it has
while nothing is known of its returns."""

NOISE_CORRELATION: Mapping[Base, float] = {"plan": 0.95, "guided": 0.0}
"""Correlation of the exploration noise from one control step to the next, by what an action changes. Fingers
that move from where they are add up their noise: at 0.95, with the noise of ``train``'s example without a
planned motion, by 2 rad in 3 s, at 0 by 0.5 rad."""


@dataclass(frozen=True)
class Progress:
    """Where a training stands."""

    steps: int
    """Control steps so far."""
    seconds: float
    """Time that the training has taken so far [s]."""
    success: float
    """Share of the last episodes that succeeded, exploration noise included."""
    reward: float
    """Mean reward per control step."""
    noise: float
    """Mean standard deviation of the actions."""
    learning_rate: float
    """Learning rate of the actor."""
    losses: dict[str, float]
    """Losses of the last update, by name."""
    terms: dict[str, float]
    """Mean of each reward term over the last batch, by name."""


class Trainer:
    """PPO on a ``TrainingEnvironment``: collects, learns, keeps checkpoints."""

    def __init__(
        self,
        environment: TrainingEnvironment,
        settings: PpoSettings | None = None,
        seed: int = 0,
        processes: Processes = ALONE,
    ):
        """
        Args:
            environment: to learn in.
            settings: the defaults if None.
            seed: of the networks and of exploration.
            processes: that learn together, each in an environment of its own.
        """
        torch.manual_seed(seed + processes.number)
        self.environment, self._seed, self._processes = environment, seed, processes
        environment.processes = processes.count
        s = self.settings = settings or PpoSettings()
        correlation = s.noise_correlation
        if correlation is None:
            correlation = NOISE_CORRELATION[environment.settings.residual.base]
        actor, critic = make_networks(environment, s.sees, s.hidden, s.noise, correlation)
        observations = tensors(environment.observations)
        worlds = environment.settings.worlds
        device = str(observations.device)
        storage = RolloutStorage("rl", worlds, s.steps, observations, [environment.actions], device)
        self.algorithm = PPO(
            actor,
            critic,
            storage,
            num_learning_epochs=s.epochs,
            num_mini_batches=s.minibatches,
            clip_param=s.clip,
            gamma=s.gamma,
            lam=s.lam,
            entropy_coef=s.entropy,
            use_clipped_value_loss=False,
            learning_rate=s.learning_rate,
            schedule="fixed",
            max_grad_norm=0.5,
            device=device,
            multi_gpu_cfg=(
                {"global_rank": processes.number, "world_size": processes.count}
                if processes.count > 1
                else None
            ),
        )
        if processes.count > 1:
            self.algorithm.broadcast_parameters()
        # The actor's steps are small against those the value network needs.
        self.algorithm.optimizer = torch.optim.Adam(
            [
                {"params": list(actor.parameters()), "lr": s.learning_rate},
                {"params": list(critic.parameters()), "lr": s.value_learning_rate},
            ]
        )
        if isinstance(actor, StudentModel):
            encoder = [*actor.encoder.parameters(), *actor.head.parameters()]
            self._encoder_optimizer = torch.optim.Adam(encoder, lr=s.value_learning_rate)
        self.steps, self.seconds = 0, 0.0
        """Control steps, and what they took [s], earlier runs included."""
        self._begun = False
        """Whether its networks come from another training."""
        self._recent: deque[bool] = deque(maxlen=1000)

    @property
    def actor(self) -> MLPModel:
        """The policy's network."""
        return self.algorithm.get_policy()

    @property
    def _batch(self) -> int:
        """Control steps of an update, of all processes."""
        return self.settings.steps * self.environment.settings.worlds * self._processes.count

    @property
    def success(self) -> float:
        """Share of the last episodes that succeeded; 0 before any has ended."""
        return float(np.mean(self._recent)) if self._recent else 0.0

    def learn(
        self,
        steps: int,
        progress: Callable[[Progress], None] = lambda p: None,
        checkpoint: Path | None = None,
        every: int = 20,
    ) -> None:
        """Go on until this many control steps have been made in all.

        Args:
            steps: since the beginning, earlier runs included.
            progress: called after each update.
            checkpoint: where to keep the state, written atomically.
            every: updates between two checkpoints, at which all episodes begin anew: a training that goes on
            from one ends as if it had never been interrupted.
        """
        start, before = perf_counter(), self.seconds
        self.algorithm.train_mode()
        if self.steps == 0 and not self._begun:
            self._warm_up()
        imitation = MotionImitation(self.actor, self.environment, self.settings.steps)
        while self.steps < steps:
            imitates = self.steps < self.settings.imitate
            report = self._imitate(imitation) if imitates else self._update()
            self.seconds = before + perf_counter() - start
            progress(
                Progress(
                    self.steps,
                    self.seconds,
                    self.success,
                    report["reward"],
                    float(self.actor.output_std.detach().mean()),
                    self.algorithm.optimizer.param_groups[0]["lr"],
                    report["losses"],
                    report["terms"],
                )
            )
            if self.steps < self.settings.imitate:
                # An imitation that was interrupted begins anew: it takes a few minutes.
                continue
            if self.steps // self._batch % every == 0:
                if checkpoint is not None:
                    self.save(checkpoint)
                self._restart()
            elif checkpoint is not None and self.steps >= steps:
                self.save(checkpoint)

    def _restart(self) -> None:
        """Begin new episodes with new noise."""
        if self._processes.count > 1:
            self._begin_random_numbers()
        self.environment.restart()
        self._restart_noise()

    def _begin_random_numbers(self) -> None:
        """Random numbers of this process's own, the same whether or not it was interrupted; the success of
        the grasps is the first one's, whose checkpoints all go on from."""
        rng, rates = self.environment.rng, self.environment.success_of_group
        own = np.random.default_rng([self._seed, self._processes.number, self.steps])
        rng.bit_generator.state = own.bit_generator.state
        torch.manual_seed(int(own.integers(2**62)))
        shared = torch.as_tensor(rates.copy(), device=self.algorithm.device)
        torch.distributed.broadcast(shared, src=0)
        rates[:] = shared.cpu().numpy()

    def _restart_noise(self) -> None:
        noise = self.actor.distribution
        if isinstance(noise, ColoredGaussian):
            noise.restart()

    def _warm_up(self) -> None:
        """Play the plans without a residual, to learn the normalization of observations."""
        still = array_namespace(self.environment.tracker.action).zeros_like(self.environment.tracker.action)
        for _ in range(self.settings.warm_up):
            self.environment.step(still)
            observations = tensors(self.environment.observations)
            self.actor.update_normalization(observations)
            self.algorithm.critic.update_normalization(observations)

    def _imitate(self, imitation: MotionImitation) -> dict[str, Any]:
        reward, loss, ended = imitation.round()
        self._recent.extend(ended)
        self.steps += self._batch
        return {"reward": reward, "losses": {"imitation": loss}, "terms": {}}

    def _update(self) -> dict[str, Any]:
        algorithm, environment = self.algorithm, self.environment
        rewards: list[Array] = []
        terms: list[dict[str, Array]] = []
        observations = tensors(environment.observations)
        with torch.no_grad():
            for _ in range(self.settings.steps):
                action = algorithm.act(observations)
                step = environment.step(played(environment, action))
                observations = tensors(environment.observations)
                reward = self.settings.reward_scale * torch.as_tensor(step.reward).float()
                algorithm.process_env_step(observations, reward, torch.as_tensor(step.done), {})
                self._recent.extend(environment.ended.success.tolist())
                rewards.append(step.reward.mean())
                terms.append(step.terms)
            algorithm.compute_returns(observations)
            self.actor(observations, stochastic_output=True)
            before = tuple(p.clone() for p in self.actor.output_distribution_params)
        report_problems(environment.episodes.engine)
        group = algorithm.optimizer.param_groups[0]
        rate = group["lr"]
        still = self.settings.imitate > 0 and self.steps < self.settings.imitate + VALUE_UPDATES * self._batch
        group["lr"] = 0.0 if still else rate
        losses = algorithm.update()
        group["lr"] = rate
        losses["kl"] = 0.0 if still else self._adapt(observations, before)
        if isinstance(self.actor, StudentModel):
            losses["reconstruction"] = self._reconstruct(self.actor)
        self.steps += self._batch
        return {
            "reward": float(np.mean([float(reward) for reward in rewards])),
            "losses": losses,
            "terms": {name: float(np.mean([float(t[name]) for t in terms])) for name in terms[0]},
        }

    def _reconstruct(self, student: StudentModel) -> float:
        """Teach a student's encoder the contacts of the last batch; gives its last loss."""
        kept = self.algorithm.storage.observations.flatten(0, 1)
        loss = torch.zeros(())
        for rows in torch.randperm(len(kept), device=kept.device).split(1024):
            loss = student.reconstruction_loss(kept[rows])
            self._encoder_optimizer.zero_grad()
            loss.backward()
            if self._processes.count > 1:
                self.algorithm.reduce_parameters()
            self._encoder_optimizer.step()
        return float(loss.detach())

    def _adapt(self, observations: TensorDict, before: tuple[torch.Tensor, ...]) -> float:
        """Change the actor's learning rate so that an update changes the policy as much as wanted.

        Returns:
            How much the last one did.
        """
        with torch.inference_mode():
            self.actor(observations, stochastic_output=True)
            change = float(self.actor.get_kl_divergence(before, self.actor.output_distribution_params).mean())
        change = self._processes.mean(change, self.algorithm.device)
        group, wanted = self.algorithm.optimizer.param_groups[0], self.settings.kl
        if change > 1.5 * wanted:
            group["lr"] = max(1e-6, group["lr"] / 1.3)
        elif change < wanted / 1.5:
            group["lr"] = min(3e-3, group["lr"] * 1.3)
        return change

    def save(self, path: Path) -> None:
        """Keep everything needed to go on.

        Raises:
            FungraspError: the file can't be written; an older one is left as it was.
        """
        state = self.algorithm.save() | environment_state(self.environment)
        if isinstance(self.actor, StudentModel):
            state["encoder_optimizer_state_dict"] = self._encoder_optimizer.state_dict()
        state |= {"steps": self.steps, "seconds": self.seconds, "recent": torch.tensor(list(self._recent))}
        write_checkpoint(path, state)

    def begin_from(self, path: Path) -> None:
        """Take the networks of another training's checkpoint, and nothing else: noise begins as set.

        Raises:
            FungraspError: it can't be read, is damaged, or belongs to another hand, other observations or
                other networks.
        """
        state = read_checkpoint(path)
        check_environment(path, state, self.environment)
        self._begun = True
        noise = self.actor.distribution
        wanted = {} if noise is None else {name: p.clone() for name, p in noise.state_dict().items()}
        with _fitting(path):
            self.algorithm.load(state, {"actor": True, "critic": True}, True)
        if noise is not None:
            noise.load_state_dict(wanted)

    def load(self, path: Path) -> None:
        """Go on from a checkpoint.

        Raises:
            FungraspError: it can't be read, is damaged, or belongs to another hand, other observations or
                other networks.
        """
        state = read_checkpoint(path)
        check_environment(path, state, self.environment)
        with _fitting(path):
            self.algorithm.load(state, None, True)
            if isinstance(self.actor, StudentModel):
                self._encoder_optimizer.load_state_dict(state["encoder_optimizer_state_dict"])
            restore_environment(state, self.environment)
            self._restart_noise()
            self.steps, self.seconds = int(state["steps"]), float(state["seconds"])
            self._recent.extend(state["recent"].bool().tolist())
        if self._processes.count > 1:
            self._restart()


@contextmanager
def _fitting(path: Path) -> Iterator[None]:
    """Say in words that a checkpoint is of other networks."""
    try:
        yield
    except (RuntimeError, ValueError, KeyError) as error:
        words = " ".join(str(error).split())
        raise FungraspError(f"the checkpoint {path} does not fit these settings: {words}") from error
