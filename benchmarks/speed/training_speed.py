"""How fast training and a trained policy are on this machine."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

from benchmarks.speed.bare_stepping import recorded_steps, step_bare
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner
from fungrasp.policies import StudentPolicy
from fungrasp.policies.checkpoint.card import Budget
from fungrasp.policies.checkpoint.checkpoint_file import load_policy
from fungrasp.policies.checkpoint.network import PolicyNetwork
from fungrasp.simulation import MujocoCpuEngine, build_scene
from fungrasp.task import Action, LiftEnvironment
from fungrasp.task.setpoints import SetpointSequence
from fungrasp.training.distill import make_student
from fungrasp.training.environment import EnvironmentSettings, TrainingEnvironment
from fungrasp.training.export import export_policy, make_card
from fungrasp.training.plan_library import PlanLibrary
from fungrasp.training.ppo import Trainer
from fungrasp.training.settings import PpoSettings


@dataclass(frozen=True)
class EnvironmentSpeed:
    """Steps per second of wall time, all worlds together."""

    worlds: int
    """Number of worlds."""
    physics_steps: int
    """Physics steps of one world in one control step."""
    environment: float
    """Control steps per second: actions, setpoints, physics, observation, reward, new episodes."""
    bare: float
    """Control steps per second of the same physics from the same states, by the engine alone."""
    identical: bool
    """Whether both environments ended in the same state, to the last bit."""

    @property
    def share(self) -> float:
        """Speed of the environment over bare physics."""
        return self.environment / self.bare


@dataclass(frozen=True)
class UpdateSpeed:
    """Speed of PPO."""

    steps: float
    """Control steps per second, learning included."""
    environment: float
    """Share of the time in the environment."""
    learning: float
    """Share of the time in the networks' updates; the rest is acting and keeping."""


@dataclass(frozen=True)
class ActingSpeed:
    """Time of one control step of one robot, medians [ms]; of the processor, so that programs beside it don't
    count."""

    policy: float
    """Time from the sensors to an action: observation, network, plan [ms]."""
    control: float
    """Time from an action to all setpoints of the servos during the control step [ms]."""

    @property
    def total(self) -> float:
        """Time from the sensors to the servos' setpoints [ms]."""
        return self.policy + self.control


def environment_speed(
    library: PlanLibrary,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    settings: EnvironmentSettings,
    steps: int = 40,
    seed: int = 0,
    threads: int = 0,
    progress: Callable[[int], None] = lambda done: None,
) -> EnvironmentSpeed:
    """Random actions in two equal environments: in the one the engine's calls of a step are recorded; in the
    other the engine makes just those, and then the whole step is made from the same state.

    Args:
        library: of plans.
        objects: by name.
        hand: the robot hand.
        settings: of the environment.
        steps: control steps.
        seed: of episodes and actions.
        threads: 0 means all processors.
        progress: called with the control steps that are done.
    """
    recorded, timed = (TrainingEnvironment(library, objects, hand, settings, seed, threads) for _ in range(2))
    rng = np.random.default_rng(seed)
    seconds = {"environment": 0.0, "bare": 0.0}
    physics = 0
    engine, stepped = timed.episodes.engine, recorded.episodes.engine
    assert isinstance(engine, MujocoCpuEngine) and isinstance(stepped, MujocoCpuEngine)
    with recorded_steps(stepped) as calls:
        for step in range(steps):
            action = rng.normal(scale=0.15, size=(settings.worlds, recorded.actions))
            calls.clear()
            recorded.step(action)
            before = engine.get_state()
            seconds["bare"] += step_bare(engine, calls)
            engine.restore(before)
            start = perf_counter()
            timed.step(action)
            seconds["environment"] += perf_counter() - start
            physics = sum(number for _, number, _ in calls)
            progress(step + 1)
    count = steps * settings.worlds
    same = np.array_equal(recorded.episodes.engine.positions, engine.positions)
    speeds = count / seconds["environment"], count / seconds["bare"]
    return EnvironmentSpeed(settings.worlds, physics, *speeds, identical=same)


def update_speed(environment: TrainingEnvironment, settings: PpoSettings, updates: int = 2) -> UpdateSpeed:
    """Collect and learn for a few updates, after a first one that does not count."""
    trainer = Trainer(environment, settings)
    trainer.learn(1)
    seconds = {"environment": 0.0, "learning": 0.0}
    step, update = environment.step, trainer.algorithm.update

    def timed(name: str, work: Callable) -> Callable:
        def run(*arguments: object) -> object:
            start = perf_counter()
            result = work(*arguments)
            seconds[name] += perf_counter() - start
            return result

        return run

    environment.step, trainer.algorithm.update = timed("environment", step), timed("learning", update)
    first, start = trainer.steps, perf_counter()
    trainer.learn(first + updates * settings.steps * environment.settings.worlds)
    whole = perf_counter() - start
    environment.step, trainer.algorithm.update = step, update
    return UpdateSpeed(
        (trainer.steps - first) / whole, seconds["environment"] / whole, seconds["learning"] / whole
    )


def acting_speed(
    network: PolicyNetwork, grasp: RobotGraspSet, objects: Mapping[str, ObjectModel], hand: Hand
) -> ActingSpeed:
    """One episode of one robot: what its computer would do in each control step. Physics does not count, nor
    what only the test does, such as to see whether the object is held.

    Args:
        network: of a policy of the hand.
        grasp: a set of one.
        objects: by name.
        hand: the robot hand.
    """
    scene = build_scene(hand, {name: objects[name] for name in grasp.object_name.tolist()})
    environment = LiftEnvironment(scene, 1, threads=1)
    plan = MotionPlanner(hand, objects).plan(grasp, environment.settle(grasp))
    policy, task = StudentPolicy(network, hand, objects), environment.task
    generate, control = task.advance_setpoints, []

    def timed(action: Action) -> SetpointSequence:
        start = process_time()
        sequence = generate(action)
        control.append(process_time() - start)
        return sequence

    task.advance_setpoints = timed
    acting = []
    observation = environment.observe()
    policy.reset(plan, observation)
    while not task.done.all():
        start = process_time()
        action = policy.act(observation)
        acting.append(process_time() - start)
        environment.step(action)
        observation = environment.observe()
    return ActingSpeed(1e3 * float(np.median(acting)), 1e3 * float(np.median(control)))


def untrained_student(library: PlanLibrary, objects: Mapping[str, ObjectModel], hand: Hand) -> PolicyNetwork:
    """A student as it is before it has learned anything, as loaded from its file."""
    settings = EnvironmentSettings(worlds=1, history=True)
    environment = TrainingEnvironment(library, objects, hand, settings, threads=1)
    card = make_card(
        "untrained",
        "student",
        hand,
        environment.student_layout,
        (),
        settings.residual,
        1 / environment.protocol.control_period,
        Budget(0, 0.0, ""),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "untrained.onnx"
        export_policy(make_student(environment), path, card)
        return load_policy(path)
