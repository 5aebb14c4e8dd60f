"""Devices for simulation, and their buffer sizes."""

from __future__ import annotations

import ctypes
import sys
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Literal, get_args

from fungrasp.core.errors import FungraspError, UnknownNameError

Device = Literal["cuda", "cpu-warp", "cpu"]
""""cuda": MuJoCo Warp on an NVIDIA GPU. "cpu-warp": the same code on the CPU, slow, for tests. "cpu":
MuJoCo."""


@dataclass(frozen=True)
class BufferSizes:
    """Contact buffers on a GPU."""

    contacts: int
    """Contacts per world on average; all worlds share the buffer."""
    rows: int
    """Largest number of constraint rows of any world."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a size is below 1.
        """
        if min(self.contacts, self.rows) < 1:
            raise FungraspError(
                f"buffers hold at least one contact and one row, not {self.contacts} and {self.rows}"
            )

    def pool(self, worlds: int) -> int:
        """Return the total number of contacts of some worlds, with a reserve if there are few."""
        return self.contacts * max(worlds, 4)


def found_device(given: str | None = None) -> Device:
    """Return the requested device. Default: a GPU if there is one with the required packages, else the CPU.

    Raises:
        FungraspError: an unknown device.
    """
    if given is None:
        ready = find_spec("mujoco_warp") and find_spec("torch") and cuda_devices() > 0
        return "cuda" if ready else "cpu"
    if given not in get_args(Device):
        raise UnknownNameError("device", given, get_args(Device))
    return given  # pyright: ignore[reportReturnType]


def cuda_driver() -> ctypes.CDLL | None:
    """Return the NVIDIA driver, or None."""
    try:
        return ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return None


@cache
def cuda_devices() -> int:
    """Return the number of GPUs according to the driver, without other packages."""
    driver, count = cuda_driver(), ctypes.c_int(0)
    if driver is None or driver.cuInit(0) or driver.cuDeviceGetCount(ctypes.byref(count)):
        return 0
    return count.value
