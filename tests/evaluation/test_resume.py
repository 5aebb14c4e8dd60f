"""What was kept of an interrupted test is used again only if all that it depends on is the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planned_grasps import grasps_and_objects
from residual_policies import policy_file

from fungrasp.core import jobs
from fungrasp.core.jobs import PartStore
from fungrasp.evaluation import LiftTestResult, LiftTestSpec, evaluate
from fungrasp.evaluation.lift_episodes import LiftTest
from fungrasp.planning.selection.settings import SelectionSettings
from fungrasp.policies.checkpoint.card import SEARCH
from fungrasp.sim2real import Randomization
from fungrasp.task import LiftProtocol

SHORT = LiftProtocol(hold_time=0.2)
ONE = SelectionSettings(2, rollouts=None)


@pytest.fixture
def runs(monkeypatch) -> list[int]:
    """Rows of the chunks that are simulated; the outcomes are made up."""
    rows: list[int] = []
    simulate = LiftTest.simulate
    known: list[dict[str, np.ndarray]] = []

    def run(self, part, progress):
        rows.extend(part.rows.tolist())
        if not known:
            known.append(simulate(self, part, progress))
        return known[0]

    monkeypatch.setattr(LiftTest, "simulate", run)
    return rows


@pytest.fixture
def tried(tmp_path, runs):
    """Tries one grasp, kept in the same file every time."""
    folder = tmp_path / "e.json.partial"

    def call(policy: str = "reference", grasps=None, threads=1, record=None, **asked) -> LiftTestResult:
        chosen, objects = grasps_and_objects()
        chosen = (chosen if grasps is None else grasps).select(np.zeros(1, int))
        spec = LiftTestSpec(**{"lift": SHORT, "policy": policy} | asked)
        store = PartStore(folder)
        return evaluate(chosen, objects, spec=spec, threads=threads, record=record, store=store)

    return call


def test_the_same_is_not_simulated_again(tried, runs):
    one, again = tried(), tried()
    assert runs == [0]
    for name, value in one.outcomes.arrays().items():
        np.testing.assert_array_equal(value, again.outcomes.arrays()[name])
    tried(threads=2)
    assert runs == [0], "threads change nothing"


@pytest.mark.parametrize(
    "change",
    [
        {"seeds": (1,)},
        {"lift": replace(SHORT, hold_time=0.3)},
        {"randomization": Randomization(mass=(2.0, 2.0))},
    ],
)
def test_other_settings_are_tried_anew(tried, runs, change):
    tried()
    tried(**change)
    tried(**change)
    assert runs == [0, 0]


def test_another_version_of_fungrasp_or_mujoco_is_tried_anew(tried, runs, monkeypatch):
    tried()
    for versions in (("0.0.0", jobs.VERSIONS[1]), (jobs.VERSIONS[0], "0.0.0")):
        monkeypatch.setattr(jobs, "VERSIONS", versions)
        tried()
    assert runs == [0, 0, 0]


def test_other_grasps_are_tried_anew(tried, runs):
    grasps, _ = grasps_and_objects()
    tried()
    tried(grasps=replace(grasps, joint_positions=grasps.joint_positions + 1e-9))
    tried(grasps=replace(grasps, extra={"force_scale": np.full(2, 0.9)}))
    assert runs == [0, 0, 0]


def test_a_missing_record_is_made_again(tried, runs, tmp_path):
    tried()
    tried(record=tmp_path / "episodes")
    tried(record=tmp_path / "episodes")
    assert runs == [0, 0, 0], "the file is not there, as nothing was simulated for it"


def test_another_network_in_the_same_file_is_tried_anew(tried, runs, tmp_path):
    path = str(policy_file(tmp_path))
    tried(path)
    tried(path)
    assert runs == [0]
    policy_file(tmp_path, np.full(22, 0.1))
    tried(path)
    assert runs == [0, 0]


def test_another_number_of_attempts_is_tried_anew(tried, runs, tmp_path):
    path = str(policy_file(tmp_path))
    tried(path)
    assert tried(path).attempts is None
    # What is made up here knows nothing of attempts.
    with pytest.raises(KeyError, match="attempts"):
        tried(path, attempts=2)
    assert runs == [0, 0]


def test_other_settings_of_the_selection_are_tried_anew(tried, runs, tmp_path):
    path = str(policy_file(tmp_path, plans=SEARCH))
    for settings in (ONE, ONE, replace(ONE, candidates=3), replace(ONE, confirmations=5)):
        tried(path, selection=settings)
    assert runs == [0, 0, 0]
