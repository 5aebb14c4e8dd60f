import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fungrasp.core.errors import FungraspError
from fungrasp.media.camera import Camera, fit_camera, orbit_camera

angles = st.floats(-180, 180)
heights = st.floats(-60, 80)


@given(angles, heights, st.floats(10, 90), st.floats(0, 63), st.floats(0, 47))
def test_a_pixels_direction_projects_back_to_it(azimuth, elevation, fov, u, v):
    camera = orbit_camera((0.1, -0.2, 0.3), 0.8, azimuth, elevation, fov_y=fov, width=64, height=48)
    point = np.asarray(camera.position) + 0.7 * camera.directions(np.array([u, v]))
    pixel, depth = camera.project(point)
    np.testing.assert_allclose(pixel, [u, v], atol=1e-9)
    assert 0 < depth <= 0.7


def test_axes_are_those_of_opencv():
    camera = Camera((0, -1, 0), (0, 0, 0), width=101, height=101)
    pixels, depth = camera.project(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.1]]))
    np.testing.assert_allclose(pixels[0], [50, 50], atol=1e-9)
    assert pixels[1, 0] > 50
    assert pixels[2, 1] < 50
    np.testing.assert_allclose(depth, 1.0)
    assert np.linalg.det(camera.rotation) == pytest.approx(1.0)


@given(angles, heights, st.integers(0, 2**31))
def test_fitted_camera_sees_all_points(azimuth, elevation, seed):
    points = np.random.default_rng(seed).uniform(-0.2, 0.2, (20, 3))
    pixels, depth = fit_camera(points, azimuth, elevation, width=80, height=60).project(points)
    assert (depth > 0).all() and (pixels > -0.5).all() and (pixels < [79.5, 59.5]).all()


@pytest.mark.parametrize(
    "arguments",
    [
        {"position": (0, 0, 1)},
        {"position": (1, 0, 0), "target": (1, 0, 0)},
        {"position": (1, 0, float("nan"))},
        {"position": (1, 0, 0), "fov_y": 0},
        {"position": (1, 0, 0), "width": 0},
    ],
)
def test_impossible_cameras_are_refused(arguments):
    with pytest.raises(FungraspError):
        Camera(**arguments)
