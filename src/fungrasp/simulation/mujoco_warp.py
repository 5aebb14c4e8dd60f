"""The GPU engine: worlds of one scene in MuJoCo Warp, on a GPU or on Warp's CPU device, as torch tensors that
share memory with the physics or as copies in NumPy arrays.

Physics uses single precision and does not support ``SceneSettings.noslip_iterations``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.arrays import moved_to
from fungrasp.geometry.poses import Array, rotation_matrix
from fungrasp.simulation.devices import BufferSizes, Device
from fungrasp.simulation.mujoco_cpu import worlds_named
from fungrasp.simulation.mujoco_engine import MujocoArrays, controls_of
from fungrasp.simulation.scene import Scene
from fungrasp.simulation.warp_device import (
    PER_WORLD,
    UNNEEDED,
    check_memory,
    host_model,
    memory_of_world,
    open_warp,
    probe_buffer_sizes,
    unused_slots,
)
from fungrasp.simulation.world_parameters import FieldChange

MATCHES = 128
"""Maximum number of contacts per contact sensor; the handles of scissors exceed Warp's default of 64."""

FASTEST = 1e10
"""Velocity at which a world counts as diverged [m/s, rad/s]: MuJoCo's own bound."""


class MujocoWarpWorlds(MujocoArrays):
    """W worlds as torch tensors on the device. Only ``problems`` waits for the device or copies from it."""

    def __init__(
        self,
        scene: Scene,
        count: int,
        device: Device = "cuda",
        sizes: BufferSizes | None = None,
    ):
        """
        Args:
            scene: the scene. All worlds start with its first object.
            count: number of worlds W.
            device: the GPU or Warp's CPU device.
            sizes: buffer sizes; determined by a probe if None.

        Raises:
            FungraspError: a requirement of the device is missing, or there is too little memory.
        """
        self._lib = open_warp(device)
        warp, mjw, torch = self._lib.warp, self._lib.mujoco, self._lib.torch
        if scene.settings.noslip_iterations:
            raise FungraspError("noslip iterations need the device cpu: the GPU engine does not support them")
        self.sizes = sizes or probe_buffer_sizes(scene)
        self._device = torch.device(self._lib.device)
        host = host_model(scene.model)
        with warp.ScopedDevice(self._lib.device):
            self.bytes_per_world = memory_of_world(scene, self.sizes, self._lib)
            """Device memory of one additional world."""
            check_memory(count * self.bytes_per_world, count, self._lib)
            # Warp shares a field with one row among all worlds, so that one world needs two rows.
            self.warp_model = mjw.put_model(host, dict.fromkeys(PER_WORLD, max(count, 2)))
            self.warp_data = mjw.make_data(
                host,
                count,
                njmax=self.sizes.rows,
                naconmax=self.sizes.pool(count),
                nconmax=self.sizes.contacts,
            )
            self.warp_model.opt.contact_sensor_maxmatch = MATCHES
            self.warp_model.opt.warn_overflow = 0
        self._fields: dict[str, Array] = {}
        self._graphs: dict[int, Any] = {}
        self._unused = unused_slots(scene)
        unknown = sorted(set(scene.fields) - set(PER_WORLD) - set(UNNEEDED))
        if unknown:
            raise FungraspError(
                f"objects differ in what the GPU engine can't tell apart: {', '.join(unknown)}"
            )
        self._geom_xpos, self._geom_xmat = self._array("geom_xpos"), self._array("geom_xmat")
        self._time, self._overflow = self._array("time"), self._array("overflow")
        self._rows, self._found = self._array("nefc"), self._array("nacon")
        flags = torch.zeros(count, dtype=torch.bool, device=self._device)
        self._broken, self._frozen, self._no_number = flags, flags.clone(), flags.clone()
        self._most_rows, self._most_contacts = self._rows.clone(), self._found.clone()
        self._table = scene.model.geom("table").id
        self._default = {
            "qpos": torch.as_tensor(scene.model.qpos0, dtype=torch.float32, device=self._device),
            "mocap_pos": self._array("mocap_pos")[0].clone(),
            "mocap_quat": self._array("mocap_quat")[0].clone(),
        }
        self._set_up(scene, count)
        self._forward()

    @property
    def diverged(self) -> Array:
        """Worlds that became unstable since their last reset, shape [W] bool. They are reset to the scene's
        default and continue."""
        return self._broken.clone()

    def problems(self) -> list[str]:
        """See ``Engine.problems``."""
        flags = self._lib.mujoco.OverflowType
        bits, rows = self._overflow.cpu().numpy(), int(self._most_rows.max())
        pool, contacts = self.sizes.pool(len(self)), int(self._most_contacts.max())
        lines = []
        if (bits & (flags.NEFC | flags.NJMAX_NNZ)).any():
            where = worlds_named((bits & (flags.NEFC | flags.NJMAX_NNZ)) != 0)
            lines.append(
                f"rows of constraints did not fit in {where}, up to {rows} of {self.sizes.rows}: give "
                f"--buffers {self.sizes.contacts} {_larger(rows)}"
            )
        if (bits & (flags.BROADPHASE | flags.NARROWPHASE | flags.CCD)).any():
            wanted = _larger(max(contacts, pool) / max(len(self), 4))
            lines.append(
                f"contacts did not fit in the pool of {pool} that {len(self)} worlds share, and any may lack "
                f"some: give buffers of {wanted} {self.sizes.rows}"
            )
        if (bits & flags.CONTACT_MATCH).any():
            where = worlds_named((bits & flags.CONTACT_MATCH) != 0)
            lines.append(
                f"a contact sensor left out contacts beyond {MATCHES} in {where}: forces are too small"
            )
        if (bits & flags.EPA_HORIZON).any():
            where = worlds_named((bits & flags.EPA_HORIZON) != 0)
            lines.append(f"how deep shapes lie in each other was not found to the end in {where}")
        for flag, what in (
            (self._frozen, "physics stood still"),
            (self._no_number, "controls were no numbers"),
        ):
            which = flag.cpu().numpy()
            if which.any():
                lines.append(f"{what} in {worlds_named(which)}")
        for array in (self._overflow, self._frozen, self._no_number, self._most_rows, self._most_contacts):
            array[:] = 0
        return lines

    def reset(self, worlds: np.ndarray | None = None) -> None:
        """See ``Engine.reset``."""
        ids = slice(None) if worlds is None else self._native(worlds)
        self._to_default(ids)
        self._force[ids] = 0.0
        self._mocap_pos[ids], self._mocap_quat[ids] = self._default["mocap_pos"], self._default["mocap_quat"]
        self._frame[ids, :3], self._frame[ids, 3:] = self._mocap_pos[ids, 0], self._mocap_quat[ids, 0]
        self._broken[ids] = False
        self._forward()

    def step(self, controls: Array, steps: int, worlds: np.ndarray | Array | None = None) -> None:
        """See ``Engine.step``. worlds: ids, or a mask of worlds to advance on the device, shape [W] bool."""
        torch = self._lib.torch
        self._ctrl[:, self._servos] = moved_to(self._ctrl, controls)
        no_number = ~torch.isfinite(self._ctrl).all(dim=1)
        moving = None if worlds is None else self._moving(worlds)
        if moving is not None:
            no_number = no_number & moving
        # Forces are clipped to the servo limits, so that a NaN control would not show in the state.
        self._ctrl[:] = torch.nan_to_num(self._ctrl, nan=0.0, posinf=0.0, neginf=0.0)
        kept = None if moving is None else [array.clone() for array in self._moved]
        before = self._time.clone()
        self._advance(steps)
        stood = self._time - before < 0.5 * steps * self.scene.settings.timestep
        broken = ~torch.isfinite(self._qpos).all(dim=1) | ~(self._qvel.abs() < FASTEST).all(dim=1)
        if kept is not None:
            assert moving is not None
            stood, broken = stood & moving, broken & moving
            for array, value in zip(self._moved, kept, strict=True):
                stays = ~moving.reshape(-1, *(1,) * (array.ndim - 1))
                torch.where(stays, value, array, out=array)
        self._frozen |= stood
        self._no_number |= no_number
        broken = broken | no_number
        self._broken |= broken
        self._put_back(broken)
        torch.maximum(self._most_rows, self._rows, out=self._most_rows)
        torch.maximum(self._most_contacts, self._found, out=self._most_contacts)
        self._forward()

    def wait(self) -> None:
        """Wait until the device has finished, for time measurements."""
        self._lib.warp.synchronize_device(self._lib.device)
        if self._device.type == "cuda":
            self._lib.torch.cuda.synchronize(self._device)

    @property
    def _moved(self) -> list[Array]:
        return [self._qpos, self._qvel, self._warmstart, self._sensors, self._time]

    def _moving(self, worlds: np.ndarray | Array) -> Array:
        """Return the mask of worlds to advance, shape [W] bool."""
        torch = self._lib.torch
        if isinstance(worlds, torch.Tensor):
            return worlds
        moving = torch.zeros(len(self), dtype=torch.bool, device=self._device)
        moving[self._native(worlds)] = True
        return moving

    def _advance(self, steps: int) -> None:
        """Advance physics; on a GPU launch a graph that is captured once for each number of steps."""
        warp, step = self._lib.warp, self._lib.mujoco.step
        with warp.ScopedDevice(self._lib.device):
            if self._device.type == "cpu":
                for _ in range(steps):
                    step(self.warp_model, self.warp_data)
                return
            if steps not in self._graphs:
                # A step outside the capture compiles and loads kernels; its effect is then undone.
                kept = [array.clone() for array in (*self._state_arrays(), self._sensors, self._time)]
                step(self.warp_model, self.warp_data)
                for array, value in zip(
                    (*self._state_arrays(), self._sensors, self._time), kept, strict=True
                ):
                    array[:] = value
                with warp.ScopedCapture() as capture:
                    for _ in range(steps):
                        step(self.warp_model, self.warp_data)
                self._graphs[steps] = capture.graph
            warp.capture_launch(self._graphs[steps])

    def _to_default(self, ids: Any) -> None:
        self._qpos[ids] = self._default["qpos"]
        for array in (self._qvel, self._warmstart, self._sensors, self._time, self._ctrl):
            array[ids] = 0.0

    def _put_back(self, broken: Array) -> None:
        """Reset diverged worlds to the scene's default, without waiting for the device. broken: shape [W]
        bool."""
        torch = self._lib.torch
        torch.where(broken[:, None], self._default["qpos"], self._qpos, out=self._qpos)
        for name in ("qvel", "qacc_warmstart", "sensordata", "qacc", "qfrc_constraint"):
            self._array(name).masked_fill_(broken[:, None], 0.0)

    def _array(self, name: str) -> Array:
        return self._lib.warp.to_torch(getattr(self.warp_data, name))

    def _native(self, indices: np.ndarray | Array) -> Array:
        return self._lib.torch.as_tensor(indices, device=self._device)

    def _write(self, change: FieldChange) -> None:
        name, index, values = change
        if name in UNNEEDED:
            return
        if name == "geom_dataid" and self._unused is not None:
            values = np.where(self._unused[self.object_index[index[0]]], -1, values)
        field = self._field(name)
        here = tuple(self._native(part) if isinstance(part, np.ndarray) else part for part in index)
        field[here] = self._lib.torch.as_tensor(np.asarray(values), dtype=field.dtype).to(self._device)
        if name in ("geom_pos", "geom_quat"):
            self._pose_table(here[0])

    def _field(self, name: str) -> Array:
        """Return a field of the model, one row for each world, each in the shape of MuJoCo on the CPU."""
        if name not in self._fields:
            whole = self._lib.warp.to_torch(getattr(self.warp_model, name))
            shape = getattr(self.model, name).shape
            self._fields[name] = whole.view(len(whole), *shape)[: len(self)]
        return self._fields[name]

    def _pose_table(self, ids: Array) -> None:
        """Update the table's pose: Warp computes poses of world geoms only when it creates the data."""
        self._geom_xpos[ids, self._table] = self._field("geom_pos")[ids, self._table]
        self._geom_xmat[ids, self._table] = rotation_matrix(self._field("geom_quat")[ids, self._table])

    def _forward(self, worlds: np.ndarray | None = None) -> None:
        with self._lib.warp.ScopedDevice(self._lib.device):
            self._lib.mujoco.kinematics(self.warp_model, self.warp_data)
            self._lib.mujoco.com_pos(self.warp_model, self.warp_data)


def _larger(number: float) -> int:
    """Return 1.5 times a number, rounded up to a multiple of 32."""
    return int(np.ceil(1.5 * number / 32)) * 32


class MujocoWarpEngine:
    """W worlds; see ``fungrasp.simulation.engine.Engine``. Arrays are copied from the device in double
    precision, and arguments to the device."""

    def __init__(
        self,
        scene: Scene,
        count: int,
        device: Device = "cuda",
        sizes: BufferSizes | None = None,
    ):
        """Arguments and errors: see ``MujocoWarpWorlds``."""
        self.worlds = MujocoWarpWorlds(scene, count, device, sizes)
        self.scene, self.object_index = scene, self.worlds.object_index

    def __len__(self) -> int:
        return len(self.worlds)

    def __getattr__(self, name: str) -> Any:
        """Return the attribute of ``worlds``; arrays on the device are copied."""
        if name == "worlds":
            raise AttributeError(name)
        found = getattr(self.worlds, name)
        return _host(found) if hasattr(found, "device") else found

    def controls(
        self, palm_pose: np.ndarray, palm_velocity: np.ndarray, finger_targets: np.ndarray
    ) -> np.ndarray:
        """See ``Engine.controls``. Computed on the CPU in double precision."""
        return controls_of(self.wrist_frame, self.worlds.lead, palm_pose, palm_velocity, finger_targets)

    def step(self, controls: np.ndarray, steps: int, worlds: np.ndarray | None = None) -> None:
        """See ``Engine.step``."""
        everyone = worlds is not None and len(worlds) == len(self)
        self.worlds.step(controls, steps, None if everyone else worlds)


def _host(array: Array) -> np.ndarray:
    """Copy to host memory, with floating-point numbers in double precision."""
    values = array.cpu().numpy()
    return values.astype(np.float64 if values.dtype == np.float32 else values.dtype)
