"""Lift tests in parts of a few episodes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from fungrasp.evaluation import LiftTestResult, evaluate, lift_evaluation


@contextmanager
def parts_of(episodes: int, together: int | None = None) -> Iterator[None]:
    """Parts of so many episodes at most, so many of which are simulated together."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lift_evaluation, "EPISODES", (episodes, episodes))
        patch.setattr(lift_evaluation, "SEARCHED_EPISODES", (episodes, episodes))
        patch.setattr(lift_evaluation, "LOSS", 1)
        patch.setattr(lift_evaluation, "BATCH", together or episodes)
        yield


def evaluate_in_parts(episodes: int, *given: Any, **options: Any) -> LiftTestResult:
    """``evaluate`` with parts of so many episodes."""
    with parts_of(episodes):
        return evaluate(*given, **options)
