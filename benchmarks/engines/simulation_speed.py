"""How fast the environment steps, beside bare physics and beside a Python loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from benchmarks.engines.bare_stepping import recorded_steps, step_bare, step_in_loop
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner
from fungrasp.policies import OpenLoopPolicy
from fungrasp.simulation import MujocoCpuEngine, build_scene
from fungrasp.task import Action, LiftEnvironment, Observation, play

LOOPED = 6
"""Worlds stepped by the Python loop."""


@dataclass(frozen=True)
class SimulationSpeed:
    """Physics steps per second of wall time, all worlds together; the same motion in all three."""

    worlds: int
    """Number of worlds."""
    steps: int
    """Physics steps of all worlds in one round."""
    environment: float
    """Steps per second of ``LiftTask.step``: speed limits, setpoints, contacts, when an episode has ended."""
    bare: float
    """Steps per second of the same model in ``mujoco.batch``, fed with the same controls."""
    loop: float
    """Steps per second of ``mj_step`` in a Python loop, one world after the other."""
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
    """Play planned motions of W grasps in three ways.

    Args:
        grasps: of ``hand``, one per world.
        objects: by name.
        hand: the robot hand.
        threads: 0 means all processors.
        repeat: rounds, of which the fastest counts.
        progress: called with the share that is done.
    """
    engine = MujocoCpuEngine(build_scene(hand, objects), len(grasps), threads)
    environment = LiftEnvironment(engine.scene, len(grasps), engine=engine)
    task = environment.task
    plan = MotionPlanner(hand, objects).plan(grasps, environment.settle(grasps))
    start = engine.get_state()
    actions: list[Action] = []
    with recorded_steps(engine) as calls:
        policy = _Recording(actions)
        play(environment, policy, plan)
    every = np.arange(len(grasps))
    steps = sum(len(every if worlds is None else worlds) * number for _, number, worlds in calls)
    progress(0.2)

    seconds = {"environment": np.inf, "bare": np.inf}
    ends = []
    for round_number in range(repeat):
        environment.settle(grasps)
        begin = perf_counter()
        for action in actions:
            task.step(action)
        seconds["environment"] = min(seconds["environment"], perf_counter() - begin)
        ends.append(engine.positions)
        engine.restore(start)
        seconds["bare"] = min(seconds["bare"], step_bare(engine, calls))
        ends.append(engine.positions)
        progress(0.2 + 0.6 * (round_number + 1) / repeat)
    engine.restore(start)
    some = np.unique(np.linspace(0, len(grasps) - 1, LOOPED).astype(int))
    looped, loop_steps, loop_seconds = step_in_loop(engine, calls, some)
    same = all(np.array_equal(end, ends[0]) for end in ends) and np.array_equal(looped, ends[0][some])
    return SimulationSpeed(
        worlds=len(grasps),
        steps=steps,
        environment=steps / seconds["environment"],
        bare=steps / seconds["bare"],
        loop=loop_steps / loop_seconds,
        identical=same,
    )


class _Recording(OpenLoopPolicy):
    """Plays plans, and keeps its actions."""

    def __init__(self, actions: list[Action]):
        self._actions = actions

    def act(self, observation: Observation) -> Action:
        self._actions.append(super().act(observation))
        return self._actions[-1]
