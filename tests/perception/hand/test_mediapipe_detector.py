"""Finding hands: decoding of the detector's answers, windows, choice among hands, the models themselves."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from fungrasp.core.errors import FungraspError
from fungrasp.grasps import load_human_grasps
from fungrasp.grasps.human_hand import HUMAN_JOINTS, joint_bends
from fungrasp.objects import builtin_object
from fungrasp.perception.hand.detected_hand import (
    DetectedHand,
    choose_hand,
    find_hands,
    hand_lengths,
    possible,
)
from fungrasp.perception.hand.mediapipe_detector import (
    FROM_MODEL,
    JOINTS_OF_LANDMARKS,
    MediaPipeHandDetector,
    consensus,
)
from fungrasp.perception.hand.mediapipe_models import have_weights
from fungrasp.perception.hand.palm_windows import Window, anchor_centers, decode_palms, exposed
from fungrasp.perception.io.estimates import Side

needs_weights = pytest.mark.skipif(
    not have_weights() or find_spec("ai_edge_litert") is None,
    reason="the hand models are not in the cache, or ai-edge-litert is not installed",
)


def test_anchors_cover_the_image_in_two_grids():
    centers = anchor_centers()
    assert centers.shape == (2016, 2)
    np.testing.assert_allclose(centers[:3], np.array([[4, 4], [4, 4], [12, 4]]) / 192)
    np.testing.assert_allclose(centers[24 * 24 * 2], np.array([8, 8]) / 192)
    np.testing.assert_allclose(centers.mean(axis=0), 0.5)


def test_overlapping_answers_are_one_palm_weighted_by_score():
    offsets, logits = np.zeros((2016, 18)), np.full(2016, -50.0)
    offsets[:, 2:4] = 48
    logits[0], logits[2], logits[-1] = 3.0, 1.0, 2.0
    first, second = decode_palms(offsets, logits, 0.5)
    weights = 1 / (1 + np.exp([-3.0, -1.0]))
    middle = weights @ np.array([4, 12]) / weights.sum() / 192
    np.testing.assert_allclose(first.box, [middle - 1 / 8, 4 / 192 - 1 / 8, middle + 1 / 8, 4 / 192 + 1 / 8])
    np.testing.assert_allclose(first.points, np.tile([middle, 4 / 192], (7, 1)))
    assert first.score > second.score and second.points[0, 0] > 0.9
    assert decode_palms(offsets, logits - 50, 0.5) == []


@settings(deadline=None, max_examples=15)
@given(
    u=st.floats(60, 240),
    v=st.floats(60, 180),
    size=st.floats(80, 700),
    angle=st.floats(-3, 3),
    at=st.floats(0.3, 0.7),
)
def test_windows_show_what_they_say(u, v, size, angle, at):
    """A blurred dot in the image is where the window's coordinates say it is, at any scale and turn."""
    window = Window((u, v), size, angle)
    dot = window.to_image(np.array([at, 1 - at]))
    rows, columns = np.mgrid[:240, :320]
    sigma = max(2.0, size / 40)
    light = np.exp(-((columns - dot[0]) ** 2 + (rows - dot[1]) ** 2) / (2 * sigma**2))
    image = Image.fromarray(np.repeat((255 * light).astype(np.uint8)[..., None], 3, axis=2))
    cut = window.cut(image, 64)[..., 0]
    if not (sigma * 3 < dot[0] < 320 - sigma * 3 and sigma * 3 < dot[1] < 240 - sigma * 3):
        return
    places = (np.arange(64) + 0.5) / 64
    found = np.array([cut.sum(axis=0) @ places, cut.sum(axis=1) @ places]) / cut.sum()
    np.testing.assert_allclose(found, [at, 1 - at], atol=0.012)


def hand_at(u, v, size=100.0, side: Side = "right", score=0.9):
    pixels = np.random.default_rng(1).uniform(-size / 2, size / 2, (21, 2))
    pixels += np.array([u, v]) - pixels.mean(axis=0)
    return DetectedHand(pixels, np.zeros((21, 3)), side, 0.9, score)


def test_the_hand_that_is_meant():
    left, small, far = hand_at(100, 100, side="left"), hand_at(300, 100, 60), hand_at(500, 300, 90)
    assert choose_hand([small]) == (small, [])
    best, (note,) = choose_hand([left, small, far])
    assert best is left and "3 hands" in str(note) and "largest one was taken, at pixel 100, 100" in str(note)
    best, (note,) = choose_hand([left, small, far], near=(480, 280, 600, 400))
    assert best is far and "nearest to the box" in str(note)
    best, (note,) = choose_hand([left, small, far], side="right")
    assert best is far and "right hand that is the largest" in str(note)
    best, (note,) = choose_hand([small], side="left")
    assert best is small and "looks like a right hand, but a left one was given" in str(note)
    with pytest.raises(FungraspError, match="no hand was found"):
        choose_hand([])


def test_order_of_joints():
    names = ["wrist", *(f"thumb_{j}" for j in ("cmc", "mcp", "ip", "tip"))]
    names += [f"{f}_{j}" for f in ("index", "middle", "ring", "pinky") for j in ("mcp", "pip", "dip", "tip")]
    assert tuple(names[i] for i in FROM_MODEL) == HUMAN_JOINTS


@pytest.fixture(scope="module")
def picture():
    from benchmarks.synthetic_captures.capture_settings import CaptureSettings
    from benchmarks.synthetic_captures.render_capture import render_capture

    grasps = load_human_grasps("builtin")
    row = int(np.flatnonzero(grasps.object_name == "mug")[0])
    near = CaptureSettings(clutter=(0, 0), distance=(0.45, 0.5), elevation=(35, 50))
    return render_capture(grasps[row], builtin_object("mug"), np.random.default_rng(5), near)


@needs_weights
def test_a_rendered_hand_is_found_and_told_from_a_left_one(picture):
    detector, color = MediaPipeHandDetector(), picture.capture.color
    truth = picture.capture.intrinsics.project(picture.joints_camera)
    (hand,) = detector.detect(color)
    assert hand.side == "right" and np.median(np.linalg.norm(hand.pixels - truth, axis=1)) < 15
    assert joint_bends(hand.shape_camera)[0][:4].mean() > 0
    (mirrored,) = detector.detect(np.ascontiguousarray(color[:, ::-1]))
    assert mirrored.side == "left"
    assert joint_bends(mirrored.shape_camera)[0][:4].mean() < 0
    turned = detector.detect(np.ascontiguousarray(np.rot90(color)))
    assert len(turned) == 1 and turned[0].side == "right"


@needs_weights
def test_no_hand_in_noise():
    noise = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    assert MediaPipeHandDetector().detect(noise) == []


def answer(pixels, score=0.9, side: Side = "right"):
    return DetectedHand(pixels, np.zeros((21, 3)), side, 0.9, score)


def test_the_answer_that_most_others_confirm_wins():
    rng = np.random.default_rng(0)
    true, wrong = rng.uniform(0, 100, (21, 2)), rng.uniform(0, 100, (21, 2))
    near = [answer(true + rng.normal(size=(21, 2)), 0.6) for _ in range(3)]
    sure = answer(wrong, 0.98, "left")
    hand = consensus([sure, *near], [sure, *near], 100.0)
    assert np.abs(hand.pixels - true).max() < 5 and hand.side == "right"
    # Three of four windows confirm it, each of them with 0.6.
    assert 0.4 < hand.score < 0.5
    lonely = consensus([sure, answer(true, 0.6)], [answer(true, 0.6)], 100.0)
    assert lonely.score < 0.1


def test_lengths_of_hands_in_the_image():
    depth = np.array([[0.5, 0.0], [1.0, 0.25]])
    np.testing.assert_allclose(hand_lengths(depth, 600.0), [[228, np.nan], [114, 456]])
    lengths = hand_lengths(np.full((480, 640), 0.5), 600.0)
    assert possible(hand_at(300, 200, 150.0), 228.0)
    assert not possible(hand_at(300, 200, 30.0), 228.0) and not possible(hand_at(300, 200, 400.0), 228.0)
    assert np.isnan(hand_lengths(np.zeros((4, 4)), 600.0)).all() and lengths.shape == (480, 640)


class Answers(MediaPipeHandDetector):
    """Sees the same hand in every window."""

    def __init__(self, pixels_per_metre, score):
        meters = np.random.default_rng(2).uniform(-0.06, 0.06, (21, 3))
        self.hand = DetectedHand(meters[:, :2] * pixels_per_metre + [320, 240], meters, "right", 0.9, score)
        self._looks = 0

    def _palms(self, image, window):
        return [(0.9, Window((320.0, 240.0), 200.0))]

    def _landmarks_in(self, image, window, mirrored=False):
        self._looks += 1
        return self.hand


def test_small_hands_are_those_that_the_first_windows_confirm():
    color, far = np.zeros((480, 640, 3), np.uint8), hand_lengths(np.full((480, 640), 1.5), 600.0)
    assert Answers(500.0, 0.7).hand.length == pytest.approx(95.0)
    assert len(Answers(500.0, 0.7).detect(color)) == 1 and Answers(400.0, 0.7).detect(color) == []
    assert Answers(500.0, 0.7).detect_with_depth(color, far) == []
    assert len(Answers(400.0, 0.9).detect(color)) == 1
    assert len(Answers(400.0, 0.9).detect_with_depth(color, far)) == 1
    assert hand_at(100, 100, 60.0).length == hand_at(100, 100, 60.0).extent


def test_underexposed_images_are_made_brighter():
    light = np.random.default_rng(3).integers(0, 256, (48, 64, 3)).astype(np.uint8)
    assert exposed(light) is light
    dark = (light * 0.3).astype(np.uint8)
    assert np.abs(exposed(dark).astype(int) - light).max() < 8
    black = np.zeros((4, 4, 3), np.uint8)
    assert exposed(black) is black


@needs_weights
def test_a_hand_in_the_dark_is_found(picture):
    truth = picture.capture.intrinsics.project(picture.joints_camera)
    dark = (picture.capture.color * 0.15).astype(np.uint8)
    (hand,) = MediaPipeHandDetector().detect(dark)
    assert np.median(np.linalg.norm(hand.pixels - truth, axis=1)) < 15


@needs_weights
def test_depth_finds_a_hand_whose_palm_is_seen_at_a_wrong_place(picture):
    capture = picture.capture
    truth = capture.intrinsics.project(picture.joints_camera)
    lengths = hand_lengths(capture.depth, capture.intrinsics.fx)
    detector = MediaPipeHandDetector()
    (hand,) = detector.detect_with_depth(capture.color, lengths)
    assert np.median(np.linalg.norm(hand.pixels - truth, axis=1)) < 15
    assert find_hands(detector, capture)[0].score == hand.score
    beside = Window((float(truth[:, 0].mean() + 45), float(truth[:, 1].mean())), 120.0)
    image = Image.fromarray(capture.color)
    again = detector._around_palm(image, beside, lengths)
    assert again is not None
    assert np.median(np.linalg.norm(again.pixels - truth, axis=1)) < 15


def test_landmarks_of_a_straight_finger_become_its_joints():
    joints = np.zeros((21, 2))
    joints[5:9, 0] = [0, 33, 55, 79]
    joints[0, 0], joints[9, 0] = -95, 0
    landmarks = np.linalg.solve(JOINTS_OF_LANDMARKS, joints)
    # Landmarks of tips are short of the end, those of the joints before beyond them.
    assert landmarks[8, 0] < 79 and landmarks[6, 0] > 33 and landmarks[7, 0] > 55 and landmarks[0, 0] > -95
    np.testing.assert_allclose(JOINTS_OF_LANDMARKS.sum(axis=1), 1)
