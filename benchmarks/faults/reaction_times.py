"""How drivers react to faults, again and again, while the joints move between two places."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fungrasp.robots.device import DeviceStatus, RobotError
from fungrasp_emulators.devices import EmulatedDevice
from fungrasp_emulators.emulator import Fault
from fungrasp_emulators.ur import URControllerEmulator

PROCESS_KILLED = "driver's process killed"
"""Besides what emulators show."""
WATCHED = 1.0
"""Time that is watched after a fault that the driver carries [s]; longer where its limit of silence is."""
AFTERWARDS = 0.4
"""Time that is watched after a fault was detected [s]."""
SETTLED = 1e-3
"""A joint that moves less in ``PAUSE`` stands [rad] ..."""
PAUSE = 0.05
"""... [s]."""


@dataclass(frozen=True)
class ReactionTrial:
    """One fault."""

    device: str
    """Name of the device."""
    fault: str
    """What happened."""
    detected: float | None
    """Time until the driver reported another status than ready [s]; None: never."""
    stopped: float | None
    """Time until the joints stood still for good [s]; None where they moved on."""
    status: str
    """What the driver reported then."""
    speed_share: float
    """Highest speed after the fault, of the limit, over 50 ms."""
    restarted: bool
    """The driver could be connected and commanded again when the fault was over."""
    limit: float | None = None
    """The time in which the device or its driver should see it by their settings [s]; None where none is
    set."""
    log_readable: bool | None = None
    """Whether the log of the deployment could be read up to the fault; None where none was written."""


def reaction_trials(
    device: EmulatedDevice, fault: Fault | str, count: int, rng: np.random.Generator
) -> Iterator[ReactionTrial]:
    """Trials of one fault.

    Args:
        device: its emulator is closed here.
        fault: one that the emulator has, or ``PROCESS_KILLED``.
        count: of trials.
        rng: of the time at which the fault comes.
    """
    try:
        for _ in range(count):
            try:
                yield _trial(device, fault, rng)
            except RobotError as error:
                # Not connected again after the trial before, which says so.
                device.driver.close()
                yield ReactionTrial(device.name, f"none: {error}", None, None, "", 0.0, False)
    finally:
        device.driver.close()
        device.emulator.close()


def _trial(device: EmulatedDevice, fault: Fault | str, rng: np.random.Generator) -> ReactionTrial:
    _make_ready(device)
    driver = device.driver
    here = driver.read().positions
    far = np.abs(here - device.away).max() > np.abs(here - device.home).max()
    goal = device.away if far else device.home
    began = time.monotonic()
    before = rng.uniform(0.05, 0.25)
    while time.monotonic() - began < before:
        with contextlib.suppress(RobotError):
            driver.command(goal)
        time.sleep(0.005)
    if driver.read().status is not DeviceStatus.READY:
        # A machine that stopped the driver for too long: a reaction to no fault of the device.
        return ReactionTrial(
            device.name, "none: false alarm", 0.0, None, driver.read().status.value, 0.0, True
        )
    start = time.monotonic()
    if isinstance(fault, Fault):
        device.emulator.inject(fault)
    elif driver.process_id is not None:
        os.kill(driver.process_id, signal.SIGKILL)
    detected, status = None, DeviceStatus.READY
    times, positions = [], []
    longest = max(WATCHED, 2 * device.stale_after)
    while (now := time.monotonic()) - start < longest:
        if detected is not None and now - start > detected + AFTERWARDS:
            break
        state = driver.read()
        if detected is None and state.status is not DeviceStatus.READY:
            detected, status = time.monotonic() - start, state.status
        times.append(now - start)
        positions.append(device.plant.state(time.monotonic()).positions)
        if detected is None:
            with contextlib.suppress(RobotError):
                driver.command(goal)
        time.sleep(0.004)
    stopped, fastest = motion_after(np.array(times), np.array(positions), driver.limits.velocity)
    device.emulator.clear()
    if isinstance(device.emulator, URControllerEmulator):
        device.emulator.unlock_protective_stop()
    name = fault.value if isinstance(fault, Fault) else fault
    restarted = _restarts(device)
    return ReactionTrial(
        device.name, name, detected, stopped, status.value, fastest, restarted, device.stale_after
    )


def motion_after(times: np.ndarray, positions: np.ndarray, limits: np.ndarray) -> tuple[float | None, float]:
    """When the motion after a fault ended, and how fast it was.

    Args:
        times: since the fault [s], shape [T].
        positions: of the joints [rad], shape [T, U].
        limits: of their speeds [rad/s], shape [U].

    Returns:
        when it ended [s], None if it did not; the highest speed over ``PAUSE``, as a share of the limit.
    """
    later = np.searchsorted(times, times + PAUSE)
    valid = later < len(times)
    moved = np.abs(positions[later[valid]] - positions[valid])
    elapsed = (times[later[valid]] - times[valid])[:, None]
    fastest = float((moved / elapsed / limits).max(initial=0.0))
    moving = np.flatnonzero((moved > SETTLED).any(axis=1))
    if len(moving) == 0:
        return 0.0, fastest
    end = moving[-1] + 1
    return (None if end >= valid.sum() else float(times[end])), fastest


def _make_ready(device: EmulatedDevice) -> None:
    for attempt in range(5):
        try:
            if device.driver.read().status is not DeviceStatus.READY:
                device.driver.connect()
            device.driver.command(device.driver.read().positions)
            return
        except RobotError:
            if attempt == 4:
                raise


def _restarts(device: EmulatedDevice) -> bool:
    try:
        _make_ready(device)
    except RobotError:
        return False
    return True
