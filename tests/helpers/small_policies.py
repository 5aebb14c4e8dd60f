"""Small policies with weights that a test can follow by hand, and their cards."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from fungrasp.hands import load_hand
from fungrasp.policies.checkpoint.card import ActionPart, Budget, Part, PolicyCard, TrainingData
from fungrasp.policies.checkpoint.checkpoint_file import hand_digest, servo_gains

OBSERVATION = (Part("joint_positions", 3), Part("wrist_velocity", 2))
ACTION = (ActionPart("wrist", 1, 0.02), ActionPart("fingers", 2, 0.3))
STEPS = 4
"""Length of the recurrent policy's history."""


def allegro_card(**changes: Any) -> PolicyCard:
    """The card of a student of the Allegro hand, with these fields set otherwise."""
    hand = load_hand("allegro")
    values: dict[str, Any] = {
        "name": "small",
        "kind": "student",
        "hand": hand.name,
        "hand_digest": hand_digest(hand),
        "joint_names": tuple(hand.actuators),
        "gains": servo_gains(hand),
        "rate_hz": 10.0,
        "observation": OBSERVATION,
        "action": ACTION,
        "action_smoothing": 0.5,
        "training_data": (TrainingData("built-in grasps", "Apache-2.0", 120),),
        "budget": Budget(1_000, 7200.0, "2 cores"),
        "git_revision": "abc123",
        "seed": 3,
        "measured": {"unseen": {"success": 0.875, "slip_mm_s": 1.25}},
        "licence": "Apache-2.0",
        "limits": ("Thin things on the table.",),
        "created": "2026-01-02",
    }
    return PolicyCard(**(values | changes))


def weights(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Matrix [5, 3] and offset [3] of the policies below."""
    generator = np.random.default_rng(seed)
    return generator.normal(size=(5, 3)).astype(np.float32), generator.normal(size=3).astype(np.float32)


def feedforward(**changes: Any) -> onnx.ModelProto:
    """``action = observation @ matrix + offset``, ``contacts = sigmoid(action)``."""
    matrix, offset = weights()
    nodes = [
        helper.make_node("Gemm", ["observation", "matrix", "offset"], ["action"]),
        helper.make_node("Sigmoid", ["action"], ["contacts"]),
    ]
    return model(
        nodes,
        {"observation": ["worlds", 5]},
        {"action": ["worlds", 3], "contacts": ["worlds", 3]},
        {"matrix": matrix, "offset": offset},
        **changes,
    )


def recurrent() -> onnx.ModelProto:
    """``action`` is the mean of the last four observations (nothings at first) times the matrix; the history
    and the number of steps are its state."""
    matrix, _ = weights()
    constants = {
        "matrix": matrix,
        "one": np.array([1], np.int64),
        "end": np.array([STEPS], np.int64),
    }
    nodes = [
        helper.make_node("Slice", ["state_history", "one", "end", "one"], ["kept"]),
        helper.make_node("Unsqueeze", ["observation", "one"], ["newest"]),
        helper.make_node("Concat", ["kept", "newest"], ["next_state_history"], axis=1),
        helper.make_node("ReduceMean", ["next_state_history", "one"], ["mean"], keepdims=0),
        helper.make_node("MatMul", ["mean", "matrix"], ["action"]),
        helper.make_node("Add", ["state_steps", "one"], ["next_state_steps"]),
    ]
    return model(
        nodes,
        {"observation": ["worlds", 5], "state_history": ["worlds", STEPS, 5], "state_steps": ["worlds", 1]},
        {
            "action": ["worlds", 3],
            "next_state_history": ["worlds", STEPS, 5],
            "next_state_steps": ["worlds", 1],
        },
        constants,
    )


def model(
    nodes: list[onnx.NodeProto],
    inputs: dict[str, list],
    outputs: dict[str, list],
    constants: dict[str, np.ndarray],
    functions: tuple[onnx.FunctionProto, ...] = (),
    domains: tuple[str, ...] = (),
) -> onnx.ModelProto:
    """An ONNX model; what ends in "steps" is int64, all else float."""

    def put(name: str, shape: list) -> onnx.ValueInfoProto:
        kind = TensorProto.INT64 if name.endswith("steps") else TensorProto.FLOAT
        return helper.make_tensor_value_info(name, kind, shape)

    graph = helper.make_graph(
        nodes,
        "small",
        [put(*entry) for entry in inputs.items()],
        [put(*entry) for entry in outputs.items()],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    opsets = [helper.make_opsetid("", 18), *(helper.make_opsetid(domain, 1) for domain in domains)]
    return helper.make_model(graph, opset_imports=opsets, functions=functions, ir_version=9)
