"""``fungrasp robots evaluate`` from grasps to its result; deployments are not played here."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fungrasp.evaluation.twin_episode as twin_episode
import fungrasp.synthetic_captures.perceived_grasps as perceived_grasps
from fungrasp.cli.evaluate_on_twins import EvaluateOnTwins
from fungrasp.errors import FungraspError, UnknownNameError
from fungrasp.evaluation.result_files import read_result


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Objects of the deployments, of which every second misses."""
    names: list[str] = []

    def deploy(cell, hand, thing, *arguments, **options):
        names.append(thing.name)
        result = SimpleNamespace(fault="", attempts=options["settings"].attempts)
        return SimpleNamespace(
            result=result, success=len(names) % 2 == 1, height=0.11, tracking=0.02, sag=0.03
        )

    def reach(cell, hand, thing, grasp, seed=0):
        yield from (np.array([x, 0, 0, 1, 0, 0, 0]) for x in (0.1, 0.2))

    monkeypatch.setattr(twin_episode, "deploy_on_twin", deploy)
    monkeypatch.setattr(twin_episode, "reachable_placements", reach)
    return names


def evaluate(out: Path, **options) -> EvaluateOnTwins:
    settings = {"rows": (0, 3), "policy": "reference", "told": True, "in_turn": True, "threads": 1}
    return EvaluateOnTwins(out=out, **{**settings, **options})


def test_images_are_numbered_by_row(played, tmp_path, monkeypatch, capsys) -> None:
    def seen(human, objects, images, seed, store, progress):
        # The second image of the first grasp is refused, and both of the other's are seen.
        rows = [0, 1, 1]
        return perceived_grasps.SeenGrasps(human.select(rows), [0, 2, 3], {1: "no hand"})

    monkeypatch.setattr(perceived_grasps, "grasps_from_images", seen)
    out = tmp_path / "twins.json"
    evaluate(out, images=2, places=2, variants=("ours, two attempts",)).run()
    result = read_result(out)
    assert [(row["index"], row["place"]) for row in result.rows] == [
        (0, 0), (0, 1), (6, 0), (6, 1), (7, 0), (7, 1),
    ]  # fmt: skip
    assert [row["success"] for row in result.rows] == [True, False] * 3
    assert {row["attempts"] for row in result.rows} == {2}
    assert result.header["not_seen"] == {"1": "no hand"}
    assert result.header["images"] == 4
    assert result.header["grasps_that_can_be_reached"] == 3
    said = capsys.readouterr().out
    assert "4 images: 1 refused; of the others 0 were found out of reach, 3 tried" in said
    assert "50%" in said
    assert not list(tmp_path.glob("*.partial"))


def test_nothing_is_seen(played, tmp_path, monkeypatch) -> None:
    nothing = perceived_grasps.SeenGrasps(None, [], {0: "no hand", 1: "no hand"})
    monkeypatch.setattr(perceived_grasps, "grasps_from_images", lambda *arguments: nothing)
    with pytest.raises(FungraspError, match="confident of no image"):
        evaluate(tmp_path / "twins.json", images=1).run()
    assert not played


def test_unknown_variant(played, tmp_path) -> None:
    with pytest.raises(UnknownNameError, match="two attempts"):
        evaluate(tmp_path / "twins.json", variants=("two tries",)).run()
