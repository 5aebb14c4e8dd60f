"""The benchmark of the verdict, on answers that were written by hand."""

import math
from dataclasses import fields, replace

import pytest

from benchmarks.perception.looks import looks_figures
from benchmarks.perception.verdict import Verdict
from benchmarks.perception.verdict_trials import VerdictTrial, append_trials
from fungrasp.core.errors import FungraspError
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


def test_another_look_is_taken_where_the_first_leaves_doubt():
    good = dict.fromkeys((field.name for field in fields(PoseEvidence)), 0.0)
    good |= {"told": 1.0, "explained": 0.99, "visible": 0.99, "larger": 0.1, "off": 0.5, "other_size": -0.5}
    doubtful = good | {"explained": 0.6, "other_side": 0.2}
    sure, unsure = _trial("right", 2.0, **good), _trial("right", 2.0, **doubtful)
    wrong = [_trial("other", math.inf, **each) for each in (doubtful, good)]
    first, second = (
        [replace(sure, capture="b"), unsure, wrong[0]],
        [replace(unsure, capture="b"), sure, wrong[0]],
    )
    figures, rows = looks_figures([first, second])
    assert [(row["capture"], row["looks"]) for row in rows] == [("b", 1), ("a-capture", 2), ("a-capture", 2)]
    assert figures["captures"] == 2
    right, others = figures["mask"]["right"], figures["mask"]["wrong_mesh"]
    assert right["first"]["rate"] == 0.5 and right["together"]["rate"] == 1.0
    assert others["first"]["rate"] == others["together"]["rate"] == 0.0
    again, _ = looks_figures([[wrong[1]], [wrong[1]]])
    assert again["mask"]["wrong_mesh"]["together"]["rate"] == 1.0, "believed twice"


def test_trials_without_a_number_that_is_needed_now_are_refused(tmp_path):
    trials = tmp_path / "trials.jsonl"
    old = _trial("right", 2.0)
    del old.evidence["left_over"]
    append_trials(trials, [old], None)
    with pytest.raises(FungraspError, match="a-capture lack left_over"):
        Verdict(trials).run()
