"""A series on twins from grasps to its result; deployments are not played here."""

from __future__ import annotations

from dataclasses import replace

import pytest
from played_twins import play_twins

from benchmarks.twins import twin_episode
from benchmarks.twins.twin_episode import TwinEpisode
from benchmarks.twins.twin_series import (
    KnownGrasps,
    TwinSeriesResult,
    TwinSeriesSpec,
    evaluate_on_twins,
)
from fungrasp.core.errors import FungraspError
from fungrasp.core.records import record_from_json
from fungrasp.evaluation.result_files import read_result
from fungrasp.grasps import builtin_grasps, load_objects
from fungrasp.hands import load_hand
from fungrasp.retargeting import retarget

SPEC = TwinSeriesSpec(policy="reference", variants=("full", "no identification"))


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    return play_twins(monkeypatch)


@pytest.fixture(scope="module")
def grasps():
    human = builtin_grasps().select([0, 3])
    objects = load_objects(human)
    robot = retarget(human, objects, load_hand("allegro"), threads=1)
    return KnownGrasps(robot, [5, 7]), objects


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"variants": ("full", "full")}, "--variants needs .* once"),
        ({"variants": ("fulll",)}, "Did you mean 'full'"),
        ({"twins": ()}, "--twins needs at least one"),
        ({"twins": (-1,)}, "--twins must not be negative"),
        ({"grasps_per_object": 0}, "--grasps-per-object must be at least 1"),
    ],
)
def test_what_can_not_be_asked(options, said) -> None:
    with pytest.raises(FungraspError, match=said):
        TwinSeriesSpec(**options).check()


def test_the_table_by_variant() -> None:
    def episode(variant: str, success: bool, tracking: float, sag: float) -> TwinEpisode:
        return TwinEpisode(0, "mug", 0, variant, success, -1.0, "", tracking, sag, held_as_shown=success)

    episodes = (
        episode("full", True, 0.02, 0.1),
        episode("full", False, 0.04, 0.3),
        episode("full", False, -1.0, -1.0),
        episode("no identification", False, -1.0, -1.0),
    )
    result = TwinSeriesResult(SPEC, episodes)
    full, other = (line.split() for line in result.table().splitlines()[-2:])
    assert full[1:4] == ["3", "2", "33%"] and full[-3:] == ["33%", "0.030", "11.5"]
    assert other[-1] == "nan"


def test_the_result_is_written_after_every_episode(played, grasps, tmp_path, monkeypatch) -> None:
    out = tmp_path / "twins.json"
    deploy, counts = twin_episode.deploy_on_twin, []

    def deploy_until_stopped(*arguments, **options):
        counts.append(len(read_result(out).rows) if out.exists() else 0)
        if len(counts) == 4:
            raise KeyboardInterrupt
        return deploy(*arguments, **options)

    monkeypatch.setattr(twin_episode, "deploy_on_twin", deploy_until_stopped)
    with pytest.raises(KeyboardInterrupt):
        evaluate_on_twins(SPEC, out, *grasps, {"grasps": "mine"}, threads=1)
    assert counts == [0, 1, 2, 3]
    assert (tmp_path / "twins.json.partial").is_dir()
    monkeypatch.setattr(twin_episode, "deploy_on_twin", deploy)
    played.clear()
    result = evaluate_on_twins(SPEC, out, *grasps, {"grasps": "mine"}, threads=1)
    # Two grasps on three twins in two variants, of which three were finished.
    assert len(result.episodes) == 12 and len(played) == 9
    assert result.reached == (5, 7) and not result.out_of_reach
    written = read_result(out)
    assert written.header["grasps"] == "mine" and len(written.rows) == 12
    assert record_from_json(TwinSeriesSpec, written.header["spec"], "spec") == SPEC
    assert not list(tmp_path.glob("*.partial"))


def test_grasps_of_another_hand_are_refused(grasps, tmp_path) -> None:
    with pytest.raises(FungraspError, match="carries the hand 'inspire', and the grasps are of 'allegro'"):
        evaluate_on_twins(replace(SPEC, cell="ur5e-inspire"), tmp_path / "twins.json", *grasps)
