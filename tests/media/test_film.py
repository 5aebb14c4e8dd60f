import mujoco
import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.media import Renderer, orbit_camera
from fungrasp.media.episode_film import film, frame_times, interpolate

SCENE = """
<mujoco>
  <worldbody>
    <body name="block" pos="0 0 0.03">
      <freejoint/>
      <geom type="box" size="0.03 0.02 0.03" rgba="0.8 0.3 0.2 1"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.fixture
def camera():
    return orbit_camera((0, 0, 0.03), 0.5, -90, 25, width=48, height=36)


def _motion(steps=21):
    times = np.linspace(1.0, 2.0, steps)
    qpos = np.tile([0, 0, 0.03, 1, 0, 0, 0.0], (steps, 1))
    angle = (times - 1.0) * np.pi / 2
    qpos[:, 0] = 0.2 * (times - 1.0)
    qpos[:, 3], qpos[:, 6] = np.cos(angle / 2), np.sin(angle / 2)
    return qpos, times


def test_states_in_between_lie_on_the_shortest_motion(model):
    qpos, times = _motion(3)
    middle = interpolate(model, qpos, times, np.array([1.25]))[0]
    angle = 0.25 * np.pi / 2
    expected = [0.05, 0, 0.03, np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
    np.testing.assert_allclose(middle, expected, atol=1e-12)


def test_recorded_states_are_kept(model):
    qpos, times = _motion()
    np.testing.assert_allclose(interpolate(model, qpos, times, times), qpos, atol=1e-12)


def test_frame_times_cover_the_motion():
    times = np.array([1.0, 2.0])
    np.testing.assert_allclose(frame_times(times, 4), [1, 1.25, 1.5, 1.75, 2.0])
    assert len(frame_times(times, 4, speed=0.5)) == 9
    assert len(frame_times(times[:1], 25)) == 1


def test_the_bar_shows_the_phase(model, camera):
    qpos, times = _motion(3)
    qpos[:] = qpos[0]
    plain = list(Renderer(model).stream(qpos[[0] * 5], camera))
    worded = list(film(model, qpos, times, 4, camera, phases=[(0, "approach"), (1.5, "lift")]))
    rows = [np.abs(a.astype(int) - b).max(axis=(1, 2)) for a, b in zip(plain, worded, strict=True)]
    assert all(row[0] == 0 and row[-1] > 30 for row in rows)
    assert not np.array_equal(worded[0][-20:], worded[-1][-20:])


def test_a_film_without_time_is_refused(model, camera):
    qpos, times = _motion(3)
    with pytest.raises(FungraspError, match="frames per second"):
        list(film(model, qpos, times, 0, camera))
