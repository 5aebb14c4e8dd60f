"""How fast the environment steps, beside bare physics and beside a Python loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter

import mujoco
import numpy as np

from fungrasp.evaluation.robustness import Disturbance
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.policies import ReferenceController
from fungrasp.simulation import Worlds, build_scene
from fungrasp.task import Action, LiftTask

LOOPED = 6
"""Worlds stepped by the Python loop."""


@dataclass(frozen=True)
class SimulationSpeed:
    """Physics steps per second of wall time, all worlds together; the same motion in all three."""

    worlds: int
    steps: int
    """Physics steps of all worlds in one round."""
    environment: float
    """``LiftTask.step``: speed limits, set points, contacts, when a trial has ended."""
    bare: float
    """The same model in ``mujoco.batch``, fed with the same controls."""
    loop: float
    """``mj_step`` in a Python loop, one world after the other."""
    identical: bool
    """Whether bare physics and loop ended where the environment did, to the last bit."""

    @property
    def share(self) -> float:
        """Speed of the environment over bare physics."""
        return self.environment / self.bare


def simulation_speed(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    threads: int = 0,
    repeat: int = 3,
    progress: Callable[[float], None] = lambda share: None,
) -> SimulationSpeed:
    """Play the reference controller's actions on W grasps in three ways.

    Args:
        grasps: of ``hand``, one per world.
        objects: by name.
        hand: the robot hand.
        threads: 0 means all processors.
        repeat: rounds, of which the fastest counts.
        progress: called with the share that is done.
    """
    scene = build_scene(hand, objects)
    worlds = _RecordedWorlds(Disturbance().worlds(scene, grasps, threads))
    task = LiftTask(scene, grasps, worlds.worlds)
    task.reset()
    start = _state(worlds.worlds)
    actions = _record(worlds, task, objects)
    steps = sum(len(which) * substeps for _, substeps, which in worlds.calls)
    progress(0.2)

    seconds = {"environment": np.inf, "bare": np.inf}
    ends = []
    for round_number in range(repeat):
        task.reset()
        begin = perf_counter()
        for action in actions:
            task.step(action)
        seconds["environment"] = min(seconds["environment"], perf_counter() - begin)
        ends.append(worlds.worlds.qpos.copy())
        _restore(worlds.worlds, start)
        begin = perf_counter()
        for ctrl, substeps, which in worlds.calls:
            worlds.worlds.ctrl[:] = ctrl
            worlds.worlds.batch.step(which, nstep=substeps)
        seconds["bare"] = min(seconds["bare"], perf_counter() - begin)
        ends.append(worlds.worlds.qpos.copy())
        progress(0.2 + 0.6 * (round_number + 1) / repeat)
    _restore(worlds.worlds, start)
    some = np.unique(np.linspace(0, len(grasps) - 1, LOOPED).astype(int))
    looped, loop_steps, loop_seconds = _loop(worlds, some)
    same = all(np.array_equal(end, ends[0]) for end in ends) and np.array_equal(looped, ends[0][some])
    return SimulationSpeed(
        worlds=len(grasps),
        steps=steps,
        environment=steps / seconds["environment"],
        bare=steps / seconds["bare"],
        loop=loop_steps / loop_seconds,
        identical=same,
    )


class _RecordedWorlds:
    """Worlds, and the controls they were stepped with."""

    def __init__(self, worlds: Worlds):
        self.worlds = worlds
        self.calls: list[tuple[np.ndarray, int, np.ndarray]] = []
        """Controls, number of substeps and ids of the worlds of each call."""


def _record(worlds: _RecordedWorlds, task: LiftTask, objects: Mapping[str, ObjectModel]) -> list[Action]:
    """Run the trials once; the actions."""
    policy, actions = ReferenceController(task, objects), []
    step = worlds.worlds.step

    def recorded(substeps: int, which: np.ndarray | None = None) -> None:
        ids = np.arange(len(worlds.worlds)) if which is None else which
        worlds.calls.append((worlds.worlds.ctrl.copy(), substeps, ids))
        step(substeps, which)

    worlds.worlds.step = recorded
    while not task.done.all():
        actions.append(policy.act())
        task.step(actions[-1])
    worlds.worlds.step = step
    return actions


def _state(worlds: Worlds) -> list[tuple[np.ndarray, np.ndarray]]:
    """State arrays and their current values."""
    warmstart = worlds.batch.bind("qacc_warmstart")
    arrays = [worlds.qpos, worlds.qvel, worlds.ctrl, worlds.mocap_pos, worlds.mocap_quat, warmstart]
    return [(array, array.copy()) for array in arrays]


def _restore(worlds: Worlds, state: list[tuple[np.ndarray, np.ndarray]]) -> None:
    for array, value in state:
        array[:] = value
    worlds.forward()


def _loop(worlds: _RecordedWorlds, chosen: np.ndarray) -> tuple[np.ndarray, int, float]:
    """Step some worlds from their current state; positions at the end [C, nq], steps made, seconds."""
    ends, steps, seconds = [], 0, 0.0
    for world in chosen.tolist():
        model, data = worlds.worlds.batch.get_model(world), worlds.worlds.batch.get_data(world)
        controls = [(ctrl[world], n) for ctrl, n, which in worlds.calls if world in which]
        begin = perf_counter()
        for ctrl, substeps in controls:
            data.ctrl[:] = ctrl
            for _ in range(substeps):
                mujoco.mj_step(model, data)
            steps += substeps
        seconds += perf_counter() - begin
        ends.append(data.qpos.copy())
    return np.array(ends), steps, seconds
