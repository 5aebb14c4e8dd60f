"""What every driver of joints must do, whatever device it drives: subclass, and say how one is made."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import DeviceStatus, JointState, RobotError, StopKind
from fungrasp_emulators.emulator import Emulator, Fault, Plant

PATIENCE = 10.0
"""A busy machine may stop a process for seconds; tests wait so long before they call it a failure [s]."""


@dataclass
class DeviceUnderTest:
    """A driver with the emulated device that it talks to."""

    driver: LoopDriver
    emulator: Emulator
    plant: Plant
    near: np.ndarray
    """A goal that is reached within a second [rad], shape [U]."""
    tolerance: float
    """Of reaching it [rad]."""

    def true_positions(self) -> np.ndarray:
        """Where the joints are [rad], shape [U], in the order of the plant."""
        return self.plant.state(time.monotonic()).positions


def wait_for(condition: Callable[[], object], patience: float = PATIENCE) -> bool:
    """Whether a condition becomes true in time."""
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.002)
    return bool(condition())


def reach(device: DeviceUnderTest, goal: np.ndarray) -> JointState:
    """Command a goal until it is reached."""

    def there() -> bool:
        device.driver.command(goal)
        return bool(np.abs(device.driver.read().positions - goal).max() < device.tolerance)

    assert wait_for(there), device.driver.read()
    return device.driver.read()


class DriverContract:
    """Tests of any driver. A subclass yields a ``DeviceUnderTest`` from ``running``."""

    lost: ClassVar[tuple[Fault, ...]] = (Fault.STALLED, Fault.POWER_LOSS, Fault.SATURATED)
    """Faults that end a connection."""
    disturbed: ClassVar[tuple[Fault, ...]] = (Fault.LOST, Fault.LATE, Fault.CORRUPT)
    """Faults that a driver rides out."""
    latches: ClassVar[bool] = True
    """Whether a lost device follows again only when somebody has connected anew."""
    when_lost: ClassVar[dict[str, Any]] = {"stale_after": 0.5}
    """Settings of the driver for the first ones ..."""
    when_disturbed: ClassVar[dict[str, Any]] = {}
    """... and for the others."""

    def running(self, **settings: Any) -> contextlib.AbstractContextManager[DeviceUnderTest]:
        """Emulator started, driver not connected."""
        raise NotImplementedError

    def test_a_lost_device_is_seen(self) -> None:
        with self.running(**self.when_lost) as device:
            device.driver.connect()
            for fault in self.lost:
                reach(device, device.near)
                device.emulator.inject(fault)
                assert wait_for(lambda: device.driver.read().status is DeviceStatus.DISCONNECTED), fault
                device.emulator.clear()
                time.sleep(0.1)
                if self.latches:
                    with pytest.raises(RobotError):
                        device.driver.command(device.near)
                device.driver.connect()
            reach(device, device.near)

    def test_a_disturbed_line_still_carries(self) -> None:
        with self.running(**self.when_disturbed) as device:
            device.driver.connect()
            for number, fault in enumerate(self.disturbed):
                device.emulator.inject(fault)
                goal = device.near + 0.05 * (number % 2)

                def there(goal: np.ndarray = goal) -> bool:
                    device.driver.command(goal)
                    return bool(np.abs(device.true_positions() - goal).max() < 2 * device.tolerance)

                assert wait_for(there), fault
                device.emulator.clear()

    @pytest.fixture
    def unconnected(self) -> Iterator[DeviceUnderTest]:
        with self.running() as device:
            yield device
            device.driver.close()

    @pytest.fixture
    def device(self, unconnected: DeviceUnderTest) -> DeviceUnderTest:
        unconnected.driver.connect()
        return unconnected

    def test_not_connected(self, unconnected: DeviceUnderTest) -> None:
        driver = unconnected.driver
        assert driver.read().status is DeviceStatus.DISCONNECTED
        with pytest.raises(RobotError):
            driver.command(unconnected.near)
        driver.stop(StopKind.HOLD)
        driver.close()
        driver.close()

    def test_nobody_there(self, unconnected: DeviceUnderTest) -> None:
        unconnected.emulator.close()
        with pytest.raises(RobotError) as caught:
            unconnected.driver.connect()
        assert "\n" not in str(caught.value)

    def test_connecting_moves_nothing(self, unconnected: DeviceUnderTest) -> None:
        before = unconnected.true_positions()
        unconnected.driver.connect()
        assert unconnected.driver.read().status is DeviceStatus.READY
        time.sleep(0.2)
        assert np.abs(unconnected.true_positions() - before).max() < 1e-3

    def test_states_stay_fresh(self, device: DeviceUnderTest) -> None:
        first = device.driver.read()
        assert wait_for(lambda: device.driver.read().device_time > first.device_time + 0.05)
        assert device.driver.read().received > first.received

    def test_reaches_a_goal_and_says_what_was_sent(self, device: DeviceUnderTest) -> None:
        sent = device.driver.command(device.near)
        assert np.allclose(sent, device.near)
        state = reach(device, device.near)
        assert state.status is DeviceStatus.READY
        assert np.abs(device.true_positions() - device.near).max() < 2 * device.tolerance

    def test_a_goal_beyond_the_limits_is_clipped(self, device: DeviceUnderTest) -> None:
        sent = device.driver.command(np.full(len(device.near), 100.0))
        assert np.allclose(sent, device.driver.limits.upper)
        device.driver.stop()

    def test_speed_stays_within_the_limit(self, device: DeviceUnderTest) -> None:
        far = np.clip(device.near + 0.5, device.driver.limits.lower, device.driver.limits.upper)
        times, positions = [], []
        # Which may take longer than the motion, on a busy machine.
        device.driver.take_control()
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            device.driver.command(far)
            times.append(time.monotonic())
            positions.append(device.plant.state(times[-1]).positions)
            time.sleep(0.005)
        # Over windows of 100 ms: a single interval is too short for the clock of a busy machine.
        times, positions = np.array(times), np.array(positions)
        later = np.searchsorted(times, times + 0.1)
        valid = later < len(times)
        moved = np.abs(positions[later[valid]] - positions[valid])
        elapsed = (times[later[valid]] - times[valid])[:, None]
        # A hand under torque control that is not served for a moment, on a busy machine, runs on.
        within = (moved <= device.driver.limits.velocity * (1.1 * elapsed + 0.02)).all(axis=1)
        assert within.mean() > 0.8 and moved.max() > 0.05

    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_refuses_values_that_are_not_finite(self, device: DeviceUnderTest, bad: float) -> None:
        goal = device.near.copy()
        goal[2] = bad
        with pytest.raises(RobotError, match="joint 2"):
            device.driver.command(goal)

    def test_refuses_another_number_of_joints(self, device: DeviceUnderTest) -> None:
        with pytest.raises(RobotError, match="shape"):
            device.driver.command(device.near[:-1])

    @pytest.mark.parametrize("kind", list(StopKind))
    def test_stop_ends_motion_and_latches(self, device: DeviceUnderTest, kind: StopKind) -> None:
        reach(device, device.near)
        device.driver.stop(kind)
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.STOPPED), device.driver.read()
        with pytest.raises(RobotError, match=r"connect\(\)"):
            device.driver.command(device.near)
        if kind is StopKind.HOLD:
            time.sleep(0.1)
            before = device.true_positions()
            time.sleep(0.2)
            assert np.abs(device.true_positions() - before).max() < 0.02
        device.driver.connect()
        reach(device, device.near)

    def test_a_silent_driver_is_a_stop(self, device: DeviceUnderTest) -> None:
        def silence_is_noticed() -> bool:
            # Reading ends the silence.
            time.sleep(0.8)
            return "no command" in device.driver.read().message

        device.driver.command(device.near)
        assert wait_for(silence_is_noticed)
        reach(device, device.near)

    def test_leaving_the_context_closes(self, unconnected: DeviceUnderTest) -> None:
        with unconnected.driver:
            reach(unconnected, unconnected.near)
        assert unconnected.driver.read().status is DeviceStatus.DISCONNECTED
        unconnected.driver.connect()
        assert unconnected.driver.read().status is DeviceStatus.READY
