"""Export of networks to policy files."""

from __future__ import annotations

import copy
import io
import warnings
from datetime import date
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from rsl_rl.models import MLPModel

from fungrasp.hands import Hand
from fungrasp.policies.checkpoint.card import ActionPart, Budget, Part, PolicyCard
from fungrasp.policies.checkpoint.checkpoint_file import hand_digest, save_policy, servo_gains
from fungrasp.policies.residual_action import WRIST_ACTIONS, ResidualSettings
from fungrasp.policies.residual_policy import ACTION_PARTS
from fungrasp.task import LiftProtocol
from fungrasp.training.environment import HISTORY
from fungrasp.training.networks import StudentGraph, StudentModel

OPSET = 18

IN_SIMULATION = "Trained in simulation only."
"""Limit stated in the card of every policy."""

HALVED_FROM = 256
"""Smallest size of matrices that are stored in half precision. Biases and normalization stay in single
precision: they are small and matter more."""


class Normalized(torch.nn.Module):
    """A feed-forward policy for inference: normalizes observations and returns the mean action."""

    def __init__(self, actor: MLPModel):
        super().__init__()
        self.normaliser = copy.deepcopy(actor.obs_normalizer)
        self.mlp = copy.deepcopy(actor.mlp)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """observation: shape [W, O]; returns shape [W, A]."""
        return self.mlp(self.normaliser(observation))


def graph(module: torch.nn.Module, inputs: dict[str, torch.Tensor], outputs: tuple[str, ...]) -> bytes:
    """Export a module to ONNX, with a dynamic first axis of all inputs and outputs.

    Args:
        inputs: example inputs by name, in the order of the module's arguments.
    """
    module.eval().cpu()
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            module,
            tuple(inputs.values()),
            cast(Any, buffer),
            input_names=list(inputs),
            output_names=list(outputs),
            dynamic_axes={name: {0: "worlds"} for name in (*inputs, *outputs)},
            opset_version=OPSET,
            dynamo=False,
        )
    return halved(buffer.getvalue())


def halved(model: bytes) -> bytes:
    """Store large weights of an ONNX model in half precision, which halves the file; computation stays in
    single precision. Weights outside the range of half precision are not converted.
    """
    import onnx
    from onnx import helper, numpy_helper

    network = onnx.load_from_string(model)
    casts = []
    for number, weight in enumerate(list(network.graph.initializer)):
        values = numpy_helper.to_array(weight)
        if values.dtype != np.float32 or values.size < HALVED_FROM or values.ndim < 2:
            continue
        if np.abs(values).max() > np.finfo(np.float16).max:
            continue
        single, half = weight.name, f"{weight.name}_half"
        network.graph.initializer[number].CopyFrom(numpy_helper.from_array(values.astype(np.float16), half))
        casts.append(helper.make_node("Cast", [half], [single], to=onnx.TensorProto.FLOAT))
    # A node must follow the nodes whose outputs it uses.
    nodes = [*casts, *network.graph.node]
    del network.graph.node[:]
    network.graph.node.extend(nodes)
    return network.SerializeToString()


def make_card(
    name: str,
    kind: str,
    hand: Hand,
    observation: tuple[tuple[str, int], ...],
    privileged: tuple[tuple[str, int], ...],
    residual: ResidualSettings,
    budget: Budget,
    **more: Any,
) -> PolicyCard:
    """Make a card from the hand and the training.

    Args:
        kind: "teacher" or "student".
        privileged: layout of the privileged observation; empty for a student.
    """
    gains = servo_gains(hand)
    sizes = (3, WRIST_ACTIONS - 3, len(gains))
    more["limits"] = (*more.get("limits", ()), IN_SIMULATION)
    parts = ACTION_PARTS[residual.base]
    scales = (residual.position, residual.rotation, residual.fingers)
    return PolicyCard(
        name=name,
        kind=kind,
        hand=hand.name,
        hand_digest=hand_digest(hand),
        joint_names=tuple(gains),
        gains=gains,
        rate_hz=1 / LiftProtocol().control_period,
        observation=tuple(Part(*part) for part in observation),
        privileged=tuple(Part(*part) for part in privileged),
        action=tuple(ActionPart(*part) for part in zip(parts, sizes, scales, strict=True)),
        action_smoothing=residual.smoothing,
        budget=budget,
        created=date.today().isoformat(),
        **more,
    )


def policy_graph(actor: MLPModel, card: PolicyCard) -> bytes:
    """Export a policy to ONNX. The state of a student is its encoder's window."""
    inputs = {"observation": torch.zeros(2, card.input_size)}
    if not isinstance(actor, StudentModel):
        return graph(Normalized(actor), inputs, ("action",))
    inputs["state_history"] = torch.zeros(2, HISTORY, actor.encoder.input_size)
    outputs = ("action", "contacts", "forces", "next_state_history")
    return graph(StudentGraph(actor), inputs, outputs)


def export_policy(actor: MLPModel, path: Path, card: PolicyCard) -> None:
    """Write the policy file of a trained network.

    Raises:
        FungraspError: the file can't be written.
    """
    save_policy(path, policy_graph(actor, card), card)
