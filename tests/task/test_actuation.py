"""Servos that lag, are badly calibrated and have play."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fungrasp.sim2real import offset_pose
from fungrasp.task.actuation import Actuation
from fungrasp.task.setpoints import SetpointSequence

PERIOD = 0.02
STILL = np.array([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0])


def sequence(palm: np.ndarray, fingers: np.ndarray, velocity: np.ndarray | None = None) -> SetpointSequence:
    """palm: [S, W, 7]; fingers: [S, W, U]."""
    speed = np.zeros((*palm.shape[:2], 3)) if velocity is None else velocity
    return SetpointSequence(palm[-1], palm, speed, fingers)


def started(count: int = 1, joints: int = 2) -> Actuation:
    actuation = Actuation(count, joints)
    actuation.begin(
        np.arange(count), np.tile(STILL, (count, 1)), np.zeros((count, 3)), np.zeros((count, joints))
    )
    return actuation


def test_perfect_servos_follow_what_they_are_told():
    told = sequence(np.tile(STILL, (5, 1, 1)), np.random.default_rng(0).random((5, 1, 2)))
    followed = started().follow(told, PERIOD)
    assert followed.palm is told.palm and followed.fingers is told.fingers


def test_a_lag_makes_the_share_of_a_step_that_its_time_constant_says():
    actuation = started(2)
    actuation.wrist_lag[:] = [0.05, 0.0]
    goal = STILL.copy()
    goal[0] += 0.01
    goal[3:] = Rotation.from_rotvec([0.0, 0.2, 0.0]).as_quat(scalar_first=True)
    told = sequence(np.tile(goal, (5, 2, 1)), np.zeros((5, 2, 2)))
    palm = actuation.follow(told, PERIOD).palm
    share = 1.0 - np.exp(-PERIOD * np.arange(1, 6) / 0.05)
    np.testing.assert_allclose(palm[:, 0, 0] - STILL[0], 0.01 * share)
    turned = Rotation.from_quat(palm[:, 0, 3:], scalar_first=True).as_rotvec()[:, 1]
    np.testing.assert_allclose(turned, 0.2 * share)
    np.testing.assert_allclose(palm[:, 1], told.palm[:, 1])
    again = actuation.follow(told, PERIOD).palm[-1, 0, 0] - STILL[0]
    assert again == pytest.approx(0.01 * (1.0 - np.exp(-0.2 / 0.05))), "it goes on from where it was"


def test_play_is_taken_up_before_a_joint_follows():
    actuation = started()
    actuation.backlash[:] = [[0.01, 0.0]]
    there, back = np.linspace(0.01, 0.05, 5), np.linspace(0.04, 0.0, 5)
    palm = np.tile(STILL, (5, 1, 1))
    up = actuation.follow(sequence(palm, np.repeat(there[:, None, None], 2, axis=2)), PERIOD).fingers[:, 0]
    np.testing.assert_allclose(up[:, 0], there - 0.01)
    np.testing.assert_allclose(up[:, 1], there)
    down = actuation.follow(sequence(palm, np.repeat(back[:, None, None], 2, axis=2)), PERIOD).fingers[:, 0]
    np.testing.assert_allclose(down[:, 0], [0.04, 0.04, 0.03, 0.02, 0.01])


def test_what_is_badly_calibrated_is_off_and_does_not_show():
    offset = np.array([[0.002, -0.001, 0.002, 0.01, 0.0, -0.01]])
    actuation = Actuation(1, 2)
    actuation.wrist_offset[:], actuation.encoder_bias[:] = offset, [[0.01, -0.02]]
    told = sequence(np.tile(STILL, (5, 1, 1)), np.full((5, 1, 2), 0.3))
    palm, fingers = actuation.begin(np.array([0]), STILL[None], np.zeros((1, 3)), np.full((1, 2), 0.3))
    np.testing.assert_allclose(palm, offset_pose(STILL[None], offset))
    np.testing.assert_allclose(fingers, [[0.29, 0.32]])
    followed = actuation.follow(told, PERIOD)
    np.testing.assert_allclose(followed.palm[-1], palm)
    np.testing.assert_allclose(followed.fingers[-1], fingers)
    np.testing.assert_allclose(actuation.seen_palm(palm), STILL[None], atol=1e-12)
