"""``view``: a page for what each verb returns, and what can't be looked at."""

from __future__ import annotations

import re

import pytest

import fungrasp
from fungrasp.core.errors import FungraspError


@pytest.fixture(scope="module")
def human():
    grasps = fungrasp.builtin_grasps()
    return grasps[[int((grasps.object_name == name).argmax()) for name in ("can", "tennis_ball")]]


@pytest.fixture(scope="module")
def objects(human):
    return fungrasp.load_objects(human)


@pytest.fixture(scope="module")
def robot(human, objects):
    return fungrasp.retarget(human, objects, "allegro")


def test_grasps_are_drawn(human, robot, objects, tmp_path):
    people = fungrasp.view(human, out=tmp_path / "people.html").read_text()
    robots = fungrasp.view(robot, objects, out=tmp_path / "robots.html").read_text()
    for page in (people, robots):
        assert page.count("data:image/png;base64,") == 2
        assert not re.search(r"(src|href)=\"(?!data:|#)", page), "the page needs another file"
    assert "Human hand" in people and "Allegro" in robots


def test_a_result_shows_its_table_and_how_episodes_ended(robot, objects, tmp_path):
    result = fungrasp.evaluate(robot, objects)
    page = fungrasp.view(result, out=tmp_path / "result.html").read_text()
    assert f"{int(result.success.sum())} of 2 episodes lifted and held" in page
    assert "mean over objects" in page and page.count("data:image/png;base64,") == 2
    assert "at the first try" in page or "It did not hold" in page


def test_what_can_not_be_viewed_is_said(robot, tmp_path):
    with pytest.raises(FungraspError, match="not of a list"):
        fungrasp.view([1, 2], out=tmp_path / "view.html")  # type: ignore[arg-type]
    with pytest.raises(FungraspError, match="not of a str"):
        fungrasp.view("log.mcap", out=tmp_path / "view.html")
    with pytest.raises(FungraspError, match="the object 'can'"):
        fungrasp.view(robot, {}, out=tmp_path / "view.html")
    assert not (tmp_path / "view.html").exists()
