"""The GPU engine on Warp's own CPU device: the contract of all engines, and the CPU engine beside it.

Kernels are compiled once, for two minutes and a few seconds more for each hand; with them in the cache all of
this takes minutes on a free core.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from engine_contract import BOX, CAN, MUG, EngineContract, contract_objects, pose, still

import fungrasp
from fungrasp.geometry.arrays import moved_to
from fungrasp.geometry.poses import compose
from fungrasp.policies import OpenLoopPolicy
from fungrasp.simulation import BufferSizes, Engine, MujocoCpuEngine, Scene, SceneSettings, build_scene
from fungrasp.task import Action, GraspPlan, LiftEnvironment, play

pytest.importorskip("mujoco_warp", reason='the extra "gpu" is not installed')
from fungrasp.simulation.mujoco_warp import MujocoWarpEngine

pytestmark = pytest.mark.slow

HANDS = ("allegro", "faive", "inspire", "leap", "shadow")
OBJECTS = ("mug", "can", "scissors", "drill", "box", "bowl", "hammer", "tennis_ball")


class TestMujocoWarpEngine(EngineContract):
    """In single precision."""

    readback = 2e-6
    turned = 1e-3
    alone = 1e-3
    alike = 1e-5
    together = 1
    apart = (BOX,)

    def make(self, scene: Scene, count: int, threads: int = 1) -> Engine:
        return MujocoWarpEngine(scene, count, "cpu-warp")


@cache
def planned(hand_name: str, count: int, names: tuple[str, ...] = ()) -> tuple[Scene, GraspPlan]:
    """A scene with 50 solver iterations, and plans of built-in grasps as they are seen in it."""
    hand, human = fungrasp.load_hand(hand_name), fungrasp.builtin_grasps()
    if names:
        rows = [int(np.flatnonzero(human.object_name == name)[0]) for name in names]
    else:
        rows = np.unique(np.linspace(0, len(human) - 1, count).astype(int)).tolist()
    human = human.select(np.array(rows))
    objects = fungrasp.load_objects(human)
    robot = fungrasp.retarget(human, objects, hand=hand_name)
    scene = build_scene(hand, objects, SceneSettings(iterations=50))
    belief = LiftEnvironment(scene, len(robot), threads=1).settle(robot)
    return scene, fungrasp.MotionPlanner(hand, objects).plan(robot, belief)


def begun(scene: Scene, plans: GraspPlan, engine: Engine, step: np.ndarray) -> LiftEnvironment:
    """Episodes of an engine that begin at a step of their plans."""
    environment = LiftEnvironment(scene, len(plans), engine=engine)
    environment.begin(np.arange(len(plans)), plans, step, environment.sample)
    return environment


def on(scene: Scene, **settings: object) -> Scene:
    """The same scene on Warp's CPU device."""
    return replace(scene, settings=replace(scene.settings, device="cpu-warp", **settings))


class RoundedCpuEngine(MujocoCpuEngine):
    """The CPU engine with commands that differ by 1e-6, several times single precision's rounding: what this
    alone changes, contacts that just touch or just do not, no engine in single precision can reproduce."""

    noise = np.random.default_rng(0)

    def step(self, controls: np.ndarray, steps: int, worlds: np.ndarray | None = None) -> None:
        super().step(controls + 1e-6 * self.noise.standard_normal(np.shape(controls)), steps, worlds)


@pytest.mark.parametrize("hand_name", HANDS)
def test_twenty_steps_from_the_same_states_are_those_of_the_cpu_engine(hand_name):
    """Before the fingers close, while they do, and as the object is lifted; of all eight objects."""
    scene, plans = planned(hand_name, 0, OBJECTS)
    cpu = MujocoCpuEngine(scene, len(plans), 1)
    gpu, rounded = MujocoWarpEngine(scene, len(plans), "cpu-warp"), RoundedCpuEngine(scene, len(plans), 1)
    environment, policy = LiftEnvironment(scene, len(plans), engine=cpu), OpenLoopPolicy()
    environment.begin(np.arange(len(plans)), plans, np.maximum(plans.closing_step - 2, 0), environment.sample)
    policy.reset(plans, environment.observe())
    for engine in (gpu, rounded):
        begun(scene, plans, engine, np.maximum(plans.closing_step - 2, 0))
    apart, flags, own = [], [], []
    last = int((plans.lift_step - plans.closing_step).max()) + 4
    for step in range(last):
        if step in (0, last // 2, last - 1):
            state = cpu.get_state()
            gpu.restore(state)
            controls = environment.task.controls
            for engine in (cpu, gpu):
                engine.step(controls, 20)
            apart.append(np.abs(cpu.positions - gpu.positions).max(axis=1))
            flags.append((cpu.link_contacts != gpu.link_contacts).any(axis=1))
            spread = np.zeros(len(plans))
            for _ in range(6):
                rounded.restore(state)
                rounded.step(controls, 20)
                spread = np.maximum(spread, np.abs(cpu.positions - rounded.positions).max(axis=1))
            own.append(spread)
            cpu.restore(state)
        environment.step(policy.act(environment.observe()))
    found, flag, spread = np.concatenate(apart), np.concatenate(flags), np.concatenate(own)
    print(hand_name, np.sort(found)[::-1][:5], (found <= 1e-4).mean(), "undecided", (spread > 3e-3).sum())
    assert gpu.problems() == []
    assert (found <= 1e-4).mean() >= 0.85, np.sort(found)
    assert (spread > 3e-3).sum() <= 1, spread
    differ = (flag | (found > 3e-3)) & (found > 2 * spread)
    assert not differ.any(), np.stack([found, spread], axis=-1)[differ]


@pytest.mark.parametrize("hand_name", ["allegro", "inspire"])
def test_whole_episodes_end_alike(hand_name):
    scene, plans = planned(hand_name, 16)
    ends = [
        play(begun(scene, plans, engine, np.zeros(len(plans), dtype=int)), OpenLoopPolicy(), plans)
        for engine in (MujocoCpuEngine(scene, len(plans), 1), MujocoWarpEngine(scene, len(plans), "cpu-warp"))
    ]
    print(hand_name, [end.success.sum() for end in ends], [end.contact_ratio.mean() for end in ends])
    differ = np.flatnonzero(ends[0].success != ends[1].success)
    assert len(differ) <= 1, [(plans.object_name[i], ends[0].reason[i], ends[1].reason[i]) for i in differ]
    for row in differ:  # Only where the last digits of the commands decide on the CPU engine too.
        again = plans.select(np.full(8, row))
        engine = RoundedCpuEngine(scene, len(again), 1)
        end = play(begun(scene, again, engine, np.zeros(len(again), dtype=int)), OpenLoopPolicy(), again)
        assert (end.success == ends[1].success[row]).any(), (plans.object_name[row], end.reason)


def test_slots_that_an_object_leaves_empty_touch_nothing():
    """Also alone in its engine: a can, in a scene whose mug has many pieces."""
    objects = {name: contract_objects()[name] for name in ("mug", "can")}
    scene = build_scene(fungrasp.load_hand("allegro"), objects)
    falls = []
    for engine in (MujocoWarpEngine(scene, 1, "cpu-warp"), MujocoCpuEngine(scene, 1, 1)):
        engine.set_parameters(object_index=np.array([1]))
        engine.set_state(object_pose=pose(1, 0.0, 0.0, 0.1), wrist_frame=pose(1, 0.0, 0.0, 0.8))
        engine.step(still(engine), 100)
        falls.append(engine.object_pose)
    np.testing.assert_allclose(*falls, atol=1e-4)


def test_contacts_and_rows_that_do_not_fit_are_named_once():
    scene = build_scene(fungrasp.load_hand("allegro"), {"can": contract_objects()["can"]})
    for sizes, words in (
        (BufferSizes(1, 512), "--buffers"),
        (BufferSizes(64, 20), "rows of constraints did not fit in 2 of 2 worlds (0, 1)"),
    ):
        engine = MujocoWarpEngine(scene, 2, "cpu-warp", sizes)
        engine.set_state(object_pose=pose(2, 0.0, 0.0, 0.05), wrist_frame=pose(2, 0.0, 0.0, 0.05))
        engine.step(still(engine), 2)
        (problem,) = engine.problems()
        assert words in problem and "--buffers" in problem, problem
        assert engine.problems() == []


def test_a_command_that_is_no_number_and_a_frozen_world_are_named(caplog):
    scene = build_scene(fungrasp.load_hand("allegro"), {"can": contract_objects()["can"]})
    engine = MujocoWarpEngine(scene, 3, "cpu-warp")
    engine.set_state(object_pose=pose(3, 0.0, 0.0, 0.3), wrist_frame=pose(3, 0.0, 0.0, 0.8))
    bad = still(engine)
    bad[2, 8] = np.nan
    engine.step(bad, 2)
    assert engine.diverged.tolist() == [False, False, True]
    assert engine.problems() == ["controls were no numbers in world 2"]
    # A clock too late for its steps stands still in single precision.
    engine.worlds.warp_data.time.numpy()[1] = 1e9
    with caplog.at_level(logging.WARNING):
        engine.step(still(engine), 2)
    assert engine.problems() == ["physics stood still in world 1"]


def test_a_scene_says_on_which_device_its_worlds_are():
    scene, plans = planned("inspire", 4)
    environment = LiftEnvironment(on(scene, buffers=BufferSizes(200, 600)), len(plans))
    assert isinstance(environment.engine, MujocoWarpEngine)
    assert environment.engine.worlds.sizes == BufferSizes(200, 600)


def test_tables_of_worlds_lie_and_lean_as_on_the_cpu():
    scene = build_scene(fungrasp.load_hand("allegro"), {n: contract_objects()[n] for n in ("mug", "can")})
    rng = np.random.default_rng(0)
    seen = []
    for engine in (MujocoWarpEngine(scene, 6, "cpu-warp"), MujocoCpuEngine(scene, 6, 1)):
        rng = np.random.default_rng(0)
        engine.set_parameters(
            object_index=np.array([MUG, 1, MUG, 1, 1, MUG]),
            table_height=rng.uniform(-0.05, 0.05, 6),
            table_tilt=rng.uniform(-0.1, 0.1, (6, 2)),
        )
        assert CAN != 1
        engine.set_state(object_pose=pose(6, 0.1, 0.1, 0.2), wrist_frame=pose(6, 0.0, 0.0, 0.8))
        engine.step(still(engine), 30)
        seen.append(engine.object_pose)
    np.testing.assert_allclose(*seen, atol=2e-3)


def test_the_lift_test_on_the_engines_own_tensors_ends_as_on_copies():
    """Thirty control steps, the lift among them; nothing leaves the device inside a step."""
    scene, plans = planned("inspire", 4)
    host, device = (MujocoWarpEngine(scene, len(plans), "cpu-warp") for _ in range(2))
    tasks = []
    for engine in (host, device.worlds):
        environment = begun(scene, plans, engine, plans.closing_step - 4)
        task, given = environment.task, partial(moved_to, environment.task.time)
        for step in range(30):
            at = np.minimum(plans.closing_step - 4 + step, plans.palm_goal_object.shape[1] - 1)
            goal, fingers = plans.at(at, np.arange(len(plans)))
            goal, lifts = compose(plans.object_pose, goal), np.full(len(plans), step >= 12)
            task.step(Action(given(goal), given(fingers), given(lifts)))
        tasks.append(task)
    on_copies, tensors = tasks
    np.testing.assert_allclose(device.positions, host.positions, atol=2e-3)
    np.testing.assert_allclose(tensors.time.numpy(), on_copies.time, atol=1e-4)
    np.testing.assert_allclose(tensors.lift_time.numpy(), on_copies.lift_time, atol=1e-4)
    assert (device.link_contacts == host.link_contacts).mean() > 0.95
