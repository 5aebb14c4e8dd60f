"""Policy files that were cut off, changed, made by somebody else or want more than themselves are refused."""

from __future__ import annotations

import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper
from small_policies import allegro_card, feedforward, model, weights

from fungrasp.core.errors import FungraspError
from fungrasp.policies.checkpoint import checkpoint_file as policy_file
from fungrasp.policies.checkpoint.checkpoint_file import (
    load_policy,
    read_card,
    save_policy,
)

ZEROS = '{"sha256": "' + "0" * 64 + '"'


def sealed(model: bytes, card: str) -> bytes:
    """A file whose hash is right, with any text as its card: made by someone who leaves out our checks."""
    entry = onnx.StringStringEntryProto(key="fungrasp", value=card)
    data = model + onnx.ModelProto(metadata_props=[entry]).SerializeToString()
    at = policy_file._digest_offset(data)
    return data[:at] + policy_file._digest(data, at).encode() + data[at + 64 :]


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
        (b"", "not a policy file: it has no policy card"),
        (b"PK\x03\x04 a zip file, perhaps a torch checkpoint", "not a policy file"),
        (b"\x80\x04\x95 a pickle", "not a policy file"),
        (feedforward().SerializeToString(), "not a policy file"),
        (sealed(b"", ZEROS), "not an ONNX file: it has no graph"),
        (sealed(b"\xff" * 40, ZEROS), "not an ONNX file, or damaged"),
    ],
)
def test_files_that_are_something_else(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "x.onnx").write_bytes(content)
    with pytest.raises(FungraspError, match=message):
        load_policy(tmp_path / "x.onnx")


def test_two_cards(saved: Path, tmp_path: Path) -> None:
    whole = saved.read_bytes()
    card = onnx.ModelProto(metadata_props=onnx.load(saved).metadata_props).SerializeToString()
    (tmp_path / "x.onnx").write_bytes(whole + card)
    with pytest.raises(FungraspError, match="several policy cards"):
        read_card(tmp_path / "x.onnx")


@pytest.mark.parametrize(
    ("card", "message"),
    [
        (ZEROS + "", "not valid JSON"),
        (ZEROS + ', "format_version": 2}', "has format 2; this version of fungrasp reads 1"),
        (ZEROS + "}", "has format None"),
        (ZEROS + ', "format_version": 1}', "lacks 'name'"),
    ],
)
def test_cards_that_cannot_be_read(tmp_path: Path, card: str, message: str) -> None:
    (tmp_path / "x.onnx").write_bytes(sealed(feedforward().SerializeToString(), card))
    with pytest.raises(FungraspError, match=message):
        read_card(tmp_path / "x.onnx")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"seed": 3', '"seed": "3"', "has '3' where 'seed' belongs"),
        ('"seed": 3', '"seed": true', "has True where 'seed' belongs"),
        ('"size": 2', '"size": 2.5', r"has 2.5 where 'observation\[1\].size' belongs"),
        ('"count": 120', '"number": 120', r"where 'training_data\[0\]' belongs"),
        ('"seed": 3', '"seed": 3, "of a later version": 1', None),
    ],
)
def test_cards_with_a_wrong_value(
    saved: Path, tmp_path: Path, old: str, new: str, message: str | None
) -> None:
    text = next(entry.value for entry in onnx.load(saved).metadata_props)
    text = ZEROS + text[len(ZEROS) :].replace(old, new)
    (tmp_path / "x.onnx").write_bytes(sealed(feedforward().SerializeToString(), text))
    if message is None:
        assert replace(read_card(tmp_path / "x.onnx"), sha256="") == allegro_card()
        return
    with pytest.raises(FungraspError, match=message):
        read_card(tmp_path / "x.onnx")


def elsewhere(location: str) -> onnx.ModelProto:
    """A policy whose weights lie in another file."""
    proto = feedforward()
    _move(proto.graph.initializer[0], location)
    return proto


def constant_elsewhere() -> onnx.ModelProto:
    """The same of a constant in the graph."""
    tensor = numpy_helper.from_array(weights()[0])
    _move(tensor, "weights.bin")
    nodes = [
        helper.make_node("Constant", [], ["matrix"], value=tensor),
        helper.make_node("MatMul", ["observation", "matrix"], ["action"]),
    ]
    return model(nodes, {"observation": ["worlds", 5]}, {"action": ["worlds", 3]}, {})


def _move(tensor: onnx.TensorProto, location: str) -> None:
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=location)


def foreign() -> onnx.ModelProto:
    """A policy with an operator that nobody has."""
    proto = feedforward(domains=("org.example",))
    proto.graph.node[1].CopyFrom(helper.make_node("Sigmoid", ["action"], ["contacts"], domain="org.example"))
    return proto


@pytest.mark.parametrize(
    "proto",
    [
        pytest.param(elsewhere("weights.bin"), id="beside"),
        pytest.param(elsewhere("/etc/passwd"), id="absolute"),
        pytest.param(elsewhere("../weights.bin"), id="above"),
        pytest.param(elsewhere("*/_ORT_MEM_ADDR_/*"), id="memory"),
        pytest.param(constant_elsewhere(), id="constant"),
        pytest.param(foreign(), id="foreign operator"),
        pytest.param(onnx.ModelProto(), id="no graph"),
    ],
)
def test_models_that_need_more_than_themselves(
    saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, proto: onnx.ModelProto
) -> None:
    (tmp_path / "inner").mkdir()
    monkeypatch.chdir(tmp_path / "inner")
    for path in ("weights.bin", "../weights.bin"):
        Path(path).write_bytes(bytes(60))
    refused = "xternal data|graph.cc|only standard ONNX ones are run|it has no graph"
    with pytest.raises(FungraspError, match=refused):
        save_policy("x.onnx", proto, allegro_card())
    assert not Path("x.onnx").exists()
    card = next(entry.value for entry in onnx.load(saved).metadata_props)
    Path("y.onnx").write_bytes(sealed(proto.SerializeToString(), ZEROS + card[len(ZEROS) :]))
    with pytest.raises(FungraspError, match=rf"y\.onnx: .*({refused})"):
        load_policy("y.onnx")


def test_a_file_that_would_grow_is_read_in_little_memory(saved: Path, tmp_path: Path) -> None:
    """A terabyte of zeros that the graph would make when it is run, or optimized."""
    matrix = {"matrix": np.zeros((5, 3), np.float32), "shape": np.array([10**6, 10**6], np.int64)}
    nodes = [
        helper.make_node("ConstantOfShape", ["shape"], ["large"]),
        helper.make_node("ReduceSum", ["large"], ["sum"], keepdims=0),
        helper.make_node("MatMul", ["observation", "matrix"], ["small"]),
        helper.make_node("Add", ["small", "sum"], ["action"]),
    ]
    proto = model(nodes, {"observation": ["worlds", 5]}, {"action": ["worlds", 3]}, matrix)
    card = next(entry.value for entry in onnx.load(saved).metadata_props)
    (tmp_path / "x.onnx").write_bytes(sealed(proto.SerializeToString(), ZEROS + card[len(ZEROS) :]))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert read_card(tmp_path / "x.onnx").name == "small"
    with pytest.raises(FungraspError, match=r"takes more than 1\.6 GB of memory"):
        load_policy(tmp_path / "x.onnx")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000
