"""Fitting and checking scores."""

from __future__ import annotations

import numpy as np
import pytest

from fungrasp.errors import FungraspError
from fungrasp.evaluation.calibration import (
    Answers,
    answers_of,
    cross_validated,
    fit_logistic,
    log_loss,
    lowest_threshold,
    reliability,
    scored,
)
from fungrasp.perception.object_pose.confidence import FEATURES


def drawn(count: int, weights: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    evidence = rng.normal(size=(count, len(weights) - 1)) * [3.0, 0.2] + [5.0, -1.0]
    return evidence, rng.uniform(size=count) < scored(weights, evidence)


def test_the_weights_that_made_the_answers_are_found():
    true = np.array([-6.0, 1.0, -2.0])
    evidence, right = drawn(20_000, true, np.random.default_rng(0))
    np.testing.assert_allclose(fit_logistic(evidence, right), true, rtol=0.15)


def test_separable_answers_give_finite_weights():
    evidence = np.linspace(0, 1, 20)[:, None]
    weights = fit_logistic(evidence, evidence[:, 0] > 0.5)
    assert np.isfinite(weights).all()
    score = scored(weights, evidence)
    assert score[0] < 0.05 and score[-1] > 0.95


def test_an_objects_own_answers_do_not_make_its_score():
    rng = np.random.default_rng(1)
    evidence = rng.normal(size=(60, 1))
    group = np.repeat(["a", "b", "c"], 20)
    right = evidence[:, 0] > 0
    # Of one object everything is the other way round; the others must not know it.
    right[group == "c"] = ~right[group == "c"]
    answers = Answers(evidence, right, np.zeros(60), group)
    score = cross_validated(answers, [0])
    strange = group == "c"
    assert (score[strange & (evidence[:, 0] > 0.5)] > 0.5).all()
    assert log_loss(score[strange], right[strange]) > 1


def test_log_loss_of_one_answer():
    assert log_loss(np.array([0.8]), np.array([True])) == pytest.approx(-np.log(0.8))
    assert log_loss(np.array([0.8]), np.array([False])) == pytest.approx(-np.log(0.2))


def test_the_threshold_keeps_its_promise():
    score = np.array([0.9, 0.8, 0.7, 0.6, 0.5])
    right = np.array([True, True, False, True, False])
    assert lowest_threshold(score, right, 0.97) == 0.8
    assert lowest_threshold(score, right, 0.75) == 0.6
    assert lowest_threshold(score, ~right, 0.97) == np.inf
    assert lowest_threshold(np.array([0.9, 0.9]), np.array([True, False]), 0.97) == np.inf


def test_reliability_counts():
    rows = reliability(
        np.array([0.1, 0.2, 0.95, 1.0]), np.array([False, True, True, True]), np.array([0, 0.5, 0.9, 1])
    )
    assert [row["count"] for row in rows] == [2, 2], "empty ranges are left out"
    assert [row["right"] for row in rows] == [0.5, 1.0]
    assert rows[0]["mean_score"] == pytest.approx(0.15)


def test_answers_of_a_benchs_rows():
    evidence = dict.fromkeys(FEATURES, 0.5)
    good = {"add_s_mm": 1.0, "score": 0.9, "evidence": evidence}
    bad = {"add_s_mm": None, "score": 0.2, "evidence": evidence}
    nothing = {"add_s_mm": 50.0, "score": 0.0, "evidence": {}}
    rows = [
        {
            "object_name": "mug",
            "masked": good,
            "unmasked": nothing,
            "wrong_mesh": bad,
            "absent": {"pose": bad},
        }
    ]
    answers = answers_of(rows)
    assert answers.right.tolist() == [True, False, False] and answers.score.tolist() == [0.9, 0.2, 0.2]
    assert answers.evidence.shape == (3, len(FEATURES)) and set(answers.group) == {"mug"}
    with pytest.raises(FungraspError, match="no pose answers"):
        answers_of([{**rows[0], "masked": nothing, "wrong_mesh": None, "absent": None}])
