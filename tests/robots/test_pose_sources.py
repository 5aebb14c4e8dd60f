"""Object poses: messages, the stream against an emulated tracker, filter and guard, replay."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import time
from collections.abc import Iterator

import numpy as np
import pytest
from driver_contract import wait_for

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import quaternion_from_rotation_vector
from fungrasp.robots.codecs.pose_message import PoseMessage, message_entries, read_message
from fungrasp.robots.device import RobotError, TrackedPose, TrackingStatus
from fungrasp.robots.emulators.emulator import Fault
from fungrasp.robots.emulators.tracker import TrackerEmulator, TrackerErrors
from fungrasp.robots.pose.filtering import GuardedPoseSource, OneEuroPoseFilter, OneEuroSettings, PoseGate
from fungrasp.robots.pose.replay import PoseRecording, PoseReplay, load_pose_recording, save_pose_recording
from fungrasp.robots.pose.stream import PoseStream

IDENTITY = np.array([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0])
MESSAGE = PoseMessage(
    3, "c", 1.0, 1.05, "mug", "world", (0.0,) * 3 + (1.0, 0, 0, 0), 0.9, TrackingStatus.TRACKING
)
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


@pytest.mark.parametrize("fault", [Fault.STALLED, Fault.FROZEN, Fault.CLOCK_JUMP, Fault.CORRUPT])
def test_what_stops_coming_grows_old(fault: Fault):
    with tracked() as (emulator, stream):
        guarded = GuardedPoseSource(stream, PoseGate(oldest=0.4))
        assert wait_for(lambda: guarded.read().status is TrackingStatus.TRACKING)
        emulator.inject(fault)
        assert wait_for(lambda: guarded.read().status is TrackingStatus.LOST)
        assert "old" in guarded.reason
        emulator.clear()
        assert wait_for(lambda: guarded.read().status is TrackingStatus.TRACKING)


@pytest.mark.parametrize("fault", [Fault.GONE, Fault.JUMPING])
def test_what_cannot_be_is_lost(fault: Fault):
    with tracked() as (emulator, stream):
        guarded = GuardedPoseSource(stream, PoseGate(oldest=5.0))
        assert wait_for(lambda: guarded.read().status is TrackingStatus.TRACKING)
        emulator.inject(fault)
        assert wait_for(lambda: guarded.read().status is TrackingStatus.LOST)
        assert np.abs(guarded.read().pose_world_object - IDENTITY).max() < 0.05


def test_the_filter_lags_as_it_says():
    settings, filter_ = OneEuroSettings(), OneEuroPoseFilter()
    speed, rate = 0.1, 300.0
    for i in range(1200):
        pose = IDENTITY + np.array([speed * i / rate, 0, 0, 0, 0, 0, 0])
        smooth = filter_.update(pose, i / rate)
    expected = settings.lag(speed)[0]
    assert (pose[0] - smooth[0]) / speed == pytest.approx(expected, rel=0.1)


def test_the_filter_lags_in_rotation_as_it_says():
    settings, filter_ = OneEuroSettings(), OneEuroPoseFilter()
    turn, rate = 0.5, 300.0
    for i in range(1200):
        angle = turn * i / rate
        pose = np.concatenate([np.zeros(3), quaternion_from_rotation_vector(np.array([0, 0, angle]))])
        smooth = filter_.update(pose, i / rate)
    reached = 2 * np.arctan2(smooth[6], smooth[3])
    assert (angle - reached) / turn == pytest.approx(settings.lag(0.0, turn)[1], rel=0.1)


def test_the_filter_halves_the_noise_at_rest():
    rng, filter_ = np.random.default_rng(0), OneEuroPoseFilter()
    noise = 0.002 * rng.normal(size=(600, 3))
    out = np.array(
        [filter_.update(np.concatenate([n, [1, 0, 0, 0]]), i / 30)[:3] for i, n in enumerate(noise)]
    )
    assert out[60:].std() < 0.5 * noise[60:].std()


class _Told:
    name = "told"

    def __init__(self):
        self.pose = TrackedPose(IDENTITY, 0.0, 1.0, TrackingStatus.TRACKING)

    def connect(self): ...

    def close(self): ...

    def read(self):
        return self.pose


def test_a_lasting_jump_is_believed_after_confirmations():
    told, now = _Told(), [0.0]
    guarded = GuardedPoseSource(told, PoseGate(confirmations=3), clock=lambda: now[0])
    assert guarded.read().status is TrackingStatus.TRACKING
    moved = IDENTITY + np.array([0.3, 0, 0, 0, 0, 0, 0])
    states = []
    for _ in range(4):
        now[0] += 0.03
        told.pose = dataclasses.replace(told.pose, pose_world_object=moved, captured=now[0])
        states.append(guarded.read().status)
        # Reading again without news confirms nothing.
        assert guarded.read().status is states[-1]
    assert states == [TrackingStatus.LOST] * 2 + [TrackingStatus.TRACKING] * 2


def test_a_recording_is_replayed_at_its_pace(tmp_path):
    poses = np.tile(IDENTITY, (3, 1))
    poses[:, 0] = [0, 1, 2]
    status = np.array(["tracking", "tracking", "lost"])
    recording = PoseRecording(
        np.array([10.0, 10.1, 10.2]), np.array([10.05, 10.15, 10.25]), poses, np.ones(3), status
    )
    save_pose_recording(tmp_path / "poses.npz", recording)
    now = [100.0]
    with PoseReplay(load_pose_recording(tmp_path / "poses.npz"), clock=lambda: now[0]) as replay:
        assert replay.read().pose_world_object[0] == 0
        assert replay.read().captured == pytest.approx(99.95)
        now[0] = 100.12
        assert replay.read().pose_world_object[0] == 1
        now[0] = 200.0
        assert replay.read().status is TrackingStatus.LOST and replay.read().captured == pytest.approx(100.15)


def test_a_broken_recording_is_refused(tmp_path):
    np.savez(tmp_path / "poses.npz", captured=np.zeros(2))
    with pytest.raises(FungraspError, match="missing"):
        load_pose_recording(tmp_path / "poses.npz")
    with pytest.raises(RobotError, match="at least one"):
        PoseRecording(np.zeros(2), np.zeros(2), np.zeros((3, 7)), np.zeros(2), np.zeros(2, "U8"))
