"""Several hands of one image stay together: rows of a file, and alternatives of one robot grasp."""

from __future__ import annotations

import numpy as np
import pytest

from fungrasp.errors import FungraspError
from fungrasp.grasps import RobotGraspSet, builtin_grasps, load_human_grasps, save_human_grasps
from fungrasp.grasps.alternatives import (
    PROBABILITY,
    alternative_rows,
    join_alternatives,
    share_out,
    take_alternatives,
)


def robot_grasps(count: int) -> RobotGraspSet:
    """Grasps told apart by their first joint."""
    pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (count, 1))
    joints = np.zeros((count, 3))
    joints[:, 0] = np.arange(count)
    return RobotGraspSet(
        hand="some",
        object_name=np.full(count, "mug"),
        object_mass=np.full(count, 0.3),
        object_pose=pose,
        object_rest_pose=pose,
        wrist_pose=pose,
        joint_names=("a", "b", "c"),
        joint_positions=joints,
        keypoints=np.zeros((count, 4, 3)),
        link_contacts=np.zeros((count, 5), dtype=bool),
    )


def test_probabilities_are_kept_in_the_file(tmp_path):
    from dataclasses import replace

    grasps = replace(builtin_grasps().select([0, 0, 1]), probability=np.array([0.75, 0.25, 1.0]))
    save_human_grasps(tmp_path / "grasps.npz", grasps)
    again = load_human_grasps(tmp_path / "grasps.npz")
    assert again.probability is not None
    assert again.probability.tolist() == [0.75, 0.25, 1.0]
    assert again[1].probability == 0.25 and builtin_grasps().probability is None


def test_one_row_of_each_image():
    grasps = join_alternatives(robot_grasps(4), np.array([0.6, 0.3, 0.1, 1.0]))
    assert grasps.joint_positions[:, 0].tolist() == [0, 3]
    np.testing.assert_allclose(grasps.extra[PROBABILITY], [[0.6, 0.3, 0.1], [1.0, 0, 0]])
    assert take_alternatives(grasps, np.array([2, 0])).joint_positions[:, 0].tolist() == [2, 3]


def test_alternatives_that_were_torn_apart_are_refused():
    with pytest.raises(FungraspError, match=r"row 1: .*must sum to 1"):
        alternative_rows(np.array([1.0, 0.6, 0.3]))
    with pytest.raises(FungraspError, match="row 0"):
        alternative_rows(np.array([0.6, 0.6]))


def test_candidates_are_shared_out_by_probability():
    grasps = join_alternatives(robot_grasps(4), np.array([0.3, 0.5, 0.2, 1.0]))
    which, number = share_out(grasps, 10)
    assert which[0].tolist() == [0, 0]
    assert np.bincount(which[:, 0]).tolist() == [3, 5, 2]
    assert not which[:, 1].any() and number[:, 1].tolist() == list(range(10))
    # Each alternative is tried as it is before it is varied.
    for one in range(3):
        assert number[which[:, 0] == one, 0].tolist() == list(range((which[:, 0] == one).sum()))


def test_a_grasp_without_alternatives_is_varied_as_before():
    which, number = share_out(robot_grasps(2), 3)
    assert not which.any() and number.tolist() == [[0, 0], [1, 1], [2, 2]]
    grasps = robot_grasps(2)
    assert take_alternatives(grasps, which[0]) is grasps
