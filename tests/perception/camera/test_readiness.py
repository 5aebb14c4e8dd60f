"""What is missing in a frame, on one rendered scene from near, far and without some of its parts."""

import dataclasses

import numpy as np
import pytest

from benchmarks.synthetic_captures.capture_scene import Label
from benchmarks.synthetic_captures.capture_settings import CaptureSettings
from benchmarks.synthetic_captures.render_capture import SyntheticCapture, render_capture
from fungrasp.core.errors import UnknownNameError
from fungrasp.grasps import builtin_grasps
from fungrasp.objects import builtin_object
from fungrasp.perception import Intrinsics, ObjectEstimate
from fungrasp.perception.camera.frames import CameraFrame
from fungrasp.perception.camera.readiness import FrameProblem, judge_frame, judge_object
from fungrasp.perception.hand.detected_hand import DetectedHand

LENS = Intrinsics(320, 240, 300, 300, 160, 119)
GRASP = builtin_grasps()[0]


def rendered(distance: tuple[float, float] = (0.5, 0.6)) -> SyntheticCapture:
    settings = CaptureSettings(intrinsics=LENS, intrinsics_spread=0, distance=distance)
    return render_capture(GRASP, builtin_object(GRASP.object_name), np.random.default_rng(3), settings)


def frame_of(seen: SyntheticCapture, **changed) -> CameraFrame:
    capture = seen.capture
    return dataclasses.replace(CameraFrame(capture.color, capture.depth, capture.intrinsics, 0.0), **changed)


def hand_of(seen: SyntheticCapture, shift: tuple[float, float] = (0, 0)) -> DetectedHand:
    joints = seen.joints_camera
    pixels = seen.capture.intrinsics.project(joints) + shift
    return DetectedHand(pixels, joints - joints.mean(axis=0), "right", 0.95, 0.95)


@pytest.fixture(scope="module")
def scene() -> SyntheticCapture:
    return rendered()


def problems(frame: CameraFrame, *hands: DetectedHand) -> list[str]:
    return [str(problem) for problem in judge_frame(frame, hands).problems]


def test_a_good_frame_has_all(scene):
    seen = judge_frame(frame_of(scene), [hand_of(scene)])
    assert seen.problems == () and seen.hand is not None and seen.table is not None
    up = scene.pose_world_camera
    assert seen.table[3] == pytest.approx(up[2], abs=0.02), "the camera's height above the table"


def test_no_hand(scene):
    assert problems(frame_of(scene)) == ["no hand"]


@pytest.mark.parametrize(
    ("edge", "direction"), [("left", (-1, 0)), ("right", (1, 0)), ("top", (0, -1)), ("bottom", (0, 1))]
)
def test_a_hand_that_is_cut_off(scene, edge, direction):
    """The image is cut through the middle of the hand."""
    hand, image = hand_of(scene), frame_of(scene)
    u, v = np.rint(hand.pixels.mean(axis=0)).astype(int)
    cut = {"left": (u, 0), "right": (u - 320, 0), "top": (0, v), "bottom": (0, v - 240)}[edge]
    color, depth = np.zeros_like(image.color), np.zeros_like(image.depth)
    rows = slice(max(0, cut[1]), 240 + min(0, cut[1])), slice(max(0, -cut[1]), 240 - max(0, cut[1]))
    columns = slice(max(0, cut[0]), 320 + min(0, cut[0])), slice(max(0, -cut[0]), 320 - max(0, cut[0]))
    color[rows[1], columns[1]] = image.color[rows[0], columns[0]]
    depth[rows[1], columns[1]] = image.depth[rows[0], columns[0]]
    moved = dataclasses.replace(hand, pixels=hand.pixels - cut)
    assert f"the hand is cut off at the {edge} edge" in problems(
        frame_of(scene, color=color, depth=depth), moved
    )


def test_distances(scene):
    near = rendered((0.22, 0.24))
    found = [p for p in judge_frame(frame_of(near), [hand_of(near)]).problems if p.code == "too_near"]
    assert found and 0.15 < found[0].values["distance"] < 0.3
    assert str(found[0]) == f"too near: {found[0].values['distance']:.2f} m, the camera needs 0.3"
    far = rendered((1.5, 1.6))
    assert any(words.startswith("too far: 1.") for words in problems(frame_of(far), hand_of(far)))


def test_a_near_scene_without_a_hand_found_is_told_to_be_near(scene):
    depth = np.where(scene.capture.depth > 0, scene.capture.depth * 0.3, 0).astype(np.float32)
    assert problems(frame_of(scene, depth=depth))[0].startswith("too near: 0.1")


def test_no_depth(scene):
    holes = np.where(scene.hand_mask, 0, scene.capture.depth).astype(np.float32)
    found = problems(frame_of(scene, depth=holes), hand_of(scene))
    assert len(found) == 1 and found[0].startswith("depth is missing on ")
    nothing = np.zeros_like(scene.capture.depth)
    assert problems(frame_of(scene, depth=nothing), hand_of(scene)) == [
        "the camera measures no depth at all: is its view covered?"
    ]


def test_exposure(scene):
    dark = (scene.capture.color * 0.1).astype(np.uint8)
    assert problems(frame_of(scene, color=dark), hand_of(scene))[0].startswith("too dark")
    burnt = np.where(scene.hand_mask[..., None], 255, scene.capture.color).astype(np.uint8)
    assert problems(frame_of(scene, color=burnt), hand_of(scene))[0].startswith("overexposed")
    # Two thirds of the hand as in measured images that are good.
    part = np.where((np.arange(320) % 3 > 0)[None, :, None], burnt, scene.capture.color).astype(np.uint8)
    assert problems(frame_of(scene, color=part), hand_of(scene)) == []


def test_no_table(scene):
    held = np.isin(scene.labels, [Label.HAND, Label.SLEEVE, Label.OBJECT])
    bare = np.where(held, scene.capture.depth, 0).astype(np.float32)
    assert problems(frame_of(scene, depth=bare), hand_of(scene)) == ["no table"]


def test_an_object_whose_pose_is_more_probably_wrong_is_not_seen():
    pose = np.array([0, 0, 0.5, 1, 0, 0, 0])
    assert judge_object(ObjectEstimate(pose, 0.55, False)) is None
    assert str(judge_object(ObjectEstimate(pose, 0.45, False))).startswith("the object is not seen")


def test_problems_have_names():
    with pytest.raises(UnknownNameError, match="Did you mean 'no_hand'"):
        FrameProblem.of("no_hands")
