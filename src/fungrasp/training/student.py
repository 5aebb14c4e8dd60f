"""The student: an LSTM infers the contacts from how the joints move; the teacher's network acts on them
(section IV.C.1 of the paper)."""

from __future__ import annotations

import copy
from typing import Any, cast

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from tensordict import TensorDict

from fungrasp.training.history import HISTORY, HISTORY_PARTS, Layout, columns


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
        units: int = 64,
        layers: int = 2,
        estimates: bool = True,
        **settings: Any,
    ):
        super().__init__(obs, {obs_set: ["robot", "privileged"]}, obs_set, output_dim, **settings)
        self.links = dict(layout)["target_contacts"]
        self.estimates = estimates
        history = columns(layout, HISTORY_PARTS)
        self.history_columns: torch.Tensor
        self.register_buffer("history_columns", torch.from_numpy(history))
        self.target_columns: torch.Tensor
        self.register_buffer("target_columns", torch.from_numpy(columns(layout, ("target_contacts",))))
        self.encoder = torch.nn.LSTM(len(history), units, layers, batch_first=True)
        self.head = torch.nn.Linear(units, 2 * self.links)

    def infer(self, window: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Contacts as probabilities and scaled forces, [W, L] each. window: shape [W, HISTORY, H]."""
        normaliser = cast(EmpiricalNormalization, self.obs_normalizer)
        mean, std = normaliser.mean[self.history_columns], normaliser.std[self.history_columns]
        hidden, _ = self.encoder((window - mean) / (std + normaliser.eps))
        # Zeros where nothing is estimated: the network then is as large, and knows nothing of the contacts.
        inferred = torch.sigmoid(self.head(hidden[:, -1])) * float(self.estimates)
        contacts, forces = inferred.split(self.links, dim=-1)
        return contacts, forces

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
        return self.student.mlp(self.student.act(observation, contacts, forces)), contacts, forces, window
