"""Policy files that were cut off, changed, made by somebody else or want more than themselves are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper
from small_policies import allegro_card, feedforward, weights

from fungrasp.errors import FungraspError
from fungrasp.policies.checkpoint import checkpoint_file as policy_file
from fungrasp.policies.checkpoint.checkpoint_file import (
    load_policy,
    read_card,
    save_policy,
)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("policies") / "small.onnx"
    save_policy(path, feedforward(), allegro_card())
    return path


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
    with pytest.raises(FungraspError, match=r"the policy .*none\.onnx does not exist"):
        load_policy(tmp_path / "none.onnx")
    with pytest.raises(FungraspError, match="is a folder"):
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
        ('"kind": "student"', '"kind": "pupil"', "a teacher or a student or a critic, not 'pupil'"),
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
        (foreign, "the operator"),
        (hidden, "the operator"),
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
