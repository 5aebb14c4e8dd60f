"""The errors users meet."""

from __future__ import annotations

import pytest

from fungrasp.core.errors import FungraspError, UnknownNameError


@pytest.mark.parametrize(
    ("given", "known", "words"),
    [
        ("alegro", ["shadow", "allegro"], " Did you mean 'allegro'? Known: allegro, shadow."),
        ("Allegro", ["shadow", "allegro"], " Did you mean 'allegro'? Known: allegro, shadow."),
        ("ur5E", ["UR5e"], " Did you mean 'UR5e'? Known: UR5e."),
        ("zzz", ["mug", "can"], " Known: can, mug."),
        ("zzz", [], " Known: none."),
    ],
)
def test_unknown_name_suggests_the_nearest(given: str, known: list[str], words: str):
    error = UnknownNameError("hand", given, known)
    assert str(error) == f"unknown hand '{given}'.{words}" and isinstance(error, FungraspError)
    assert str(UnknownNameError("hand", given, known, "Ask.")) == f"{error} Ask."
