"""Object poses: messages, the stream of an emulated tracker, and what the deployment loop says of it."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from driver_contract import wait_for

from fungrasp.core.errors import FungraspError
from fungrasp.robots.assembly import pose_source
from fungrasp.robots.cell import RobotCell, TrackerSettings
from fungrasp.robots.codecs.pose_message import PoseMessage, message_entries, read_message
from fungrasp.robots.device import RobotError, TrackedPose, TrackingStatus
from fungrasp.robots.pose.stream import PosePublisher, PoseStream
from fungrasp.robots.safety import check_pose
from fungrasp_emulators.emulator import Fault
from fungrasp_emulators.tracker import TrackerEmulator, TrackerErrors

IDENTITY = np.array([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0])
MESSAGE = PoseMessage(
    3, "c", 1.0, 1.05, "mug", "world", (0.0,) * 3 + (1.0, 0, 0, 0), 0.9, TrackingStatus.TRACKING
)
CELL = RobotCell("allegro")
QUICK = TrackerErrors(delay=0.02)
ADDRESS = f"ipc:///tmp/fungrasp-test-pose-{os.getpid()}"


@contextlib.contextmanager
def tracked(
    errors: TrackerErrors = QUICK,
) -> Iterator[tuple[TrackerEmulator, PoseStream]]:
    pytest.importorskip("zmq")
    pytest.importorskip("msgpack")
    emulated = TrackerEmulator(lambda now: IDENTITY, ADDRESS, "mug", errors)
    with emulated as emulator, PoseStream(ADDRESS, "mug", timeout=10.0) as stream:
        yield emulator, stream


def test_a_message_comes_back():
    assert read_message(message_entries(MESSAGE)) == MESSAGE


@pytest.mark.parametrize(
    "change, match",
    [
        ({"version": 2}, "version 2"),
        ({"schema": "other"}, "another kind"),
        ({"position": [0.0, float("nan"), 0.0]}, "not finite"),
        ({"rotation": [1.0, 1.0, 0.0, 0.0]}, "unit quaternion"),
        ({"rotation": [1.0, 0.0]}, "seven"),
        ({"status": "asleep"}, "asleep"),
    ],
)
def test_a_wrong_message_is_refused(change: dict, match: str):
    with pytest.raises(RobotError, match=match):
        read_message(message_entries(MESSAGE) | change)


def test_the_newest_pose_arrives_with_its_capture_time():
    with tracked(TrackerErrors(delay=0.02, position=0.0, rotation=0.0)) as (_, stream):
        assert wait_for(lambda: stream.read() is not None)
        first = stream.read()
        assert np.allclose(first.pose_world_object, IDENTITY)
        assert 0.02 <= time.monotonic() - first.captured < 5.0
        assert wait_for(lambda: stream.read().captured > first.captured)


def test_nobody_publishes_and_nonsense_addresses():
    pytest.importorskip("zmq")
    with pytest.raises(RobotError, match="is the tracker running"):
        PoseStream("tcp://127.0.0.1:9", timeout=0.1).connect()
    with pytest.raises(RobotError, match="an address is like"):
        PoseStream("nonsense").connect()


def test_another_object_is_refused():
    with tracked() as (emulator, _), pytest.raises(RobotError, match="'mug', not 'drill'"):
        PoseStream(emulator.address, "drill", timeout=10.0).connect()


def problem(stream: PoseStream) -> str:
    """What the deployment loop says of the newest pose."""
    return check_pose(stream.read(), IDENTITY, time.monotonic(), CELL)


@pytest.mark.parametrize("fault", [Fault.STALLED, Fault.FROZEN, Fault.CLOCK_JUMP, Fault.CORRUPT])
def test_what_stops_coming_grows_old_and_is_refused(fault: Fault):
    with tracked() as (emulator, stream):
        assert wait_for(lambda: not problem(stream))
        emulator.inject(fault)
        assert wait_for(lambda: "ms old" in problem(stream))
        emulator.clear()
        assert wait_for(lambda: not problem(stream))


def test_an_object_that_jumps_is_refused():
    with tracked() as (emulator, stream):
        assert wait_for(lambda: not problem(stream))
        emulator.inject(Fault.JUMPING)
        assert wait_for(lambda: "has jumped" in problem(stream))


def test_poses_in_the_cameras_frame_become_those_of_the_world():
    """As a cell says it: through the calibrated pose of the camera, refused without a calibration."""
    pytest.importorskip("zmq")
    pytest.importorskip("msgpack")
    # A camera that looks straight down from a meter above the table.
    camera = (0.5, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0)
    address = f"{ADDRESS}-camera"
    tracker = TrackerSettings(
        "pose-stream", address, {"frame": "camera", "timeout": 10.0}, camera, calibration_residual=0.001
    )
    cell = RobotCell("allegro", tracker=tracker)
    publisher = PosePublisher(address, "mug", frame="camera")
    ended = threading.Event()

    def publish() -> None:
        while not ended.wait(0.02):
            publisher.publish(np.array([0.1, 0.2, 0.9, 1.0, 0.0, 0.0, 0.0]), time.monotonic())

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        with pose_source(cell) as source:
            seen = source.read()
        assert seen is not None
        assert np.allclose(seen.pose_world_object, [0.6, -0.2, 0.1, 0.0, 1.0, 0.0, 0.0], atol=1e-9)
        with pytest.raises(RobotError, match="frame 'camera', not 'world'"):
            PoseStream(address, timeout=10.0).connect()
    finally:
        ended.set()
        thread.join()
        publisher.close()
    with pytest.raises(FungraspError, match="no calibration of the camera"):
        pose_source(replace(cell, tracker=replace(tracker, calibration_residual=-1.0)))
    with pytest.raises(RobotError, match="needs the pose of the camera"):
        PoseStream(address, frame="camera")
    with pytest.raises(RobotError, match="not 'gripper'"):
        PoseStream(address, frame="gripper")


def test_flips_and_doubts_are_refused():
    flipped = np.array([*IDENTITY[:3], 0.0, 0.0, 0.0, 1.0])
    for pose, score, said in (
        (flipped, 1.0, "turned by 180 degrees"),
        (IDENTITY, 0.05, "confidence is 0.05"),
    ):
        tracked_pose = TrackedPose(pose, 1.0, score, TrackingStatus.TRACKING)
        assert said in check_pose(tracked_pose, IDENTITY, 1.0, CELL)


def test_an_object_that_is_gone_is_lost():
    with tracked() as (emulator, stream):
        assert wait_for(lambda: stream.read().status is TrackingStatus.TRACKING)
        emulator.inject(Fault.GONE)
        assert wait_for(lambda: stream.read().status is TrackingStatus.LOST)
