"""Samples in the worlds: what is heavier, softer or higher moves as it should; other worlds don't notice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fungrasp.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.objects import builtin_object
from fungrasp.simulation import Scene, Worlds, build_scene
from fungrasp.transfer import NONE, Randomisation, Sample, apply, push_objects, pushes, sample

DOWN = np.array([0.0, 0.0, 0.4, 0.0, 1.0, 0.0, 0.0])
FIELDS = ("dof_damping", "actuator_gainprm", "actuator_biasprm", "geom_pos")


@pytest.fixture(scope="module", params=["allegro", "inspire"])
def scene(request) -> Scene:
    """One hand with a servo for each joint, one with coupled joints."""
    return build_scene(load_hand(request.param), {"can": builtin_object("can")})


@pytest.fixture(scope="module")
def allegro() -> Scene:
    return build_scene(load_hand("allegro"), {"can": builtin_object("can")})


def drawn(scene: Scene, count: int, randomisation: Randomisation = NONE, seed: int = 0) -> Sample:
    joints = len(scene.hand.joint_names)
    return sample(randomisation, count, joints, np.random.default_rng(seed))


def ready(scene: Scene, count: int, changes: Sample | None = None) -> Worlds:
    """Cans on the table, open hands above."""
    worlds = Worlds(scene, np.zeros(count, dtype=int), threads=1)
    if changes is not None:
        apply(changes, worlds, np.arange(count))
    worlds.reset()
    height = -builtin_object("can").vertices[:, 2].min() + (0 if changes is None else changes.table_height)
    pose = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1))
    pose[:, 2] = height
    worlds.object_pose = pose
    worlds.wrist_reference = np.tile(DOWN, (count, 1))
    worlds.ctrl[:, scene.finger_actuators] = middle(scene)
    worlds.joint_positions = middle(scene) @ scene.hand.coupling[0].T + scene.hand.coupling[1]
    worlds.forward()
    return worlds


def middle(scene: Scene) -> np.ndarray:
    return scene.model.actuator_ctrlrange[scene.finger_actuators].mean(axis=1)


def fields_of(worlds: Worlds) -> list[np.ndarray]:
    return [worlds.batch.expand(name).copy() for name in FIELDS]


def test_nothing_drawn_changes_nothing(scene):
    plain, same = ready(scene, 2), ready(scene, 2, drawn(scene, 2))
    for worlds in (plain, same):
        worlds.ctrl[:, scene.finger_actuators] += 0.2
        worlds.step(40)
    np.testing.assert_array_equal(plain.qpos, same.qpos)


def test_applying_again_does_not_compound_and_the_last_sample_counts(scene):
    once, often = ready(scene, 3), ready(scene, 3)
    ids = np.arange(3)
    last = drawn(scene, 3, Randomisation(), seed=1)
    apply(last, once, ids)
    for changes in (drawn(scene, 3, Randomisation(), seed=2), last, last):
        apply(changes, often, ids)
    for a, b in zip(fields_of(once), fields_of(often), strict=True):
        np.testing.assert_array_equal(a, b)
    apply(drawn(scene, 3), often, ids)
    for name, values in zip(FIELDS, fields_of(often), strict=True):
        nominal = getattr(scene.model, name)
        np.testing.assert_array_equal(values, np.broadcast_to(nominal, values.shape))


def test_other_worlds_are_untouched(scene):
    plain, mixed = ready(scene, 4), ready(scene, 4)
    apply(drawn(scene, 2, Randomisation()), mixed, np.array([3, 1]))
    for worlds in (plain, mixed):
        worlds.ctrl[:, scene.finger_actuators] += 0.2
        worlds.ctrl[:, scene.wrist_actuators] += 0.02
        worlds.step(20)
    np.testing.assert_array_equal(plain.qpos[[0, 2]], mixed.qpos[[0, 2]])
    assert (np.abs(plain.qpos[[1, 3]] - mixed.qpos[[1, 3]]).max(axis=1) > 1e-4).all()


def test_rows_of_the_sample_follow_the_order_of_the_worlds(allegro):
    worlds = ready(allegro, 3)
    changes = drawn(allegro, 2, Randomisation())
    apply(changes, worlds, np.array([2, 0]))
    heights = worlds.batch.expand("geom_pos")[:, allegro.model.geom("table").id, 2]
    np.testing.assert_array_equal(heights, [changes.table_height[1], 0.0, changes.table_height[0]])
    gains = worlds.batch.expand("actuator_gainprm")[:, allegro.finger_actuators, 0]
    nominal = allegro.model.actuator_gainprm[allegro.finger_actuators, 0]
    np.testing.assert_allclose(
        gains[[2, 1, 0]] / nominal, [changes.stiffness[0], [1] * 16, changes.stiffness[1]]
    )


@pytest.mark.parametrize("what", ["damping", "servo_damping"])
def test_heavier_damping_slows_the_joint_it_belongs_to(allegro, what):
    changes = drawn(allegro, 2)
    getattr(changes, what)[1, 5] = 8.0
    worlds = ready(allegro, 2, changes)
    start = worlds.joint_positions.copy()
    worlds.ctrl[:, allegro.finger_actuators] += 0.2
    worlds.step(8)
    moved = worlds.joint_positions - start
    assert moved[1, 5] < 0.7 * moved[0, 5]
    others = np.delete(np.arange(16), 5)
    np.testing.assert_allclose(moved[1, others], moved[0, others], rtol=0.2)
    worlds.step(1000)
    np.testing.assert_allclose(worlds.joint_positions[1], worlds.joint_positions[0], atol=0.01)


def test_a_softer_finger_servo_gives_way_further(allegro):
    changes = drawn(allegro, 2)
    changes.stiffness[1] = 0.5
    worlds = ready(allegro, 2, changes)
    joint = 5
    start = worlds.joint_positions[:, joint].copy()
    dof = allegro.model.joint(f"hand/{allegro.hand.joint_names[joint]}").dofadr[0]
    worlds.batch.bind("qfrc_applied")[:, dof] = 0.2
    worlds.step(1000)
    # 0.2 N m against 4 N m/rad, less up to 0.01 N m of dry friction.
    sag = worlds.joint_positions[:, joint] - start
    np.testing.assert_allclose(sag, [0.2 / 4, 0.2 / 2], rtol=0.06)


def test_a_softer_wrist_gives_way_further_and_follows_as_well(allegro):
    changes = replace(drawn(allegro, 2), wrist_stiffness=np.array([1.0, 0.5]))
    worlds = ready(allegro, 2, changes)
    worlds.batch.bind("xfrc_applied")[:, allegro.model.body("wrist").id, 0] = 10.0
    worlds.step(600)
    np.testing.assert_allclose(worlds.palm_pose[:, 0], [10 / 2000, 10 / 1000], atol=1e-4)
    worlds = ready(allegro, 2, changes)
    speed, lead = 0.1, 120.0 / 2000.0
    for i in range(200):
        worlds.ctrl[:, 0] = speed * (0.005 * (i + 1) + lead)
        worlds.step(1)
    np.testing.assert_allclose(worlds.qpos[:, worlds.wrist_qpos[0]], speed * 1.0, atol=1.5e-3)


def test_the_table_carries_the_object_at_its_new_height(allegro):
    heights = np.array([0.0, 0.03, -0.03])
    worlds = ready(allegro, 3, replace(drawn(allegro, 3), table_height=heights))
    resting = worlds.center_of_mass[0, 2]
    worlds.step(200)
    np.testing.assert_allclose(worlds.center_of_mass[:, 2] - resting, heights, atol=1e-3)
    assert worlds.object_on_table.all()


def test_coupled_joints_have_damping_of_their_own_and_servos_the_factors_of_their_joints():
    scene = build_scene(load_hand("inspire"), {"can": builtin_object("can")})
    hand, model = scene.hand, scene.model
    assert (len(hand.joint_names), len(hand.actuators)) == (12, 6)
    changes = drawn(scene, 1, Randomisation())
    worlds = ready(scene, 1, changes)
    for column, name in enumerate(hand.joint_names):
        dof = model.joint(f"hand/{name}").dofadr[0]
        factor = worlds.batch.expand("dof_damping")[0, dof] / model.dof_damping[dof]
        assert factor == pytest.approx(changes.damping[0, column])
    for name in hand.actuators:
        column, servo = hand.joint_names.index(name), model.actuator(f"hand/{name}").id
        gain = worlds.batch.expand("actuator_gainprm")[0, servo, 0] / model.actuator_gainprm[servo, 0]
        bias = worlds.batch.expand("actuator_biasprm")[0, servo, :3]
        assert gain == pytest.approx(changes.stiffness[0, column])
        assert bias[1] / model.actuator_biasprm[servo, 1] == pytest.approx(gain)
        assert bias[2] / model.actuator_biasprm[servo, 2] == pytest.approx(changes.servo_damping[0, column])


def test_samples_that_do_not_fit_are_refused(allegro):
    worlds = ready(allegro, 2)
    with pytest.raises(FungraspError, match="sample of 2 trials can't be applied to 1 worlds"):
        apply(drawn(allegro, 2), worlds, np.array([0]))
    wrong = sample(NONE, 2, 12, np.random.default_rng(0))
    with pytest.raises(FungraspError, match="drawn for 12 joints; hand 'allegro' has 16"):
        apply(wrong, worlds, np.arange(2))


def test_a_push_lasts_its_time_from_its_start():
    force = np.arange(18.0).reshape(6, 3) + 1
    now = np.array([-np.inf, 0.99, 1.0, 1.19, 1.2, np.nan])
    np.testing.assert_array_equal(pushes(force, 1.0, 0.2, now)[[2, 3]], force[[2, 3]])
    np.testing.assert_array_equal(pushes(force, 1.0, 0.2, now)[[0, 1, 4, 5]], 0.0)
    own = pushes(force, np.array([0.0, 0.0, 0.9, 1.0, 1.0, 1.0]), np.array([1, 1, 0.05, 0.1, 0.3, 1]), now)
    assert (own != 0).all(axis=1).tolist() == [False, True, False, False, True, False]


def test_a_push_moves_the_object_without_turning_it_until_it_is_taken_back(allegro):
    worlds = ready(allegro, 3)
    mass = builtin_object("can").mass
    up = np.array([[0.0, 0.0, mass * (9.81 + 1.0)]])
    push_objects(worlds, up, np.array([1]))
    before = worlds.object_pose.copy()
    worlds.step(100)
    moved = worlds.object_pose - before
    assert moved[1, 2] == pytest.approx(0.5 * 1.0 * 0.5**2, rel=0.02)
    np.testing.assert_allclose(moved[1, [0, 1, 3, 4, 5, 6]], 0.0, atol=1e-9)
    np.testing.assert_allclose(moved[[0, 2]], 0.0, atol=1e-3)
    push_objects(worlds, np.zeros((3, 3)))
    worlds.step(200)
    assert worlds.object_on_table.all()
