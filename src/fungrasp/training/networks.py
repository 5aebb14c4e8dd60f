"""Actor and value network of a teacher, and the noise with which it explores."""

from __future__ import annotations

from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules.distribution import GaussianDistribution
from tensordict import TensorDict

from fungrasp.geometry.arrays import is_numpy
from fungrasp.geometry.poses import Array
from fungrasp.training.environment import NetworkInputs, TrainingEnvironment
from fungrasp.training.settings import Sees
from fungrasp.training.student import StudentModel


class ColoredGaussian(GaussianDistribution):
    """Normal actions whose noise is correlated in time while the worlds are played, as in Eberhard et al.,
    "Colored Noise in PPO" (AAAI 2024); its probabilities are those of independent noise."""

    def __init__(
        self,
        output_dim: int,
        worlds: int,
        correlation: float,
        device: torch.device | None = None,
        **settings: Any,
    ):
        super().__init__(output_dim, **settings)
        self._correlation, self._fresh = correlation, (1.0 - correlation**2) ** 0.5
        self._noise = torch.randn(worlds, output_dim, device=device)

    def restart(self) -> None:
        """Forget the noise so far."""
        self._noise = torch.randn_like(self._noise)

    def sample(self) -> torch.Tensor:
        """Shape [W, A]; independent where the batch is not that of the worlds."""
        if len(self.mean) != len(self._noise):
            return super().sample()
        self._noise = self._correlation * self._noise + self._fresh * torch.randn_like(self._noise)
        return self.mean + self.std * self._noise


def make_networks(
    environment: TrainingEnvironment, sees: Sees, hidden: tuple[int, ...], noise: float, correlation: float
) -> tuple[MLPModel, MLPModel]:
    """Actor, whose actions hardly change the plan at first, and value network.

    Args:
        environment: that they are for.
        sees: what the actor knows of the contacts.
        hidden: units of the hidden layers, of both.
        noise: standard deviation of the actions.
        correlation: of the noise from one control step to the next.
    """
    observations = tensors(environment.observations)
    groups = {
        "actor": ["robot", "privileged"] if sees == "contacts" else ["robot"],
        "critic": ["robot", "privileged", "value"],
    }
    model: dict[str, Any] = {"hidden_dims": list(hidden), "activation": "elu", "obs_normalization": True}
    student = sees == "history"
    kind: type[MLPModel] = StudentModel if student else MLPModel
    own: dict[str, Any] = {}
    if student:
        own = {"layout": environment.student_layout, "encoder": environment.encoder_layout}
    actor = kind(
        observations,
        groups,
        "actor",
        environment.actions,
        **model,
        **own,
        distribution_cfg={
            "class_name": ColoredGaussian,
            "worlds": environment.settings.worlds,
            "correlation": correlation,
            "device": observations.device,
            "init_std": noise,
            "std_type": "log",
            "std_range": (0.03, 0.5),
        },
    )
    critic = MLPModel(observations, groups, "critic", 1, **model)
    with torch.no_grad():
        last = [m for m in actor.mlp.modules() if isinstance(m, torch.nn.Linear)][-1]
        for parameter in last.parameters():
            parameter.mul_(0.01)
    return actor.to(observations.device), critic.to(observations.device)


def tensors(observations: NetworkInputs) -> TensorDict:
    """NetworkInputs as rsl-rl wants them: a group each. Nothing is copied."""
    groups = {name: torch.as_tensor(getattr(observations, name)) for name in ("robot", "privileged", "value")}
    if observations.history is not None:
        groups["history"] = torch.as_tensor(observations.history).flatten(1)
    return TensorDict(groups, batch_size=[len(observations.robot)], device=groups["robot"].device)


def played(environment: TrainingEnvironment, action: torch.Tensor) -> Array:
    """A network's actions as its worlds take them."""
    return action.numpy() if is_numpy(environment.on) else action
