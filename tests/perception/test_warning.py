"""Warnings have a code, values and a sentence."""

from __future__ import annotations

import re

import pytest

from fungrasp.core.errors import UnknownNameError
from fungrasp.perception.estimates import MESSAGES, PerceptionWarning


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
