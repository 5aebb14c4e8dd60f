"""``python -m benchmarks.twins`` from grasps to its result; deployments are not played here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from played_twins import play_twins

from benchmarks.synthetic_captures.perceived_grasps import PerceivedGrasps
from benchmarks.twins.__main__ import EvaluateOnTwins
from benchmarks.twins.twin_series import TwinSeriesSpec
from fungrasp.cli.main import run_command
from fungrasp.evaluation.result_files import read_result


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    return play_twins(monkeypatch)


def evaluate(out: Path, **options) -> EvaluateOnTwins:
    images = options.pop("images_per_grasp", 0)
    asked = {"policy": "reference", "in_turn": True, **options}
    spec = TwinSeriesSpec(**asked)
    return EvaluateOnTwins(out, spec, rows=(0, 3), images_per_grasp=images, threads=1)


def test_images_are_numbered_by_row(played, tmp_path, monkeypatch, capsys) -> None:
    # The second image of the first grasp is refused, and both of the other's are seen.
    taken = []

    def seen(source, grasp, image, model):
        taken.append((grasp, image))
        if (grasp, image) == (0, 1):
            return {"refused": np.asarray("no hand")}
        human = source._human.select([grasp])
        known = {name: getattr(human, name) for name in human.FIELDS}
        return {name: value for name, value in known.items() if value is not None}

    monkeypatch.setattr(PerceivedGrasps, "_seen", seen)
    out = tmp_path / "twins.json"
    again = {"variants": ("full, two attempts",), "policy": "student"}
    evaluate(out, images_per_grasp=2, **again).run()
    assert sorted(taken) == [(0, 0), (0, 1), (1, 0), (1, 1)]
    result = read_result(out)
    assert [row["index"] for row in result.rows] == [0, 6, 7]
    assert [row["success"] for row in result.rows] == [True, False, True]
    assert {row["attempts"] for row in result.rows} == {2}
    assert result.header["not_seen"] == {"1": "no hand"}
    assert result.header["images"] == 4
    assert result.header["grasps_that_can_be_reached"] == 3
    said = capsys.readouterr().out
    assert "4 images: 1 refused; of the others 0 were found out of reach, 3 tried" in said
    assert "67%" in said
    assert not list(tmp_path.glob("*.partial"))


@pytest.mark.parametrize("policy", ["plan", "reference"])
def test_a_second_attempt_of_a_blind_policy_is_refused_before_images_are_seen(
    policy: str, played, tmp_path, capsys
) -> None:
    given = ["--variants", "full, two attempts", "--policy", policy, "--images-per-grasp", "2"]
    assert (
        run_command(
            "python -m benchmarks.twins", EvaluateOnTwins, [*given, "--out", str(tmp_path / "twins.json")]
        )
        == 2
    )
    said = capsys.readouterr().err.strip()
    assert "'full, two attempts' needs a policy that watches" in said and "\n" not in said
    assert not list(tmp_path.iterdir())
