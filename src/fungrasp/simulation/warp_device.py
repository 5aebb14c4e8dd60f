"""What is needed to simulate on a GPU: packages that fit together, a driver, memory, a
cache of compiled kernels."""

from __future__ import annotations

import ctypes
import json
import logging
import os
from datetime import date
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, cache_folder, cache_path
from fungrasp.simulation.devices import Device, cuda_devices, cuda_driver

_log = logging.getLogger(__name__)

INSTALL = 'pip install "fungrasp[gpu]"'
KERNELS = "kernels"
"""Kind of the compiled kernels in the package's cache."""
VERSIONS = "versions.json"
"""File beside kernels that says what compiled them."""
SPARE_MEMORY = 0.9
"""Share of a GPU's free memory that worlds may take; the rest is for what learns."""


class Warp(NamedTuple):
    """The libraries, ready."""

    warp: ModuleType
    """``warp``."""
    mujoco: ModuleType
    """``mujoco_warp``."""
    torch: ModuleType
    """``torch``."""
    device: str
    """Warp's and torch's name of the device."""


@cache
def open_warp(device: Device) -> Warp:
    """Import and check what a device needs.

    Raises:
        FungraspError: a package is missing or of another version, there is no GPU, or its driver does not do;
            one line that says what to do.
    """
    check_warp_packages(device)
    # Before Warp is imported, which would say so in more words.
    if device == "cuda" and cuda_devices() == 0:
        raise FungraspError(f"--device cuda: {why_no_cuda()}; --device cpu works without a GPU")
    import mujoco_warp  # pyright: ignore[reportMissingImports]
    import torch
    import warp  # pyright: ignore[reportMissingImports]

    warp.config.log_level = warp.LOG_WARNING
    if device == "cpu-warp":
        _prepare_cache(warp)
        return Warp(warp, mujoco_warp, torch, "cpu")
    if not warp.is_cuda_available():
        raise FungraspError(f"--device cuda: {why_no_cuda()}; --device cpu works without a GPU")
    if not torch.cuda.is_available():
        raise FungraspError(
            f"--device cuda: torch {torch.__version__} is built without CUDA: install the one from "
            "https://pytorch.org/get-started for your CUDA"
        )
    _prepare_cache(warp)
    # Of processes that torchrun starts, each has a GPU of its own.
    return Warp(warp, mujoco_warp, torch, f"cuda:{os.environ.get('LOCAL_RANK', 0)}")


def check_memory(needed: int, worlds: int, warp: Warp) -> None:
    """Complain before worlds are made that will not fit.

    Args:
        needed: by all worlds together [bytes].
        worlds: how many.
        warp: with the device.

    Raises:
        FungraspError: they need more than the GPU has left.
    """
    device = warp.warp.get_device(warp.device)
    if not device.is_cuda:
        return
    free = SPARE_MEMORY * device.free_memory
    if needed > free:
        fitting = int(worlds * free / needed)
        raise FungraspError(
            f"{worlds} worlds need {needed / 1e9:.1f} GB and {device.name} has {free / 1e9:.1f} GB left: "
            f"simulate at most {fitting} at once"
        )


def check_warp_packages(device: Device) -> None:
    """Complain about packages that are missing or do not fit together.

    Raises:
        FungraspError: some are.
    """
    for name in ("warp", "mujoco_warp", "torch"):
        if find_spec(name) is None:
            raise FungraspError(f"--device {device} needs {name}, which is not installed: {INSTALL}")
    wanted = {"mujoco-warp": "4.0.", "mujoco": "4.", "warp-lang": "1.19."}
    found = {}
    for name, start in wanted.items():
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
        if not found[name].startswith(start):
            raise FungraspError(
                f"--device {device} needs {name} {start}x, not {found[name]}: {INSTALL} --force-reinstall"
            )
    # Both fill the folder mujoco/, and whichever was installed last wins.
    core = version("mujoco-core")
    if core != found["mujoco"]:
        raise FungraspError(
            f"--device {device} needs mujoco and mujoco-core of one version, not {found['mujoco']}, {core}: "
            f"pip install mujoco=={core} mujoco-core=={core}"
        )


def _prepare_cache(warp: ModuleType) -> None:
    """Keep kernels in the package's cache unless Warp is told of another place, and say if they must be
    compiled."""
    told = os.environ.get("WARP_CACHE_PATH") or warp.config.kernel_cache_dir
    made_by = {"warp-lang": version("warp-lang"), "mujoco-warp": version("mujoco-warp")}
    label = "-".join(made_by.values())
    try:
        folder = Path(told) if told else cache_folder(f"{KERNELS}/{label}")
    except FungraspError as error:
        _log.warning("%s: kernels are compiled anew in every process", error)
        return
    if not told:
        warp.config.kernel_cache_dir = str(folder)
        others = sorted(p.name for p in cache_path(KERNELS).iterdir() if p.is_dir() and p.name != label)
        if others:
            _log.info("kernels of other versions may be deleted: %s in %s", ", ".join(others), folder.parent)
    before = _stamp(folder / VERSIONS)
    if before is not None and {name: before.get(name) for name in made_by} == made_by:
        return
    if before is not None:
        _log.warning(
            "the kernels in %s were compiled on %s by warp %s for mujoco-warp %s: they are compiled anew for "
            "%s and %s, which takes minutes once",
            folder,
            before.get("date"),
            before.get("warp-lang"),
            before.get("mujoco-warp"),
            *made_by.values(),
        )
    else:
        _log.warning("the first run compiles kernels into %s, which takes minutes once", folder)
    try:
        with atomic_path(folder / VERSIONS) as temporary:
            temporary.write_text(json.dumps(made_by | {"date": date.today().isoformat()}) + "\n")
    except FungraspError as error:
        _log.warning("%s", error)


def _stamp(path: Path) -> dict[str, str] | None:
    try:
        read = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return read if isinstance(read, dict) else None


def why_no_cuda() -> str:
    """Why Warp finds no GPU, and what to do."""
    driver, number = cuda_driver(), ctypes.c_int(0)
    if driver is None:
        return "there is no NVIDIA driver"
    driver.cuDriverGetVersion(ctypes.byref(number))
    if number.value < 12000:
        known = f"{number.value // 1000}.{number.value % 1000 // 10}"
        return f"the NVIDIA driver knows CUDA {known}, and Warp needs 12: install a newer driver"
    if driver.cuInit(0):
        return "the NVIDIA driver does not start (nvidia-smi says why)"
    return "the NVIDIA driver finds no GPU (CUDA_VISIBLE_DEVICES hides them if it is set)"
