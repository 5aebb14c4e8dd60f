"""The hand's skeleton: exact derivatives, joints that are a person's, solving for it."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fungrasp.grasps import load_human_grasps
from fungrasp.grasps.human_hand import ADULT_BONES, bone_lengths, joint_bends
from fungrasp.perception.hand.fit import skeleton_through
from fungrasp.perception.hand.image_evidence import FAR_BONES, NEAR_BONES, direction_evidence
from fungrasp.perception.hand.physical_evidence import anatomy_evidence
from fungrasp.perception.hand.skeleton import (
    ANGLE_LOW,
    ANGLE_MEAN,
    LONGEST_STEP,
    PARAMETERS,
    SIZE,
    HandEvidence,
    Skeleton,
    damped_step,
    normal_equations,
    robust_weights,
)


def random_skeleton(seed: int) -> Skeleton:
    rng = np.random.default_rng(seed)
    step = rng.normal(size=SIZE) * 0.2
    step[PARAMETERS["bases"]] *= 0.02
    step[PARAMETERS["bones"]] *= 0.5
    step[PARAMETERS["size"]] *= 0.5
    return Skeleton.usual(rng.normal(size=3), Rotation.random(rng=rng).as_matrix()).moved(step)


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000))
def test_derivatives_are_those_of_the_joints(seed):
    hand = random_skeleton(seed)
    joints, jacobian = hand.joints_and_derivatives()
    np.testing.assert_array_equal(joints, hand.joints())
    way = np.random.default_rng(seed).normal(size=SIZE)
    ahead, behind = hand.moved(1e-6 * way).joints(), hand.moved(-1e-6 * way).joints()
    np.testing.assert_allclose(jacobian @ way, (ahead - behind) / 2e-6, atol=1e-7)


def test_the_usual_hand_is_an_adults():
    hand = Skeleton.usual(np.zeros(3), np.eye(3))
    low, high = ADULT_BONES[..., 0].ravel() * 0.85, ADULT_BONES[..., 1].ravel() * 1.15
    lengths = 1000 * bone_lengths(hand.joints())
    assert ((lengths > low) & (lengths < high)).all()
    flexion, deviation = joint_bends(hand.joints())
    assert (flexion > 0).all() and np.abs(deviation[:4]).max() < np.radians(25)


def test_flexion_bends_a_right_hand_and_size_scales_it():
    hand = Skeleton.usual(np.zeros(3), np.eye(3))
    step = np.zeros(SIZE)
    step[PARAMETERS["angles"].start + 9 + 3 + 1] = 0.3
    before, after = joint_bends(hand.joints())[0], joint_bends(hand.moved(step).joints())[0]
    np.testing.assert_allclose(after[1] - before[1], [0, 0.3, 0], atol=0.01)
    np.testing.assert_allclose(after[[0, 2, 3]], before[[0, 2, 3]], atol=1e-9)
    grown = np.zeros(SIZE)
    grown[PARAMETERS["size"]] = np.log(1.1)
    np.testing.assert_allclose(hand.moved(grown).joints(), 1.1 * hand.joints())


def test_it_can_take_the_postures_of_real_grasps():
    joints = load_human_grasps("builtin").hand_joints[::5]
    off = [np.linalg.norm(skeleton_through(hand, 0.002).joints() - hand, axis=1) for hand in joints]
    assert np.mean(off) < 0.004


def test_limits_count_only_beyond_them():
    hand = Skeleton.usual(np.zeros(3), np.eye(3))
    assert not anatomy_evidence(hand)[-1].residual.any()
    step = np.zeros(SIZE)
    step[PARAMETERS["angles"].start + 3 + 1] = ANGLE_LOW[0, 1, 1] - ANGLE_MEAN[0, 1, 1] - 0.2
    assert np.count_nonzero(anatomy_evidence(hand.moved(step))[-1].residual) == 1


def test_shape_evidence_forgives_a_turn_of_the_whole():
    hand = random_skeleton(3)
    joints, jacobian = hand.joints_and_derivatives()
    bones = joints[FAR_BONES] - joints[NEAR_BONES]
    units = bones / np.linalg.norm(bones, axis=1)[:, None]
    turn = np.array([0.004, -0.003, 0.002])
    turned = direction_evidence(joints, jacobian, Rotation.from_rotvec(turn).apply(units), 0.3)
    np.testing.assert_allclose(turned.residual + turned.jacobian[:, SIZE:] @ -turn, 0, atol=1e-4)
    assert np.abs(turned.residual).max() > 0.005


def test_outliers_hardly_count_and_groups_are_judged_together():
    block = HandEvidence(np.array([0.0, 1.0, 30.0, 0.0]), np.zeros((4, 1)), outlier=3.0, group=2)
    weights = robust_weights(block)
    np.testing.assert_allclose(weights[:2], (1 + 1 / 9) ** -2)
    assert weights[2] == weights[3] < 1e-3
    each = HandEvidence(np.array([1.0, 1.0]), np.zeros((2, 1)), outlier=np.array([1.0, np.inf]))
    np.testing.assert_allclose(robust_weights(each), [0.25, 1.0])
    assert (robust_weights(HandEvidence(np.full(3, 9.0), np.zeros((3, 1)))) == 1).all()


def test_steps_solve_linear_problems_and_are_never_too_long():
    rng = np.random.default_rng(0)
    jacobian, residual = rng.normal(size=(200, SIZE)), rng.normal(size=200) * 0.01
    step = damped_step(*normal_equations([HandEvidence(residual, jacobian)], SIZE), damping=0.0)
    np.testing.assert_allclose(step, np.linalg.lstsq(jacobian, -residual, rcond=None)[0], atol=1e-8)
    far = damped_step(*normal_equations([HandEvidence(residual * 1e4, jacobian)], SIZE))
    assert max(np.abs(far[PARAMETERS[k]]).max() / most for k, most in LONGEST_STEP.items()) <= 1 + 1e-9
