"""Where worlds are simulated, and how much room they get there."""

from __future__ import annotations

import ctypes
import sys
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Literal, get_args

from fungrasp.core.errors import FungraspError, UnknownNameError

Device = Literal["cuda", "cpu-warp", "cpu"]
"""A GPU of NVIDIA's by MuJoCo Warp; the same code on the processor, slow, for tests; the processor by
MuJoCo."""


@dataclass(frozen=True)
class BufferSizes:
    """Room for what touches, on a GPU."""

    contacts: int
    """Contacts of a world, on average: all worlds share them."""
    rows: int
    """Rows of constraints of a world, none may have more."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: there is no room.
        """
        if min(self.contacts, self.rows) < 1:
            raise FungraspError(
                f"buffers hold at least one contact and one row, not {self.contacts} and {self.rows}"
            )

    def pool(self, worlds: int) -> int:
        """Contacts of so many worlds together. Of a few, all may have more than the average."""
        return self.contacts * max(worlds, 4)


def found_device(given: str | None = None) -> Device:
    """The device that was asked for, or else a GPU if there is one with all it needs, or else the processor.

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
    """NVIDIA's driver, None if there is none."""
    try:
        return ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return None


@cache
def cuda_devices() -> int:
    """How many GPUs the driver knows; asking it takes no package."""
    driver, count = cuda_driver(), ctypes.c_int(0)
    if driver is None or driver.cuInit(0) or driver.cuDeviceGetCount(ctypes.byref(count)):
        return 0
    return count.value
