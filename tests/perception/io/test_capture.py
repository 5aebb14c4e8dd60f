"""Captures and lenses, estimates and warnings are checked."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.perception import Capture, HandEstimate, Intrinsics, ObjectEstimate
from fungrasp.perception.io.estimates import MESSAGES, PerceptionWarning

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
        ({"depth": np.full((48, 64), 700, np.float32)}, "millimeters"),
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


POSE = np.array([0, 0, 0.6, 1, 0, 0, 0.0])


def a_hand(**changes) -> HandEstimate:
    fields = {
        "joints_camera": np.ones((21, 3)),
        "pixels": np.ones((21, 2)),
        "confidence": np.ones(21),
        "covariance": np.tile(np.eye(3), (21, 1, 1)),
        "side": "right",
        "score": 0.9,
    }
    return HandEstimate(**{**fields, **changes})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"joints_camera": np.ones((20, 3))}, r"joints_camera must have shape \[21, 3\], not \[20, 3\]"),
        ({"covariance": np.ones((21, 3))}, "covariance"),
        ({"pixels": np.full((21, 2), np.nan)}, "pixels has non-finite"),
        ({"side": "Right"}, "side"),
        ({"score": 1.2}, "score"),
    ],
)
def test_a_hand_is_checked(changes, words):
    assert a_hand().side == "right"
    with pytest.raises(FungraspError, match=words):
        a_hand(**changes)


def test_an_object_and_its_alternatives_are_checked():
    estimate = ObjectEstimate(POSE, 0.8, True, ((POSE, 0.4),))
    assert estimate.alternatives[0][1] == 0.4
    with pytest.raises(FungraspError, match="score"):
        ObjectEstimate(POSE, 0.8, True, ((POSE, 1.4),))
    with pytest.raises(FungraspError, match="pose"):
        ObjectEstimate(POSE[:6], 0.8, True)


def test_a_warning_reads_as_a_sentence():
    given = PerceptionWarning.of("low_own_score", score=0.314)
    assert str(given) == "the estimator's own score is 0.31"
    assert given.code == "low_own_score" and given.values == {"score": 0.314}


def test_every_sentence_takes_its_values():
    for code, message in MESSAGES.items():
        values = dict.fromkeys(re.findall(r"{(\w+)", message), 1.5)
        assert str(PerceptionWarning(code, values))


def test_an_unknown_code_is_refused():
    with pytest.raises(UnknownNameError, match="low_own_score"):
        PerceptionWarning.of("low_own_scor")
