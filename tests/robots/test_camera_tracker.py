"""Our own tracker as a source of poses, on rendered images."""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Self

import numpy as np
import pytest
from fake_realsense import FakeRealSense

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, invert, quaternion_from_rotation_vector
from fungrasp.objects import load_object
from fungrasp.perception import Capture, Intrinsics
from fungrasp.perception.io.capture import CameraFrame
from fungrasp.perception.io.realsense import RealSenseCamera, StreamSettings
from fungrasp.perception.object_pose.object_template import MeshRays
from fungrasp.robots.assembly import pose_source
from fungrasp.robots.cell import TrackerSettings, load_cell
from fungrasp.robots.device import RobotError, TrackingStatus
from fungrasp.robots.pose.camera import LOST_FRAMES, CameraTracker

LENS = Intrinsics(640, 480, 615.0, 615.0, 319.5, 239.5)
# 0.65 m away from the middle of the table, looking down at 50 degrees.
CAMERA = np.array([0.0, -0.42, 0.5, *quaternion_from_rotation_vector(np.array([-2.44, 0.0, 0.0]))])
IMAGES = 16


def truth(image: int) -> np.ndarray:
    """The can slides by 5 mm an image and turns by 2 degrees."""
    turn = quaternion_from_rotation_vector(np.array([0.0, 0.0, 0.035 * image]))
    return np.array([0.005 * image - 0.04, 0.0, 0.0575, *turn])


@cache
def images() -> tuple[Capture, ...]:
    rng, rays = np.random.default_rng(0), LENS.rays().reshape(-1, 3)
    obj = load_object("can")
    center = compose(invert(CAMERA), np.array([0.0, 0, 0, 1, 0, 0, 0]))
    up = compose(invert(CAMERA), np.array([0.0, 0, 1, 1, 0, 0, 0]))[:3] - center[:3]
    table = (up @ center[:3]) / (rays @ up)
    caster, captures = MeshRays(obj.vertices, obj.faces), []
    for i in range(IMAGES):
        seen = caster.cast(compose(invert(CAMERA), truth(i))[None], rays)[0]
        on = seen < table
        color = np.where(on[:, None], [60, 110, 170], [120, 95, 70]) + 6.0 * rng.normal(size=(len(rays), 3))
        depth = np.where(on, seen, table) + 0.0015 * rng.normal(size=len(rays))
        captures.append(
            Capture(
                np.clip(color, 0, 255).astype(np.uint8).reshape(480, 640, 3),
                depth.astype(np.float32).reshape(480, 640),
                LENS,
            )
        )
    return tuple(captures)


class RecordedFrames:
    """A camera that gives captures one after the other."""

    name = "recorded frames"

    def __init__(self, captures: Sequence[Capture]):
        self._left = list(captures)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None: ...

    def newest(self, timeout: float) -> CameraFrame | None:
        if not self._left:
            return time.sleep(timeout)
        one = self._left.pop(0)
        return CameraFrame(one.color, one.depth, one.intrinsics, time.monotonic())


def wait_for(condition, seconds: float = 60.0) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "nothing came"
        time.sleep(0.01)


def test_an_object_is_followed_at_ten_images_a_second_and_more() -> None:
    source = CameraTracker(RecordedFrames(images()), load_object("can"), CAMERA, start=truth(0))
    with source:
        wait_for(lambda: len(source.seconds) == IMAGES - 1)
        wait_for(lambda: source.read().status is TrackingStatus.TRACKING)
        found = source.read()
    place = found.pose_world_object[:3] - truth(IMAGES - 1)[:3]
    assert np.abs(place).max() < 0.006
    # Processor time: the test's computer may be busy.
    assert np.median(source.seconds) < 0.1
    assert found.score > 0.6


def test_without_a_start_the_object_is_searched_for() -> None:
    source = CameraTracker(RecordedFrames(images()[:1] * 8), load_object("can"), CAMERA)
    with source:
        wait_for(lambda: source.read() is not None, 120.0)
        place = source.read().pose_world_object[:3] - truth(0)[:3]
    assert np.abs(place).max() < 0.02


def test_an_object_that_is_gone_is_lost_and_its_pose_grows_old() -> None:
    bare = images()[0]
    flat = np.median(bare.depth, axis=1, keepdims=True).repeat(640, axis=1)
    gone = replace(bare, color=np.full_like(bare.color, 100), depth=flat.astype(np.float32))
    recording = RecordedFrames([images()[0]] * 3 + [gone] * (LOST_FRAMES - 1))
    source = CameraTracker(recording, load_object("can"), CAMERA, start=truth(0))
    with source:
        wait_for(lambda: len(source.seconds) == LOST_FRAMES + 1)
        wait_for(lambda: source.read().status is TrackingStatus.LOST)
        assert source.read().score < 0.5


def test_a_cell_needs_a_calibration_and_an_object_for_its_camera() -> None:
    cell = load_cell("ur5e-allegro")
    tracker = TrackerSettings(driver="realsense", options={"object": "can"})
    with pytest.raises(FungraspError, match="no calibration of the camera"):
        pose_source(replace(cell, tracker=tracker))
    known = replace(tracker, calibration_residual=0.001)
    assert "can" in pose_source(replace(cell, tracker=known)).name
    with pytest.raises(FungraspError, match="needs the option 'object'"):
        pose_source(replace(cell, tracker=replace(known, options={})))
    with pytest.raises(FungraspError, match="objekt"):
        pose_source(replace(cell, tracker=replace(known, options={"objekt": "can"})))


def test_a_camera_gives_its_newest_frame_until_it_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = FakeRealSense(images=4)
    fake.domain, fake.age = "global", 0.2
    monkeypatch.setitem(sys.modules, "pyrealsense2", fake)
    camera = RealSenseCamera(serial="77", stream=StreamSettings(64, 48, 15))
    with camera:
        frame = camera.newest(0.0)
        assert frame is not None and frame.color[0, 0, 1] == 3
        assert 0.2 <= time.monotonic() - frame.time < 5.0, "the camera's time stamp counts"
        assert camera.newest(0.0) is None
        fake.images, fake.millimeters = 5, 0
        with pytest.raises(FungraspError):
            camera.newest(0.0).capture()
    assert (fake.serial, fake.stopped) == ("77", 1)
    assert fake.streams == [("depth", 64, 48, "z16", 15), ("color", 64, 48, "rgb8", 15)]
    fake.start_error = "No device connected"
    source = CameraTracker(camera, load_object("can"), CAMERA)
    with pytest.raises(RobotError, match="no RealSense camera 77 is connected"):
        source.connect()
    source.close()
