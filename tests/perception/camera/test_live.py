"""The loop that waits for a good frame, on the demo's image with a stand-in for the detector."""

import dataclasses

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.objects import builtin_object
from fungrasp.perception.builtin_image import builtin_truth
from fungrasp.perception.camera.frames import CameraFrame, FolderCamera
from fungrasp.perception.camera.live import LiveCapture, LiveSettings, LiveView, best_first
from fungrasp.perception.hand.detected_hand import DetectedHand
from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE as FOLDER
from fungrasp.perception.io.scene_folders import read_folder, write_folder

TRUTH = builtin_truth()
SEEN = read_folder(FOLDER)
BOX = (200.0, 150.0, 400.0, 350.0)


def frame(time: float, color=None) -> CameraFrame:
    return CameraFrame(SEEN.color if color is None else color, SEEN.depth, SEEN.intrinsics, time)


class Hands:
    """The true hand, shifted by so many pixels in each image in turn; None: no hand."""

    def __init__(self, *shifts: float | None):
        self.shifts = list(shifts)

    def detect(self, color, near=None):
        shift = self.shifts.pop(0) if self.shifts else 0.0
        if shift is None:
            return []
        joints = TRUTH.joints_camera
        pixels = SEEN.intrinsics.project(joints) + np.array([shift, 0])
        return [DetectedHand(pixels, joints - joints.mean(axis=0), "right", 0.95, 0.95)]


class FrameList:
    """A camera that gives frames known before."""

    name = "the list of frames"

    def __init__(self, frames: list[CameraFrame]):
        self._frames = frames

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return None

    def frames(self):
        yield from self._frames


def taken(detector: Hands, times: list[float], countdown: float, burst: int = 1):
    views: list[LiveView] = []
    camera = FrameList([frame(t) for t in times])
    settings = LiveSettings(countdown=countdown, burst=burst)
    model = builtin_object(TRUTH.object_name)
    return LiveCapture(camera, model, detector, settings).take(views.append), views


def test_it_waits_for_a_still_hand_then_counts_down():
    found, views = taken(Hands(None, 0.0, 12.0, 12.0), [0.0, 0.1, 0.2, 0.3, 1.0, 1.7], countdown=1.0)
    words = [view.words for view in views]
    assert words[0] == "no hand" and words[2].endswith("1"), words
    assert [str(p) for view in views for p in view.readiness.problems] == [
        "no hand",
        "hold still",
    ]
    assert found.time == 1.7, "0.1 was good, and 0.2 too short to begin again"
    assert views[-1].seconds_left == 0.0
    pose = views[-1].pose_camera_object
    assert pose is not None and np.linalg.norm(pose[:3] - TRUTH.pose_camera_object[:3]) < 0.01


def test_a_long_disturbance_begins_the_countdown_again():
    detector = Hands(0.0, None, None, None)
    found, views = taken(detector, [0.0, 0.4, 0.8, 1.2, 1.3, 2.0, 2.4], countdown=1.0)
    left = [view.seconds_left for view in views]
    assert left[0] == 1.0 and left[2] is None and left[4] == 1.0
    assert found.time == 2.4


def test_a_recording_that_ends_says_what_was_missing():
    with pytest.raises(FungraspError, match=r"the list of frames ended before .* last: no hand"):
        taken(Hands(None, None), [0.0, 0.1], countdown=0.0)
    with pytest.raises(FungraspError, match="there were no frames"):
        taken(Hands(), [], countdown=0.0)
    with pytest.raises(FungraspError, match="countdown of 0 to 60 s"):
        LiveSettings(countdown=-1)


def blurred(color: np.ndarray) -> np.ndarray:
    return np.mean([np.roll(color, shift, axis=1) for shift in range(-3, 4)], axis=0).astype(np.uint8)


def order_of(*images: np.ndarray) -> list[int]:
    """What ``best_first`` says of images, with a camera's noise."""
    rng = np.random.default_rng(0)
    noisy = [np.clip(image + rng.normal(size=image.shape) * 2, 0, 255).astype(np.uint8) for image in images]
    return best_first([frame(0.1 * i, image) for i, image in enumerate(noisy)], BOX)


def test_the_sharpest_of_the_steady_frames_is_the_best():
    sharp, soft = SEEN.color, blurred(SEEN.color)
    moved = np.roll(SEEN.color, 12, axis=1)
    assert order_of(moved, sharp, sharp, sharp, moved)[0] == 2, "the others have moved, or will"
    assert set(order_of(soft, soft, soft, sharp, sharp, sharp)[:2]) == {4, 5}
    assert order_of(sharp) == [0]


def test_a_folder_of_frames_is_a_camera(tmp_path):
    for name in ("b", "a"):
        color = np.full_like(SEEN.color, 10 if name == "a" else 20)
        write_folder(dataclasses.replace(SEEN, color=color, mask=None), tmp_path / name)
    with FolderCamera(tmp_path, rate=5.0) as camera:
        frames = list(camera.frames())
    assert [int(f.color[0, 0, 0]) for f in frames] == [10, 20] and [f.time for f in frames] == [0.0, 0.2]
    still = FolderCamera(tmp_path / "a").frames()
    assert [next(still).time for _ in range(3)] == pytest.approx([0.0, 0.1, 0.2])
    (tmp_path / "empty").mkdir()
    with pytest.raises(FungraspError, match="has no frames"):
        FolderCamera(tmp_path / "empty")
    with pytest.raises(FungraspError, match="does not exist"):
        FolderCamera(tmp_path / "none")


def test_a_frame_is_checked():
    with pytest.raises(FungraspError, match="color must be uint8"):
        dataclasses.replace(frame(0.0), color=SEEN.color.astype(float))
    with pytest.raises(FungraspError, match="depth must be float32"):
        dataclasses.replace(frame(0.0), depth=SEEN.depth[:-1])
