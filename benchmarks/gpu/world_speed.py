"""How fast worlds run on a device, and what they take of its memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from fungrasp.geometry.poses import Array
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.selection.rollouts import RolloutSettings, roll_out
from fungrasp.policies import OpenLoopPolicy
from fungrasp.sim2real import draw
from fungrasp.simulation import BufferSizes, Device, Engine, SceneSettings, build_scene
from fungrasp.simulation.mujoco_warp import MujocoWarpWorlds
from fungrasp.task import Belief
from fungrasp.training.environment import EnvironmentSettings, TrainingEnvironment
from fungrasp.training.plan_library import PlanLibrary
from fungrasp.training.ppo import Trainer
from fungrasp.training.settings import PpoSettings


@dataclass(frozen=True)
class WorldSpeed:
    """Speed of W worlds together, in steps of all of them per second of wall time."""

    device: str
    """Where."""
    worlds: int
    """W."""
    physics_steps: float
    """Physics steps per second of the engine alone."""
    environment_steps: float
    """Control steps per second of training without learning: actions, setpoints, observation, reward, new
    episodes."""
    training_steps: float
    """Control steps per second of training, learning included."""
    physics_share: float
    """Share of training's time that is physics."""
    task_share: float
    """Share of all else but learning."""
    learning_share: float
    """Share of collecting actions and learning."""
    rollouts: float
    """Rollouts of planning per second."""
    bytes_per_world: int | None
    """Memory that a world takes; None on the processor."""
    problems: tuple[str, ...]
    """What did not fit, in words."""


def world_speed(
    library: PlanLibrary,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    device: Device,
    worlds: int,
    buffers: BufferSizes | None = None,
    steps: int = 24,
    threads: int = 0,
) -> WorldSpeed:
    """Measure one number of worlds on one device, each part after a first round that does not count.

    Args:
        library: plans of ``hand``; they are spread over the worlds.
        objects: by name.
        hand: the robot hand.
        device: where.
        worlds: W.
        buffers: room for contacts; found by a probe if None.
        steps: control steps between two updates, and of the other measurements.
        threads: of the processor; 0 means all.
    """
    settings = EnvironmentSettings(worlds=worlds)
    environment = TrainingEnvironment(library, objects, hand, settings, 0, threads, device, buffers)
    engine = environment.episodes.engine
    physics = _physics(engine, environment.episodes.task.controls, steps)
    still = 0.0 * environment.tracker.action
    environment.step(still)
    alone = _rate(lambda: environment.step(still), steps, worlds, engine)
    with (
        timed(engine, "step", _wait(engine)) as inside,
        timed(environment, "step", _wait(engine)) as stepping,
    ):
        trainer = Trainer(environment, PpoSettings(steps=steps, warm_up=0))
        trainer.learn(1)
        inside[0] = stepping[0] = 0.0
        start = perf_counter()
        trainer.learn(trainer.steps + steps * worlds)
        whole = perf_counter() - start
    return WorldSpeed(
        device=device,
        worlds=worlds,
        physics_steps=physics,
        environment_steps=alone,
        training_steps=steps * worlds / whole,
        physics_share=inside[0] / whole,
        task_share=(stepping[0] - inside[0]) / whole,
        learning_share=1.0 - stepping[0] / whole,
        rollouts=_rollouts(library, objects, hand, device, worlds, buffers, threads),
        bytes_per_world=_memory(engine),
        problems=tuple(engine.problems()),
    )


@contextmanager
def timed(thing: Any, name: str, wait: Callable[[], None] = lambda: None) -> Iterator[list[float]]:
    """A list of one number, the seconds spent in a method inside the block. wait: for a device to finish."""
    seconds, method = [0.0], getattr(thing, name)

    def run(*arguments: Any, **named: Any) -> Any:
        start = perf_counter()
        result = method(*arguments, **named)
        wait()
        seconds[0] += perf_counter() - start
        return result

    setattr(thing, name, run)
    try:
        yield seconds
    finally:
        setattr(thing, name, method)


def _wait(engine: Engine) -> Callable[[], None]:
    """Waits for the device to finish."""
    return engine.wait if isinstance(engine, MujocoWarpWorlds) else lambda: None


def _rate(work: Callable[[], object], times: int, worlds: int, engine: Engine) -> float:
    _wait(engine)()
    start = perf_counter()
    for _ in range(times):
        work()
    _wait(engine)()
    return times * worlds / (perf_counter() - start)


def _physics(engine: Engine, controls: Array, times: int) -> float:
    """Physics steps per second, ten to a call."""
    state = engine.get_state()
    engine.step(controls, 10)
    found = 10 * _rate(lambda: engine.step(controls, 10), times, len(engine), engine)
    engine.restore(state)
    return found


def _rollouts(
    library: PlanLibrary,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    device: Device,
    count: int,
    buffers: BufferSizes | None,
    threads: int,
) -> float:
    """Rollouts per second of as many at once as there are worlds."""
    settings = RolloutSettings(device=device, buffers=buffers, chunk=count)
    plans = library.plans.select(np.arange(count) % len(library.plans))
    present = {name: objects[name] for name in sorted(set(plans.object_name.tolist()))}
    physics = SceneSettings(timestep=settings.timestep, device=device, buffers=buffers)
    scene = build_scene(hand, present, physics)
    rng = np.random.default_rng(0)
    sample = draw(settings.randomization, count, len(hand.joint_names), rng)
    belief = Belief.nominal(
        plans.object_pose, plans.object_mass, plans.palm_setpoint[:, 0], plans.finger_targets[:, 0]
    )
    start = perf_counter()
    roll_out(plans, belief, sample, scene, OpenLoopPolicy(), settings, threads)
    return count / (perf_counter() - start)


def _memory(engine: Engine) -> int | None:
    return engine.bytes_per_world if isinstance(engine, MujocoWarpWorlds) else None
