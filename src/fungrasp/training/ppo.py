"""Training of teachers with PPO (rsl-rl-lib); with ``torchrun``, several processes learn together."""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.env import VecEnv
from rsl_rl.models import MLPModel
from rsl_rl.runners import OnPolicyRunner
from rsl_rl.storage import RolloutStorage
from rsl_rl.utils.logger import Logger
from tensordict import TensorDict

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import Array, array_namespace
from fungrasp.policies.residual_action import Base
from fungrasp.simulation import Device
from fungrasp.task.environment import report_problems
from fungrasp.training.environment import TrainingEnvironment
from fungrasp.training.folder import (
    check_environment,
    environment_state,
    read_checkpoint,
    restore_environment,
    write_checkpoint,
)
from fungrasp.training.imitation import MotionImitation
from fungrasp.training.networks import ColoredGaussian, StudentModel, make_networks, played, tensors
from fungrasp.training.settings import PpoSettings

VALUE_UPDATES = 5
"""Updates after an imitation in which only the value network learns. Without them, the actor would lose what
it has imitated before returns are known."""

NOISE_CORRELATION: Mapping[Base, float] = {"plan": 0.95, "guided": 0.0}
"""Correlation of exploration noise between control steps, by base of the actions. Finger targets relative to
the measured joints accumulate noise: with the noise of ``train``'s example without a planned motion, by 2 rad
in 3 s at 0.95, and by 0.5 rad at 0."""


class Processes(NamedTuple):
    """Number of processes, and index of this one."""

    count: int = 1
    """Number of processes."""
    number: int = 0
    """Index of this process."""

    @property
    def first(self) -> bool:
        """Whether this process writes files and prints."""
        return self.number == 0

    def wait(self) -> None:
        """Wait until all processes have called this."""
        if self.count > 1:
            torch.distributed.barrier()


ALONE = Processes()


@contextmanager
def joined(device: Device) -> Iterator[Processes]:
    """Connect the processes that were started together, each with its own GPU.

    Raises:
        FungraspError: the processes cannot connect.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield Processes()
        return
    if device == "cuda":
        torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    try:
        torch.distributed.init_process_group("nccl" if device == "cuda" else "gloo")
    except (RuntimeError, ValueError) as error:
        words = " ".join(str(error).split())
        raise FungraspError(f"the processes of torchrun find no connection: {words}") from error
    try:
        yield Processes(torch.distributed.get_world_size(), torch.distributed.get_rank())
    finally:
        torch.distributed.destroy_process_group()


@dataclass(frozen=True)
class Progress:
    """Progress of a training."""

    steps: int
    """Control steps so far."""
    seconds: float
    """Duration of the training so far [s]."""
    success: float
    """Success rate of the last episodes, with exploration noise."""
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


class Worlds(VecEnv):
    """A ``TrainingEnvironment`` with the runner's interface; collects data for ``Progress``."""

    def __init__(self, environment: TrainingEnvironment, reward_scale: float):
        """reward_scale: factor on the reward."""
        self.environment, self._scale = environment, reward_scale
        self.num_envs, self.num_actions = environment.settings.worlds, environment.actions
        self.device, self.cfg = str(self.get_observations().device), {}
        self.recent: deque[bool] = deque(maxlen=1000)
        """Success of each of the last episodes."""
        self._rewards: list[Array] = []
        self._terms: list[dict[str, Array]] = []

    def get_observations(self) -> TensorDict:
        """Return the current observations."""
        return tensors(self.environment.observations)

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Advance by one control period."""
        # The runner calls this in inference mode, whose tensors cannot be changed in place elsewhere.
        with torch.inference_mode(False), torch.no_grad():
            step = self.environment.step(played(self.environment, actions.clone()))
        self.recent.extend(self.environment.ended.success.tolist())
        self._rewards.append(step.reward.mean())
        self._terms.append(step.terms)
        reward = self._scale * torch.as_tensor(step.reward).float()
        return self.get_observations(), reward, torch.as_tensor(step.done), {}

    def means(self) -> tuple[float, dict[str, float]]:
        """Return mean reward and mean of each reward term since the last call."""
        reward = float(np.mean([float(reward) for reward in self._rewards]))
        names = self._terms[0]
        terms = {name: float(np.mean([float(t[name]) for t in self._terms])) for name in names}
        self._rewards.clear()
        self._terms.clear()
        return reward, terms


class AdaptedPpo(PPO):
    """PPO with a separate learning rate of the value network. The actor's learning rate adapts to the change
    of the policy in each update. For a student, it also trains the encoder."""

    def __init__(
        self,
        environment: TrainingEnvironment,
        settings: PpoSettings,
        processes: Mapping[str, int] | None = None,
    ):
        """processes: multi-GPU configuration of rsl-rl; None for a single process."""
        s = self._settings = settings
        self._environment = environment
        self.steps = 0
        """Control steps so far, of all processes."""
        correlation = s.noise_correlation
        if correlation is None:
            correlation = NOISE_CORRELATION[environment.settings.residual.base]
        actor, critic = make_networks(environment, s.sees, s.hidden, s.noise, correlation)
        observations, worlds = tensors(environment.observations), environment.settings.worlds
        device = str(observations.device)
        super().__init__(
            actor,
            critic,
            RolloutStorage("rl", worlds, s.steps, observations, [environment.actions], device),
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
            multi_gpu_cfg=None if processes is None else dict(processes),
        )
        if self.is_multi_gpu:
            self.broadcast_parameters()
        self.batch = s.steps * worlds * self.gpu_world_size
        """Control steps per update, of all processes."""
        # The value network needs larger steps than the actor.
        self.optimizer = torch.optim.Adam(
            [
                {"params": list(actor.parameters()), "lr": s.learning_rate},
                {"params": list(critic.parameters()), "lr": s.value_learning_rate},
            ]
        )
        if isinstance(actor, StudentModel):
            encoder = [*actor.encoder.parameters(), *actor.head.parameters()]
            self._encoder_optimizer = torch.optim.Adam(encoder, lr=s.learning_rate)

    @staticmethod
    def construct_algorithm(obs: TensorDict, env: VecEnv, cfg: dict, device: str) -> AdaptedPpo:
        """Construct the algorithm for the runner."""
        assert isinstance(env, Worlds)
        return AdaptedPpo(env.environment, cfg["settings"], cfg["multi_gpu"])

    def compute_returns(self, obs: TensorDict) -> None:
        """Compute returns, and store the action distribution at the last observations for ``update``."""
        super().compute_returns(obs)
        self.actor(obs, stochastic_output=True)
        self._before = obs, tuple(p.clone() for p in self.actor.output_distribution_params)

    def update(self) -> dict[str, float]:
        """Learn from the batch and return losses by name."""
        report_problems(self._environment.episodes.engine)
        s, group = self._settings, self.optimizer.param_groups[0]
        rate = group["lr"]
        still = s.imitate > 0 and self.steps < s.imitate + VALUE_UPDATES * self.batch
        group["lr"] = 0.0 if still else rate
        losses = super().update()
        group["lr"] = rate
        # The encoder is part of the policy: it gets the actor's rate, and ``_adapt`` measures its change too.
        if isinstance(self.actor, StudentModel) and not still:
            losses["reconstruction"] = self._reconstruct(self.actor, rate)
        losses["kl"] = 0.0 if still else self._adapt(*self._before)
        self.steps += self.batch
        return losses

    def _reconstruct(self, student: StudentModel, rate: float) -> float:
        """Train a student's encoder on the contacts of the last batch, and return the last loss."""
        kept = self.storage.observations.flatten(0, 1)
        self._encoder_optimizer.param_groups[0]["lr"] = rate
        loss = torch.zeros(())
        for rows in torch.randperm(len(kept), device=kept.device).split(1024):
            loss = student.reconstruction_loss(kept[rows])
            self._encoder_optimizer.zero_grad()
            loss.backward()
            if self.is_multi_gpu:
                self.reduce_parameters()
            self._encoder_optimizer.step()
        return float(loss.detach())

    def _adapt(self, observations: TensorDict, before: tuple[torch.Tensor, ...]) -> float:
        """Adapt the actor's learning rate to the target KL divergence.

        Returns:
            KL divergence of the last update.
        """
        with torch.inference_mode():
            self.actor(observations, stochastic_output=True)
            change = self.actor.get_kl_divergence(before, self.actor.output_distribution_params).mean()
            if self.is_multi_gpu:
                torch.distributed.all_reduce(change)
                change /= self.gpu_world_size
        found = float(change)
        group, wanted = self.optimizer.param_groups[0], self._settings.kl
        if found > 1.5 * wanted:
            group["lr"] = max(1e-6, group["lr"] / 1.3)
        elif found < wanted / 1.5:
            group["lr"] = min(3e-3, group["lr"] * 1.3)
        return found

    def save(self) -> dict[str, Any]:
        """Return the states of networks and optimizers."""
        state = super().save()
        if isinstance(self.actor, StudentModel):
            state["encoder_optimizer_state_dict"] = self._encoder_optimizer.state_dict()
        return state

    def load(self, loaded_dict: dict, load_cfg: dict | None, strict: bool) -> bool:
        """Load networks and, without ``load_cfg``, optimizers."""
        if load_cfg is None and isinstance(self.actor, StudentModel):
            self._encoder_optimizer.load_state_dict(loaded_dict["encoder_optimizer_state_dict"])
        return super().load(loaded_dict, load_cfg, strict)


class _Reports(Logger):
    """Forwards the runner's log after an update, and writes nothing."""

    def __init__(self, report: Callable[[dict[str, float]], None]):
        self._report, self.log_dir, self.writer, self.disable_logs = report, None, None, True

    def log(self, **numbers: Any) -> None:
        """Forward an update's losses."""
        self._report(numbers["loss_dict"])


class Trainer(OnPolicyRunner):
    """PPO on a ``TrainingEnvironment`` with rsl-rl's runner. It counts control steps, has its own
    checkpoints, and can begin with an imitation."""

    alg: AdaptedPpo

    def __init__(
        self,
        environment: TrainingEnvironment,
        settings: PpoSettings | None = None,
        seed: int = 0,
        processes: Processes = ALONE,
    ):
        """
        Args:
            processes: training processes, each with its own environment.
        """
        torch.manual_seed(seed + processes.number)
        self.environment, self._seed, self._processes = environment, seed, processes
        environment.processes = processes.count
        s = self.settings = settings or PpoSettings()
        self._worlds = Worlds(environment, s.reward_scale)
        config = {"algorithm": {"class_name": AdaptedPpo}, "settings": s, "num_steps_per_env": s.steps}
        super().__init__(self._worlds, config | {"check_for_nan": False}, None, str(self._worlds.device))
        self.seconds = 0.0
        """Duration of the training so far [s], including earlier runs."""
        self._begun = False
        """Whether the networks come from another training."""

    def _configure_multi_gpu(self) -> None:
        """Use the process group of ``joined``; the algorithm broadcasts parameters once."""
        self.is_distributed, self.gpu_local_rank = False, 0
        self.gpu_world_size, self.gpu_global_rank = self._processes
        several = {"global_rank": self.gpu_global_rank, "world_size": self.gpu_world_size}
        self.cfg["multi_gpu"] = several if self.gpu_world_size > 1 else None

    @property
    def steps(self) -> int:
        """Control steps so far, of all processes, including earlier runs."""
        return self.alg.steps

    @property
    def actor(self) -> MLPModel:
        """The policy network."""
        return self.alg.get_policy()

    @property
    def success(self) -> float:
        """Success rate of the last episodes; 0 before the first has ended."""
        return float(np.mean(self._worlds.recent)) if self._worlds.recent else 0.0

    def learn_until(
        self,
        steps: float,
        progress: Callable[[Progress], None] = lambda p: None,
        checkpoint: Path | None = None,
        every: int = 20,
    ) -> None:
        """Learn until a total number of control steps.

        Args:
            steps: total number, including earlier runs.
            checkpoint: file of the state, written atomically.
            every: updates between two checkpoints. All episodes restart at a checkpoint, so that
                interruptions do not change the result.
        """
        start, before = perf_counter(), self.seconds

        def told(losses: dict[str, float], reward: float, terms: dict[str, float]) -> None:
            self.seconds = before + perf_counter() - start
            noise, rate = self.actor.output_std.detach().mean(), self.alg.optimizer.param_groups[0]["lr"]
            now = self.steps, self.seconds, self.success
            progress(Progress(*now, reward, float(noise), rate, losses, terms))

        self.logger = _Reports(lambda losses: told(losses, *self._worlds.means()))
        self.alg.train_mode()
        if self.steps == 0 and not self._begun:
            self._warm_up()
        imitation = MotionImitation(self.actor, self.environment, self.settings.steps)
        while self.steps < steps:
            if self.steps < self.settings.imitate:
                reward, loss, ended = imitation.round()
                self._worlds.recent.extend(ended)
                self.alg.steps += self.alg.batch
                told({"imitation": loss}, reward, {})
                if self.steps < self.settings.imitate:
                    # An interrupted imitation starts again: it takes only a few minutes.
                    continue
            else:
                left = math.ceil((steps - self.steps) / self.alg.batch)
                self.learn(min(left, every - self.steps // self.alg.batch % every))
            if self.steps // self.alg.batch % every == 0:
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
        """Seed this process's random numbers from its index and the number of steps, and use the success
        rates of the first process, which are in the checkpoint."""
        rng, rates = self.environment.rng, self.environment.success_of_group
        own = np.random.default_rng([self._seed, self._processes.number, self.steps])
        rng.bit_generator.state = own.bit_generator.state
        torch.manual_seed(int(own.integers(2**62)))
        shared = torch.as_tensor(rates.copy(), device=self.alg.device)
        torch.distributed.broadcast(shared, src=0)
        rates[:] = shared.cpu().numpy()

    def _restart_noise(self) -> None:
        noise = self.actor.distribution
        if isinstance(noise, ColoredGaussian):
            noise.restart()

    def _warm_up(self) -> None:
        """Play the plans without residuals, to initialize the normalization of observations."""
        still = array_namespace(self.environment.tracker.action).zeros_like(self.environment.tracker.action)
        for _ in range(self.settings.warm_up):
            self.environment.step(still)
            observations = tensors(self.environment.observations)
            self.actor.update_normalization(observations)
            self.alg.critic.update_normalization(observations)

    def save(self, path: Path) -> None:  # type: ignore[override]
        """Save everything needed to continue.

        Raises:
            FungraspError: the file can't be written; an existing file is kept.
        """
        state = self.alg.save() | environment_state(self.environment)
        counted = {"steps": self.steps, "seconds": self.seconds}
        write_checkpoint(path, state | counted | {"recent": torch.tensor(list(self._worlds.recent))})

    def begin_from(self, path: Path) -> None:
        """Load only the networks of another training's checkpoint; the noise stays at its initial value.

        Raises:
            FungraspError: the checkpoint can't be read, is damaged, or is for another hand, other
                observations or other networks.
        """
        state = read_checkpoint(path)
        check_environment(path, state, self.environment)
        self._begun = True
        noise = self.actor.distribution
        wanted = {} if noise is None else {name: p.clone() for name, p in noise.state_dict().items()}
        with _fitting(path):
            self.alg.load(state, {"actor": True, "critic": True}, True)
        if noise is not None:
            noise.load_state_dict(wanted)

    def load(self, path: Path) -> None:  # type: ignore[override]
        """Continue from a checkpoint.

        Raises:
            FungraspError: the checkpoint can't be read, is damaged, or is for another hand, other
                observations or other networks.
        """
        state = read_checkpoint(path)
        check_environment(path, state, self.environment)
        with _fitting(path):
            self.alg.load(state, None, True)
            restore_environment(state, self.environment)
            self._restart_noise()
            self.alg.steps, self.seconds = int(state["steps"]), float(state["seconds"])
            self._worlds.recent.extend(state["recent"].bool().tolist())
        if self._processes.count > 1:
            self._restart()


@contextmanager
def _fitting(path: Path) -> Iterator[None]:
    """Raise ``FungraspError`` if a checkpoint is for other networks."""
    try:
        yield
    except (RuntimeError, ValueError, KeyError) as error:
        words = " ".join(str(error).split())
        raise FungraspError(f"the checkpoint {path} does not fit these settings: {words}") from error
