import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fungrasp.core.errors import FungraspError
from fungrasp.perception import Capture, Intrinsics

LENS = Intrinsics(64, 48, 60.0, 61.0, 31.0, 24.5)


def a_capture(**changes) -> Capture:
    fields = {
        "color": np.zeros((48, 64, 3), np.uint8),
        "depth": np.full((48, 64), 0.7, np.float32),
        "intrinsics": LENS,
    }
    return Capture(**{**fields, **changes})


@settings(deadline=None)
@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.1, 5))
def test_deprojecting_what_was_projected_gives_the_point(x, y, z):
    point = np.array([x, y, z])
    np.testing.assert_allclose(LENS.deproject(LENS.project(point), z), point, atol=1e-9)


def test_points_behind_the_camera_have_no_pixel():
    assert np.isnan(LENS.project(np.array([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0]]))).all()


def test_resizing_keeps_where_rays_go():
    # Pixel centers are whole numbers: the left edge is at -0.5 before and after.
    small = LENS.resized(32, 24)
    for edge in (-0.5, 20.0, 63.5):
        ray = LENS.deproject(np.array([edge, 10.0]), np.array(1.0))
        assert small.project(ray)[0] == pytest.approx((edge + 0.5) / 2 - 0.5)


def test_points_are_in_the_camera_frame_and_holes_are_nan():
    depth = np.full((48, 64), 0.5, np.float32)
    depth[10, 20] = 0.0
    depth[30, 40] = 0.8
    points = a_capture(depth=depth).points()
    assert np.isnan(points[10, 20]).all()
    np.testing.assert_allclose(points[30, 40], [(40 - 31) / 60 * 0.8, (30 - 24.5) / 61 * 0.8, 0.8], rtol=1e-6)
    np.testing.assert_allclose(LENS.project(points[30, 40]), [40, 30], atol=1e-4)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"color": np.zeros((48, 60, 3), np.uint8)}, "color image has shape"),
        ({"color": np.zeros((48, 64, 3), np.float32)}, "array of uint8, not float32"),
        ({"depth": np.ones((24, 32), np.float32)}, "depth image has shape"),
        ({"depth": np.ones((48, 64))}, "array of float32, not float64"),
        ({"depth": np.zeros((48, 64), np.float32)}, "empty"),
        ({"depth": np.full((48, 64), 700, np.float32)}, "millimetres"),
        ({"depth": np.full((48, 64), -0.7, np.float32)}, "negative"),
        ({"depth": np.full((48, 64), np.nan, np.float32)}, "non-finite"),
        ({"mask": np.zeros((48, 64), bool)}, "mask is empty"),
        ({"mask": np.ones((48, 64), np.uint8)}, "array of bool"),
        ({"box": (10, 10, 5, 20)}, "x0 < x1"),
        ({"box": (100, 10, 120, 20)}, "outside the image"),
        ({"box": (0.3, 0.2, 0.7, 0.6)}, "smaller than a pixel: it must be in pixels"),
    ],
)
def test_what_is_no_capture_is_refused_in_words(changes, words):
    with pytest.raises(FungraspError, match=words):
        a_capture(**changes)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("fx", -1.0, "positive"),
        ("fy", np.nan, "positive"),
        ("cx", 100.0, "resolution"),
        ("width", 0, "pixels"),
    ],
)
def test_what_is_no_lens_is_refused_in_words(field, value, words):
    with pytest.raises(FungraspError, match=words):
        dataclasses.replace(LENS, **{field: value})
