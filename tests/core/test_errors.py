"""The errors users meet."""

from __future__ import annotations

import pytest

from fungrasp.core.errors import FungraspError, UnknownNameError


@pytest.mark.parametrize(
    ("given", "meant"),
    [("alegro", "allegro"), ("Allegro", "allegro"), ("shadowhand", "shadow"), ("leep", "leap")],
)
def test_unknown_name_suggests_the_nearest(given: str, meant: str):
    message = str(UnknownNameError("hand", given, {"shadow": 1, "allegro": 2, "leap": 3}))
    assert message == f"unknown hand '{given}'. Did you mean '{meant}'? Known: allegro, leap, shadow."


def test_unknown_name_without_a_near_one_lists_what_there_is():
    message = str(UnknownNameError("object", "zzz", ["mug", "can"]))
    assert message == "unknown object 'zzz'. Known: can, mug."


def test_suggestion_ignores_case_on_both_sides():
    assert "Did you mean '037_Scissors'?" in str(
        UnknownNameError("object", "037_scissors", ["037_Scissors", "mug"])
    )
    assert "Did you mean 'UR5e'?" in str(UnknownNameError("arm", "ur5E", ["UR5e"]))


def test_errors_are_one_kind_and_one_line():
    error = UnknownNameError("hand", "claw", ["allegro"])
    assert isinstance(error, FungraspError)
    assert isinstance(error, ValueError)
    assert "\n" not in str(error)
