"""Bare physics beside an engine: what it was asked for, done again by MuJoCo alone, for benchmarks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

import numpy as np

from fungrasp.simulation.mujoco_cpu import MujocoCpuEngine

StepCall = tuple[np.ndarray, int, np.ndarray | None]
"""Controls, number of physics steps and worlds of one call of ``Engine.step``."""


@contextmanager
def recorded_steps(engine: MujocoCpuEngine) -> Iterator[list[StepCall]]:
    """A list to which every call of ``engine.step`` inside the block is added."""
    calls: list[StepCall] = []
    step = engine.step

    def record(controls: np.ndarray, steps: int, worlds: np.ndarray | None = None) -> None:
        calls.append((controls.copy(), steps, None if worlds is None else worlds.copy()))
        step(controls, steps, worlds)

    engine.step = record  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield calls
    finally:
        engine.step = step  # pyright: ignore[reportAttributeAccessIssue]


def step_bare(engine: MujocoCpuEngine, calls: list[StepCall]) -> float:
    """Make the steps by ``mujoco.batch`` alone, sensors and poses left out; the seconds it took."""
    batch, ctrl, actuators = engine.batch, engine.batch.bind("ctrl"), engine.actuators
    start = perf_counter()
    for controls, steps, worlds in calls:
        ctrl[:, actuators] = controls
        batch.step(worlds, nstep=steps)
    return perf_counter() - start
