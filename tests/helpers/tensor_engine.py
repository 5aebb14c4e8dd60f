"""The CPU engine's worlds as torch tensors: what runs on a GPU, tried without one and without Warp."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from fungrasp.simulation import MujocoCpuEngine, Scene
from fungrasp.simulation.mujoco_engine import MujocoArrays

Convert = Callable[[np.ndarray], Any]


def tensor(values: np.ndarray) -> Any:
    """That shares memory with the array."""
    import torch

    with warnings.catch_warnings():
        # What physics computes may not be written to.
        warnings.simplefilter("ignore", UserWarning)
        return torch.from_numpy(np.asarray(values))


def meta(values: np.ndarray) -> Any:
    """Without numbers, and in single precision, as on a GPU: what asks such a tensor for a number fails."""
    import torch

    made = torch.as_tensor(np.array(values))
    return (made.float() if made.is_floating_point() else made).to("meta")


class TensorEngine(MujocoArrays):
    """Worlds of the CPU engine as tensors. They move where tensors share memory with its arrays; elsewhere
    nothing but the clock goes on."""

    def __init__(self, cpu: MujocoCpuEngine, convert: Convert):
        self._cpu, self._convert, self._moves = cpu, convert, convert is tensor
        self._sound = convert(np.zeros(len(cpu), dtype=bool))
        self._set_up(cpu.scene, len(cpu))

    def _array(self, name: str) -> Any:
        return self._convert(self._cpu.batch.bind(name))

    def _native(self, indices: Any) -> Any:
        return self._convert(indices) if isinstance(indices, np.ndarray) else indices

    def _write(self, change: Any) -> None:
        if self._moves:
            self._cpu._write(change)

    def _forward(self, worlds: Any = None) -> None:
        if self._moves:
            self._cpu._forward(None if worlds is None else np.asarray(worlds))

    @property
    def diverged(self) -> Any:
        return self._convert(self._cpu.diverged) if self._moves else self._sound

    def problems(self) -> list[str]:
        return self._cpu.problems()

    def reset(self, worlds: np.ndarray) -> None:
        self._cpu.reset(worlds)
        self._frame[self._native(worlds)] = self._convert(self._cpu.wrist_frame[worlds])

    def step(self, controls: Any, steps: int, worlds: Any) -> None:
        self._ctrl[:, self._servos] = controls
        if self._moves:
            self._cpu.step(controls.numpy(), steps, np.flatnonzero(worlds))


def tensor_worlds(convert: Convert) -> Callable[..., TensorEngine]:
    """In the place of ``fungrasp.simulation.make_engine``."""

    def make(scene: Scene, count: int, threads: int, tensors: bool) -> TensorEngine:
        assert tensors
        return TensorEngine(MujocoCpuEngine(scene, count, threads), convert)

    return make
