"""Object poses: messages, the stream of an emulated tracker, and what the deployment loop says of it."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from driver_contract import wait_for

from fungrasp.core.errors import FungraspError
from fungrasp.robots.assembly import pose_source
from fungrasp.robots.cell import RobotCell, TrackerSettings
from fungrasp.robots.device import RobotError, TrackingStatus
from fungrasp.robots.pose.stream import PoseMessage, PosePublisher, PoseStream, read_message
from fungrasp.robots.safety import check_pose

IDENTITY = np.array([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0])
MESSAGE = PoseMessage(
    3, "c", 1.0, 1.05, "mug", "world", (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), 0.9, TrackingStatus.TRACKING
)
CELL = RobotCell("allegro")
ADDRESS = f"ipc:///tmp/fungrasp-test-pose-{os.getpid()}"


class Tracker:
    """Publishes where the object is 30 times a second, 20 ms late."""

    def __init__(self) -> None:
        self.publisher = PosePublisher(ADDRESS, "mug")
        self.answer: Callable[[float], object] = self.publish
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self._run)

    def publish(self, captured: float, **said: Any) -> None:
        self.publisher.publish(IDENTITY, captured, **said)

    def spoil(self, what: str) -> None:
        began = time.monotonic()
        answers: dict[str, Callable[[float], object]] = {
            "stalled": lambda captured: None,
            "frozen": lambda captured: self.publish(began),
            "clock jump": lambda captured: self.publish(captured + 3600.0),
            "corrupt": lambda captured: self.publisher.send_bytes(np.random.default_rng(0).bytes(80)),
            "gone": lambda captured: self.publish(captured, score=0.0, status=TrackingStatus.LOST),
        }
        self.answer = answers[what]

    def _run(self) -> None:
        while not self.ended.wait(1 / 30):
            self.answer(time.monotonic() - 0.02)


@contextlib.contextmanager
def tracked() -> Iterator[tuple[Tracker, PoseStream]]:
    pytest.importorskip("zmq")
    pytest.importorskip("msgpack")
    tracker = Tracker()
    tracker.thread.start()
    try:
        with PoseStream(ADDRESS, "mug", timeout=10.0) as stream:
            yield tracker, stream
    finally:
        tracker.ended.set()
        tracker.thread.join()
        tracker.publisher.close()


def test_a_message_comes_back():
    assert read_message(MESSAGE.entries()) == MESSAGE


@pytest.mark.parametrize(
    "change, match",
    [
        ({"version": 2}, "version 2"),
        ({"schema": "other"}, "another kind"),
        ({"position": [0.0, float("nan"), 0.0]}, "expected a finite number"),
        ({"rotation": [1.0, 1.0, 0.0, 0.0]}, "unit quaternion"),
        ({"rotation": [1.0, 0.0]}, r"expected a list of 4, not \[1\.0, 0\.0\]"),
        ({"status": "asleep"}, "asleep"),
    ],
)
def test_a_wrong_message_is_refused(change: dict, match: str):
    with pytest.raises(RobotError, match=match):
        read_message(MESSAGE.entries() | change)


def test_the_newest_pose_arrives_with_its_capture_time():
    with tracked() as (_, stream):
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
    with tracked(), pytest.raises(RobotError, match="'mug', not 'drill'"):
        PoseStream(ADDRESS, "drill", timeout=10.0).connect()


def problem(stream: PoseStream) -> str:
    """What the deployment loop says of the newest pose."""
    return check_pose(stream.read(), IDENTITY, time.monotonic(), CELL)


@pytest.mark.parametrize("fault", ["stalled", "frozen", "clock jump", "corrupt"])
def test_what_stops_coming_grows_old_and_is_refused(fault: str):
    with tracked() as (tracker, stream):
        assert wait_for(lambda: not problem(stream))
        tracker.spoil(fault)
        assert wait_for(lambda: "ms old" in problem(stream))
        tracker.answer = tracker.publish
        assert wait_for(lambda: not problem(stream))


class Elsewhere:
    """A tracker on another machine: its clock has another origin, and its messages take their time."""

    def __init__(self, address: str, wall: bool):
        zmq, self.msgpack = pytest.importorskip("zmq"), pytest.importorskip("msgpack")
        self.socket = zmq.Context.instance().socket(zmq.PUB)
        self.socket.bind(address)
        self.wall, self.travel, self.skew = wall, 0.0, 0.0
        self.waiting: list[tuple[float, bytes]] = []
        self.ended = threading.Event()
        self.silent = False
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        while not self.ended.wait(0.02):
            now = time.monotonic()
            said = replace(
                MESSAGE,
                clock="monotonic:of another machine",
                captured=now - 1e5 - 0.03,
                sent=now - 1e5,
                wall=time.time() + self.skew if self.wall else None,
            )
            if not self.silent:
                self.waiting.append((now + self.travel, self.msgpack.packb(said.entries())))
            while self.waiting and self.waiting[0][0] <= time.monotonic():
                self.socket.send(self.waiting.pop(0)[1])

    def close(self) -> None:
        self.ended.set()
        self.thread.join()
        self.socket.close()


@pytest.mark.parametrize("wall", [True, False])
def test_a_pose_of_another_machine_ages_though_nobody_looks_and_though_the_network_is_slow(wall: bool):
    address = f"{ADDRESS}-elsewhere-{wall}"
    tracker = Elsewhere(address, wall)
    try:
        with PoseStream(address, MESSAGE.object, timeout=10.0) as stream:
            assert wait_for(lambda: 0.02 < time.monotonic() - stream.read().captured < 0.2)
            # Dead for a while, in which nobody reads: planning takes seconds.
            tracker.silent = True
            time.sleep(1.2)
            assert time.monotonic() - stream.read().captured > 1.0
            tracker.silent = False
            assert wait_for(lambda: time.monotonic() - stream.read().captured < 0.3)
            tracker.travel = 0.8
            time.sleep(1.5)
            age = time.monotonic() - stream.read().captured
            assert 0.75 < age < 1.6
    finally:
        tracker.close()


def test_machines_with_another_time_of_day_are_refused():
    address = f"{ADDRESS}-skewed"
    tracker = Elsewhere(address, wall=True)
    tracker.skew = 2.0
    try:
        with pytest.raises(RobotError, match=r"2\.0\d s ahead of ours"):
            PoseStream(address, MESSAGE.object, timeout=10.0).connect()
    finally:
        tracker.close()


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


def test_an_object_that_is_gone_is_lost():
    with tracked() as (tracker, stream):
        assert wait_for(lambda: stream.read().status is TrackingStatus.TRACKING)
        tracker.spoil("gone")
        assert wait_for(lambda: stream.read().status is TrackingStatus.LOST)
