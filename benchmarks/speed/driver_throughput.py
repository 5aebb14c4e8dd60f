"""What a driver costs and how fast it answers, against an emulated device."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from benchmarks.processor_time import processor_time
from fungrasp_emulators.devices import EmulatedDevice


@dataclass(frozen=True)
class DriverSpeed:
    """Of one driver, while it follows goals at 10 Hz."""

    device: str
    """Name of the device."""
    connect: float
    """Time to connect [s]."""
    rate: float
    """Steps of the control loop per second."""
    busy_share: float
    """Share of a core that the control loop takes; client libraries' own threads are not in it."""
    process_share: float
    """Share of a core that the driver's process takes, client libraries' threads and waking up included."""
    command: float
    """Median time of a command [s]."""
    read: float
    """Median time of a read [s]."""
    age: float
    """Median age of a state when it is read [s]."""


def driver_speed(device: EmulatedDevice, seconds: float) -> DriverSpeed:
    """Measure a driver.

    Args:
        device: its emulator is closed here.
        seconds: of following goals.
    """
    began = time.monotonic()
    try:
        device.driver.connect()
        connect = time.monotonic() - began
        commands, reads, ages = [], [], []
        process = device.driver.process_id
        first, used, start = device.driver.load(), processor_time(process), time.monotonic()
        while (now := time.monotonic()) - start < seconds:
            device.driver.command(device.home if int(now - start) % 2 else device.away)
            commands.append(time.monotonic() - now)
            for _ in range(10):
                before = time.monotonic()
                state = device.driver.read()
                after = time.monotonic()
                reads.append(after - before)
                ages.append(after - state.received)
                time.sleep(0.01)
        elapsed, last = time.monotonic() - start, device.driver.load()
        return DriverSpeed(
            device.name,
            connect,
            (last.steps - first.steps) / elapsed,
            (last.busy - first.busy) / elapsed,
            (processor_time(process) - used) / elapsed,
            float(np.median(commands)),
            float(np.median(reads)),
            float(np.median(ages)),
        )
    finally:
        device.driver.close()
        device.emulator.close()
