"""Differences drawn anew for each trial."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fungrasp.hands import load_hand
from fungrasp.objects import builtin_object
from fungrasp.simulation import Worlds, build_scene
from fungrasp.transfer import NONE, Differences, Randomisation

SETTLED = np.tile([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0], (2, 1))


def differences(randomisation: Randomisation, count: int = 4, hand: str = "allegro") -> Differences:
    scene = build_scene(load_hand(hand), {name: builtin_object(name) for name in ("can", "mug")})
    worlds = Worlds(scene, np.zeros(count, dtype=int), threads=1)
    worlds.reset()
    return Differences(randomisation, worlds, np.random.default_rng(0))


def test_without_differences_everything_is_as_told():
    same = differences(NONE, hand="inspire")
    ids = np.array([1, 3])
    same.begin(ids, np.zeros(2, dtype=int), np.array([0.2, 0.3]))
    np.testing.assert_allclose(same.placed(ids, SETTLED), SETTLED)
    assert not same.latency(ids, 0.1).any()
    joints = np.linspace(0, 1, 4 * same.worlds.scene.hand.coupling[0].shape[1]).reshape(4, -1)
    np.testing.assert_allclose(same.joints(joints), joints)
    pose = np.tile([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0], (4, 1))
    np.testing.assert_allclose(same.palm(pose), pose)
    np.testing.assert_allclose(same.object(pose), pose)
    body = same.worlds.model.body("object").id
    np.testing.assert_allclose(same.worlds.batch.expand("body_mass")[ids, body], [0.2, 0.3])


def test_a_trial_that_begins_leaves_the_others():
    random = differences(Randomisation())
    ids = np.array([0, 2])
    before = random.drawn
    random.begin(ids, np.array([0, 1]), np.array([0.2, 0.2]))
    for name in ("mass", "stiffness", "table_height", "object_bias", "push"):
        was, now = getattr(before, name), getattr(random.drawn, name)
        np.testing.assert_array_equal(now[[1, 3]], was[[1, 3]], err_msg=name)
        assert (now[ids] != was[ids]).any(), name
    body = random.worlds.model.body("object").id
    mass = random.worlds.batch.expand("body_mass")[ids, body]
    np.testing.assert_allclose(mass, 0.2 * random.drawn.mass[ids])


def test_objects_stand_on_the_table_that_was_drawn():
    random = differences(replace(NONE, table_height=(-0.01, 0.01), object_shift=0.02))
    ids = np.array([0, 2])
    random.begin(ids, np.array([0, 1]), np.array([0.2, 0.2]))
    placed = random.placed(ids, SETTLED)
    np.testing.assert_allclose(placed[:, 2] - SETTLED[:, 2], random.drawn.table_height[ids])
    table = random.worlds.model.geom("table").id
    height = random.worlds.batch.expand("geom_pos")[ids, table, 2] - random.worlds.model.geom_pos[table, 2]
    np.testing.assert_allclose(height, random.drawn.table_height[ids])
    assert (height != 0).all()
    moved = np.linalg.norm(placed[:, :2] - SETTLED[:, :2], axis=1)
    assert ((moved > 0) & (moved <= 0.02)).all()


def test_delays_are_added_and_cut():
    late = differences(replace(NONE, observation_delay=(0.08, 0.08), action_delay=(0.05, 0.05)))
    np.testing.assert_allclose(late.latency(np.array([0, 1]), 0.1), 0.1)
    np.testing.assert_allclose(late.latency(np.array([0, 1]), 0.2), 0.13)


def test_pushes_come_once_the_lift_has_begun():
    pushed = differences(replace(NONE, push_force=(2.0, 2.0), push_start=(0.5, 0.5)))
    force = pushed.worlds.batch.bind("xfrc_applied")[:, pushed.worlds.model.body("object").id, :3]
    pushed.push(np.array([-np.inf, 0.4, 0.6, 0.8]))
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), [0, 0, 2.0, 0])
