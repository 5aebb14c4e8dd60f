"""Estimates are checked; warnings have a code, values and a sentence."""

from __future__ import annotations

import re

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.perception import HandEstimate, ObjectEstimate
from fungrasp.perception.io.estimates import MESSAGES, PerceptionWarning

POSE = np.array([0, 0, 0.6, 1, 0, 0, 0.0])


def a_hand(**changes) -> HandEstimate:
    fields = {
        "joints_camera": np.ones((21, 3)),
        "pixels": np.ones((21, 2)),
        "confidence": np.ones(21),
        "covariance": np.tile(np.eye(3), (21, 1, 1)),
        "side": "right",
        "score": 0.9,
    }
    return HandEstimate(**{**fields, **changes})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"joints_camera": np.ones((20, 3))}, r"joints_camera must have shape \[21, 3\], not \[20, 3\]"),
        ({"covariance": np.ones((21, 3))}, "covariance"),
        ({"pixels": np.full((21, 2), np.nan)}, "pixels has non-finite"),
        ({"side": "Right"}, "side"),
        ({"score": 1.2}, "score"),
    ],
)
def test_a_hand_is_checked(changes, words):
    assert a_hand().side == "right"
    with pytest.raises(FungraspError, match=words):
        a_hand(**changes)


def test_an_object_and_its_alternatives_are_checked():
    estimate = ObjectEstimate(POSE, 0.8, True, ((POSE, 0.4),), residual_m=0.001)
    assert estimate.alternatives[0][1] == 0.4
    with pytest.raises(FungraspError, match="score"):
        ObjectEstimate(POSE, 0.8, True, ((POSE, 1.4),))
    with pytest.raises(FungraspError, match="pose"):
        ObjectEstimate(POSE[:6], 0.8, True)


def test_a_warning_reads_as_a_sentence():
    given = PerceptionWarning.of("low_own_score", score=0.314)
    assert str(given) == "the estimator's own score is 0.31"
    assert given.code == "low_own_score" and given.values == {"score": 0.314}


def test_every_sentence_takes_its_values():
    for code, message in MESSAGES.items():
        values = dict.fromkeys(re.findall(r"{(\w+)", message), 1.5)
        assert str(PerceptionWarning(code, values))


def test_an_unknown_code_is_refused():
    with pytest.raises(UnknownNameError, match="low_own_score"):
        PerceptionWarning.of("low_own_scor")
