"""Each command that is printed as the next one runs as it is printed, from objects of one's own."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fungrasp
from fungrasp.cli.main import main, parsed
from fungrasp.viewer.choose_page import ChosenPage, choose_page

ROW = 50


def hint(output: str) -> list[str]:
    """The command line after ``next: fungrasp``."""
    (words,) = re.findall(r"^next: fungrasp (.*)$", output, re.MULTILINE)
    return shlex.split(words)


def test_hints_lead_from_grasps_to_a_page(tmp_path: Path, monkeypatch, capsys) -> None:
    pytest.importorskip("viser", reason="the extra viewer is not installed")
    monkeypatch.chdir(tmp_path)
    human = fungrasp.builtin_grasps()[ROW : ROW + 1]
    Path("my meshes").mkdir()
    fungrasp.load_object(str(human.object_name[0])).mesh.export("my meshes/mine.obj")
    fields = {name: getattr(human, name) for name in human.FIELDS} | {"object_name": np.array(["mine"])}
    fungrasp.HumanGraspSet(**fields).save("mine.npz")

    shown = []

    def view(what, objects, *, hand, **_):
        page = choose_page(what, objects, hand)
        shown.append(page)
        return Path(page.title)

    monkeypatch.setattr("fungrasp.viewer.view.view", view)
    assert main(["retarget", "--grasps", "mine.npz", "--objects", "my meshes", "--out", "robot 1.npz"]) == 0
    evaluate = hint(capsys.readouterr().out)
    assert evaluate[0] == "evaluate" and "my meshes" in evaluate
    assert main([*evaluate, "--json", "result.json"]) == 0
    assert main(hint(capsys.readouterr().out)) == 0
    (page,) = shown
    assert isinstance(page, ChosenPage) and page.title == "Result"
    result = page.make.keywords["shown"]
    assert result.missing == "" and set(result.objects) == {"mine"}


@pytest.mark.parametrize(
    ("height", "why"), [(0.012, "at 1.2 cm in the hold"), (np.inf, "no hold was reached")]
)
def test_a_lift_that_fails_on_a_twin_says_why(height, why, tmp_path: Path, monkeypatch, capsys) -> None:
    late = SimpleNamespace(summary=lambda: "no tick")
    result = SimpleNamespace(
        ticks=late,
        setpoints=late,
        phase=SimpleNamespace(name="DONE"),
        fault="",
        attempts=1,
        success=False,
        height=height,
        held_as_shown=None,
        times={},
        words=lambda: "not lifted",
    )
    monkeypatch.setattr("fungrasp.deployment.deploy.deploy", lambda *_, **__: result)
    with pytest.raises(SystemExit) as end:
        main(["deploy", "--log", str(tmp_path / "lift.mcap")])
    out = capsys.readouterr().out
    assert end.value.code == 4 and f"not lifted: {why}" in out
    assert parsed(hint(out)).what == str(tmp_path / "lift.mcap")


def test_a_hand_that_was_added_is_retargeted_to(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["hands", "export", "inspire", "--out", "inspire.xml"]) == 0
    assert main(["hands", "add", "inspire.xml", "--out", "my hands/mine"]) == 0
    command = parsed(hint(capsys.readouterr().out))
    assert Path(command.spec.hand) == Path("my hands/mine/hand.toml") and Path(command.out) == Path(
        "mine.npz"
    )
    fungrasp.builtin_grasps()[ROW : ROW + 1].save("one.npz")
    replace(command, grasps="one.npz").run()
    assert Path(fungrasp.load_robot_grasps("mine.npz").hand_file).samefile("my hands/mine/hand.toml")
