"""``fungrasp policies`` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from onnx import TensorProto, helper

from fungrasp.cli.main import main
from fungrasp.hands import load_hand
from fungrasp.policies.checkpoint import checkpoint_file as policy_file
from fungrasp.policies.checkpoint.card import ActionPart, Budget, Part, PolicyCard, TrainingData
from fungrasp.policies.checkpoint.checkpoint_file import hand_digest, save_policy, servo_gains

NAMES = ("allegro-student", "allegro-teacher")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A student and a teacher that give back the sine of what they see."""
    folder = tmp_path_factory.mktemp("weights")
    hand = load_hand("allegro")
    put = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["w", 4]) for name in ("observation", "action")
    ]
    graph = helper.make_graph([helper.make_node("Sin", ["observation"], ["action"])], "g", put[:1], put[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    for name in NAMES:
        teacher = name.endswith("teacher")
        card = PolicyCard(
            name=name,
            kind="teacher" if teacher else "student",
            hand="allegro",
            hand_digest=hand_digest(hand),
            joint_names=tuple(hand.actuators),
            gains=servo_gains(hand),
            rate_hz=10,
            observation=(Part("joint_positions", 3 if teacher else 4),),
            privileged=(Part("contact_forces", 1),) if teacher else (),
            action=(ActionPart("wrist_position", 3, 0.02), ActionPart("fingers", 1, 0.3)),
            budget=Budget(3_000_000, 5400.0, "two cores"),
            training_data=(TrainingData("built-in", "Apache-2.0", 120), TrainingData("mine", "CC0", 7)),
            measured={"unseen": {"success": 0.885, "slip_mm_s": 1.2}, "built-in": {"success": 0.9}},
            licence="Apache-2.0",
            limits=("It drops\x1b[2J scissors.",),
        )
        save_policy(folder / f"{name}.onnx", model, card)
    return folder


@pytest.fixture
def shipped(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(policy_file, "FOLDER", folder)
    return folder


def test_list(shipped: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["policies", "list"]) == 0
    header, *rows = capsys.readouterr().out.splitlines()
    assert header.split() == ["name", "kind", "hand", "size", "success", "license", "data"]
    assert [row.split()[:3] for row in rows] == [
        ["allegro-student", "student", "allegro"],
        ["allegro-teacher", "teacher", "allegro"],
    ]
    assert "kB" in rows[0] and "unseen 88%, built-in 90%" in rows[0] and rows[0].endswith("built-in, mine")


def test_the_list_of_what_comes_with_the_package_fits_a_page(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["policies", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > 3 and max(map(len, lines)) <= 130


def test_a_list_of_none(tmp_path: Path, monkeypatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(policy_file, "FOLDER", tmp_path / "none")
    assert main(["policies", "list"]) == 0
    assert "has no built-in policies" in capsys.readouterr().out
    assert main(["policies", "list", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == []


def test_info_says_everything(shipped: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["policies", "info", "allegro-teacher"]) == 0
    out = capsys.readouterr().out
    for words in (
        "allegro-teacher: teacher",
        "at 10 Hz",
        "3,000,000 steps, 1.5 h on two cores",
        "contact_forces  1",
        "wrist_position  3, 1 is 0.02",
        "4, 0.15",
        "120 grasps; Apache-2.0",
        "unseen success    0.885",
        "scissors.",
    ):
        assert words in out, words
    assert "\x1b" not in out


def test_unknown_and_damaged(shipped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["policies", "info", "allegro-studen"]) == 2
    assert "Did you mean 'allegro-student'?" in capsys.readouterr().err
    whole = (shipped / "allegro-student.onnx").read_bytes()
    (tmp_path / "cut.onnx").write_bytes(whole[:-9])
    assert main(["policies", "info", str(tmp_path / "cut.onnx")]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and "cut.onnx: damaged or changed since" in said.err
