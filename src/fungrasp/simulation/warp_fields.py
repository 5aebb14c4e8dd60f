"""Fields of a scene's model on a GPU: which may differ between worlds, and what they take of its memory."""

from __future__ import annotations

import copy
from dataclasses import fields
from typing import Any

import mujoco
import numpy as np

from fungrasp.simulation.devices import BufferSizes
from fungrasp.simulation.scene import Scene
from fungrasp.simulation.warp_device import Warp

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
"""Fields of MuJoCo on the CPU that have no counterpart: inertia and poses of geoms are always computed in
full, nothing sleeps or is drawn, and a geom that collides with nothing has no mesh instead."""


def memory_of_world(scene: Scene, sizes: BufferSizes, lib: Warp) -> int:
    """Bytes that each further world takes on the device."""
    warp, mjw, host = lib.warp, lib.mujoco, host_model(scene.model)
    with warp.ScopedDevice("cpu"):
        data = mjw.make_data(host, 1, njmax=sizes.rows, naconmax=sizes.contacts, nconmax=sizes.contacts)
        model = mjw.put_model(host)
    rows = [getattr(model, name) for name in PER_WORLD]
    return _bytes_of(data, warp) + sum(int(row.capacity) for row in rows)


def _bytes_of(record: Any, warp: Any) -> int:
    """Memory of all arrays in a record and the records in it."""
    total = 0
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, warp.array):
            total += int(value.capacity)
        elif hasattr(value, "__dataclass_fields__"):
            total += _bytes_of(value, warp)
    return total


def unused_slots(scene: Scene) -> np.ndarray | None:
    """Slots for pieces that an object leaves empty, one row for each object, shape [N, G] bool; None where
    all objects have as many pieces."""
    collides = scene.fields.get("geom_contype")
    if collides is None:
        return None
    return (collides == 0) & (scene.model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH))


def host_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy that MuJoCo Warp takes: it knows no other way than without the middle phase, and no flag for
    it."""
    host = copy.copy(model)
    host.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    return host
