"""A device's process that hangs or is held up: one whose client library never returns ends after its
policy's, and frees the device; a pause is no silence of the device."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from driver_contract import wait_for
from hanging_loop import HangingLoop

from fungrasp.robots.control_loop.loop_driver import LoopDriver, LoopProcess
from fungrasp.robots.control_loop.loop_worker import DeviceLock
from fungrasp.robots.device import DeviceStatus, RobotError
from fungrasp_emulators.plants import ServoPlant
from fungrasp_emulators.ur import URControllerEmulator


def test_a_process_that_hangs_ends_after_its_drivers_and_frees_the_lock(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    halting, hosts = 0.4, []

    class Watched(LoopProcess):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            hosts.append(self)

    name = f"hanging device of {tmp_path}"
    driver = LoopDriver(HangingLoop(name, tmp_path / "hangs", halting), Watched)
    driver.connect()
    driver.command(np.zeros(1))
    assert wait_for((tmp_path / "hangs").exists)
    with pytest.raises(RobotError, match="moved by another program"):
        DeviceLock(name).take()
    child = hosts[0]._child
    began = time.monotonic()
    # As the policy's process ends, however it does.
    child.stdin.close()
    try:
        assert child.wait(timeout=20.0) == 1
    finally:
        child.kill()
    # Not at once: a hand that does not show that it holds is told so again for ``HALTING``.
    assert time.monotonic() - began > 1.9 * halting
    lock = DeviceLock(name)
    lock.take()
    lock.release()


def test_a_pause_of_the_drivers_process_is_no_silence_of_the_arms_controller() -> None:
    pytest.importorskip("rtde_control")
    from fungrasp.robots.arms.ur import URLoop, URSettings

    home, address = np.array([0.0, -1.5, 1.5, -1.5, -1.5, 0.0]), f"127.1.{os.getpid() % 200 + 1}.2"
    settings = URSettings(address, stale_after=0.2, watchdog=0.5)
    with (
        URControllerEmulator(ServoPlant(home, time_constant=0.02), address),
        LoopDriver(URLoop(settings)) as driver,
    ):
        assert driver.process_id is not None
        for _ in range(3):
            os.kill(driver.process_id, signal.SIGSTOP)
            time.sleep(0.4)
            os.kill(driver.process_id, signal.SIGCONT)
            assert wait_for(lambda: driver.read().status is DeviceStatus.READY)
        driver.command(home)
