"""How long a robot takes to see that its object tracker has failed."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from benchmarks.faults.reaction_times import ReactionTrial
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.device import RobotError, TrackedPose, TrackingStatus
from fungrasp.robots.pose.stream import PoseStream
from fungrasp.robots.safety import check_pose
from fungrasp_emulators.emulator import Fault
from fungrasp_emulators.tracker import TrackerEmulator

TRACKER = "tracker"
"""Name of the device."""
FAULTS = tuple(sorted(TrackerEmulator.supported))
"""What an emulated tracker shows."""
CHECK_PERIOD = 0.1
"""Before the fingers close the tracked pose is checked at every control step [s]."""
WATCHED = 2.0
"""Longest wait for the reaction [s]."""
TRUTH = np.array([0.1, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0])
"""Where the object is, world frame."""


def tracker_reactions(
    cell: RobotCell, fault: Fault, count: int, rng: np.random.Generator, address: str
) -> Iterator[ReactionTrial]:
    """Trials of one fault over ZeroMQ; what detects it is the check of the deployment.

    Args:
        cell: with the limits of its watchdog.
        fault: one that ``TrackerEmulator`` has.
        count: of trials.
        rng: of the time at which the fault comes.
        address: to publish on.
    """
    with TrackerEmulator(lambda now: TRUTH, address) as emulator, PoseStream(address) as stream:
        for _ in range(count):
            yield _trial(cell, emulator, stream, fault, rng)


def _trial(
    cell: RobotCell, emulator: TrackerEmulator, stream: PoseStream, fault: Fault, rng: np.random.Generator
) -> ReactionTrial:
    seen = _fresh(cell, stream)
    if seen is None:
        return ReactionTrial(TRACKER, "none: no pose", None, None, "", 0.0, False)
    start = time.monotonic()
    injected, said = start + rng.uniform(0.0, 0.2), ""
    step, begun = 0, False
    while (now := time.monotonic()) < injected + WATCHED and not said:
        if not begun and now >= injected:
            emulator.inject(fault)
            begun = True
        # Read at every setpoint, checked at every control step.
        seen = _latest(stream, seen)
        if now >= start + step * CHECK_PERIOD:
            step += 1
            said = check_pose(seen, TRUTH, now, cell)
        time.sleep(0.005)
    detected = time.monotonic() - injected if said else None
    emulator.clear()
    restarted = _fresh(cell, stream) is not None
    name = fault.value if begun else "none: false alarm"
    return ReactionTrial(TRACKER, name, detected, None, said, 0.0, restarted)


def _latest(stream: PoseStream, seen: TrackedPose | None) -> TrackedPose | None:
    """The last pose in which the object was tracked, as ``Robot.state`` has it."""
    try:
        now = stream.read()
    except RobotError:
        return seen
    return now if now is not None and now.status is TrackingStatus.TRACKING else seen


def _fresh(cell: RobotCell, stream: PoseStream) -> TrackedPose | None:
    """A pose with which nothing is wrong; None where none comes."""
    seen, deadline = None, time.monotonic() + 3.0
    while time.monotonic() < deadline:
        seen = _latest(stream, seen)
        if not check_pose(seen, TRUTH, time.monotonic(), cell):
            return seen
        time.sleep(0.02)
    return None
