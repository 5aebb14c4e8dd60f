"""The interactive page in a real browser: it loads, picks, drags, plays and scrubs, without an error."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra viewer is not installed")

from browsers import Tab, chromium

import fungrasp

pytestmark = pytest.mark.slow

PATIENCE = 120.0
"""Browsers draw on the processor here, and may have little of it [s]."""


@pytest.fixture(scope="module")
def browser():
    with chromium() as running:
        yield running


@pytest.fixture(scope="module")
def human():
    grasps = fungrasp.builtin_grasps()
    return grasps[[int((grasps.object_name == name).argmax()) for name in ("can", "mug")]]


@pytest.fixture(scope="module")
def viewer(human):
    with fungrasp.view(human, hand="allegro", port=0, wait=False) as running:
        yield running


def until(condition) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.05)


def drag_up(tab: Tab, page) -> None:
    """Take the arrow that points up by the mouse, and pull."""
    place, camera = np.array(page._object_handle.position) + page._figures[0].position, page.client.camera
    top = place + np.array([0.0, 0.0, 0.09])
    forward = np.subtract(camera.look_at, camera.position)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    away = top - camera.position
    scale = camera.image_height / 2 / np.tan(camera.fov / 2) / (away @ forward)
    x = camera.image_width / 2 + scale * (away @ right)
    y = camera.image_height / 2 - scale * (away @ np.cross(right, forward))
    mouse = tab.page.mouse
    mouse.move(x, y)
    mouse.down()
    for step in range(1, 9):
        mouse.move(x, y - 8 * step)
        time.sleep(0.06)


def test_a_grasp_follows_the_mouse_and_the_keyboard(browser, viewer):
    tab = Tab(browser, viewer.url)
    tab.sees("retargeted in", PATIENCE)
    page = viewer.pages[-1]
    robot, start = page._robots[0], page._human.object_pose[2]
    wrist = robot.grasp.wrist_pose.copy()
    until(lambda: page.client.camera.image_height > 0)
    drag_up(tab, page)
    until(lambda: robot.grasp.object_pose[2] > start + 0.01)
    assert np.abs(robot.grasp.wrist_pose - wrist).max() > 1e-3, "the robot hand did not follow"
    tab.page.mouse.up()
    until(lambda: robot._follower is None)
    # By the keyboard: the third of the numbers says how high the object is.
    fields = tab.page.locator("input")
    values = [i for i in range(fields.count()) if fields.nth(i).input_value() == "0"]
    fields.nth(values[2]).press("ArrowUp")
    until(lambda: abs(robot.grasp.object_pose[2] - (start + 0.001)) < 1e-6)
    assert not tab.complaints
    tab.close()
    until(lambda: page not in viewer.pages)
    assert page.worker.closed


def test_pages_are_independent_and_an_episode_plays(browser, viewer):
    first, second = Tab(browser, viewer.url), Tab(browser, viewer.url, 390, 844)
    until(lambda: len(viewer.pages) == 2)
    for tab in (first, second):
        tab.sees("retargeted in", PATIENCE)
    one, other = viewer.pages
    one._hand.value = "leap"
    one._on_hand()
    until(lambda: one._robots and one._robots[0].hand.name == "leap" and one._robots[0].grasp is not None)
    assert other._robots[0].hand.name == "allegro"
    second.close()
    first.click("text=Lift")
    one._lift._speed.value = 4.0
    one._lift._policy.value = "reference"
    first.click("button:has-text('Play')")
    until(lambda: one._lift._end is not None)
    first.sees("lifted and held" if one._lift._end.success else "failed: ", PATIENCE)
    player = one._lift.player
    curves = player._frames.curves()
    assert curves.time[-1] > 5 and np.isfinite(curves.force).all() and np.isfinite(curves.palm_error).all()
    player.go_to(1.0)
    until(lambda: not one.worker.busy)
    assert not first.complaints and not second.complaints
    first.close()
    until(lambda: not viewer.pages)


def test_a_browser_that_goes_in_mid_episode_ends_it(browser, viewer):
    tab = Tab(browser, viewer.url)
    tab.sees("retargeted in", PATIENCE)
    page = viewer.pages[-1]
    page._lift._policy.value = "reference"
    page.worker.ask("episode", page._lift._run)
    until(lambda: page._lift._episode is not None and len(page._lift._episode.frames) > 3)
    tab.close()
    until(lambda: page.worker.closed)
    until(lambda: not page.worker._thread.is_alive())
    assert page._lift._end is None
