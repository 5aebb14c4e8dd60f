"""Worlds of one scene: each as if it had a model of its own."""

from __future__ import annotations

import numpy as np
import pytest

from fungrasp.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.objects import builtin_object
from fungrasp.simulation import Scene, SceneSettings, Worlds, build_scene
from fungrasp.simulation.mujoco_cpu import INERTIAL

OBJECTS = ("mug", "box", "tennis_ball", "can", "scissors", "drill")
"""Many pieces and one, centre of mass at the origin and away from it."""

DOWN = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
"""Pose of a palm at the origin, upside down."""


@pytest.fixture(scope="module")
def hand():
    return load_hand("allegro")


@pytest.fixture(scope="module")
def objects():
    return {name: builtin_object(name) for name in OBJECTS}


@pytest.fixture(scope="module")
def scene(hand, objects) -> Scene:
    return build_scene(hand, objects)


def pose_above(worlds: Worlds, height: float) -> np.ndarray:
    pose = np.tile(DOWN, (len(worlds), 1))
    pose[:, 2] = height
    return pose


def put(worlds: Worlds, heights: np.ndarray, wrist_height: float = 0.3) -> None:
    """Objects upright at these heights of the origin, the hand above."""
    worlds.reset()
    pose = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (len(worlds), 1))
    pose[:, 2] = heights
    worlds.object_pose = pose
    worlds.wrist_reference = pose_above(worlds, wrist_height)
    worlds.forward()


def standing(objects, names) -> np.ndarray:
    return np.array([-objects[name].vertices[:, 2].min() for name in names])


def collide(worlds: Worlds, heights: np.ndarray, seeds: np.ndarray, steps: int = 150) -> list[np.ndarray]:
    """The hand comes down on the object while its fingers move at random; positions along the way."""
    put(worlds, heights + 0.02, wrist_height=0.12)
    path = []
    random = [np.random.default_rng(seed) for seed in seeds]
    size = worlds.ctrl.shape[1] - 6
    for _ in range(steps // 5):
        worlds.ctrl[:, 2] += 0.004
        worlds.ctrl[:, 6:] = [r.uniform(0.0, 1.2, size) for r in random]
        worlds.step(5)
        path.append(worlds.qpos.copy())
    return path


def test_a_world_among_others_moves_as_one_with_a_model_of_its_own(hand, objects, scene):
    index = np.array([3, 0, 5, 1, 2, 4, 0])
    names = [OBJECTS[i] for i in index]
    mass = np.array([0.3, 0.2, 1.1, 0.05, 0.058, 0.04, 0.4])
    friction = np.array([0.9, 0.4, 0.9, 0.7, 0.9, 1.2, 0.9])
    heights = standing(objects, names)
    together = collide(Worlds(scene, index, mass, friction, threads=2), heights, np.arange(7))
    assert np.isfinite(together[-1]).all()
    moved = np.abs(together[-1] - together[0]).max(axis=1)
    assert (moved > 0.01).all()
    for world, name in enumerate(names):
        alone = build_scene(hand, {name: objects[name]})
        one = Worlds(alone, np.zeros(1, int), mass[world : world + 1], friction[world : world + 1], threads=1)
        path = collide(one, heights[world : world + 1], np.array([world]))
        for ours, theirs in zip(together, path, strict=True):
            np.testing.assert_allclose(ours[world], theirs[0], rtol=0, atol=1e-10, err_msg=name)


def test_threads_do_not_matter(objects, scene):
    index = np.arange(len(OBJECTS))
    heights = standing(objects, OBJECTS)
    one, two = (collide(Worlds(scene, index, threads=n), heights, index, 60) for n in (1, 3))
    np.testing.assert_array_equal(one[-1], two[-1])


def test_stepping_some_worlds_leaves_the_others(objects, scene):
    worlds = Worlds(scene, np.zeros(3, int))
    put(worlds, np.full(3, 0.3))
    before = worlds.qpos.copy()
    worlds.step(10, np.array([1]))
    np.testing.assert_array_equal(worlds.qpos[[0, 2]], before[[0, 2]])
    assert worlds.qpos[1, 2] < before[1, 2]


def test_a_mass_is_that_of_an_object_of_this_mass(hand):
    """Scaling the mass of a world equals an object that has this mass."""
    light, heavy = builtin_object("mug", 0.2), builtin_object("mug", 0.7)
    scaled = Worlds(build_scene(hand, {"mug": light}), np.zeros(1, int), mass=np.array([0.7]))
    own = Worlds(build_scene(hand, {"mug": heavy}), np.zeros(1, int))
    for name in ("body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "dof_invweight0"):
        a = scaled.batch.expand(name)[0]
        np.testing.assert_allclose(a, getattr(own.batch.get_model(0), name), rtol=1e-9, err_msg=name)
    height = standing({"mug": light}, ["mug"])
    one, other = collide(scaled, height, np.zeros(1, int)), collide(own, height, np.zeros(1, int))
    np.testing.assert_allclose(one[20], other[20], rtol=0, atol=1e-7)


def test_a_world_that_was_given_another_object_moves_as_a_fresh_one(objects, scene):
    before, index = np.array([0, 1, 2]), np.array([3, 1, 5])
    mass, friction = np.array([0.3, 0.2, 1.1]), np.array([0.5, 0.9, 0.7])
    used = Worlds(scene, before, np.array([0.9, 0.2, 0.4]), np.array([1.2, 0.9, 0.3]), threads=1)
    collide(used, standing(objects, [OBJECTS[i] for i in before]), np.arange(3), 20)
    used.assign(np.array([2, 0]), index[[2, 0]], mass[[2, 0]], friction[[2, 0]])
    fresh = Worlds(scene, index, mass, friction, threads=1)
    heights = standing(objects, [OBJECTS[i] for i in index])
    for ours, theirs in zip(*(collide(w, heights, np.arange(3), 60) for w in (used, fresh)), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_objects_have_their_own_mass_again_when_none_is_given(hand, scene):
    alone = build_scene(hand, {"can": builtin_object("can")})
    for some, names in ((scene, OBJECTS), (alone, ("can",))):
        worlds = Worlds(some, np.zeros(2, int), mass=np.array([1.7, 1.7]))
        worlds.assign(np.array([1]), np.array([len(names) - 1]))
        own = Worlds(some, np.array([0, len(names) - 1]))
        for name in INERTIAL:
            ours, theirs = worlds.batch.expand(name), own.batch.expand(name)
            np.testing.assert_array_equal(ours[1], theirs[1], err_msg=name)
        assert np.abs(worlds.batch.expand("body_mass")[0] - own.batch.expand("body_mass")[0]).max() > 1.0


def test_settled_objects_weigh_what_they_weigh(objects, scene):
    mass = np.linspace(0.1, 1.2, len(OBJECTS))
    worlds = Worlds(scene, np.arange(len(OBJECTS)), mass=mass)
    put(worlds, standing(objects, OBJECTS) + 0.002, wrist_height=1.0)
    worlds.step(300)
    assert worlds.object_on_table.all() and not worlds.link_contacts.any()
    assert np.linalg.norm(worlds.qvel[:, :3], axis=1).max() < 0.02
    column = scene.model.sensor("object/table").adr[0]
    force = np.linalg.norm(worlds.sensordata[:, column + 1 : column + 4], axis=1)
    np.testing.assert_allclose(force, 9.81 * mass, rtol=0.05)


def test_friction_decides_what_slides(scene):
    """Cans that are pushed by a quarter of their weight."""
    settings = SceneSettings()
    worlds = Worlds(scene, np.full(2, OBJECTS.index("can")), friction=np.array([0.15, 0.35]))
    put(worlds, -builtin_object("can").vertices[:, 2].min().repeat(2), wrist_height=1.0)
    worlds.step(50)
    before = worlds.object_pose
    push = worlds.batch.bind("xfrc_applied")
    mass = builtin_object("can").mass
    push[:, scene.model.body("object").id, 0] = 0.25 * 9.81 * mass
    worlds.step(round(0.5 / settings.timestep))
    slid = np.linalg.norm(worlds.object_pose[:, :2] - before[:, :2], axis=1)
    assert slid[0] > 0.1 and slid[1] < 0.005


def test_sensors_see_contacts(hand, objects, scene):
    """A ball on a finger, on the table, in the air."""
    worlds = Worlds(scene, np.full(3, OBJECTS.index("tennis_ball")))
    worlds.reset()
    worlds.wrist_reference = pose_above(worlds, 0.5)
    worlds.forward()
    link = hand.link_names.index("middle_proximal")
    finger = worlds.batch.bind("xpos")
    worlds.forward()
    pose = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (3, 1))
    pose[0, :3] = finger[0, scene.model.body(f"hand/{hand.links[link][0]}").id] - [0.0, 0.0, 0.02]
    pose[1, 2] = 0.033
    pose[2, :3] = [0.4, 0.0, 0.3]
    worlds.object_pose = pose
    worlds.step(1)
    assert worlds.link_contacts[0, link] and not worlds.object_on_table[0]
    assert not worlds.link_contacts[1].any() and worlds.object_on_table[1]
    assert not worlds.link_contacts[2].any() and not worlds.object_on_table[2]
    forces = worlds.link_forces
    assert forces.shape == (3, len(hand.links))
    assert forces[0, link] > 0.1 and not forces[1:].any()
    assert not worlds.table_forces.any()


def test_the_table_stops_fingers_and_the_sensors_know(scene):
    worlds = Worlds(scene, np.zeros(1, int))
    worlds.reset()
    worlds.object_pose = np.array([[0.6, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0]])
    worlds.wrist_reference = pose_above(worlds, 0.12)
    worlds.forward()
    worlds.ctrl[:, 2] = 0.05
    worlds.step(200)
    assert worlds.table_forces.sum() > 1.0


def test_poses_written_are_poses_read(scene):
    worlds = Worlds(scene, np.zeros(4, int))
    random = np.random.default_rng(0)
    pose = random.normal(size=(4, 7))
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    worlds.object_pose, worlds.wrist_reference = pose, pose[::-1]
    joints = random.uniform(0, 1, size=worlds.joint_positions.shape)
    worlds.joint_positions = joints
    worlds.forward()
    np.testing.assert_array_equal(worlds.object_pose, pose)
    np.testing.assert_array_equal(worlds.wrist_reference, pose[::-1])
    np.testing.assert_array_equal(worlds.joint_positions, joints)
    same = np.abs(np.sum(worlds.palm_pose[:, 3:] * pose[::-1][:, 3:], axis=1))
    np.testing.assert_allclose(worlds.palm_pose[:, :3], pose[::-1][:, :3], atol=1e-9)
    np.testing.assert_allclose(same, 1.0, atol=1e-9)


def test_a_scene_needs_an_object(hand):
    with pytest.raises(FungraspError, match="at least one object"):
        build_scene(hand, {})


@pytest.mark.parametrize("name", ["allegro", "shadow", "faive", "inspire", "leap"])
def test_every_hand_fits_in_a_scene_and_stays_still(name):
    hand = load_hand(name)
    scene = build_scene(hand, {"can": builtin_object("can")})
    assert len(scene.finger_actuators) == len(hand.actuators)
    worlds = Worlds(scene, np.zeros(1, int))
    worlds.reset()
    worlds.wrist_reference = pose_above(worlds, 0.5)
    worlds.object_pose = np.array([[0.6, 0.0, 0.06, 1.0, 0.0, 0.0, 0.0]])
    matrix, offset = hand.coupling
    middle = np.clip(np.zeros(matrix.shape[1]), *scene.model.actuator_ctrlrange[scene.finger_actuators].T)
    worlds.joint_positions = (middle @ matrix.T + offset)[None]
    worlds.ctrl[:, scene.finger_actuators] = middle
    worlds.forward()
    worlds.step(100)
    palm = worlds.palm_pose[0]
    np.testing.assert_allclose(palm[:3], [0.0, 0.0, 0.5], atol=2e-3)
    assert np.abs(worlds.qvel[0, 6:]).max() < 0.2


def test_a_world_that_explodes_is_known_as_broken_until_it_is_reset(scene, objects, monkeypatch, tmp_path):
    # MuJoCo writes a log where it is.
    monkeypatch.chdir(tmp_path)
    worlds = Worlds(scene, np.zeros(3, dtype=int), threads=1)
    put(worlds, standing(objects, OBJECTS[:1] * 3))
    worlds.step(5)
    assert not worlds.broken.any()
    worlds.qvel[1] = 1e9
    worlds.step(5)
    assert np.isfinite(worlds.qpos).all()
    np.testing.assert_array_equal(worlds.broken, [False, True, False])
    worlds.step(5)
    worlds.reset(np.array([0]))
    np.testing.assert_array_equal(worlds.broken, [False, True, False])
    worlds.reset(np.array([1]))
    worlds.step(5)
    assert not worlds.broken.any()


def test_a_command_that_is_not_a_number_breaks_a_world(scene, objects, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    worlds = Worlds(scene, np.zeros(2, dtype=int), threads=1)
    put(worlds, standing(objects, OBJECTS[:1] * 2))
    worlds.ctrl[0, 0] = np.nan
    worlds.step(1)
    np.testing.assert_array_equal(worlds.broken, [True, False])
