"""Compiled loops against the NumPy code that they stand for."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from retarget_scenes import held, plain_objects

from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization import terms
from fungrasp.optimization.firmness import NO_GRIP, unresisted_share
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.levenberg_marquardt import minimize, objective_equations
from fungrasp.optimization.retargeting_problem import RetargetingProblem
from fungrasp.retargeting.contact_optimization import initial_pose

pytest.importorskip("numba", reason="the compiled loops need Numba (extra 'fast')")

from fungrasp.optimization.compiled.solver import NormalEquations

HANDS = ("allegro", "inspire")
"""A hand with independent joints and one with coupled ones."""


class Setting:
    """Six hands near the objects that they are to hold, some in them, in the table and in themselves."""

    def __init__(self, name: str):
        hand = load_hand(name)
        grasps = held()
        self.points = HandPoints(HandKinematics(hand, len(grasps)))
        self.problem = RetargetingProblem.from_grasps(grasps, plain_objects(), self.points.match)
        pose, joints = initial_pose(self.points, self.problem)
        random = np.random.default_rng(0)
        pose[:, :3] += random.normal(0, 0.01, pose[:, :3].shape)
        kinematics = self.points.kinematics
        joints = joints + random.uniform(0.0, 0.4, joints.shape) * (kinematics.upper - kinematics.lower)
        self.pose, self.joints = pose, np.clip(joints, kinematics.lower, kinematics.upper)


def every_term(setting: Setting) -> dict:
    start = (setting.pose + 0.01, 0.9 * setting.joints)
    return {
        "fingertip_position": terms.fingertip_position,
        "link_direction": terms.link_direction,
        "links of the thumb": partial(terms.link_direction, links=np.array([1, 2])),
        "contact_position": terms.contact_position,
        "contact_gap": terms.contact_gap,
        "object_penetration": terms.object_penetration,
        "deepest only": partial(terms.object_penetration, margin=0.02, count=5),
        "table_penetration": partial(terms.table_penetration, margin=0.05),
        "self_penetration": partial(terms.self_penetration, margin=0.01),
        "force_closure": partial(terms.force_closure, unit=0.3),
        "stay_near": partial(terms.stay_near, start=start, position_unit=0.05, rotation_unit=0.3),
        "a term of one's own": lambda state: terms.contact_gap(state, unit=0.002),
    }


@pytest.mark.parametrize("name", HANDS)
def test_normal_equations_are_those_of_numpy(name: str):
    setting = Setting(name)
    points, problem, pose, joints = setting.points, setting.problem, setting.pose, setting.joints
    for label, term in every_term(setting).items():
        expected = objective_equations(HandState(points, problem, pose, joints), [term])
        assert np.any(expected[0] > 0), label
        loops = NormalEquations(points, problem, [term])
        found = loops.empty(np.ones(len(problem), dtype=bool))
        loops.evaluate(found, pose, joints)
        lower = np.tril(np.ones_like(expected[1]))
        pairs = zip((found.cost, lower * found.hessian, found.gradient), expected, strict=True)
        for got, wanted in pairs:
            wanted = lower * wanted if wanted.ndim == 3 else wanted
            np.testing.assert_allclose(
                got, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max(), err_msg=label
            )


@pytest.mark.parametrize("name", HANDS)
def test_the_same_minimum(name: str):
    """Roundings grow from step to step: few steps agree closely, many end as low."""
    setting = Setting(name)
    objective = [
        terms.contact_position,
        terms.contact_gap,
        terms.object_penetration,
        terms.link_direction,
        partial(terms.force_closure, unit=0.3),
        partial(terms.stay_near, start=(setting.pose, setting.joints), unit=3.0),
    ]
    start = setting.pose, setting.joints
    for iterations, tolerance in ((4, 1e-6), (40, 0.1)):
        found = minimize(setting.points, setting.problem, objective, *start, iterations)
        expected = minimize(setting.points, setting.problem, objective, *start, iterations, compiled=False)
        np.testing.assert_allclose(found[2], expected[2], rtol=tolerance, atol=tolerance)
        if iterations == 4:
            np.testing.assert_allclose(found[0], expected[0], atol=1e-6)
            np.testing.assert_allclose(found[1], expected[1], atol=1e-6)


def test_grasps_that_have_left_are_not_touched():
    setting = Setting("allegro")
    loops = NormalEquations(setting.points, setting.problem, [terms.contact_gap, terms.link_direction])
    found = loops.empty(np.array([True, False, True, True, False, True]))
    found.cost[:] = 7.0
    loops.evaluate(found, setting.pose, setting.joints)
    assert np.all((found.cost == 7.0) == [False, True, False, False, True, False])
    assert np.all(found.gradient[[1, 4]] == 0)


@pytest.mark.parametrize("compiled", [True, False])
def test_a_row_that_is_not_a_number_harms_no_other(compiled: bool):
    setting = Setting("allegro")
    objective = [terms.contact_gap, terms.object_penetration, terms.link_direction]
    expected = minimize(
        setting.points, setting.problem, objective, setting.pose, setting.joints, 10, compiled=compiled
    )
    setting.problem.joints[2] = np.nan
    found = minimize(
        setting.points, setting.problem, objective, setting.pose, setting.joints, 10, compiled=compiled
    )
    others = [0, 1, 3, 4, 5]
    for got, wanted in zip(found, expected, strict=True):
        np.testing.assert_array_equal(got[others], wanted[others])
    np.testing.assert_array_equal(found[0][2], setting.pose[2])


@pytest.mark.parametrize("name", HANDS)
def test_unresisted_shares_are_those_of_numpy(name: str):
    """Of solved grasps, which are in touch; one goes into its object, one is not asked for."""
    setting = Setting(name)
    points, problem = setting.points.dense, setting.problem
    objective = [terms.contact_position, terms.contact_gap, terms.object_penetration]
    pose, joints, _ = minimize(setting.points, problem, objective, setting.pose, setting.joints, 40)
    surface, normals = problem.surface[0, 12], problem.normals[0, 12]
    pose[0, :3] = surface - 0.01 * normals
    which = np.array([True, True, False, True, True, True])
    expected = unresisted_share(points, problem, pose, joints, which, compiled=False)
    found = unresisted_share(points, problem, pose, joints, which)
    assert expected[0] == NO_GRIP and expected[2] == np.inf
    assert np.any((expected > 1e-3) & (expected < 1.2))
    np.testing.assert_allclose(found, expected, atol=1e-9)
