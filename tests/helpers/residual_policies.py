"""Policy files whose networks a test can follow by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from onnx import helper
from planned_grasps import layouts
from small_policies import allegro_card, model

from fungrasp.policies.checkpoint.card import ActionPart, Part
from fungrasp.policies.checkpoint.checkpoint_file import save_policy
from fungrasp.policies.residual_action import ResidualSettings

ACTION = (ActionPart("position", 3, 0.02), ActionPart("rotation", 3, 0.1), ActionPart("fingers", 16, 0.2))
SIZE = 22
SETTINGS = ResidualSettings(position=0.02, rotation=0.1, fingers=0.2, smoothing=0.5)


def policy_file(
    folder: Path, offset: np.ndarray | None = None, watch: tuple[str, float] | None = None, **card
) -> Path:
    """A policy with the action ``offset``; its first number follows the first of a part of the observation.

    Args:
        folder: for the file.
        offset: shape [A], zero if None.
        watch: name of that part and gain.
        card: fields that differ.
    """
    seen, contacts = layouts()
    kind = card.get("kind", "student")
    values = {
        "kind": kind,
        "observation": tuple(Part(*part) for part in seen),
        "privileged": tuple(Part(*part) for part in contacts) if kind == "teacher" else (),
        "action": ACTION,
        "action_smoothing": 0.5,
    }
    described = allegro_card(**(values | card))
    matrix = np.zeros((described.input_size, described.action_size), np.float32)
    if watch is not None:
        names = [part.name for part in described.inputs]
        at = names.index(watch[0])
        matrix[sum(part.size for part in described.inputs[:at]), 0] = watch[1]
    constant = np.zeros(described.action_size) if offset is None else offset
    graph = model(
        [helper.make_node("Gemm", ["observation", "matrix", "offset"], ["action"])],
        {"observation": ["worlds", described.input_size]},
        {"action": ["worlds", described.action_size]},
        {"matrix": matrix, "offset": constant.astype(np.float32)},
    )
    path = folder / "p.onnx"
    save_policy(path, graph, described)
    return path
