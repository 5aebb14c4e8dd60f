"""Running a policy: its numbers, its memory, its worlds; and graphs that can't be run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import helper
from small_policies import OBSERVATION, STEPS, allegro_card, feedforward, model, recurrent, weights

from fungrasp.core.errors import FungraspError
from fungrasp.policies.checkpoint.card import ActionPart
from fungrasp.policies.checkpoint.checkpoint_file import (
    PolicyNetwork,
    load_policy,
    save_policy,
)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> PolicyNetwork:
    path = tmp_path_factory.mktemp("policies") / "small.onnx"
    save_policy(path, feedforward(), allegro_card())
    return load_policy(path)


@pytest.fixture(scope="module")
def remembering(tmp_path_factory: pytest.TempPathFactory) -> PolicyNetwork:
    path = tmp_path_factory.mktemp("policies") / "remembering.onnx"
    save_policy(path, recurrent(), allegro_card())
    return load_policy(path)


def observations(worlds: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(worlds, 5)).astype(np.float32)


def test_the_action_is_the_graphs(small: PolicyNetwork) -> None:
    seen = observations(6)
    matrix, offset = weights()
    action, extras, state = small(seen, small.initial_state(6))
    np.testing.assert_allclose(action, seen @ matrix + offset, atol=1e-6)
    np.testing.assert_allclose(extras["contacts"], 1 / (1 + np.exp(-action)), atol=1e-6)
    assert set(extras) == {"contacts"} and state == {}


def test_a_history_is_a_state(remembering: PolicyNetwork) -> None:
    seen = np.stack([observations(3, seed) for seed in range(7)])
    state = remembering.initial_state(3)
    assert {name: (value.shape, value.dtype) for name, value in state.items()} == {
        "history": ((3, STEPS, 5), np.float32),
        "steps": ((3, 1), np.int64),
    }
    for step in range(7):
        action, extras, state = remembering(seen[step], state)
        recent = seen[max(0, step - STEPS + 1) : step + 1].sum(axis=0) / STEPS
        np.testing.assert_allclose(action, recent @ weights()[0], atol=1e-5)
        assert extras == {} and (state["steps"] == step + 1).all()


def test_worlds_do_not_see_each_other(remembering: PolicyNetwork) -> None:
    together, apart = remembering.initial_state(4), [remembering.initial_state(1) for _ in range(4)]
    for step in range(5):
        seen = observations(4, step)
        action, _, together = remembering(seen, together)
        for world in range(4):
            alone, _, apart[world] = remembering(seen[world : world + 1], apart[world])
            np.testing.assert_allclose(alone[0], action[world], atol=1e-6)


def test_a_step_changes_neither_observation_nor_state(remembering: PolicyNetwork) -> None:
    seen, state = observations(2), remembering.initial_state(2)
    remembering(seen, state)
    np.testing.assert_array_equal(seen, observations(2))
    assert all((value == 0).all() for value in state.values())


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_numbers_that_are_not_finite_are_named(small: PolicyNetwork, bad: float) -> None:
    seen = observations(9).astype(np.float64)
    seen[2, 4] = bad
    with pytest.raises(
        FungraspError, match=r"'small' was given NaN or infinite numbers in 'wrist_velocity', world 2$"
    ):
        small(seen)
    seen[1:, 0] = bad
    with pytest.raises(
        FungraspError, match=r"in 'joint_positions', 'wrist_velocity', worlds 1, 2, 3, 4, 5 and 3 more$"
    ):
        small(seen)


def test_a_broken_state_does_not_become_an_action(remembering: PolicyNetwork) -> None:
    state = remembering.initial_state(2)
    state["history"][1] = np.nan
    with pytest.raises(FungraspError, match=r"gave an action with NaN .* 'wrist', 'fingers', world 1$"):
        remembering(observations(2), state)


@pytest.mark.parametrize("shape", [(5,), (2, 4), (2, 6), (2, 1, 5)])
def test_observations_of_another_shape(small: PolicyNetwork, shape: tuple[int, ...]) -> None:
    with pytest.raises(FungraspError, match=r"shape \[W, 5\] \(joint_positions 3, wrist_velocity 2\), not"):
        small(np.zeros(shape))


def test_states_that_do_not_belong(small: PolicyNetwork, remembering: PolicyNetwork) -> None:
    with pytest.raises(FungraspError, match="remembers 'history', 'steps', the given state has nothing"):
        remembering(observations(2))
    with pytest.raises(FungraspError, match=r"state 'history' .* shape \(2, 4, 5\), not \(3, 4, 5\)"):
        remembering(observations(2), remembering.initial_state(3))
    with pytest.raises(FungraspError, match="remembers nothing"):
        small(observations(2), remembering.initial_state(2))


def graph(
    inputs: dict[str, list], outputs: dict[str, list], nodes: list[tuple[str, str, str]]
) -> onnx.ModelProto:
    return model([helper.make_node(op, [a], [b]) for op, a, b in nodes], inputs, outputs, {})


SEEN, DONE = {"observation": ["w", 5]}, {"action": ["w", 5]}
COPY = ("Identity", "observation", "action")


@pytest.mark.parametrize(
    ("proto", "message"),
    [
        (graph({"seen": ["w", 5]}, DONE, [("Identity", "seen", "action")]), "no 'observation'"),
        (graph(SEEN, {"done": ["w", 5]}, [("Identity", "observation", "done")]), "no 'action'"),
        (graph({"observation": [1, 5]}, {"action": [1, 5]}, [COPY]), "the world, must be left open"),
        (graph({"observation": ["w", 4]}, {"action": ["w", 4]}, [COPY]), r"should be float \[W, 5\]"),
        (graph(SEEN | {"goal": ["w", 5]}, DONE, [COPY]), "has an input 'goal'"),
        (graph(SEEN | {"state_h": ["w", 5]}, DONE, [COPY]), "input 'state_h' and no output 'next_state_h'"),
        (
            graph(SEEN, DONE | {"next_state_h": ["w", 5]}, [COPY, ("Neg", "observation", "next_state_h")]),
            "output 'next_state_h' and no input 'state_h'",
        ),
        (
            graph(
                SEEN | {"state_h": ["w", "n"]},
                DONE | {"next_state_h": ["w", "n"]},
                [COPY, ("Neg", "state_h", "next_state_h")],
            ),
            "'state_h' has no fixed shape",
        ),
        (graph(SEEN, DONE, [("NoSuchOperator", "observation", "action")]), "NoSuchOperator"),
    ],
)
def test_graphs_that_are_not_as_the_card_says(tmp_path: Path, proto: onnx.ModelProto, message: str) -> None:
    with pytest.raises(FungraspError, match=message):
        save_policy(tmp_path / "x.onnx", proto, allegro_card(action=(ActionPart("fingers", 5, 0.3),)))
    assert list(tmp_path.iterdir()) == []


def test_an_action_of_another_size(tmp_path: Path) -> None:
    with pytest.raises(FungraspError, match=r"'action' is tensor\(float\) \['w', 5\]; .* float \[W, 3\]"):
        save_policy(tmp_path / "x.onnx", graph(SEEN, DONE, [COPY]), allegro_card())


def test_a_teachers_input_holds_the_privileged_parts_too(tmp_path: Path) -> None:
    card = allegro_card(kind="teacher", observation=OBSERVATION[:1], privileged=OBSERVATION[1:])
    assert card.input_size == 5
    save_policy(tmp_path / "t.onnx", feedforward(), card)
    with pytest.raises(FungraspError, match="in 'wrist_velocity', world 0"):
        load_policy(tmp_path / "t.onnx")(np.array([[0, 0, 0, 0, np.nan]]))
