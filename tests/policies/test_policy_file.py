"""Policies as files: what is saved comes back and runs; what is damaged, foreign or unsafe is refused."""

from __future__ import annotations

import errno
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper
from small_policies import OBSERVATION, STEPS, allegro_card, feedforward, model, recurrent, weights

from fungrasp.errors import FungraspError, UnknownNameError
from fungrasp.hands import load_hand
from fungrasp.hands.hand import read_hand
from fungrasp.policies import policy_file
from fungrasp.policies.card import ActionPart, Budget, Part, PolicyCard
from fungrasp.policies.network import PolicyNetwork
from fungrasp.policies.policy_file import (
    check_fits,
    find_policy,
    hand_digest,
    list_policies,
    load_policy,
    read_card,
    save_policy,
)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("policies") / "small.onnx"
    save_policy(path, feedforward(), allegro_card())
    return path


@pytest.fixture(scope="module")
def small(saved: Path) -> PolicyNetwork:
    return load_policy(saved)


@pytest.fixture(scope="module")
def remembering(tmp_path_factory: pytest.TempPathFactory) -> PolicyNetwork:
    path = tmp_path_factory.mktemp("policies") / "remembering.onnx"
    save_policy(path, recurrent(), allegro_card())
    return load_policy(path)


def observations(worlds: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(worlds, 5)).astype(np.float32)


# Saving and loading


def test_the_card_comes_back(saved: Path) -> None:
    card = read_card(saved)
    assert len(card.sha256) == 64
    assert replace(card, sha256="") == allegro_card()


TEXT = st.text(max_size=20)
NUMBER = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    name=TEXT,
    limits=st.lists(TEXT, max_size=3),
    measured=st.recursive(NUMBER, lambda inner: st.dictionaries(TEXT, inner, max_size=3), max_leaves=5),
    seconds=st.floats(0, 1e9),
)
def test_any_card_comes_back(tmp_path: Path, name, limits, measured, seconds) -> None:
    card = allegro_card(
        name=name, limits=tuple(limits), measured={"all": measured}, budget=Budget(5, seconds, name)
    )
    returned = save_policy(tmp_path / "a.onnx", feedforward(), card)
    assert read_card(tmp_path / "a.onnx") == returned == replace(card, sha256=returned.sha256)


def test_the_file_is_a_sound_onnx_file_for_others(saved: Path) -> None:
    proto = onnx.load(saved)
    onnx.checker.check_model(proto, full_check=True)
    assert [entry.key for entry in proto.metadata_props] == ["fungrasp"]


def test_saving_again_replaces_the_card_and_keeps_other_metadata(saved: Path, tmp_path: Path) -> None:
    proto = onnx.load(saved)
    helper.set_model_props(
        proto, {entry.key: entry.value for entry in proto.metadata_props} | {"note": "mine"}
    )
    save_policy(tmp_path / "b.onnx", proto.SerializeToString(), allegro_card(seed=9))
    assert read_card(tmp_path / "b.onnx").seed == 9
    props = {entry.key: entry.value for entry in onnx.load(tmp_path / "b.onnx").metadata_props}
    assert set(props) == {"fungrasp", "note"} and props["note"] == "mine"


def test_the_same_policy_gives_the_same_bytes(saved: Path, tmp_path: Path) -> None:
    save_policy(tmp_path / "again.onnx", feedforward().SerializeToString(), allegro_card())
    assert (tmp_path / "again.onnx").read_bytes() == saved.read_bytes()


def test_it_loads_and_runs_without_torch_and_onnx(saved: Path) -> None:
    program = f"""
import sys
sys.modules["torch"] = sys.modules["onnx"] = None
import numpy as np
from fungrasp.policies.policy_file import load_policy, read_card, save_policy
import os
assert "onnxruntime" not in sys.modules
policy = load_policy({str(saved)!r})
assert os.environ["ORT_DISABLE_TELEMETRY"] == "1"
print(policy(np.zeros((2, 5)), policy.initial_state(2))[0].shape)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "(2, 3)\n" and done.stderr == ""


def test_a_missing_onnx_runtime_is_said(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(FungraspError, match=r"pip install onnxruntime .*fungrasp\[learning\]"):
        load_policy(saved)
    assert read_card(saved).name == "small"


# Running


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


# Damage


@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.data())
def test_a_changed_byte_is_found(saved: Path, tmp_path: Path, data: st.DataObject) -> None:
    whole = bytearray(saved.read_bytes())
    at = data.draw(st.integers(0, len(whole) - 1))
    whole[at] ^= data.draw(st.integers(1, 255))
    (tmp_path / "x.onnx").write_bytes(whole)
    for read in (read_card, load_policy):
        with pytest.raises(FungraspError, match=r"x\.onnx: "):
            read(tmp_path / "x.onnx")


def test_a_file_cut_off_anywhere_is_found(saved: Path, tmp_path: Path) -> None:
    whole = saved.read_bytes()
    for length in range(0, len(whole), 7):
        (tmp_path / "x.onnx").write_bytes(whole[:length])
        with pytest.raises(FungraspError, match=r"x\.onnx: "):
            read_card(tmp_path / "x.onnx")


def test_a_changed_weight_or_card_is_told_by_the_hash(saved: Path, tmp_path: Path) -> None:
    whole = saved.read_bytes()
    one = weights()[0].tobytes()[:4]
    for old, new in ((one, np.float32(0.1).tobytes()), (b'"seed": 3', b'"seed": 4')):
        assert whole.count(old) == 1
        (tmp_path / "x.onnx").write_bytes(whole.replace(old, new))
        with pytest.raises(FungraspError, match="damaged or changed since it was saved: its SHA-256 is"):
            load_policy(tmp_path / "x.onnx")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no policy: it has no policy card"),
        (b"PK\x03\x04 a zip file, perhaps a torch checkpoint", "not an ONNX file"),
        (b"\x80\x04\x95 a pickle", "not an ONNX file"),
        (b"\xff" * 40, "not an ONNX file"),
        (feedforward().SerializeToString(), "an ONNX file, but no policy"),
    ],
)
def test_files_that_are_something_else(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "x.onnx").write_bytes(content)
    with pytest.raises(FungraspError, match=message):
        load_policy(tmp_path / "x.onnx")


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(FungraspError, match=r"cannot read the policy .*none\.onnx: No such file"):
        load_policy(tmp_path / "none.onnx")
    with pytest.raises(FungraspError, match="cannot read the policy"):
        read_card(tmp_path)


def test_two_cards(saved: Path, tmp_path: Path) -> None:
    whole = saved.read_bytes()
    card = onnx.ModelProto(metadata_props=onnx.load(saved).metadata_props).SerializeToString()
    (tmp_path / "x.onnx").write_bytes(whole + card)
    with pytest.raises(FungraspError, match="several policy cards"):
        read_card(tmp_path / "x.onnx")


def sealed(card: str) -> bytes:
    """A file whose hash is right, with any text as its card."""
    data = policy_file.with_metadata(feedforward().SerializeToString(), "fungrasp", card.encode())
    at = policy_file._digest_offset(data)
    return data[:at] + policy_file._digest(data, at).encode() + data[at + 64 :]


ZEROS = '{"sha256": "' + "0" * 64 + '"'


@pytest.mark.parametrize(
    ("card", "message"),
    [
        (ZEROS + "", "not valid JSON"),
        (ZEROS + ', "format_version": 2}', "of format 2; this version of fungrasp reads 1"),
        (ZEROS + "}", "of format None"),
        (ZEROS + ', "format_version": 1}', "lacks 'name'"),
    ],
)
def test_cards_that_cannot_be_read(tmp_path: Path, card: str, message: str) -> None:
    (tmp_path / "x.onnx").write_bytes(sealed(card))
    with pytest.raises(FungraspError, match=message):
        read_card(tmp_path / "x.onnx")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"seed": 3', '"seed": "3"', "has '3' where 'seed' belongs"),
        ('"seed": 3', '"seed": true', "has True where 'seed' belongs"),
        ('"size": 2', '"size": 2.5', r"has 2.5 where 'observation\[1\].size' belongs"),
        ('"kind": "student"', '"kind": "pupil"', "a teacher or a student, not 'pupil'"),
        ('"rate_hz": 10.0', '"rate_hz": NaN', "rate_hz must be positive"),
        ('"count": 120', '"number": 120', r"where 'training_data\[0\]' belongs"),
        ('"seed": 3', '"seed": 3, "of a later version": 1', None),
    ],
)
def test_cards_with_a_wrong_value(
    saved: Path, tmp_path: Path, old: str, new: str, message: str | None
) -> None:
    text = next(entry.value for entry in onnx.load(saved).metadata_props)
    text = ZEROS + text[len(ZEROS) :].replace(old, new)
    (tmp_path / "x.onnx").write_bytes(sealed(text))
    if message is None:
        assert replace(read_card(tmp_path / "x.onnx"), sha256="") == allegro_card()
        return
    with pytest.raises(FungraspError, match=message):
        read_card(tmp_path / "x.onnx")


# What a file may not do


def external() -> onnx.ModelProto:
    proto = feedforward()
    tensor = proto.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")
    return proto


def foreign() -> onnx.ModelProto:
    proto = feedforward(domains=("com.microsoft",))
    proto.graph.node[1].CopyFrom(helper.make_node("Gelu", ["action"], ["contacts"], domain="com.microsoft"))
    return proto


def hidden() -> onnx.ModelProto:
    """A foreign operator, undeclared, in a branch of a branch."""
    inner = helper.make_node("Gelu", ["action"], ["inner"], domain="com.microsoft")
    plain = helper.make_node("Sigmoid", ["action"], ["plain"])

    def branch(node: onnx.NodeProto) -> onnx.GraphProto:
        put = helper.make_tensor_value_info(node.output[0], TensorProto.FLOAT, None)
        return helper.make_graph([node], "branch", [], [put])

    choice = helper.make_node("If", ["yes"], ["chosen"], then_branch=branch(inner), else_branch=branch(plain))
    proto = feedforward()
    proto.graph.initializer.append(numpy_helper.from_array(np.array(True), "yes"))
    proto.graph.node[1].CopyFrom(
        helper.make_node("If", ["yes"], ["contacts"], then_branch=branch(choice), else_branch=branch(plain))
    )
    return proto


def constant_elsewhere() -> onnx.ModelProto:
    proto = feedforward()
    tensor = numpy_helper.from_array(np.zeros(3, np.float32), "zeros")
    tensor.external_data.add(key="location", value="weights.bin")
    proto.graph.node.append(helper.make_node("Constant", [], ["unused"], value=tensor))
    return proto


def with_function() -> onnx.ModelProto:
    body = [helper.make_node("Sigmoid", ["x"], ["y"])]
    function = helper.make_function("", "Mine", ["x"], ["y"], body, [helper.make_opsetid("", 18)])
    return feedforward(functions=(function,))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (external, "the weights lie in another file"),
        (constant_elsewhere, "the weights lie in another file"),
        (foreign, "the operator 'Gelu' is of the domain 'com.microsoft'"),
        (hidden, "the operator 'Gelu' is of the domain 'com.microsoft'"),
        (with_function, "functions of its own"),
        (onnx.ModelProto, "it has no graph"),
    ],
)
def test_models_that_need_more_than_themselves(saved: Path, tmp_path: Path, make, message: str) -> None:
    with pytest.raises(FungraspError, match=message):
        save_policy(tmp_path / "x.onnx", make(), allegro_card())
    assert not (tmp_path / "x.onnx").exists()
    # Made by someone who leaves out our checks, with a right hash.
    card = next(entry.value for entry in onnx.load(saved).metadata_props)
    data = policy_file.with_metadata(
        make().SerializeToString(), "fungrasp", (ZEROS + card[len(ZEROS) :]).encode()
    )
    at = policy_file._digest_offset(data)
    (tmp_path / "y.onnx").write_bytes(data[:at] + policy_file._digest(data, at).encode() + data[at + 64 :])
    with pytest.raises(FungraspError, match=message):
        load_policy(tmp_path / "y.onnx")


# Graphs that are not as the card says


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
        (graph(SEEN, DONE, [("NoSuchOperator", "observation", "action")]), "ONNX Runtime can't run it"),
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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "master"}, "a teacher or a student"),
        ({"privileged": (Part("forces", 2),)}, "student can't have privileged"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"action_smoothing": 1.0}, "action_smoothing"),
        ({"gains": {}}, "gains must be given for the joints"),
        ({"observation": ()}, "parts of size 1 or more"),
        ({"observation": (Part("a", 3), Part("a", 2))}, "each name once"),
        ({"observation": (Part("a", 0),)}, "size 1 or more"),
        ({"created": "yesterday"}, "ISO 8601"),
    ],
)
def test_cards_that_make_no_sense(changes: dict, message: str) -> None:
    with pytest.raises(FungraspError, match=message):
        allegro_card(**changes)


@pytest.mark.parametrize("measured", [{"success": float("nan")}, {"success": np.float32(1)}, {"a": {1, 2}}])
def test_cards_that_cannot_be_written(tmp_path: Path, measured: dict) -> None:
    with pytest.raises(FungraspError, match="card of policy 'small' can't be written"):
        save_policy(tmp_path / "x.onnx", feedforward(), allegro_card(measured=measured))
    assert list(tmp_path.iterdir()) == []


# A disk that fails


@pytest.mark.parametrize("written", [0, 100])
def test_a_full_disk_leaves_the_older_policy(saved: Path, tmp_path: Path, monkeypatch, written: int) -> None:
    old = tmp_path / "p.onnx"
    old.write_bytes(saved.read_bytes())

    def fill(path: Path, data: bytes) -> int:
        with path.open("wb") as file:
            file.write(data[:written])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fill)
    with pytest.raises(FungraspError, match=r"cannot write .*p\.onnx: No space left on device"):
        save_policy(old, feedforward(), allegro_card(seed=99))
    assert list(tmp_path.iterdir()) == [old]
    assert read_card(old).seed == 3


def test_only_as_onnx(tmp_path: Path) -> None:
    with pytest.raises(FungraspError, match=r"saved as \.onnx"):
        save_policy(tmp_path / "p.pt", feedforward(), allegro_card())


# What it was made for


def fits(card: PolicyCard, **changes) -> None:
    given = {
        "hand": load_hand("allegro"),
        "observation_layout": OBSERVATION,
        "privileged_layout": (),
        "rate": 10.0,
    }
    check_fits(card, **(given | changes))


def test_what_it_was_made_for_fits() -> None:
    fits(allegro_card())
    fits(allegro_card(), privileged_layout=(Part("forces", 13),))
    fits(allegro_card(), observation_layout={"joint_positions": 3, "wrist_velocity": 2})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hand": load_hand("leap")}, "does not fit: it was made for the hand 'allegro', not 'leap'$"),
        ({"rate": 20.0}, "it acts at 10 Hz, here at 20 Hz"),
        (
            {"observation_layout": OBSERVATION[:1]},
            "its observation has 'wrist_velocity', which is missing here",
        ),
        ({"observation_layout": (*OBSERVATION, Part("new", 1))}, "its observation lacks 'new'"),
        (
            {"observation_layout": (OBSERVATION[0], Part("wrist_velocity", 6))},
            "'wrist_velocity' of its observation has 2 numbers, here 6",
        ),
        (
            {"observation_layout": OBSERVATION[::-1]},
            "in the order joint_positions, wrist_velocity, here wrist_velocity, joint_positions",
        ),
        ({"rate": 20.0, "observation_layout": OBSERVATION[:1]}, "missing here; it acts at 10 Hz"),
    ],
)
def test_what_it_was_not_made_for(changes: dict, message: str) -> None:
    with pytest.raises(FungraspError, match=message):
        fits(allegro_card(), **changes)


def test_a_teacher_needs_its_privileged_parts() -> None:
    card = allegro_card(kind="teacher", privileged=(Part("forces", 13),))
    with pytest.raises(FungraspError, match="its privileged observation has 'forces', which is missing here"):
        fits(card)
    fits(card, privileged_layout=(Part("forces", 13),))


def test_another_order_of_joints_or_other_gains() -> None:
    card = allegro_card()
    turned = tuple(reversed(card.joint_names))
    with pytest.raises(FungraspError, match=f"its joints are {turned[0]}, {turned[1]}"):
        fits(replace(card, joint_names=turned, gains={name: card.gains[name] for name in turned}))
    stiff = {name: (9.0, kd) for name, (_, kd) in card.gains.items()}
    with pytest.raises(
        FungraspError,
        match=rf"other servo gains: {card.joint_names[0]} kp 9, kd 0\.15, not 4, 0\.15 and 15 more",
    ):
        fits(replace(card, gains=stiff))


@pytest.fixture
def copy_of_allegro(tmp_path: Path) -> Path:
    hand = load_hand("allegro")
    for path in (hand.path, hand.model_path):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path / hand.path.name


@pytest.mark.parametrize(
    ("file", "old", "new", "same"),
    [
        ("hand.toml", "\n", "\r\n", True),
        ("allegro.xml", "\n", "\r\n", True),
        ("allegro.xml", "<worldbody>", "<!-- note -->\n   <worldbody>", True),
        ("hand.toml", 'title = "', 'title = "My ', True),
        ("hand.toml", "force_limit = 0.7", "force_limit = 0.8", False),
        ("allegro.xml", 'name="ff_tip_centre" pos="', 'name="ff_tip_centre" pos="0.00', False),
    ],
)
def test_a_hand_is_another_when_its_files_say_something_else(copy_of_allegro, file, old, new, same) -> None:
    path = copy_of_allegro.parent / file
    text = path.read_text()
    assert old in text
    path.write_bytes(text.replace(old, new).encode())
    changed = read_hand(copy_of_allegro)
    assert (hand_digest(changed) == hand_digest(load_hand("allegro"))) is same
    if same:
        fits(allegro_card(), hand=changed)
        return
    with pytest.raises(FungraspError, match="the model of the hand 'allegro' has changed since"):
        fits(allegro_card(), hand=changed)


# Policies that come with the package


def test_policies_by_name(saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("allegro-student", "allegro-teacher"):
        (tmp_path / f"{name}.onnx").write_bytes(saved.read_bytes())
    (tmp_path / "README.md").write_text("")
    monkeypatch.setattr(policy_file, "FOLDER", tmp_path)
    assert list(list_policies()) == ["allegro-student", "allegro-teacher"]
    assert find_policy("allegro-student") == tmp_path / "allegro-student.onnx"
    assert load_policy("allegro-teacher").card.name == "small"
    for look_up in (find_policy, load_policy, read_card):
        with pytest.raises(
            UnknownNameError, match=r"policy 'allegro-studnet'. Did you mean 'allegro-student'\?"
        ):
            look_up("allegro-studnet")


def test_shipped_policies_are_sound() -> None:
    for name, path in list_policies().items():
        policy = load_policy(path)
        card = policy.card
        assert card.name == name and card.licence and card.limits and card.training_data
        action, _, _ = policy(np.zeros((2, card.input_size)), policy.initial_state(2))
        assert action.shape == (2, card.action_size)
        assert card.hand_digest == hand_digest(load_hand(card.hand)), "made for an older model of the hand"
