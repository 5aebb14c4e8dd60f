"""Scenes of any hand and any objects."""

from __future__ import annotations

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.objects import builtin_object
from fungrasp.simulation import MujocoCpuEngine, build_scene


def test_a_scene_needs_an_object():
    with pytest.raises(FungraspError, match="at least one object"):
        build_scene(load_hand("allegro"), {})


def test_objects_are_numbered_by_name():
    objects = {name: builtin_object(name) for name in ("mug", "can")}
    assert build_scene(load_hand("allegro"), objects).indices(["can", "mug", "can"]).tolist() == [1, 0, 1]


@pytest.mark.parametrize("name", ["allegro", "shadow", "faive", "inspire", "leap"])
def test_every_hand_fits_in_a_scene_and_stays_still(name):
    hand = load_hand(name)
    scene = build_scene(hand, {"can": builtin_object("can")})
    assert len(scene.finger_actuators) == len(hand.actuators)
    engine = MujocoCpuEngine(scene, 1)
    frame = np.array([[0.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.0]])
    fingers = np.clip(np.zeros((1, len(hand.actuators))), *scene.servo_limits.T)
    joints = hand.all_joints(fingers)
    away = np.array([[0.6, 0.0, 0.06, 1.0, 0.0, 0.0, 0.0]])
    engine.set_state(object_pose=away, wrist_frame=frame, joint_positions=joints)
    engine.step(engine.controls(frame, np.zeros((1, 3)), fingers), 100)
    np.testing.assert_allclose(engine.palm_pose[0, :3], [0.0, 0.0, 0.5], atol=2e-3)
    assert np.abs(engine.batch.bind("qvel")[0, 6:]).max() < 0.2
