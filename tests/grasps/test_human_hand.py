"""The human hand: names, bones, directions, mirroring, anatomy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import (
    BONES,
    HUMAN_JOINTS,
    HUMAN_LINKS,
    bone_lengths,
    finger_link_directions,
    load_human_grasps,
)
from fungrasp.grasps.anatomy import check_anatomy
from fungrasp.grasps.human_hand import hand_sides, joint_bends, mirror_points, mirror_pose

DEXYCB = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "dexycb_train.npz"

angles = st.tuples(st.floats(-0.5, 1.4), st.floats(0, 1.7), st.floats(0, 1.4))


def test_names():
    assert len(set(HUMAN_JOINTS)) == 21 and HUMAN_JOINTS[1] == "index_mcp" and HUMAN_JOINTS[17] == "thumb_cmc"
    assert len(set(HUMAN_LINKS)) == 16 and HUMAN_LINKS[:2] == ("palm", "index_proximal")
    near_far = {(HUMAN_JOINTS[near], HUMAN_JOINTS[far]) for near, far in BONES}
    assert {("wrist", "ring_mcp"), ("ring_mcp", "ring_pip"), ("thumb_ip", "thumb_tip")} <= near_far


def test_directions_of_a_flat_hand(hand):
    joints = hand((0, 0, 0))
    directions = finger_link_directions(np.stack([joints, 2 * joints]))
    assert directions.shape == (2, 5, 3, 3)
    np.testing.assert_allclose(directions[0], directions[1])
    toward = joints[5] / np.linalg.norm(joints[5])
    np.testing.assert_allclose(directions[0, 1], [toward] * 3, atol=1e-12)
    np.testing.assert_allclose(bone_lengths(joints)[4:8], [0.090, 0.042, 0.025, 0.022])


@given(bends=angles, turn=st.integers(0, 50))
def test_bends_are_those_the_hand_was_made_with_in_any_frame(bends, turn):
    from bent_hand import bent_hand

    joints = bent_hand(bends) @ Rotation.random(rng=turn).as_matrix().T + [1, 2, 3]
    flexion, deviation = joint_bends(joints)
    # A finger bends about its own axis, not about the line across the palm: the difference is small.
    np.testing.assert_allclose(flexion[1], bends, atol=0.05)
    assert np.abs(deviation[1, 0]) < 0.35
    unsigned, _ = joint_bends(np.stack([joints, joints]))
    np.testing.assert_allclose(unsigned[1, 4], flexion[4])


def test_anatomy_names_what_is_wrong(human_grasps, hand):
    grasps = human_grasps(2)
    assert check_anatomy(grasps) == []
    at = grasps.object_pose[:, None, :3]
    long = hand() * 1.0
    long[8] = long[7] + (long[8] - long[7]) * 2.5
    backwards = hand((-1.3, 0.5, 0.3))
    findings = check_anatomy(human_grasps(2, hand_joints=np.stack([long, backwards]) + at))
    assert any(f.startswith("grasp 0 (object 0): the bone from middle_dip to middle_tip") for f in findings)
    assert any(f.startswith("grasp 1 (object 1): index_mcp is bent -7") for f in findings)


def test_a_left_hand_is_told_by_its_bends(human_grasps, hand):
    grasps = human_grasps(1)
    at = grasps.object_pose[:, None, :3]
    left = mirror_points(hand((0.9, 1.2, 0.6)))
    assert hand_sides(np.stack([left, mirror_points(left)])).tolist() == ["left", "right"]
    assert check_anatomy(human_grasps(1, hand_joints=left + at)) == []
    assert check_anatomy(human_grasps(1, hand_joints=mirror_points(left) + at)) == []


@given(seed=st.integers(0, 1000))
def test_mirroring_a_scene_mirrors_every_point(seed):
    random = np.random.default_rng(seed)
    quaternion = Rotation.random(rng=seed).as_quat(scalar_first=True)
    pose = np.concatenate([random.normal(size=3), quaternion])
    points = random.normal(size=(5, 3))
    world = transform_points(pose, points)
    mirrored = transform_points(mirror_pose(pose), mirror_points(points))
    np.testing.assert_allclose(mirrored, mirror_points(world), atol=1e-12)
    np.testing.assert_array_equal(mirror_pose(mirror_pose(pose)), pose)


@pytest.mark.skipif(not DEXYCB.is_file(), reason="the shared DexYCB grasps are not here")
def test_real_hands_are_found_sound():
    assert len(check_anatomy(load_human_grasps(DEXYCB))) <= 1
