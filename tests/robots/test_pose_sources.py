"""Object poses: messages, the stream of an emulated tracker, and what the deployment loop says of it."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator

import numpy as np
import pytest
from driver_contract import wait_for

from fungrasp.robots.cell import RobotCell
from fungrasp.robots.codecs.pose_message import PoseMessage, message_entries, read_message
from fungrasp.robots.device import RobotError, TrackingStatus
from fungrasp.robots.emulators.emulator import Fault
from fungrasp.robots.emulators.tracker import TrackerEmulator, TrackerErrors
from fungrasp.robots.pose.stream import PoseStream
from fungrasp.robots.safety import check_pose

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
        time.sleep(0.3)
        first = stream.read()
        assert first is not None and np.allclose(first.pose_world_object, IDENTITY)
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


def test_an_object_that_is_gone_is_lost():
    with tracked() as (emulator, stream):
        assert wait_for(lambda: stream.read().status is TrackingStatus.TRACKING)
        emulator.inject(Fault.GONE)
        assert wait_for(lambda: stream.read().status is TrackingStatus.LOST)
