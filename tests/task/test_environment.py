"""Episodes: worlds differ from what is believed as drawn, and policies are played in them."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import ClassVar

import numpy as np
import pytest
from lifted_grasps import allegro_hand, good_grasps, grasped_objects
from planned_grasps import belief, grasps_and_objects, hand, plan, scene, start

from fungrasp.geometry.poses import (
    compose,
    inverse_transform_points,
    invert,
    relative,
    rotation_vector,
    transform_points,
)
from fungrasp.objects import with_sizes
from fungrasp.planning import MotionPlanner
from fungrasp.policies import OpenLoopPolicy
from fungrasp.sim2real import (
    NOMINAL,
    REALITY,
    THREE_PUSHES,
    WIDE,
    EpisodeSample,
    MeasurementError,
    Randomization,
    draw_each,
)
from fungrasp.simulation import build_scene
from fungrasp.task import Action, Belief, LiftEnvironment, LiftProtocol, Observation, Privileged, play

BOTH = np.arange(2)


def sample(randomization: Randomization, seed: int = 0, rows=BOTH) -> EpisodeSample:
    return draw_each(randomization, seed, rows, len(hand().joint_names))


def settled(randomization: Randomization, seed: int = 0, rows=BOTH) -> tuple[LiftEnvironment, Belief]:
    environment = LiftEnvironment(scene(), len(rows), randomization, threads=1)
    return environment, environment.settle(grasps_and_objects()[0], sample(randomization, seed, rows))


def begun(randomization: Randomization, count: int = 2, seed: int = 0, **options) -> LiftEnvironment:
    """Episodes that begin with the plans' first step, the can's in the even worlds."""
    rows, environment = np.arange(count) % 2, LiftEnvironment(scene(), count, randomization, threads=1)
    drawn, first = sample(randomization, seed, np.arange(count)), np.zeros(count, dtype=int)
    environment.begin(np.arange(count), plan().select(rows), first, drawn, **options)
    return environment


def still(environment: LiftEnvironment) -> Action:
    setpoints = environment.task.setpoints
    return Action(setpoints.wrist.pose.copy(), setpoints.fingers.copy(), np.zeros(len(environment), bool))


# Settling


def test_nominal_worlds_are_as_believed():
    environment, believed = settled(NOMINAL)
    grasps, _ = grasps_and_objects()
    seen, truth = environment.observe(), environment.privileged()
    np.testing.assert_array_equal(believed.object_pose, environment.task.settled_pose)
    np.testing.assert_array_equal(believed.object_mass, grasps.object_mass)
    np.testing.assert_array_equal(believed.palm_pose, seen.palm_setpoint)
    np.testing.assert_allclose(believed.palm_pose, environment.engine.palm_pose, atol=1e-9)
    np.testing.assert_array_equal(believed.joint_positions, seen.joint_setpoints)
    np.testing.assert_array_equal(believed.table_height, 0.0)
    np.testing.assert_array_equal(truth.object_mass, grasps.object_mass)
    np.testing.assert_array_equal(truth.friction, believed.friction)
    np.testing.assert_array_equal(seen.object_pose, environment.engine.object_pose)
    assert not environment.task.setpoints.delay.any()


def test_the_worlds_have_the_true_mass_and_friction():
    environment, believed = settled(Randomization(mass=(2.0, 2.0), friction=(0.6, 0.6)))
    truth = environment.privileged()
    np.testing.assert_allclose(truth.object_mass, 2.0 * believed.object_mass)
    np.testing.assert_array_equal(truth.friction, 0.6)
    np.testing.assert_array_equal(believed.friction, scene().settings.friction)
    body = scene().model.body("object").id
    np.testing.assert_allclose(environment.engine.batch.expand("body_mass")[:, body], truth.object_mass)
    assert (environment.engine.batch.expand("geom_friction")[:, :, 0] == 0.6).all()


def test_a_higher_table_carries_the_objects_higher():
    (usual, _), (raised, believed) = settled(NOMINAL), settled(Randomization(table_height=(0.02, 0.02)))
    rise = raised.task.settled_pose[:, 2] - usual.task.settled_pose[:, 2]
    np.testing.assert_allclose(rise, 0.02, atol=1e-4)
    frames = raised.engine.wrist_frame[:, 2] - usual.engine.wrist_frame[:, 2]
    np.testing.assert_allclose(frames, 0.02, atol=1e-3)
    raised.step(still(raised))
    assert raised.engine.object_on_table.all()
    np.testing.assert_array_equal(believed.table_height, 0.0)


def test_the_believed_pose_is_off_by_what_was_drawn_about_the_center_of_mass():
    error = Randomization(
        object_position_error=MeasurementError(offset=0.01),
        object_rotation_error=MeasurementError(offset=float(np.deg2rad(10))),
    )
    environment, believed = settled(error)
    grasps, objects = grasps_and_objects()
    true_pose = environment.task.settled_pose
    off = compose(invert(true_pose), believed.object_pose)
    np.testing.assert_allclose(np.linalg.norm(rotation_vector(off[:, 3:]), axis=1), np.deg2rad(10))
    centers = np.array([objects[name].center_of_mass for name in grasps.object_name])[:, None]
    true, seen, tracked = (
        transform_points(pose, centers)
        for pose in (true_pose, believed.object_pose, environment.observe().object_pose)
    )
    np.testing.assert_allclose(np.linalg.norm(seen - true, axis=-1), 0.01, atol=1e-6)
    np.testing.assert_allclose(tracked, seen, atol=1e-6)


def test_settling_again_with_another_sample_forgets_the_last():
    used = LiftEnvironment(scene(), 2, WIDE, threads=1)
    grasps, _ = grasps_and_objects()
    used.settle(grasps, sample(WIDE, 1))
    used.step(still(used))
    last = used.settle(grasps, sample(WIDE, 2))
    fresh = LiftEnvironment(scene(), 2, WIDE, threads=1)
    first = fresh.settle(grasps, sample(WIDE, 2))
    for name, value in first.arrays().items():
        np.testing.assert_array_equal(last.arrays()[name], value, err_msg=name)
    for _ in range(3):
        for environment in (used, fresh):
            environment.step(still(environment))
    np.testing.assert_array_equal(used.engine.positions, fresh.engine.positions)


# Moved objects


def test_a_hidden_shift_moves_the_object_and_not_the_plan():
    shifted, believed = settled(Randomization(object_shift=(0.02, 0.02)), seed=5)
    usual, _ = settled(NOMINAL)
    np.testing.assert_allclose(believed.object_pose, usual.task.settled_pose, atol=1e-12)
    shifted.move_objects()
    task = shifted.task
    shift = task.settled_pose - usual.task.settled_pose
    np.testing.assert_allclose(np.linalg.norm(shift[:, :2], axis=1), 0.02)
    np.testing.assert_allclose(shift[:, 2:], 0.0, atol=1e-12)
    assert np.linalg.norm(shift[0, :2] - shift[1, :2]) > 1e-3, "directions differ"
    np.testing.assert_allclose(shifted.engine.object_pose, task.settled_pose)
    heights = [e.task.measurements.settled_height for e in (shifted, usual)]
    np.testing.assert_allclose(*heights, atol=1e-9)
    np.testing.assert_array_equal(shifted.observe().object_pose, shifted.engine.object_pose)
    np.testing.assert_allclose(shifted.engine.palm_pose, usual.engine.palm_pose, atol=1e-6)
    for environment in (shifted, usual):
        for _ in range(5):
            environment.step(still(environment))
    np.testing.assert_allclose(shifted.engine.object_pose - usual.engine.object_pose, shift, atol=1e-3)
    assert shifted.engine.object_on_table.all()


def test_nothing_moves_where_nothing_was_drawn():
    environment, _ = settled(NOMINAL)
    before = environment.engine.positions
    environment.move_objects()
    np.testing.assert_array_equal(environment.engine.positions, before)


# Beginning in the midst of plans


def test_an_episode_begins_where_its_plan_is():
    environment = LiftEnvironment(scene(), 2, threads=1)
    step = np.array([4, 9])
    environment.begin(BOTH, plan(), step, sample(NOMINAL))
    seen, p = environment.observe(), plan()
    np.testing.assert_allclose(seen.time, 0.1 * step)
    np.testing.assert_allclose(seen.object_pose, p.object_pose, atol=1e-9)
    np.testing.assert_allclose(seen.palm_setpoint, compose(p.object_pose, p.palm_setpoint_object[BOTH, step]))
    np.testing.assert_allclose(seen.palm_pose[:, :3], seen.palm_setpoint[:, :3], atol=1e-9)
    np.testing.assert_allclose(seen.joint_positions, p.finger_targets[BOTH, step - 1], atol=1e-9)
    np.testing.assert_array_equal(environment.task.setpoints.wrist.velocity, p.palm_velocity[BOTH, step])
    np.testing.assert_allclose(
        environment.engine.wrist_frame, compose(p.object_pose, p.grasp_palm_pose), atol=1e-12
    )
    np.testing.assert_array_equal(environment.task.target_contacts, p.link_contacts)


def test_an_episode_that_begins_leaves_the_others():
    environment, alone = begun(WIDE, 4), begun(WIDE, 4)
    ids = np.array([0, 2])
    before, drawn = environment.sample, sample(WIDE, 7, BOTH)
    environment.begin(ids, plan(), np.array([0, 3]), drawn)
    for f in fields(EpisodeSample):
        was, now = getattr(before, f.name), getattr(environment.sample, f.name)
        np.testing.assert_array_equal(now[[1, 3]], was[[1, 3]], err_msg=f.name)
        np.testing.assert_array_equal(now[ids], getattr(drawn, f.name), err_msg=f.name)
    truth = environment.privileged()
    np.testing.assert_allclose(truth.object_mass[ids], drawn.mass * plan().object_mass)
    np.testing.assert_array_equal(truth.friction[ids], drawn.friction)
    np.testing.assert_array_equal(environment.task.setpoints.delay[ids], drawn.action_delay)
    for one in (environment, alone):
        for _ in range(3):
            one.step(still(one))
    # To rounding: setpoints are made in pieces that end where any world's action takes effect.
    np.testing.assert_allclose(
        environment.engine.positions[[1, 3]], alone.engine.positions[[1, 3]], atol=1e-12
    )


def test_objects_stand_on_the_table_that_was_drawn():
    environment = begun(Randomization(table_height=(-0.01, 0.01), object_shift=(0.0, 0.02)), 4)
    rest = np.concatenate([plan().object_pose] * 2)
    placed, drawn = environment.engine.object_pose, environment.sample
    np.testing.assert_allclose(placed[:, 2] - rest[:, 2], drawn.table_height, atol=1e-12)
    moved = np.linalg.norm(placed[:, :2] - rest[:, :2], axis=1)
    assert ((moved > 0) & (moved <= 0.02)).all() and len(np.unique(drawn.table_height)) == 4
    environment.step(still(environment))
    assert environment.engine.object_on_table.all()
    np.testing.assert_allclose(environment.engine.object_pose[:, 2], placed[:, 2], atol=1e-3)


def test_an_object_whose_pose_is_wrong_is_seen_where_the_plan_has_it():
    """It stands on its table all the same: seen too high, the table is lower."""
    r = Randomization(
        object_position_error=MeasurementError(uniform=0.005),
        object_rotation_error=MeasurementError(offset=0.01),
    )
    environment = begun(r, 4)
    planned = np.concatenate([plan().object_pose] * 2)
    truth, seen = environment.engine.object_pose, environment.observe().object_pose
    off = environment.sample.object_bias
    assert np.abs(off[:, :3]).min() > 0
    np.testing.assert_allclose(seen[:, :3], planned[:, :3], atol=1.5e-3)
    assert np.abs(truth[:, :2] - planned[:, :2] + off[:, :2]).max() < 1.5e-3
    turned = rotation_vector(relative(planned, seen)[:, 3:])
    np.testing.assert_allclose(turned, 0.0, atol=1e-6)
    expected = compose(planned, np.concatenate([plan().palm_setpoint_object[:, 0]] * 2))
    np.testing.assert_allclose(environment.engine.palm_pose[:, :3], expected[:, :3], atol=1e-9)
    for _ in range(4):
        environment.step(still(environment))
    assert environment.engine.object_on_table.all()
    np.testing.assert_allclose(environment.engine.object_pose[:, 2], planned[:, 2] - off[:, 2], atol=2.5e-3)


def test_a_planner_is_told_how_wrong_a_pose_may_be():
    r = Randomization(object_position_error=MeasurementError(bias=0.003))
    covariance = settled(r)[1].object_pose_covariance
    assert covariance is not None and covariance.shape == (2, 6, 6)
    np.testing.assert_allclose(covariance[1], np.diag([9e-6] * 3 + [0.0] * 3))
    assert settled(NOMINAL)[1].object_pose_covariance is None


def test_a_world_of_the_reality_protocol_differs_in_everything_from_what_is_believed():
    sizes = with_sizes(grasps_and_objects()[1], REALITY.object_scales)
    drawn = sample(REALITY, 3, BOTH)
    environment = LiftEnvironment(build_scene(hand(), sizes), 2, REALITY, threads=1)
    believed = environment.settle(grasps_and_objects()[0], drawn)
    engine, (grasps, objects) = environment.engine, grasps_and_objects()
    center = inverse_transform_points(engine.object_pose, engine.center_of_mass[:, None])[:, 0]
    for world, name in enumerate(grasps.object_name.tolist()):
        model = engine.scene.models[engine.object_index[world]]
        np.testing.assert_allclose(model.size, drawn.object_scale[world] * objects[name].size)
        expected = model.center_of_mass + drawn.center_of_mass_shift[world] * model.size
        np.testing.assert_allclose(center[world], expected, atol=1e-9)
    apart = np.linalg.norm(believed.object_pose[:, :3] - engine.object_pose[:, :3], axis=1)
    assert (apart > 1e-3).all() and (apart < 0.03).all()


@pytest.mark.parametrize("followed", [True, False])
def test_a_hand_has_followed_a_moved_object_or_is_where_the_plan_has_it(followed):
    environment = begun(Randomization(object_shift=(0.02, 0.02), object_turn=0.1), hand_followed=followed)
    origin = environment.engine.object_pose if followed else plan().object_pose
    expected = compose(origin, plan().palm_setpoint_object[:, 0])
    np.testing.assert_allclose(environment.engine.palm_pose[:, :3], expected[:, :3], atol=1e-9)


def test_what_is_believed_of_the_joints_and_of_friction_is_where_worlds_begin():
    """A belief's factors, as if the same had been drawn; both multiply."""
    joints, rng = len(hand().joint_names), np.random.default_rng(0)
    factors = {
        name: rng.uniform(0.6, 1.6, (2, joints))
        for name in ("joint_damping", "servo_stiffness", "servo_damping")
    }
    believed = replace(belief(), friction=np.full(2, 0.45), **factors)
    nominal = sample(NOMINAL)
    drawn = replace(nominal, friction=np.full(2, 0.45), **factors)
    halves = {name: np.sqrt(value) for name, value in factors.items()}
    slippery = Randomization(friction=(0.45, 0.45))
    first, second, third = (LiftEnvironment(scene(), 2, r, threads=1) for r in (NOMINAL, slippery, slippery))
    step = np.maximum(plan().closing_step - 2, 0)
    first.begin(BOTH, plan(), step, nominal, believed)
    second.begin(BOTH, plan(), step, drawn)
    third.begin(
        BOTH, plan(), step, replace(nominal, friction=np.full(2, 0.6), **halves),
        replace(believed, friction=np.full(2, 0.675), **halves),
    )  # fmt: skip
    policy = OpenLoopPolicy()
    for environment in (first, second, third):
        np.testing.assert_allclose(environment.privileged().friction, 0.45)
        policy.reset(plan(), environment.observe())
        for _ in range(14):
            environment.step(policy.act(environment.observe()))
    np.testing.assert_allclose(first.engine.positions, second.engine.positions, atol=1e-9)
    np.testing.assert_allclose(first.engine.positions, third.engine.positions, atol=1e-6)
    nothing = begun(NOMINAL)
    nothing.begin(BOTH, plan(), step, nominal)
    policy.reset(plan(), nothing.observe())
    for _ in range(14):
        nothing.step(policy.act(nothing.observe()))
    assert np.abs(nothing.engine.positions - first.engine.positions).max() > 1e-4


# Pushes


def pushed(r: Randomization, began: np.ndarray, first: float, number: int) -> np.ndarray:
    """Forces on the objects at setpoints from some time on [N], shape [S, 2, 3]."""
    environment, forces = begun(r), []
    task, engine = environment.task, environment.engine
    push = engine.push_object
    engine.push_object = lambda force: forces.append(force.copy()) or push(force)
    if r.push_phase == "lift":
        task.lift_time[:] = began
    else:
        task.hold_time[:] = began
    task.time[:] = first
    while len(forces) < number:
        environment.step(still(environment))
    return np.array(forces[:number])


def test_pushes_are_forces_at_their_times_of_the_hold():
    r = Randomization(mass=(2.0, 2.0), push_times=THREE_PUSHES, push_weights=(1.5, 1.5), push_duration=0.1)
    force = pushed(r, np.array([0.0, np.inf]), 0.0, 145)
    times = 0.02 * np.arange(145)
    during = np.any([(times >= t - 1e-9) & (times < t + 0.1 - 1e-9) for t, _ in THREE_PUSHES], axis=0)
    assert during.sum() == 15
    assert not force[:, 1].any(), "the hold of the second has not begun"
    assert not force[~during].any()
    weight = 2.0 * 9.81 * plan().object_mass[0]
    np.testing.assert_allclose(np.linalg.norm(force[during, 0], axis=-1), 1.5 * weight)
    directions = force[during, 0].reshape(3, 5, 3) / weight
    np.testing.assert_array_equal(directions, np.repeat(directions[:, :1], 5, axis=1))
    apart = np.linalg.norm(directions[:, None, 0] - directions[None, :, 0], axis=-1)
    assert apart[~np.eye(3, dtype=bool)].min() > 0.01


def test_pushes_come_once_the_lift_has_begun():
    r = Randomization(push_phase="lift", push_times=((0.5, 0.5),), push_force=(2.0, 2.0))
    force = pushed(r, np.array([0.1, np.inf]), 0.0, 60)
    times = 0.02 * np.arange(60)
    during = (times >= 0.6 - 1e-9) & (times < 0.8 - 1e-9)
    np.testing.assert_allclose(np.linalg.norm(force[:, 0], axis=1), np.where(during, 2.0, 0.0))
    assert not force[:, 1].any()


# Play


def good_start(threads: int = 2) -> tuple[LiftEnvironment, Belief]:
    grasps = good_grasps()
    environment = LiftEnvironment(
        build_scene(allegro_hand(), grasped_objects()), len(grasps), threads=threads
    )
    return environment, environment.settle(grasps)


def good_plan(believed: Belief):
    return MotionPlanner(allegro_hand(), grasped_objects()).plan(good_grasps(), believed)


def test_good_grasps_lift_and_hold():
    environment, believed = good_start()
    fastest, before = 0.0, environment.engine.palm_pose

    def watch() -> None:
        nonlocal before, fastest
        now = environment.engine.palm_pose
        fastest = max(fastest, np.linalg.norm(now[:, :3] - before[:, :3], axis=1).max() / 0.02)
        before = now

    outcomes = play(environment, OpenLoopPolicy(), good_plan(believed), watch=watch)
    assert outcomes.success.sum() >= 3
    held = outcomes.success
    assert (outcomes.lifted_height_m[held] >= 0.10).all() and (outcomes.reason[held] == "").all()
    assert (outcomes.contact_ratio[held] > 0.3).all() and (outcomes.sim_distance_hand_mm_s[held] < 10).all()
    assert fastest < 1.2 * environment.protocol.wrist_speed


def test_an_open_hand_lifts_nothing():
    """The same way, but fingers that do not close."""
    environment, believed = good_start()

    class Open(OpenLoopPolicy):
        def act(self, observation: Observation) -> Action:
            return replace(super().act(observation), finger_targets=believed.joint_positions)

    outcomes = play(environment, Open(), good_plan(believed))
    assert not outcomes.success.any()
    assert (outcomes.lifted_height_m < 0.02).all()
    assert set(outcomes.reason) <= {"lost before the hold", "dropped during the hold"}
    assert (outcomes.reason == "lost before the hold").sum() >= 3


class Watching(OpenLoopPolicy):
    """Keeps what it is given."""

    def __init__(self):
        self.begun: list[Observation] = []
        self.seen: list[Observation] = []

    def reset(self, plan, observation: Observation) -> None:
        super().reset(plan, observation)
        self.begun.append(observation)

    def act(self, observation: Observation) -> Action:
        self.seen.append(observation)
        return super().act(observation)


def test_a_policy_is_reset_once_and_acts_once_in_each_control_period():
    policy, environment = Watching(), start(protocol=LiftProtocol(hold_time=0.3))
    play(environment, policy, plan())
    assert len(policy.begun) == 1 and policy.begun[0] is policy.seen[0]
    times = np.array([observation.time for observation in policy.seen])
    steps = np.diff(times, axis=0)
    np.testing.assert_allclose(steps[:-5], 0.1)
    assert ((np.abs(steps - 0.1) < 1e-9) | (steps == 0)).all(), "the clock of an episode that is over stands"


def test_a_teacher_is_told_what_only_a_simulation_knows():
    class Teacher(Watching):
        told: ClassVar[list[Privileged]] = []

        def act_privileged(self, observation: Observation, privileged: Privileged) -> Action:
            self.told.append(privileged)
            return OpenLoopPolicy.act(self, observation)

        def act(self, observation: Observation) -> Action:
            raise AssertionError("a teacher is told more")

    policy, environment = Teacher(), start(protocol=LiftProtocol(hold_time=0.3))
    assert play(environment, policy, plan()).success.all()
    assert not policy.told[0].contacts.any() and policy.told[-1].contacts.any()
    assert policy.told[-1].lifted_height.min() > 0.1
    assert policy.told[3].object_on_table.all() and not policy.told[-1].object_on_table.any()


def test_lost_episodes_can_be_ended_at_once():
    grasps, _ = grasps_and_objects()
    opened = replace(plan(), finger_targets=0.0 * plan().finger_targets)
    both = []
    for end_lost in (False, True):
        environment = LiftEnvironment(scene(), 2, threads=1)
        environment.settle(grasps)
        outcomes = play(environment, OpenLoopPolicy(), opened, end_lost=end_lost)
        assert not outcomes.success.any() and (outcomes.reason == "lost before the hold").all()
        both.append(environment.task.time.copy())
    assert (both[1] < both[0] - 2.0).all()
