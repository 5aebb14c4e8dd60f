"""Networks as policy files."""

from __future__ import annotations

import copy
import io
import warnings
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any, cast

import torch
from rsl_rl.models import MLPModel

from fungrasp.hands import Hand
from fungrasp.policies.checkpoint.card import ActionPart, Budget, Part, PolicyCard
from fungrasp.policies.checkpoint.checkpoint_file import hand_digest, save_policy, servo_gains
from fungrasp.policies.residual_action import WRIST_ACTIONS, ResidualSettings
from fungrasp.policies.residual_policy import ACTION_PARTS
from fungrasp.training.history import HISTORY
from fungrasp.training.student import StudentGraph, StudentModel
from fungrasp.training.success_predictor import PredictorNetwork

OPSET = 18


class Normalised(torch.nn.Module):
    """A teacher for inference: normalises what it sees, and gives the mean action."""

    def __init__(self, actor: MLPModel):
        super().__init__()
        self.normaliser = copy.deepcopy(actor.obs_normalizer)
        self.mlp = copy.deepcopy(actor.mlp)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """observation: shape [W, O]; returns shape [W, A]."""
        return self.mlp(self.normaliser(observation))


def graph(module: torch.nn.Module, inputs: dict[str, torch.Tensor], outputs: tuple[str, ...]) -> bytes:
    """A module as an ONNX file, the first axis of everything left open.

    Args:
        module: in evaluation mode afterwards.
        inputs: examples by name, in the order of the module's arguments.
        outputs: names of what it gives.
    """
    module.eval()
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
    return buffer.getvalue()


def make_card(
    name: str,
    kind: str,
    hand: Hand,
    layout: tuple[tuple[str, int], ...],
    privileged: tuple[tuple[str, int], ...],
    residual: ResidualSettings,
    rate: float,
    budget: Budget,
    **more: Any,
) -> PolicyCard:
    """A card with what the hand and the training say.

    Args:
        name: of the policy.
        kind: "teacher", "student" or "predictor".
        hand: that it moves.
        layout: of the observation.
        privileged: layout of the privileged observation; empty but for a teacher.
        residual: of its actions.
        rate: of control [Hz].
        budget: of the training.
        more: further fields of ``PolicyCard``.
    """
    gains = servo_gains(hand)
    sizes = (3, WRIST_ACTIONS - 3, len(gains))
    scales = (residual.position, residual.rotation, residual.fingers)
    return PolicyCard(
        name=name,
        kind=kind,
        hand=hand.name,
        hand_digest=hand_digest(hand),
        joint_names=tuple(gains),
        gains=gains,
        rate_hz=rate,
        observation=tuple(Part(*part) for part in layout),
        privileged=tuple(Part(*part) for part in privileged),
        action=tuple(ActionPart(*part) for part in zip(ACTION_PARTS, sizes, scales, strict=True)),
        action_smoothing=residual.smoothing,
        budget=budget,
        created=date.today().isoformat(),
        **more,
    )


def export_teacher(actor: MLPModel, path: Path, card: PolicyCard) -> None:
    """Write a teacher's policy file."""
    example = torch.zeros(2, card.input_size)
    save_policy(path, graph(Normalised(actor), {"observation": example}, ("action",)), card)


def export_student(student: StudentModel, path: Path, card: PolicyCard) -> None:
    """Write a student's policy file; its state is the window of what its encoder looks back on."""
    observation = torch.zeros(2, card.input_size)
    history = torch.zeros(2, HISTORY, student.encoder.input_size)
    inputs = {"observation": observation, "state_history": history}
    outputs = ("action", "contacts", "forces", "next_state_history")
    save_policy(path, graph(StudentGraph(student), inputs, outputs), card)


def export_predictor(predictor: PredictorNetwork, path: Path, card: PolicyCard) -> None:
    """Write a success predictor's file: its observation is ``plan_features``, its action the expected
    success."""
    card = replace(card, action=(ActionPart("success", 1, 1.0),))
    example = torch.zeros(2, card.input_size)
    save_policy(path, graph(predictor, {"observation": example}, ("action",)), card)
