"""Recorded episodes in other engines. MuJoCo, built anew from what was recorded, is the control; Drake is
tried where it is installed."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from benchmark_runs import run_benchmark
from mujoco_control import MujocoWorld

import benchmarks.engines.__main__ as audits
import fungrasp
from benchmarks.engines import drake_world
from benchmarks.engines.__main__ import audit, load_bundles
from benchmarks.engines.bundle import EpisodeBundle
from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import LiftTestSpec
from fungrasp.objects import builtin_object


@cache
def recorded(hand: str, folder: Path) -> Path:
    """The folder of a can's and a ball's recorded grasps."""
    human = fungrasp.builtin_grasps()
    rows = [int(np.flatnonzero(human.object_name == name)[0]) for name in ("can", "tennis_ball")]
    human = human.select(np.array(rows))
    objects = fungrasp.load_objects(human)
    robot = fungrasp.retarget(human, objects, hand=hand)
    fungrasp.evaluate(robot, objects, threads=1, record=folder / hand)
    return folder / hand


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recorded")


def bundles_of(path: Path) -> list[EpisodeBundle]:
    return load_bundles([path], lambda one: builtin_object(one.object_name, one.object_mass))


@pytest.mark.parametrize("hand", ["allegro", "inspire"])
def test_mujoco_built_anew_from_the_recordings_ends_as_they_did(hand, folder):
    """Of a hand with coupled joints too; slip agrees, so that it is the same motion."""
    bundles = bundles_of(recorded(hand, folder))
    result = audit(bundles, MujocoWorld)
    assert result.agreeing == len(bundles) == 2 and any(one.recorded for one in result.episodes)
    for one in result.episodes:
        assert one.settled_mm < 0.5 and one.difference == ""
        if one.recorded:
            assert one.slip_mm_s == pytest.approx(one.recorded_slip_mm_s, abs=0.3)
    assert len(bundles[0].couplings) == (6 if hand == "inspire" else 0)


def test_use_tests_in_which_only_the_hand_moves_end_as_they_did(tmp_path):
    """A can that is drunk from. What is handed over is pulled at, and left out."""
    human = fungrasp.builtin_grasps()
    rows = [
        np.flatnonzero(human.object_name == "can")[1],
        np.flatnonzero(human.task == "hand over")[0],
    ]
    human = human.select(np.array(rows))
    objects = fungrasp.load_objects(human)
    robot = fungrasp.retarget(human, objects, hand="shadow")
    spec = LiftTestSpec(policy="reference", use=True)
    result = fungrasp.evaluate(robot, objects, spec=spec, human=human, threads=1, record=tmp_path)
    assert result.success.all()
    files = sorted(tmp_path.glob("*_use.npz"))
    assert len(files) == 2 and len(list(tmp_path.iterdir())) == 4
    bundles = load_bundles([tmp_path], lambda one: builtin_object(one.object_name, one.object_mass), use=True)
    assert [one.use for one in bundles] == [True]
    (one,) = audit(bundles, MujocoWorld).episodes
    assert one.success and one.recorded and one.slip_mm_s == pytest.approx(one.recorded_slip_mm_s, abs=0.3)
    (lost,) = audit([replace(bundles[0], friction=0.05)], MujocoWorld).episodes
    assert not lost.success and "in the palm" in lost.reason
    with pytest.raises(FungraspError, match="leave it out where it is of a use test"):
        load_bundles([files[1]], lambda one: builtin_object(one.object_name, one.object_mass), use=True)


def test_a_grasp_that_is_spoiled_is_lost_and_it_is_said_why(folder):
    bundle = next(one for one in bundles_of(recorded("allegro", folder)) if one.success)
    told = bundle.told.copy()
    told[:, 6:] = told[0, 6:]
    open_hand = replace(bundle, setpoints=tuple(map(tuple, told.tolist())))
    (one,) = audit([open_hand], MujocoWorld).episodes
    assert one.recorded and not one.success
    assert (one.reason, one.difference) == ("lost before the hold", "fewer links touched as the lift began")
    assert "held only when recorded:   1 fewer links" in audit([open_hand], MujocoWorld).table()
    slippery = replace(bundle, friction=0.05)
    (one,) = audit([slippery], MujocoWorld).episodes
    assert not one.success and one.difference


def test_the_command_says_what_holds(folder, tmp_path, capsys, monkeypatch):
    where, file = recorded("allegro", folder), tmp_path / "audit.json"
    monkeypatch.setattr(drake_world, "DrakeWorld", MujocoWorld)
    monkeypatch.setattr(audits, "find_spec", lambda name: True)
    status, out, _ = run_benchmark(capsys, "engines", "audit", where, "--json", file)
    assert status == 0 and "held here" in out and len(json.loads(file.read_text())["each"]) == 2


def test_what_can_not_be_replayed_is_refused_in_words(folder, tmp_path, monkeypatch, capsys):
    first = sorted(recorded("allegro", folder).iterdir())[0]
    moved = replace(fungrasp.evaluation.trajectory.replay(first), differs="friction")
    moved.save(tmp_path / "other.npz")
    with pytest.raises(FungraspError, match=r"other is of a world in which .*: friction"):
        bundles_of(tmp_path / "other.npz")
    (tmp_path / "none").mkdir()
    with pytest.raises(FungraspError, match="no recorded episodes"):
        bundles_of(tmp_path / "none")
    monkeypatch.setattr(audits, "find_spec", lambda name: None)
    status, _, err = run_benchmark(capsys, "engines", "audit", first)
    assert status == 2 and 'not installed: pip install "fungrasp[drake]"' in err


@pytest.mark.slow
def test_good_grasps_hold_in_drake(folder):
    pytest.importorskip("pydrake", reason='the extra "drake" is not installed')
    for hand in ("allegro", "inspire"):
        result = audit(bundles_of(recorded(hand, folder)), drake_world.DrakeWorld)
        assert all(one.success for one in result.episodes if one.recorded), result.table()
