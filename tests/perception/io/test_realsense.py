"""Captures, streams and recordings of a camera that a made-up pyrealsense2 plays."""

import logging
import sys
import time

import numpy as np
import pytest
from fake_realsense import FakeRealSense

from fungrasp.core.errors import FungraspError
from fungrasp.perception.io.realsense import RealSenseCamera, StreamSettings, capture_from_camera


@pytest.fixture
def realsense(monkeypatch):
    def install(**options):
        fake = FakeRealSense(**options)
        monkeypatch.setitem(sys.modules, "pyrealsense2", fake)
        return fake

    return install


def test_a_camera_gives_a_capture_after_the_warm_up(realsense):
    fake = realsense()
    capture = capture_from_camera()
    assert capture.color[0, 0].tolist() == [200, 30, 0]
    assert capture.depth.dtype == np.float32 and np.allclose(capture.depth, 0.7)
    assert (capture.intrinsics.fx, capture.intrinsics.fy) == (60, 61)
    assert (capture.intrinsics.cx, capture.intrinsics.cy) == (31, 24)
    assert (fake.given, fake.aligned, fake.stopped, fake.played) == (31, 1, 1, None)
    assert fake.streams == [("depth", "z16"), ("color", "rgb8")]


@pytest.mark.parametrize("fmt", ["rgb8", "bgr8", "rgba8", "bgra8"])
def test_a_recording_is_played_once_and_in_its_own_format(realsense, tmp_path, fmt):
    file = tmp_path / "recording.bag"
    file.touch()
    fake = realsense(fmt=fmt, images=4)
    capture = capture_from_camera(file)
    assert capture.color[5, 5].tolist() == [200, 3, 0], "of a short recording the last image"
    assert fake.played == (str(file), False) and fake.real_time is False and fake.stopped == 1
    assert fake.streams == [("depth",), ("color",)]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"start_error": "No device connected"}, "no RealSense camera is connected"),
        ({"start_error": "Couldn't resolve requests"}, "no depth and color together"),
        ({"images": 0}, "gives no images"),
        ({"missing": "depth"}, "has no depth image"),
        ({"missing": "color"}, "has no color image"),
        ({"fmt": "yuyv"}, "format yuyv; one of rgb8, bgr8"),
        ({"millimeters": 0}, "no pixel has a measurement"),
    ],
)
def test_what_fails_is_named_and_the_camera_is_let_go(realsense, options, words):
    fake = realsense(**options)
    with pytest.raises(FungraspError, match=words):
        capture_from_camera()
    assert fake.stopped == (0 if "start_error" in options else 1)


def test_an_image_of_a_recording_by_its_number(realsense, tmp_path):
    file = tmp_path / "recording.bag"
    file.touch()
    realsense(images=4)
    assert capture_from_camera(file, image=2).color[0, 0].tolist() == [200, 2, 0]
    realsense(images=4)
    with pytest.raises(FungraspError, match="has no image 4: its images are 0 to 3"):
        capture_from_camera(file, image=4)
    with pytest.raises(FungraspError, match="no image -1"):
        capture_from_camera(file, image=-1)


def test_bad_recordings(realsense, tmp_path):
    realsense(start_error="Failed to resolve request.\n Reason: Error reading version line")
    with pytest.raises(FungraspError, match="does not exist"):
        capture_from_camera(tmp_path / "missing.bag")
    file = tmp_path / "bad.bag"
    file.write_bytes(b"cut short")
    with pytest.raises(FungraspError, match=r"can't be played: is it damaged.*Error reading version line"):
        capture_from_camera(file)


def test_distortion_is_told(realsense, caplog):
    realsense(coeffs=(0.1, -0.2, 0, 0, 0))
    with caplog.at_level(logging.WARNING):
        capture_from_camera()
    assert "distortion is not taken into account" in caplog.text


def test_without_pyrealsense2_the_way_to_get_it_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(FungraspError, match=r'pip install "\.\[realsense\]".*none for macOS'):
        capture_from_camera()


def test_without_libusb_the_package_is_named(monkeypatch):
    def broken(name):
        raise ImportError("libusb-1.0.so.0: cannot open shared object file: No such file or directory")

    monkeypatch.setattr("fungrasp.perception.io.realsense.importlib.import_module", broken)
    with pytest.raises(FungraspError, match=r"can't be loaded: libusb.*apt install libusb-1.0-0"):
        capture_from_camera()


@pytest.mark.parametrize("age", [0.2, 3.0])
def test_the_newest_frame_of_a_camera_with_a_number(realsense, age: float):
    fake = realsense(images=5)
    fake.domain, fake.age = "global", age
    with RealSenseCamera(serial="123", stream=StreamSettings(848, 480, 60)) as camera:
        assert camera.name == "RealSense camera 123"
        frame = camera.newest(0.1)
        assert frame is not None and frame.color[0, 0, 1] == 4, "those before have queued and are left out"
        assert age <= time.monotonic() - frame.time < age + 4.0, "when it was taken, however long ago"
        assert camera.newest(0.0) is None
    assert (fake.serial, fake.aligned, fake.stopped) == ("123", 1, 1)
    assert fake.streams == [("depth", 848, 480, "z16", 60), ("color", 848, 480, "rgb8", 60)]
    realsense(start_error="No device connected")
    with pytest.raises(FungraspError, match="no RealSense camera 123 is connected"):
        RealSenseCamera(serial="123").__enter__()
