"""Policies as files: what is saved comes back, whole or not at all, and is found by name."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from onnx import helper
from small_policies import allegro_card, feedforward

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands import load_hand
from fungrasp.policies.checkpoint import checkpoint_file as policy_file
from fungrasp.policies.checkpoint.card import Budget
from fungrasp.policies.checkpoint.checkpoint_file import (
    find_policy,
    hand_digest,
    list_policies,
    load_policy,
    read_card,
    save_policy,
)

RESEARCH = Path(__file__).parents[3] / "research"


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("policies") / "small.onnx"
    save_policy(path, feedforward(), allegro_card())
    return path


TEXT = st.text(max_size=20)
NUMBER = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
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
from fungrasp.policies.checkpoint.checkpoint_file import load_policy, read_card, save_policy
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
    with pytest.raises(FungraspError, match=r"pip install onnxruntime .*\.\[learning\]"):
        load_policy(saved)


def test_writing_without_onnx_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = feedforward().SerializeToString()
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(FungraspError, match=r"needs the package onnx: .*\.\[learning\]"):
        save_policy(tmp_path / "p.onnx", model, allegro_card())


@pytest.mark.parametrize("measured", [{"success": float("nan")}, {"success": np.float32(1)}, {"a": {1, 2}}])
def test_cards_that_cannot_be_written(tmp_path: Path, measured: dict) -> None:
    with pytest.raises(FungraspError, match="card of policy 'small' can't be written"):
        save_policy(tmp_path / "x.onnx", feedforward(), allegro_card(measured=measured))
    assert list(tmp_path.iterdir()) == []


def test_only_as_onnx(tmp_path: Path) -> None:
    with pytest.raises(FungraspError, match=r"a policy is a \.onnx file"):
        save_policy(tmp_path / "p.pt", feedforward(), allegro_card())


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


def test_policies_of_the_repository_are_sound() -> None:
    """Those of the package by name, those for research by path; files of earlier versions keep loading."""
    shipped = list_policies()
    assert shipped and all(name.endswith("-free") for name in shipped)
    files = [*shipped.values(), *RESEARCH.glob("*.onnx")]
    for name, path in {path.stem: path for path in files}.items():
        policy = load_policy(path)
        card = policy.card
        assert card.name == name and card.licence and card.limits and card.training_data
        action, _, _ = policy(np.zeros((2, card.input_size)), policy.initial_state(2))
        assert action.shape == (2, card.action_size)
        assert card.hand_digest == hand_digest(load_hand(card.hand)), "made for an older model of the hand"
