"""The student: an LSTM infers the contacts from how the joints move; the teacher's network acts on them
(section IV.C.1 of the paper)."""

from __future__ import annotations

import copy
from typing import Any, cast

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from tensordict import TensorDict

from fungrasp.training.history import HISTORY, Layout, columns


class StudentModel(MLPModel):
    """An actor for rsl-rl that sees the groups ``robot`` and ``history``; ``privileged`` is what its encoder
    learns to infer."""

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
            obs: an example.
            obs_groups: not looked at.
            obs_set: name of the networks' groups.
            output_dim: numbers in an action.
            layout: of all that it gets (``TrainingEnvironment.student_layout``): the group ``robot``, then
                what only its encoder needs.
            encoder: what of it the encoder gets.
            units: of the encoder's layers.
            layers: of the encoder.
            estimates: whether it infers the contacts.
            settings: of the network.
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
        """Contacts as probabilities and scaled forces, [W, L] each. window: shape [W, HISTORY, H]."""
        normaliser = cast(EmpiricalNormalization, self.obs_normalizer)
        mean, std = self._scaling(normaliser.mean, 0.0), self._scaling(normaliser.std, 1.0)
        hidden, _ = self.encoder((window - mean) / (std + normaliser.eps))
        # Zeros where nothing is estimated: the network then is as large, and knows nothing of the contacts.
        inferred = torch.sigmoid(self.head(hidden[:, -1])) * float(self.estimates)
        contacts, forces = inferred.split(self.links, dim=-1)
        return contacts, forces

    def _scaling(self, known: torch.Tensor, other: float) -> torch.Tensor:
        """Mean or standard deviation of what the encoder gets. Of what the network does not get, none is
        learned: it is of the order of one."""
        among = self.history_columns < self.robot_size
        return torch.where(among, known[torch.where(among, self.history_columns, 0)], other)

    def act(self, robot: torch.Tensor, contacts: torch.Tensor, forces: torch.Tensor) -> torch.Tensor:
        """The network's input, normalised, with inferred contacts."""
        targets = robot[:, self.target_columns]
        return self.obs_normalizer(torch.cat([robot, contacts, targets - contacts, forces], dim=-1))

    def get_latent(
        self, obs: TensorDict, masks: torch.Tensor | None = None, hidden_state: Any = None
    ) -> torch.Tensor:
        """Input of the network."""
        window = obs["history"].unflatten(-1, (HISTORY, -1))
        return self.act(obs["robot"], *self.infer(window))

    def reconstruction_loss(self, obs: TensorDict) -> torch.Tensor:
        """L_re of the paper: squared errors of contacts and of scaled forces."""
        contacts, forces = self.infer(obs["history"].unflatten(-1, (HISTORY, -1)))
        true = obs["privileged"]
        return ((contacts - true[:, : self.links]) ** 2).mean() + (
            (forces - true[:, -self.links :]) ** 2
        ).mean()

    def take_over(self, teacher: MLPModel) -> None:
        """Begin with a teacher's network and normalisation."""
        self.mlp.load_state_dict(teacher.mlp.state_dict())
        self.obs_normalizer.load_state_dict(teacher.obs_normalizer.state_dict())


class StudentGraph(torch.nn.Module):
    """A student for inference: one step, its window explicit."""

    def __init__(self, student: StudentModel):
        super().__init__()
        self.student = copy.deepcopy(student)

    def forward(
        self, observation: torch.Tensor, state_history: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Action, contacts, scaled forces and the next window."""
        present = observation[:, self.student.history_columns]
        window = torch.cat([state_history[:, 1:], present[:, None]], dim=1)
        contacts, forces = self.student.infer(window)
        robot = observation[:, : self.student.robot_size]
        return self.student.mlp(self.student.act(robot, contacts, forces)), contacts, forces, window
