"""Requirements of simulation on a GPU: compatible packages, a driver, a cache of compiled kernels, memory and
buffers.

MuJoCo on the CPU allocates memory as needed. On a GPU the buffers for contacts and constraint rows have a
fixed size, and contacts beyond it are lost. A probe that closes the hand at random poses around each object
of the scene determines the sizes, with a reserve.
"""

from __future__ import annotations

import copy
import ctypes
import json
import logging
import os
from dataclasses import fields
from datetime import date
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, cache_folder, cache_path
from fungrasp.simulation.devices import BufferSizes, Device, cuda_devices, cuda_driver
from fungrasp.simulation.mujoco_cpu import MujocoCpuEngine
from fungrasp.simulation.scene import Scene

_log = logging.getLogger(__name__)

INSTALL = 'pip install ".[gpu]"'
KERNELS = "kernels"
"""Folder of compiled kernels in the package's cache."""
VERSIONS = "versions.json"
"""File beside kernels with the versions that compiled them."""
SPARE_MEMORY = 0.9
"""Share of a GPU's free memory that worlds may use; the rest is for training."""
PER_WORLD = (
    "geom_dataid",
    "geom_size",
    "geom_aabb",
    "geom_rbound",
    "geom_pos",
    "geom_quat",
    "geom_friction",
    "body_mass",
    "body_subtreemass",
    "body_inertia",
    "body_ipos",
    "body_iquat",
    "body_invweight0",
    "dof_invweight0",
    "dof_frictionloss",
    "dof_damping",
    "actuator_gainprm",
    "actuator_biasprm",
)
"""Model fields that may differ between worlds."""

UNNEEDED = (
    "dof_M0",
    "dof_length",
    "body_sameframe",
    "geom_sameframe",
    "geom_rgba",
    "geom_contype",
    "geom_conaffinity",
)
"""Fields of MuJoCo on the CPU that the GPU engine ignores: it always computes inertial and geom poses in
full, has no sleep and no rendering, and unused geom slots have no mesh instead of disabled collisions."""
HANDS = 8
"""Random hand poses per object."""
MOST_WORLDS = 256
"""Maximum number of worlds of a probe; with more, a random subset is used."""
STEPS = 40
"""Number of finger motions of two physics steps each; the fingers are closed after the first half."""
NEAR = 0.06
"""Distance of the palm from the object's origin [m]; the fingers reach the object from there."""
SPARE = 2.0
"""Factor on the probe's results. Whole episodes of Allegro had up to 71 contacts and 300 rows; the probe
finds 40 contacts (99th percentile) and up to 304 rows."""


class Warp(NamedTuple):
    """The imported libraries and the device."""

    warp: ModuleType
    """``warp``."""
    mujoco: ModuleType
    """``mujoco_warp``."""
    torch: ModuleType
    """``torch``."""
    device: str
    """Name of the device in Warp and torch."""


@cache
def open_warp(device: Device) -> Warp:
    """Import the packages of a device and check its requirements.

    Raises:
        FungraspError: a package is missing or has a wrong version, there is no GPU, or its driver is too old.
            The message has the remedy.
    """
    check_warp_packages(device)
    # Check before importing Warp, whose error message is longer.
    if device == "cuda" and cuda_devices() == 0:
        raise FungraspError(f"device cuda: {why_no_cuda()}; device cpu works without a GPU")
    import mujoco_warp  # pyright: ignore[reportMissingImports]
    import torch
    import warp  # pyright: ignore[reportMissingImports]

    warp.config.log_level = warp.LOG_WARNING
    if device == "cpu-warp":
        _prepare_cache(warp)
        return Warp(warp, mujoco_warp, torch, "cpu")
    if not warp.is_cuda_available():
        raise FungraspError(f"device cuda: {why_no_cuda()}; device cpu works without a GPU")
    if not torch.cuda.is_available():
        raise FungraspError(
            f"device cuda: torch {torch.__version__} is built without CUDA: install the one from "
            "https://pytorch.org/get-started for your CUDA"
        )
    _prepare_cache(warp)
    # Each process of torchrun has its own GPU.
    return Warp(warp, mujoco_warp, torch, f"cuda:{os.environ.get('LOCAL_RANK', 0)}")


def check_memory(needed: int, worlds: int, warp: Warp) -> None:
    """Check the GPU's free memory before creating worlds.

    Args:
        needed: memory of all worlds [bytes].
        worlds: number of worlds.
        warp: libraries and device.

    Raises:
        FungraspError: the worlds need more memory than is free.
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
    """Check that required packages are installed and compatible.

    Raises:
        FungraspError: a package is missing or incompatible.
    """
    for name in ("warp", "mujoco_warp", "torch"):
        if find_spec(name) is None:
            raise FungraspError(f"device {device} needs {name}, which is not installed: {INSTALL}")
    wanted = {"mujoco-warp": "4.0.", "mujoco": "4.", "warp-lang": "1.19."}
    found = {}
    for name, start in wanted.items():
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
        if not found[name].startswith(start):
            raise FungraspError(
                f"device {device} needs {name} {start}x, not {found[name]}: {INSTALL} --force-reinstall"
            )
    # Both install to the folder mujoco/, and the last one overwrites the other.
    core = version("mujoco-core")
    if core != found["mujoco"]:
        raise FungraspError(
            f"device {device} needs mujoco and mujoco-core of one version, not {found['mujoco']}, {core}: "
            f"pip install mujoco=={core} mujoco-core=={core}"
        )


def _prepare_cache(warp: ModuleType) -> None:
    """Put kernels into the package's cache unless Warp has another cache folder, and warn if they must be
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
    """Return why Warp finds no GPU, with a remedy."""
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


def memory_of_world(scene: Scene, sizes: BufferSizes, lib: Warp) -> int:
    """Return the device memory of each additional world [bytes]."""
    warp, mjw, host = lib.warp, lib.mujoco, host_model(scene.model)
    with warp.ScopedDevice("cpu"):
        data = mjw.make_data(host, 1, njmax=sizes.rows, naconmax=sizes.contacts, nconmax=sizes.contacts)
        model = mjw.put_model(host)
    rows = [getattr(model, name) for name in PER_WORLD]
    return _bytes_of(data, warp) + sum(int(row.capacity) for row in rows)


def _bytes_of(record: Any, warp: Any) -> int:
    """Return the memory of all arrays in a record and its nested records."""
    total = 0
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, warp.array):
            total += int(value.capacity)
        elif hasattr(value, "__dataclass_fields__"):
            total += _bytes_of(value, warp)
    return total


def unused_slots(scene: Scene) -> np.ndarray | None:
    """Return the geom slots that each object leaves unused, shape [N, G] bool; None if all objects have the
    same number of pieces."""
    collides = scene.fields.get("geom_contype")
    if collides is None:
        return None
    return (collides == 0) & (scene.model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH))


def host_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy without the midphase flag, which MuJoCo Warp does not accept: it never has a midphase."""
    host = copy.copy(model)
    host.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    return host


_known: WeakKeyDictionary[Scene, BufferSizes] = WeakKeyDictionary()


def probe_buffer_sizes(scene: Scene) -> BufferSizes:
    """Return buffer sizes for the hand and objects of a scene. Takes about a second, once per scene."""
    if scene not in _known:
        _known[scene] = _probe(scene)
    return _known[scene]


def _probe(scene: Scene) -> BufferSizes:
    rng = np.random.default_rng(0)
    held = np.repeat(np.arange(len(scene.objects)), HANDS)
    if len(held) > MOST_WORLDS:
        held = rng.permutation(held)[:MOST_WORLDS]
    count, hand = len(held), scene.hand
    engine = MujocoCpuEngine(scene, count, 1)
    engine.set_parameters(object_index=held)
    engine.reset()
    standing = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1))
    standing[:, 2] = [-scene.models[i].vertices[:, 2].min() for i in held]
    away, turn = rng.normal(size=(count, 3)), rng.normal(size=(count, 4))
    away[:, 2] = np.abs(away[:, 2])
    palm = standing.copy()
    palm[:, :3] += NEAR * away / np.linalg.norm(away, axis=1, keepdims=True)
    palm[:, 3:] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    engine.set_state(
        object_pose=standing, wrist_frame=palm, joint_positions=np.zeros((count, len(hand.joint_names)))
    )
    contacts, rows = engine.batch.bind("ncon"), engine.batch.bind("nefc")
    lowest, highest = scene.servo_limits.T
    still, found = np.zeros((count, 3)), []
    for step in range(STEPS):
        closed = lowest + min(1.0, 2 * (step + 1) / STEPS) * (highest - lowest)
        engine.step(engine.controls(palm, still, np.tile(closed, (count, 1))), 2)
        found.append((contacts.copy(), rows.copy()))
    most_contacts, most_rows = np.array(found).transpose(1, 0, 2).reshape(2, -1)
    return BufferSizes(
        contacts=_rounded(SPARE * float(np.percentile(most_contacts, 99)), 16),
        rows=_rounded(SPARE * float(most_rows.max()), 32),
    )


def _rounded(number: float, step: int) -> int:
    return max(step, int(np.ceil(number / step)) * step)
