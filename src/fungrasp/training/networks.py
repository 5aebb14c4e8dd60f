"""Networks: actor, value network and exploration noise of a teacher; and a student, whose LSTM infers
contacts from joint motion as inputs of the teacher's network (section IV.C.1 of the paper)."""

from __future__ import annotations

import copy
from typing import Any, cast

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from rsl_rl.modules.distribution import GaussianDistribution
from tensordict import TensorDict

from fungrasp.geometry.arrays import is_numpy
from fungrasp.geometry.poses import Array
from fungrasp.training.environment import HISTORY, Layout, NetworkInputs, TrainingEnvironment, columns
from fungrasp.training.settings import HIDDEN, Sees


class ColoredGaussian(GaussianDistribution):
    """Gaussian actions with noise that is correlated in time during rollouts (Eberhard et al., "Colored Noise
    in PPO", AAAI 2024); probabilities are those of independent noise."""

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
        """Draw new noise."""
        self._noise = torch.randn_like(self._noise)

    def sample(self) -> torch.Tensor:
        """Draw actions, shape [W, A]; independent if the batch size is not W."""
        if len(self.mean) != len(self._noise):
            return super().sample()
        self._noise = self._correlation * self._noise + self._fresh * torch.randn_like(self._noise)
        return self.mean + self.std * self._noise


class StudentModel(MLPModel):
    """An rsl-rl actor with the observation groups ``robot`` and ``history``; its encoder learns to infer
    ``privileged``."""

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        layout: Layout,
        encoder: Layout,
        units: int = 64,
        layers: int = 2,
        estimates: bool = True,
        **settings: Any,
    ):
        """
        Args:
            obs_groups: ignored.
            layout: layout of all inputs (``TrainingEnvironment.student_layout``): the group ``robot``, then
                inputs of the encoder only.
            encoder: layout of the encoder's inputs.
        """
        super().__init__(obs, {obs_set: ["robot", "privileged"]}, obs_set, output_dim, **settings)
        self.robot_size = int(obs["robot"].shape[-1])
        self.links = dict(layout)["target_contacts"]
        self.estimates = estimates
        history = columns(layout, tuple(name for name, _ in encoder))
        self.history_columns: torch.Tensor
        self.register_buffer("history_columns", torch.from_numpy(history))
        self.target_columns: torch.Tensor
        self.register_buffer("target_columns", torch.from_numpy(columns(layout, ("target_contacts",))))
        self.encoder = torch.nn.LSTM(len(history), units, layers, batch_first=True)
        self.head = torch.nn.Linear(units, 2 * self.links)

    def infer(self, window: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return contact probabilities and scaled forces, shape [W, L] each. window: shape [W, HISTORY,
        H]."""
        normaliser = cast(EmpiricalNormalization, self.obs_normalizer)
        mean, std = self._scaling(normaliser.mean, 0.0), self._scaling(normaliser.std, 1.0)
        hidden, _ = self.encoder((window - mean) / (std + normaliser.eps))
        # Without estimates, use zeros: the network has the same size but no contact information.
        inferred = torch.sigmoid(self.head(hidden[:, -1])) * float(self.estimates)
        contacts, forces = inferred.split(self.links, dim=-1)
        return contacts, forces

    def _scaling(self, known: torch.Tensor, other: float) -> torch.Tensor:
        """Return mean or standard deviation of the encoder's inputs. Inputs of the encoder only have no
        learned normalization; they are of the order of one."""
        among = self.history_columns < self.robot_size
        return torch.where(among, known[torch.where(among, self.history_columns, 0)], other)

    def act(self, robot: torch.Tensor, contacts: torch.Tensor, forces: torch.Tensor) -> torch.Tensor:
        """Return the normalized network input with inferred contacts."""
        targets = robot[:, self.target_columns]
        return self.obs_normalizer(torch.cat([robot, contacts, targets - contacts, forces], dim=-1))

    def get_latent(
        self, obs: TensorDict, masks: torch.Tensor | None = None, hidden_state: Any = None
    ) -> torch.Tensor:
        """Return the network input."""
        window = obs["history"].unflatten(-1, (HISTORY, -1))
        return self.act(obs["robot"], *self.infer(window))

    def reconstruction_loss(self, obs: TensorDict) -> torch.Tensor:
        """Return L_re of the paper: mean squared errors of contacts and scaled forces."""
        contacts, forces = self.infer(obs["history"].unflatten(-1, (HISTORY, -1)))
        true = obs["privileged"]
        return ((contacts - true[:, : self.links]) ** 2).mean() + (
            (forces - true[:, -self.links :]) ** 2
        ).mean()

    def take_over(self, teacher: MLPModel) -> None:
        """Copy a teacher's network and normalization."""
        self.mlp.load_state_dict(teacher.mlp.state_dict())
        self.obs_normalizer.load_state_dict(teacher.obs_normalizer.state_dict())


class StudentGraph(torch.nn.Module):
    """A student for inference: one step, with its window as input and output."""

    def __init__(self, student: StudentModel):
        super().__init__()
        self.student = copy.deepcopy(student)

    def forward(
        self, observation: torch.Tensor, state_history: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return action, contacts, scaled forces and the next window."""
        present = observation[:, self.student.history_columns]
        window = torch.cat([state_history[:, 1:], present[:, None]], dim=1)
        contacts, forces = self.student.infer(window)
        robot = observation[:, : self.student.robot_size]
        return self.student.mlp(self.student.act(robot, contacts, forces)), contacts, forces, window


def make_networks(
    environment: TrainingEnvironment, sees: Sees, hidden: tuple[int, ...], noise: float, correlation: float
) -> tuple[MLPModel, MLPModel]:
    """Make an actor, whose initial actions are small, and a value network."""
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


def make_student(
    environment: TrainingEnvironment, hidden: tuple[int, ...] = HIDDEN, estimates: bool = True
) -> StudentModel:
    """Make an untrained student for an environment with history."""
    observations = tensors(environment.observations)
    return StudentModel(
        observations,
        {},
        "actor",
        environment.actions,
        layout=environment.student_layout,
        encoder=environment.encoder_layout,
        estimates=estimates,
        hidden_dims=list(hidden),
        activation="elu",
        obs_normalization=True,
    )


def tensors(observations: NetworkInputs) -> TensorDict:
    """Convert ``NetworkInputs`` to groups for rsl-rl, without copying."""
    groups = {name: torch.as_tensor(getattr(observations, name)) for name in ("robot", "privileged", "value")}
    if observations.history is not None:
        groups["history"] = torch.as_tensor(observations.history).flatten(1)
    return TensorDict(groups, batch_size=[len(observations.robot)], device=groups["robot"].device)


def played(environment: TrainingEnvironment, action: torch.Tensor) -> Array:
    """Convert a network's actions for its worlds."""
    return action.numpy() if is_numpy(environment.on) else action
