"""``view``: a page for what each verb returns, and what can't be looked at."""

from __future__ import annotations

import re

import numpy as np
import pytest

import fungrasp
from fungrasp.core.errors import FungraspError
from fungrasp.grasps import load_robot_grasps, save_robot_grasps
from fungrasp.grasps.as_shown import ShownContacts, ShownJudge
from fungrasp.media.grasp_pages import in_the_hold


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
    save_robot_grasps(tmp_path / "robot.npz", robot)
    robots = fungrasp.view(tmp_path / "robot.npz", objects, out=tmp_path / "robots.html").read_text()
    for page in (people, robots):
        assert page.count("data:image/png;base64,") == 2
        assert not re.search(r"(src|href)=\"(?!data:|#)", page), "the page needs another file"
    assert "Human hand" in people and "Allegro" in robots


def test_a_result_shows_its_table_and_how_episodes_ended(robot, objects, tmp_path):
    result = fungrasp.evaluate(robot, objects)
    page = fungrasp.view(result, out=tmp_path / "result.html").read_text()
    shown = result.outcomes.held_as_shown
    assert f"{int(result.success.sum())} of 2 held, {int(shown.sum())} as shown" in page
    assert "mean over objects" in page and page.count("data:image/png;base64,") == 2
    assert "at the first try" in page or "It did not hold" in page
    assert page.count("✓ Held as shown") == page.count(" Held as shown: ") == shown.sum()


def test_a_result_shows_the_person_beside_what_was_held(human, robot, objects, tmp_path):
    result = fungrasp.evaluate(robot, objects, human=human)
    o = result.outcomes
    assert result.success[0] and robot.shown_places is not None
    # As if the thumb had slipped off its place.
    o.held_as_shown[0], o.not_as_shown[0] = False, "the thumb is more than 20 mm off"
    page = fungrasp.view(result, out=tmp_path / "result.html").read_text()
    assert page.count("data:image/png;base64,") == 4
    assert "Held, but not as shown: the thumb is more than 20 mm off (" in page
    assert f" links, {o.place_error_mm[0]:.0f} mm)" in page
    assert repr(result).endswith(f"{o.success.sum()} of 2 held, {o.held_as_shown.sum()} as shown>")
    assert "not as shown:   1 the thumb is more than 20 mm off" in result.table()


def test_the_hand_is_drawn_as_it_held(robot, objects):
    result = fungrasp.evaluate(robot, objects)
    held, row = in_the_hold(result), int(np.flatnonzero(result.success)[0])
    assert result.hold is not None
    judge = ShownJudge(robot.load_hand(), objects)
    shown = ShownContacts.of(held)
    assert shown is not None
    palm = held.wrist_pose_object
    found = judge(palm, held.joint_positions, shown, result.hold.touching[:, 1:])
    np.testing.assert_allclose(1e3 * found.place_error[row], result.outcomes.place_error_mm[row], atol=1e-6)
    assert np.abs(held.joint_positions - robot.joint_positions)[row].max() > 1e-3


def test_what_can_not_be_viewed_is_said(robot, tmp_path):
    with pytest.raises(FungraspError, match="a page of a list"):
        fungrasp.view([1, 2], out=tmp_path / "view.html")  # type: ignore[arg-type]
    with pytest.raises(FungraspError, match=r"only grasp files .* not log\.mcap"):
        fungrasp.view("log.mcap", out=tmp_path / "view.html")
    with pytest.raises(FungraspError, match=r"a page is a \.html file, not .*view\.png"):
        fungrasp.view(robot, out=tmp_path / "view.png")
    # A file does not hold the objects that a set carries.
    robot_file = tmp_path / "robot.npz"
    save_robot_grasps(robot_file, robot)
    with pytest.raises(FungraspError, match="the object 'can'"):
        fungrasp.view(load_robot_grasps(robot_file), {}, out=tmp_path / "view.html")
    assert not (tmp_path / "view.html").exists()
