"""Learns the prior of hidden fingers (``perception.hand.finger_prior``) from synthesized grasps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np
import torch

from fungrasp.perception.hand.finger_prior import FREE_ANGLES, posture_features, to_free
from fungrasp.training.finger_examples import FingerExamples, FingerPriorSettings


class FingerNetwork(torch.nn.Module):
    """Mixture of Gaussians of one finger's angles: see ``perception.hand.finger_prior``."""

    def __init__(self, finger: int, inputs: int, s: FingerPriorSettings):
        super().__init__()
        self.size, self.count = len(FREE_ANGLES[finger]), s.components
        self.largest = -float(np.log(s.narrowest))
        out = self.count * (1 + self.size + self.size * (self.size + 1) // 2)
        a, b = s.hidden
        last = torch.nn.Linear(b, out)
        self.layers = torch.nn.ModuleList([torch.nn.Linear(inputs, a), torch.nn.Linear(a, b), last])
        self.dropout = torch.nn.Dropout(s.dropout)
        with torch.no_grad():
            # Components that begin alike would stay alike.
            last.bias[self.count : self.count * (1 + self.size)].normal_()

    def forward(self, values: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
        """Logarithm of the density of true angles, shape [N]. values: [N, inputs]; truth: [N, D]."""
        first, second, last = self.layers
        values = self.dropout(torch.nn.functional.elu(first(values)))
        values = self.dropout(torch.nn.functional.elu(second(values)))
        n, m, d = len(values), self.count, self.size
        logits, mean, diagonal, below = last(values).split([m, m * d, m * d, m * d * (d - 1) // 2], dim=1)
        diagonal = diagonal.reshape(n, m, d)
        factor = torch.zeros(n, m, d, d)
        rows, columns = np.tril_indices(d, -1)
        factor[:, :, rows, columns] = below.reshape(n, m, -1)
        factor = factor + torch.diag_embed(diagonal.exp())
        off = torch.einsum("nmij,nmi->nmj", factor, truth[:, None] - mean.reshape(n, m, d))
        # What is narrower than allowed gains nothing by it.
        parts = (
            torch.log_softmax(logits, dim=1)
            + diagonal.clamp(max=self.largest).sum(dim=2)
            - 0.5 * off.square().sum(dim=2)
            - 0.5 * d * float(np.log(2 * np.pi))
        )
        return torch.logsumexp(parts, dim=1)


def fit_finger(
    finger: int,
    examples: FingerExamples,
    checked: FingerExamples,
    settings: FingerPriorSettings | None = None,
    seed: int = 0,
) -> tuple[FingerNetwork, list[tuple[float, float]]]:
    """Learn one finger's network.

    Args:
        finger: which.
        examples: to learn from.
        checked: of other objects, for the validation curve.
        settings: the defaults if None.
        seed: of everything random.

    Returns:
        The network, and after each epoch the mean negative log-likelihood of both [nats].
    """
    s = settings or FingerPriorSettings()
    torch.manual_seed(seed)
    rng = np.random.default_rng([seed, finger])
    inputs = _inputs(finger, examples, s, rng)
    network = FingerNetwork(finger, inputs.shape[1], s)
    optimizer = torch.optim.AdamW(network.parameters(), lr=s.learning_rate, weight_decay=s.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, s.epochs)
    truth = torch.from_numpy(to_free(finger, examples.angles[:, finger])).float()
    check_inputs = _inputs(finger, checked, s, rng)
    check_truth = torch.from_numpy(to_free(finger, checked.angles[:, finger])).float()
    curve = []
    for _ in range(s.epochs):
        network.train()
        inputs, total = _inputs(finger, examples, s, rng), 0.0
        for rows in torch.randperm(len(truth)).split(s.minibatch):
            loss = -network(inputs[rows], truth[rows]).mean()
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
            optimizer.step()
            total += float(loss.detach()) * len(rows)
        schedule.step()
        network.eval()
        with torch.inference_mode():
            curve.append((total / len(truth), -float(network(check_inputs, check_truth).mean())))
    return network, curve


def _inputs(
    finger: int, examples: FingerExamples, s: FingerPriorSettings, rng: np.random.Generator
) -> torch.Tensor:
    """Inputs with other fingers known, and other errors of them, at every call, shape [N, inputs]."""
    known = rng.random((len(examples.angles), 5)) < s.known
    postures = posture_features(finger, examples.angles, known)
    noise = s.angle_noise * rng.normal(size=(len(postures), postures.shape[1] - 5))
    postures[:, :-5] += np.where(postures[:, :-5] != 0, noise, 0.0)
    return torch.from_numpy(np.concatenate([examples.surface, postures], axis=1)).float()


def save_weights(stream: BinaryIO, networks: Sequence[FingerNetwork]) -> None:
    """Write the file that ``FingerPrior.load`` reads, of the five networks."""
    arrays: dict[str, Any] = {"layers": np.array(3)}
    for finger, network in enumerate(networks):
        for number, layer in enumerate(network.layers):
            assert isinstance(layer, torch.nn.Linear)
            arrays[f"weight_{finger}_{number}"] = layer.weight.detach().numpy().T
            arrays[f"bias_{finger}_{number}"] = layer.bias.detach().numpy()
    np.savez_compressed(stream, **arrays)
