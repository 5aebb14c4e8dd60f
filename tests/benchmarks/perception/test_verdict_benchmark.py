"""The benchmark of the verdict, on answers that were written by hand."""

import math
from dataclasses import fields

import pytest

from benchmarks.perception.verdict import Verdict
from benchmarks.perception.verdict_trials import VerdictTrial, append_trials
from fungrasp.errors import FungraspError
from fungrasp.evaluation import read_result
from fungrasp.perception.object_pose.evidence import PoseEvidence


def _trial(mesh, add_s_mm, **evidence):
    numbers = dict.fromkeys((field.name for field in fields(PoseEvidence)), 0.5) | evidence
    pose = [0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0]
    return VerdictTrial("a-capture", "mask", mesh, True, add_s_mm, 3.0, numbers, pose, 1.0)


def test_columns_of_the_evidence_do_not_replace_those_of_the_trial(tmp_path):
    trials, result = tmp_path / "trials.jsonl", tmp_path / "verdict.json"
    append_trials(trials, [_trial("right", 2.0, told=1.0, colored=0.0), _trial("other", math.inf)], None)
    Verdict(trials, json=result).run()
    rows = read_result(result).rows
    assert [row["told"] for row in rows] == ["mask", "mask"]
    assert [row["colored"] for row in rows] == [True, True]
    assert rows[0]["evidence.told"] == 1.0
    assert rows[0]["evidence.colored"] == 0.0


def test_trials_without_a_number_that_is_needed_now_are_refused(tmp_path):
    trials = tmp_path / "trials.jsonl"
    old = _trial("right", 2.0)
    del old.evidence["left_over"]
    append_trials(trials, [old], None)
    with pytest.raises(FungraspError, match="a-capture lack left_over"):
        Verdict(trials).run()
