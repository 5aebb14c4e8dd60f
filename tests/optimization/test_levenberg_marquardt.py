"""The optimiser: bounds, descent, independence of the batch."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from retarget_scenes import held, plain_objects

from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.levenberg_marquardt import NormalEquations, minimize
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.optimization.terms import Term
from fungrasp.retargeting.contact_optimization import initial_pose

TERMS: list[Term] = [
    partial(terms.fingertip_position, unit=0.01),
    partial(terms.link_direction, unit=0.5),
    partial(terms.object_penetration, unit=0.001),
    partial(terms.self_penetration, unit=0.001),
]


def setting(name: str, rows: slice = slice(None)) -> tuple[HandPoints, RetargetingProblem]:
    hand = load_hand(name)
    count = len(range(6)[rows])
    points = HandPoints(HandKinematics(hand, count))
    return points, RetargetingProblem.from_grasps(held(), plain_objects(), points.match).rows(rows)


def cost_of(
    points: HandPoints, problem: RetargetingProblem, pose: np.ndarray, joints: np.ndarray
) -> np.ndarray:
    equations = NormalEquations(points, problem, TERMS)
    found = equations.empty(np.ones(len(problem), dtype=bool))
    equations.evaluate(found, pose, joints)
    return found.cost


@pytest.mark.parametrize("name", ["allegro", "inspire"])
def test_cost_never_grows_and_is_the_one_reported(name: str):
    points, problem = setting(name)
    start = initial_pose(points, problem)
    costs = [cost_of(points, problem, *start)]
    for iterations in (0, 1, 3, 10, 30):
        pose, joints, cost = minimize(points, problem, TERMS, *start, iterations)
        np.testing.assert_allclose(cost, cost_of(points, problem, pose, joints), rtol=1e-9)
        assert np.all(cost <= costs[-1] + 1e-9)
        costs.append(cost)
    assert np.all(costs[-1] < 0.5 * costs[0])


def test_without_iterations_nothing_moves():
    points, problem = setting("leap")
    pose, joints = initial_pose(points, problem)
    before = pose.copy(), joints.copy()
    result = minimize(points, problem, TERMS, pose, joints, 0)
    for found, given, kept in zip(result[:2], (pose, joints), before, strict=True):
        np.testing.assert_array_equal(found, kept)
        np.testing.assert_array_equal(given, kept)
    minimize(points, problem, TERMS, pose, joints, 3)
    np.testing.assert_array_equal(pose, before[0])
    np.testing.assert_array_equal(joints, before[1])


@pytest.mark.parametrize("name", ["allegro", "shadow", "inspire"])
def test_joints_stop_at_their_limits(name: str):
    """Human fingertips that are out of reach pull the joints against their stops."""
    points, problem = setting(name)
    far = problem.joints.copy()
    far[:, 4::4] += 0.3 * np.random.default_rng(0).normal(size=far[:, 4::4].shape)
    problem = type(problem)(**{**vars(problem), "joints": far})
    kinematics = points.kinematics
    pose, joints, _ = minimize(
        points, problem, [terms.fingertip_position], *initial_pose(points, problem), 40
    )
    assert np.all(joints >= kinematics.lower)
    assert np.all(joints <= kinematics.upper)
    assert np.any((joints == kinematics.lower) | (joints == kinematics.upper))
    full = joints @ kinematics.matrix.T + kinematics.offset
    limits = kinematics.hand.joint_limits
    assert np.all((full >= limits[:, 0] - 1e-9) & (full <= limits[:, 1] + 1e-9))
    np.testing.assert_allclose(np.linalg.norm(pose[:, 3:], axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("name", ["allegro", "inspire"])
def test_a_batch_is_each_grasp_by_itself(name: str):
    points, problem = setting(name)
    together = minimize(points, problem, TERMS, *initial_pose(points, problem), 15)
    for row in (0, 3, 5):
        alone_points, alone = setting(name, slice(row, row + 1))
        found = minimize(alone_points, alone, TERMS, *initial_pose(alone_points, alone), 15)
        for batch, single in zip(together, found, strict=True):
            np.testing.assert_allclose(batch[row], single[0], rtol=1e-6, atol=1e-7)


def test_grasps_that_have_left_are_not_touched():
    points, problem = setting("allegro")
    loops = NormalEquations(points, problem, [terms.contact_gap, terms.link_direction])
    found = loops.empty(np.array([True, False, True, True, False, True]))
    found.cost[:] = 7.0
    loops.evaluate(found, *initial_pose(points, problem))
    assert np.all((found.cost == 7.0) == [False, True, False, False, True, False])
    assert np.all(found.gradient[[1, 4]] == 0)


def test_a_row_that_is_not_a_number_harms_no_other():
    points, problem = setting("allegro")
    start = initial_pose(points, problem)
    objective = [terms.contact_gap, terms.object_penetration, terms.link_direction]
    expected = minimize(points, problem, objective, *start, 10)
    problem.joints[2] = np.nan
    found = minimize(points, problem, objective, *start, 10)
    others = [0, 1, 3, 4, 5]
    for got, wanted in zip(found, expected, strict=True):
        np.testing.assert_array_equal(got[others], wanted[others])
    np.testing.assert_array_equal(found[0][2], start[0][2])
