"""Compiled terms, solver and loads against plain NumPy."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import reference_terms as reference
from retarget_scenes import around_field, field, held, plain_objects

from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.levenberg_marquardt import NormalEquations, minimize
from fungrasp.optimization.link_contacts import contacts_of_links
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.optimization.wrench_resistance import NO_GRIP, unresisted_share
from fungrasp.retargeting import dexgraspnet
from fungrasp.retargeting.contact_optimization import initial_pose

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


def every_term(setting: Setting) -> dict[str, tuple]:
    """Name of a term, other arguments, and what is compared with it by name if that is not its namesake."""
    start = (setting.pose + 0.01, 0.9 * setting.joints)

    def smooth(state: HandState) -> reference.Residual:
        depth = reference.object_penetration(state, unit=1.0, count=48)
        return reference.smooth_absolute(depth, dexgraspnet.PENETRATION_WEIGHT, dexgraspnet.SMOOTHING_LENGTH)

    def smooth_self(state: HandState) -> reference.Residual:
        depth = reference.self_penetration(state, unit=1.0, margin=0.01, count=16)
        return reference.smooth_absolute(
            depth, dexgraspnet.SELF_PENETRATION_WEIGHT, dexgraspnet.SMOOTHING_LENGTH
        )

    plain = {
        "fingertip_position": ("fingertip_position", {}),
        "link_direction": ("link_direction", {}),
        "links of the thumb": ("link_direction", {"links": np.array([1, 2])}),
        "contact_position": ("contact_position", {}),
        "contact_gap": ("contact_gap", {}),
        "object_penetration": ("object_penetration", {}),
        "deepest only": ("object_penetration", {"margin": 0.02, "count": 5}),
        "table_penetration": ("table_penetration", {"margin": 0.05}),
        "self_penetration": ("self_penetration", {"margin": 0.01}),
        "force_closure": ("force_closure", {"unit": 0.3}),
        "stay_near": ("stay_near", {"start": start, "position_unit": 0.05, "rotation_unit": 0.3}),
    }
    found = {
        label: (partial(getattr(terms, name), **given), partial(getattr(reference, name), **given))
        for label, (name, given) in plain.items()
    }
    own = partial(reference.contact_gap, unit=0.002)
    found["terms of one's own"] = terms.residual_terms([own]), own
    found["dexgraspnet: object"] = dexgraspnet.object_penetration_energy, smooth
    found["dexgraspnet: self"] = partial(dexgraspnet.self_penetration_energy, margin=0.01), smooth_self
    return found


@pytest.mark.parametrize("name", HANDS)
def test_normal_equations_are_those_of_numpy(name: str):
    setting = Setting(name)
    points, problem, pose, joints = setting.points, setting.problem, setting.pose, setting.joints
    for label, (term, plain) in every_term(setting).items():
        expected = reference.objective_equations(HandState(points, problem, pose, joints), [plain])
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
    start = setting.pose, setting.joints
    found, expected = [], []
    for module, solve, results in ((terms, minimize, found), (reference, reference.minimize, expected)):
        objective = [
            module.contact_position,
            module.contact_gap,
            module.object_penetration,
            module.link_direction,
            partial(module.force_closure, unit=0.3),
            partial(module.stay_near, start=start, unit=3.0),
        ]
        results += [solve(setting.points, setting.problem, objective, *start, count) for count in (4, 40)]
    for got, wanted, tolerance in zip(found, expected, (1e-6, 0.1), strict=True):
        np.testing.assert_allclose(got[2], wanted[2], rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(found[0][0], expected[0][0], atol=1e-6)
    np.testing.assert_allclose(found[0][1], expected[0][1], atol=1e-6)


def test_grasps_that_have_left_are_not_touched():
    setting = Setting("allegro")
    loops = NormalEquations(setting.points, setting.problem, [terms.contact_gap, terms.link_direction])
    found = loops.empty(np.array([True, False, True, True, False, True]))
    found.cost[:] = 7.0
    loops.evaluate(found, setting.pose, setting.joints)
    assert np.all((found.cost == 7.0) == [False, True, False, False, True, False])
    assert np.all(found.gradient[[1, 4]] == 0)


def test_a_row_that_is_not_a_number_harms_no_other():
    setting = Setting("allegro")
    objective = [terms.contact_gap, terms.object_penetration, terms.link_direction]
    expected = minimize(setting.points, setting.problem, objective, setting.pose, setting.joints, 10)
    setting.problem.joints[2] = np.nan
    found = minimize(setting.points, setting.problem, objective, setting.pose, setting.joints, 10)
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
    expected = reference.unresisted_share(points, problem, pose, joints, which)
    found = unresisted_share(points, problem, pose, joints, upper=np.where(which, np.inf, 0.0))
    assert expected[0] == NO_GRIP and expected[2] == np.inf
    assert np.any((expected > 1e-3) & (expected < NO_GRIP))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    # Between a share that is enough and one that is too much, nothing else is found.
    most = np.where(which, expected + np.array([1, 1, 1, 1, -0.01, -0.01]), 0.0)
    found = unresisted_share(points, problem, pose, joints, 0.2, most)
    clipped = np.where(most > 0.2, np.clip(found, 0.2, most), np.inf)
    np.testing.assert_allclose(clipped, np.where(most > 0.2, np.clip(expected, 0.2, most), np.inf), atol=1e-9)


@pytest.mark.parametrize("name", HANDS)
def test_contacts_of_links_are_those_of_numpy(name: str):
    setting = Setting(name)
    found = contacts_of_links(setting.points, setting.problem, setting.pose, setting.joints)
    state = HandState(setting.points, setting.problem, setting.pose, setting.joints)
    for name, got, wanted in zip(found._fields, found, reference.contacts_of_links(state), strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-6, err_msg=name)
    near = contacts_of_links(setting.points, setting.problem, setting.pose, setting.joints, within=0.01)
    touching = found.clearance < 0.01
    assert np.any(touching) and not np.all(touching)
    np.testing.assert_array_equal(near.place[touching], found.place[touching])
    assert np.all(near.clearance[~touching] == np.inf)


SLIDING_HAND = """<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="palm">
      <geom name="palm" type="box" size="0.01 0.04 0.04" pos="0 0 0.04"/>
      <body name="index_a" pos="0 0.03 0.1">
        <joint name="index_j1" axis="0 1 0" range="0 1.5"/>
        <geom name="index_a" type="capsule" size="0.008" fromto="0 0 0.015 0 0 0.03"/>
        <site name="index_tip" pos="0 0 0.03"/>
      </body>
      <body name="thumb_a" pos="0 -0.03 0.1">
        <joint name="thumb_j1" type="slide" axis="0 0.6 0.8" range="0 0.05"/>
        <geom name="thumb_a" type="capsule" size="0.008" fromto="0 0 0.015 0 0 0.03"/>
        <body name="thumb_b" pos="0 0 0.045">
          <joint name="thumb_j2" axis="0 1 0" range="0 1.5"/>
          <geom name="thumb_b" type="capsule" size="0.008" fromto="0 0 0.015 0 0 0.03"/>
          <site name="thumb_tip" pos="0 0 0.03"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>"""
SLIDING_HAND_TOML = """name = "sliding"
model = "sliding.xml"
palm = "palm"
[palm_frame]
fingers = [0.0, 0.0, 1.0]
normal = [1.0, 0.0, 0.0]
[fingers.index]
links = ["index_a"]
tip = "index_tip"
[fingers.thumb]
links = ["thumb_a", "thumb_b"]
tip = "thumb_tip"
[actuators]
kp = 1.0
kd = 0.1
force_limit = 0.5
"""


def test_sliding_joints_move_along_their_axes(tmp_path: Path):
    """The compiled kinematics against MuJoCo's; the thumb slides and turns."""
    (tmp_path / "sliding.xml").write_text(SLIDING_HAND)
    (tmp_path / "sliding.toml").write_text(SLIDING_HAND_TOML)
    kinematics = HandKinematics(load_hand(str(tmp_path / "sliding.toml")), 2)
    points = HandPoints(kinematics)
    joints = kinematics.lower + np.array([[0.2], [0.7]]) * (kinematics.upper - kinematics.lower)
    pose = np.tile([0.1, 0.2, 0.3, 0.5, -0.5, 0.5, 0.5], (2, 1))
    problem = around_field(field(lambda p: p[..., 1] + 0.5), 2)
    state = HandState(points, problem, pose, joints)
    keypoints = np.arange(state.keypoints.shape[1])
    given = {
        "which": keypoints,
        "target": np.zeros(state.keypoints.shape),
        "weight": np.ones((2, len(keypoints))),
    }
    cost, _, gradient = reference.objective_equations(state, [partial(reference.keypoint_position, **given)])
    loops = NormalEquations(points, problem, [partial(terms.keypoint_position, **given)])
    found = loops.empty(np.ones(2, dtype=bool))
    loops.evaluate(found, pose, joints)
    np.testing.assert_allclose(found.cost, cost, rtol=1e-9)
    np.testing.assert_allclose(found.gradient, gradient, rtol=1e-9, atol=1e-12)
    contacts = contacts_of_links(points, problem, pose, joints)
    np.testing.assert_allclose(contacts.jacobian, reference.contacts_of_links(state).jacobian, atol=1e-9)
