"""Films of recorded episodes: phases, frames drawn once, failures and diverged simulations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import Trajectory
from fungrasp.hands import load_hand
from fungrasp.media import episode_film as module
from fungrasp.media import orbit_camera
from fungrasp.media.episode_film import (
    VERDICT_TIME,
    FilmSettings,
    episode_film,
    episode_phases,
    film_frames,
    frame_times,
    interpolate,
)
from fungrasp.objects import builtin_object

HAND = load_hand("allegro")
BALL = builtin_object("tennis_ball")
FPS, WIDTH, HEIGHT = 5.0, 96, 72
SMALL = FilmSettings(FPS, 1.0, WIDTH, HEIGHT)


@pytest.fixture
def trajectory() -> Trajectory:
    """The hand comes down for 2 s, touches from 1 s on, goes up with the ball for 1 s and holds for 2 s."""
    times = np.arange(51) / 10
    height = np.interp(times, [0, 1, 2, 3], [0.3, 0.12, 0.12, 0.22])
    lifted = np.maximum(height - 0.12, 0.0) * (times > 2)
    pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (51, 1))
    palm, ball = pose.copy(), pose.copy()
    palm[:, 2], ball[:, 2] = height, 0.033 + lifted
    contacts = np.zeros((51, len(HAND.links)), dtype=bool)
    contacts[times >= 1.0, 2] = True
    return Trajectory(
        hand=HAND.name,
        object_name=BALL.name,
        object_mass=BALL.mass,
        index=0,
        success=True,
        reason="",
        times=times,
        qpos=np.zeros((51, 1)),
        wrist_reference=pose[0],
        object_pose=ball,
        palm_pose=palm,
        joint_positions=np.tile(HAND.joint_limits.mean(axis=1), (51, 1)),
        link_contacts=contacts,
        phase=(times >= 2).astype(int) + (times >= 3),
    )


def test_closing_begins_with_the_first_touch(trajectory: Trajectory) -> None:
    assert episode_phases(trajectory) == [(0.0, "approach"), (1.0, "close"), (2.0, "lift"), (3.0, "hold")]


def test_without_touch_there_is_no_closing(trajectory: Trajectory) -> None:
    never = replace(trajectory, link_contacts=np.zeros_like(trajectory.link_contacts))
    assert [name for _, name in episode_phases(never)] == ["approach", "lift", "hold"]


def leave_blank(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nothing be drawn, which takes long."""

    class Blank:
        def __init__(self, model: mujoco.MjModel, threads: int = 0) -> None: ...

        def stream(self, qpos: np.ndarray, *_: object, **__: object) -> Iterator[np.ndarray]:
            return iter(np.zeros((len(qpos), HEIGHT, WIDTH, 3), np.uint8))

    still = orbit_camera((0.0, 0.0, 0.1), 0.5, 30.0, 30.0, width=WIDTH, height=HEIGHT)
    monkeypatch.setattr(module, "Renderer", Blank)
    monkeypatch.setattr(module, "look_at_grasp", lambda *_, **__: still)


def captions(monkeypatch: pytest.MonkeyPatch, trajectory: Trajectory) -> list[str]:
    words: list[str] = []

    def captioned(image: np.ndarray, left: str, right: str) -> np.ndarray:
        words.append(left)
        return image

    leave_blank(monkeypatch)
    monkeypatch.setattr(module, "captioned", captioned)
    frames = list(episode_film(trajectory, HAND, BALL, SMALL, title="Ball"))
    assert all(frame.shape == (HEIGHT, WIDTH, 3) for frame in frames)
    return words


def test_a_film_says_what_happens_and_how_it_ended(
    trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = captions(monkeypatch, trajectory)
    assert list(dict.fromkeys(words)) == [
        "Ball · approach",
        "Ball · close",
        "Ball · lift",
        "Ball · hold",
        "Ball · lifted and held",
    ]
    assert len(words) == 26 + round(VERDICT_TIME * FPS)


def test_a_failure_is_named(trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    words = captions(monkeypatch, replace(trajectory, success=False, reason="held too low"))
    assert words[-1] == "Ball · failed: held too low"


def test_a_diverged_simulation_is_shown_until_then(
    trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    pose = trajectory.object_pose.copy()
    pose[25:] = np.nan
    failed = replace(trajectory, object_pose=pose, success=False, reason="the simulation diverged")
    words = captions(monkeypatch, failed)
    assert "Ball · hold" not in words
    assert len(words) == 13 + round(VERDICT_TIME * FPS)


def test_an_object_that_gets_away_does_not_shrink_the_picture(trajectory: Trajectory) -> None:
    pose = trajectory.object_pose.copy()
    pose[25:, 0] = np.linspace(0.0, 5.0, 26)
    first = next(episode_film(trajectory, HAND, BALL, SMALL))
    other = next(episode_film(replace(trajectory, object_pose=pose), HAND, BALL, SMALL))
    dark = [int((frame[:60].max(axis=-1) < 70).sum()) for frame in (first, other)]
    assert dark[1] > 0.3 * dark[0] > 0, "the hand is much smaller"


def test_still_frames_are_drawn_once(trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = 0

    class Counting(module.Renderer):
        def stream(self, qpos, camera, **others):
            nonlocal drawn
            drawn = len(qpos)
            return super().stream(qpos, camera, **others)

    monkeypatch.setattr(module, "Renderer", Counting)
    count = len(list(episode_film(trajectory, HAND, BALL, SMALL)))
    assert count == 26 + round(VERDICT_TIME * FPS)
    assert drawn <= 13, "the hand is still from 1 s to 2 s and from 3 s on"


def test_the_number_of_frames_is_known_before(
    trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave_blank(monkeypatch)
    diverged = replace(trajectory, object_pose=trajectory.object_pose.copy())
    diverged.object_pose[30:] = np.nan
    for each in (trajectory, diverged):
        faster = replace(SMALL, speed=1.7)
        assert len(list(episode_film(each, HAND, BALL, faster))) == film_frames(each, faster)


def test_states_in_between_lie_on_the_shortest_motion() -> None:
    xml = "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    model, times = mujoco.MjModel.from_xml_string(xml), np.array([1.0, 1.5, 2.0])
    qpos, angle = np.zeros((3, 7)), (times - 1.0) * np.pi / 2
    qpos[:, 0], qpos[:, 3], qpos[:, 6] = 0.2 * (times - 1.0), np.cos(angle / 2), np.sin(angle / 2)
    middle = interpolate(model, qpos, times, np.array([1.25]))[0]
    eighth = 0.125 * np.pi / 2
    np.testing.assert_allclose(middle, [0.05, 0, 0, np.cos(eighth), 0, 0, np.sin(eighth)], atol=1e-12)
    np.testing.assert_allclose(interpolate(model, qpos, times, times), qpos, atol=1e-12)


def test_frame_times_cover_the_motion() -> None:
    times = np.array([1.0, 2.0])
    np.testing.assert_allclose(frame_times(times, 4), [1, 1.25, 1.5, 1.75, 2.0])
    assert len(frame_times(times, 4, speed=0.5)) == 9
    assert len(frame_times(times[:1], 25)) == 1
    with pytest.raises(FungraspError, match="frames per second"):
        frame_times(times, 0)
