"""Where objects rest, and with which centers of mass."""

from __future__ import annotations

import numpy as np
import pytest

from fungrasp.geometry.poses import rotate
from fungrasp.hands import load_hand
from fungrasp.objects import builtin_object, plain_shape
from fungrasp.simulation import MujocoCpuEngine, SceneSettings, build_scene
from fungrasp.task.object_placement import resting_shift

HALF = np.sqrt(0.5)
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
ON_ITS_SIDE = np.array([0.0, 0.0, 0.0, HALF, HALF, 0.0, 0.0])
"""The object's y axis points up."""


def rested(name: str, pose: np.ndarray, *shift: float) -> np.ndarray:
    return resting_shift([plain_shape(name, 0.3)], pose[None], np.array([shift]))[0]


def test_what_stands_on_its_foot_keeps_its_shift():
    np.testing.assert_array_equal(rested("box:60x60x60", UPRIGHT, 0.15, -0.1, 0.15), [0.15, -0.1, 0.15])
    np.testing.assert_array_equal(rested("box:60x60x60", UPRIGHT, 0.0, 0.0, 0.0), 0.0)


def test_a_ball_has_its_mass_low():
    shift = rested("sphere:67", UPRIGHT, 0.12, 0.05, 0.1)
    assert shift[2] == pytest.approx(-0.12, abs=1e-3) and np.linalg.norm(shift[:2]) < 0.02


def test_a_can_on_its_side_keeps_its_shift_along_its_axis():
    shift = rested("cylinder:66x115", ON_ITS_SIDE, 0.14, 0.05, 0.1)
    across, up, along = shift
    assert along == pytest.approx(0.1, abs=1e-6)
    assert abs(across) < 0.03 and up == pytest.approx(-0.14, abs=0.005)


def test_no_fraction_becomes_larger_than_the_largest_drawn():
    rng = np.random.default_rng(0)
    drawn = rng.uniform(-0.15, 0.15, (50, 3))
    turns = rng.normal(size=(50, 4))
    poses = np.concatenate([np.zeros((50, 3)), turns / np.linalg.norm(turns, axis=1, keepdims=True)], axis=1)
    shift = resting_shift([builtin_object("mug")] * 50, poses, drawn)
    assert (np.abs(shift).max(axis=1) <= np.abs(drawn).max(axis=1) + 1e-9).all()


@pytest.mark.parametrize("name", ["can", "tennis_ball", "bottle"])
def test_round_objects_rest_in_simulation(name):
    """Forty shifts of an object on its side, none of which rolls by a centimeter within a second; as they
    were drawn, most do."""
    model, count = builtin_object(name), 40
    scene = build_scene(load_hand("allegro"), {name: model}, SceneSettings(timestep=0.01))
    pose = np.tile(ON_ITS_SIDE, (count, 1))
    pose[:, 2] = -rotate(ON_ITS_SIDE[3:], model.vertices)[:, 2].min()
    drawn = np.random.default_rng(0).uniform(-0.15, 0.15, (count, 3))
    moved = {}
    for label, shift in (("drawn", drawn), ("rested", resting_shift([model] * count, pose, drawn))):
        engine = MujocoCpuEngine(scene, count, 1)
        engine.set_parameters(
            object_mass=np.full(count, model.mass),
            object_center=model.center_of_mass + shift * model.size,
            object_inertia=np.tile(model.inertia, (count, 1, 1)),
        )
        away = np.tile([0.0, 0.0, 3.0, 1.0, 0.0, 0.0, 0.0], (count, 1))
        engine.set_state(object_pose=pose, wrist_frame=away)
        fingers = scene.hand.independent(engine.joint_positions)
        engine.step(engine.controls(away, np.zeros((count, 3)), fingers), 100)
        moved[label] = np.linalg.norm(engine.object_pose[:, :3] - pose[:, :3], axis=1)
    assert np.mean(moved["drawn"] > 0.01) > 0.5
    assert np.mean(moved["rested"] > 0.01) < 0.05
