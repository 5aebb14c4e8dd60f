"""Bare physics beside an engine: what it was asked for, done again by MuJoCo alone, for benchmarks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

import mujoco
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


def step_in_loop(
    engine: MujocoCpuEngine, calls: list[StepCall], worlds: np.ndarray
) -> tuple[np.ndarray, int, float]:
    """Make the steps of some worlds one after the other with ``mj_step``.

    Returns:
        Generalised positions at the end, shape [C, nq]; steps made; seconds.
    """
    ends, steps, seconds = [], 0, 0.0
    for world in worlds.tolist():
        model, data = engine.batch.get_model(world), engine.batch.get_data(world)
        chosen = [(c[world], n) for c, n, which in calls if which is None or world in which]
        start = perf_counter()
        for controls, number in chosen:
            data.ctrl[engine.actuators] = controls
            for _ in range(number):
                mujoco.mj_step(model, data)
            steps += number
        seconds += perf_counter() - start
        ends.append(data.qpos.copy())
    return np.array(ends), steps, seconds
