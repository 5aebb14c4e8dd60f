"""``--json``: every command that finds or makes something answers a program too."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from fungrasp.cli.main import every_command, main

WITHOUT = {
    "view": "serves a page until it is ended",
    "robots bring-up": "a conversation; its log is the answer",
    "robots emulate": "runs until it is ended",
}
"""Commands that have no answer for a program, and why."""


def leaves(commands: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, command in commands.items():
        if isinstance(command, Mapping):
            yield from leaves(command, f"{before}{name} ")
        else:
            yield before + name, command


def test_every_command_with_an_answer_takes_json():
    known = dict(leaves(every_command()))
    assert set(WITHOUT) <= set(known)
    for name, command in known.items():
        answers = "json" in getattr(command, "__dataclass_fields__", {}) or hasattr(command, "json")
        assert answers != (name in WITHOUT), name


def answered(capsys: pytest.CaptureFixture[str], *words: object) -> Any:
    """What is on stdout, all of it, as JSON."""
    assert main([str(word) for word in words]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    "words",
    [
        "doctor",
        "hands list",
        "hands show allegro",
        "hands check allegro",
        "objects list",
        "objects show mug",
        "grasps list",
        "grasps show builtin --grasp 3",
        "policies list",
        "policies info allegro-student-free",
        "robots list",
        "robots check ur5e-allegro",
    ],
)
def test_answers_are_json_and_nothing_else(words: str, capsys: pytest.CaptureFixture[str]):
    assert answered(capsys, *words.split(), "--json") is not None
    main(words.split())
    text = capsys.readouterr().out
    assert text and not text.startswith(("{", "["))


def test_a_chain_of_commands_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    some, robot = tmp_path / "some.npz", tmp_path / "robot.npz"
    chosen = answered(capsys, "grasps", "select", "builtin", "--rows", "0", "--out", some, "--json")
    assert chosen["count"] == 1 and Path(chosen["grasps"]) == some
    made = answered(capsys, "retarget", "--grasps", some, "--out", robot, "--json")
    assert made["count"] == 1 and made["quality"]["grasps_per_second"] > 0
    shown = answered(capsys, "grasps", "show", robot, "--json")
    assert len(shown["joint_positions"]) == len(shown["joint_names"])
    result = answered(capsys, "evaluate", "--grasps", robot, "--policy", "reference", "--json")
    assert len(result["trials"]) == 1
    file = tmp_path / "result.json"
    assert main(["evaluate", "--grasps", str(robot), "--policy", "reference", "--json", str(file)]) == 0
    assert json.loads(file.read_text())["trials"] == result["trials"]
    assert not capsys.readouterr().out.startswith("{")


def test_what_is_wrong_is_one_line_on_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["grasps", "show", str(tmp_path / "none.npz"), "--json"]) == 2
    out, err = capsys.readouterr()
    assert not out and err.startswith("fungrasp: error: ") and err.count("\n") == 1


def test_findings_of_a_bad_hand_are_json_and_a_status(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    bad = tmp_path / "bad.toml"
    bad.write_text("[hand]\n")
    with pytest.raises(SystemExit) as end:
        main(["hands", "check", str(bad), "--json"])
    assert end.value.code == 1
    findings = json.loads(capsys.readouterr().out)
    assert {finding["severity"] for finding in findings} >= {"error"}
