"""Each term: a value worked out by hand, and its derivative against differences. Of the compiled terms, their
plain versions are tried here; ``test_reference`` compares the two."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import reference_terms as terms
from retarget_scenes import around_field, field, problem_with
from scipy.spatial.transform import Rotation

from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.levenberg_marquardt import NormalEquations
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.retargeting import dexgraspnet

COUNT = 3
WALL = field(lambda p: p[..., 1] + 0.02)
"""Solid below y = -0.02."""
BALL = field(lambda p: np.linalg.norm(p, axis=-1) - 0.08, spacing=0.0025, half=0.2)


class Case:
    """Hands in random poses, half closed, and what surrounds them."""

    def __init__(self, name: str, grid=WALL, table: float = -10.0, closed: float = 0.5, **given: np.ndarray):
        kinematics = HandKinematics(load_hand(name), COUNT)
        self.points = HandPoints(kinematics)
        random = np.random.default_rng(0)
        rotation = Rotation.random(COUNT, random).as_quat(scalar_first=True)
        self.pose = np.concatenate([random.uniform(-0.02, 0.02, (COUNT, 3)), rotation], axis=1)
        share = closed + random.uniform(-0.1, 0.1, (COUNT, 1))
        self.joints = kinematics.lower + share * (kinematics.upper - kinematics.lower)
        links = 1 + len(self.points.match.far)
        default = {
            "joints": random.uniform(-0.1, 0.1, (COUNT, 21, 3)),
            "contacts": np.ones((COUNT, links), dtype=bool),
            "surface": random.uniform(-0.1, 0.1, (COUNT, 21, 3)),
            "normals": np.broadcast_to([0.0, 1.0, 0.0], (COUNT, 21, 3)),
        }
        self.problem = problem_with(around_field(grid, COUNT, table), **(default | given))

    @property
    def state(self) -> HandState[RetargetingProblem]:
        return HandState(self.points, self.problem, self.pose, self.joints)

    def change(self, **given: np.ndarray) -> None:
        self.problem = problem_with(self.problem, **{k: getattr(self.problem, k) for k in FIELDS} | given)

    def stepped(self, tangent: np.ndarray) -> HandState[RetargetingProblem]:
        kinematics = self.points.kinematics
        return HandState(self.points, self.problem, *kinematics.step(self.pose, self.joints, tangent))


FIELDS = ("joints", "contacts", "surface", "normals", "center", "extent")

TERMS: dict[str, tuple[Callable, dict]] = {
    "fingertip_position": (terms.fingertip_position, {}),
    "link_direction": (terms.link_direction, {}),
    "contact_position": (terms.contact_position, {}),
    "contact_gap": (terms.contact_gap, {}),
    "object_penetration": (terms.object_penetration, {}),
    "table_penetration": (terms.table_penetration, {"table": 0.0}),
    "self_penetration": (partial(terms.self_penetration, margin=0.02), {"closed": 0.8}),
    "stay_near": (terms.stay_near, {}),
    "dexgraspnet.contact_distance_energy": (dexgraspnet.contact_distance_energy, {}),
}


@pytest.mark.parametrize("hand", ["allegro", "inspire"])
@pytest.mark.parametrize("name", TERMS)
def test_jacobian_is_the_derivative(name: str, hand: str):
    term, given = TERMS[name]
    case = Case(hand, **given)
    size = case.points.kinematics.size
    if name == "stay_near":
        start = (case.pose, case.joints + 0.1)
        term = partial(term, start=start, unit=0.5, position_unit=0.1, rotation_unit=0.2)
    residual, jacobian = term(case.state)
    assert jacobian.shape == (*residual.shape, size)
    assert np.abs(residual).max() > 0
    h = 1e-6
    for direction in range(size):
        tangent = np.zeros((COUNT, size))
        tangent[:, direction] = h
        ahead, behind = term(case.stepped(tangent))[0], term(case.stepped(-tangent))[0]
        # Terms that pick the nearest spheres may list them in another order: their cost does not depend on
        # it.
        if "penetration" in name:
            expected = (0.5 * (ahead**2).sum(axis=1) - 0.5 * (behind**2).sum(axis=1)) / (2 * h)
            found = np.einsum("nr,nr->n", residual, jacobian[..., direction])
        else:
            expected, found = (ahead - behind) / (2 * h), jacobian[..., direction]
        scale = max(1.0, float(np.abs(jacobian).max()), float(np.abs(expected).max()))
        np.testing.assert_allclose(found, expected, atol=1e-4 * scale)


@pytest.mark.parametrize("hand", ["allegro", "inspire"])
@pytest.mark.parametrize(
    "term",
    [partial(terms.force_closure, friction=0.0), dexgraspnet.force_closure_energy],
    ids=["contact", "dexgraspnet"],
)
def test_force_closure_has_the_gradient_of_its_cost(term: Callable, hand: str):
    """About: the normals' derivative is itself a difference over some millimetres."""
    case = Case(hand, BALL, closed=0.3)
    tips = case.points.match.far[case.points.match.is_last]
    case.pose[:, :3] -= case.state.keypoints[:, tips].mean(axis=1)
    case.pose[:, 0] -= 0.04
    case.change(contacts=np.tile([False, *case.points.match.is_last], (COUNT, 1)))
    size = case.points.kinematics.size
    residual, jacobian = term(case.state)
    steps = np.repeat([0.01, 0.1], [3, size - 3])
    gradient = np.einsum("nr,nrd->nd", residual, jacobian) * steps
    expected = np.empty_like(gradient)
    for direction in range(size):
        tangent = np.zeros((COUNT, size))
        tangent[:, direction] = steps[direction]
        ahead, behind = term(case.stepped(tangent))[0], term(case.stepped(-tangent))[0]
        expected[:, direction] = ((ahead**2).sum(axis=1) - (behind**2).sum(axis=1)) / 4
    norms = np.linalg.norm(gradient, axis=1) * np.linalg.norm(expected, axis=1)
    assert np.all(np.sum(gradient * expected, axis=1) > 0.95 * norms)


@pytest.fixture(params=["allegro", "inspire"])
def case(request: pytest.FixtureRequest) -> Case:
    return Case(request.param)


def test_fingertip_position_counts_units(case: Case):
    match, joints = case.points.match, case.problem.joints.copy()
    tips = match.far[match.is_last]
    joints[:, match.human_far[match.is_last]] = case.state.keypoints[:, tips] - [0.01, 0.0, -0.03]
    case.change(joints=joints)
    residual, _ = terms.fingertip_position(case.state, unit=0.01)
    np.testing.assert_allclose(
        residual.reshape(COUNT, -1, 3), np.tile([1.0, 0.0, -3.0], (COUNT, len(tips), 1))
    )


def test_link_direction_is_the_chord_between_directions(case: Case):
    match = case.points.match
    state = case.state
    links = state.keypoints[:, match.far] - state.keypoints[:, match.near]
    side = np.cross(links, [0.3, 0.5, 0.8])
    side *= np.linalg.norm(links, axis=-1, keepdims=True) / np.linalg.norm(side, axis=-1, keepdims=True)
    for finger in np.unique((match.human_near - 1) // 4):
        joints = np.zeros((COUNT, 21, 3))
        chosen = np.flatnonzero((match.human_near - 1) // 4 == finger)
        for s in chosen:
            turned = np.cos(np.pi / 3) * links[:, s] + np.sin(np.pi / 3) * side[:, s]
            joints[:, match.human_far[s]] = joints[:, match.human_near[s]] + 2 * turned
        case.change(joints=joints + np.random.default_rng(0).normal(size=(COUNT, 1, 3)))
        with np.errstate(invalid="ignore"):
            residual, _ = terms.link_direction(case.state, unit=0.5)
        chord = np.linalg.norm(residual.reshape(COUNT, -1, 3)[:, chosen], axis=-1)
        np.testing.assert_allclose(chord, 1.0 / 0.5)


def test_contact_position_stops_a_radius_off_the_surface(case: Case):
    match = case.points.match
    state, contacts = case.state, np.zeros_like(case.problem.contacts)
    contacts[0] = True
    radius = case.points.far_radius[:, None]
    surface, normals = np.zeros((COUNT, 21, 3)), np.zeros((COUNT, 21, 3))
    last = match.is_last
    normals[:, match.human_far] = [0.0, 0.0, 1.0]
    reached = state.keypoints[:, match.far] - radius * np.array([0.0, 0.0, 1.0])
    surface[:, match.human_far] = reached - [0.004, 0.0, 0.0]
    case.change(surface=surface, normals=normals, contacts=contacts)
    residual, _ = terms.contact_position(case.state, unit=0.002, inner_weight=0.25)
    residual = residual.reshape(COUNT, -1, 3)
    np.testing.assert_allclose(residual[0, last], np.tile([2.0, 0.0, 0.0], (last.sum(), 1)), atol=1e-9)
    np.testing.assert_allclose(residual[0, ~last], np.tile([0.5, 0.0, 0.0], ((~last).sum(), 1)), atol=1e-9)
    assert np.all(residual[1:] == 0)


def test_contact_gap_is_the_distance_of_the_nearest_ball(case: Case):
    contacts = case.problem.contacts.copy()
    contacts[2] = False
    case.change(contacts=contacts)
    state, spheres = case.state, case.points.spheres
    height = state.spheres[..., 1] + 0.02 - spheres.radius
    links = range(1, len(case.points.link_members))
    expected = np.stack([height[:, spheres.link == link].min(axis=1) for link in links], axis=1)
    residual, _ = terms.contact_gap(state, unit=0.002)
    np.testing.assert_allclose(residual[:2], np.maximum(expected, 0)[:2] / 0.002, atol=1e-6)
    assert np.all(residual[2] == 0)


def test_object_penetration_is_the_depth_of_the_deepest_balls(case: Case):
    depth = np.sort(np.maximum(0.003 - (case.state.spheres[..., 1] + 0.02 - case.points.spheres.radius), 0))
    residual, _ = terms.object_penetration(case.state, unit=0.001, margin=0.003, count=5)
    np.testing.assert_allclose(np.sort(residual, axis=1), depth[:, -5:] / 0.001, atol=1e-6)


def test_table_penetration_is_the_depth_of_the_lowest_balls():
    case = Case("allegro", table=0.01)
    depth = np.sort(np.maximum(0.002 + 0.01 - case.state.spheres[..., 0] + case.points.spheres.radius, 0))
    residual, _ = terms.table_penetration(case.state, unit=0.001, margin=0.002, count=6)
    np.testing.assert_allclose(np.sort(residual, axis=1), depth[:, -6:] / 0.001, atol=1e-9)


def test_self_penetration_finds_the_closest_balls_of_two_fingers():
    case = Case("allegro", closed=0.9)
    state, spheres = case.state, case.points.spheres
    finger = np.array([-1, *np.repeat(np.arange(4), 3)])[spheres.link]
    for row in range(COUNT):
        gaps = [
            np.linalg.norm(state.spheres[row, a] - state.spheres[row, b])
            - spheres.radius[a]
            - spheres.radius[b]
            for a in range(len(finger))
            for b in range(a)
            if finger[a] != finger[b] and min(finger[a], finger[b]) >= 0
        ]
        gaps = [0.01 - g for g in sorted(gaps)[:4]]
        residual, _ = terms.self_penetration(state, unit=0.001, margin=0.01, count=4)
        np.testing.assert_allclose(np.sort(residual[row])[::-1], np.maximum(gaps, 0) / 0.001, atol=1e-6)
    assert residual.max() > 0


def test_force_closure_cannot_balance_a_wall(case: Case):
    residual, _ = terms.force_closure(case.state, unit=0.1, friction=0.3)
    np.testing.assert_allclose(residual[:, 1], -1.0 / 0.1, rtol=1e-6)
    alone = np.zeros_like(case.problem.contacts)
    alone[:, 1] = True
    case.change(contacts=alone)
    assert np.all(terms.force_closure(case.state)[0] == 0), "one contact asks for no balance"


def test_stay_near_measures_position_rotation_and_joints(case: Case):
    turn = Rotation.from_rotvec([0.0, 0.0, 0.4])
    start = case.pose.copy()
    start[:, :3] -= [0.0, 0.03, 0.0]
    start[:, 3:] = (turn.inv() * Rotation.from_quat(start[:, 3:], scalar_first=True)).as_quat(
        scalar_first=True
    )
    term = partial(terms.stay_near, unit=0.5, position_unit=0.01, rotation_unit=0.2)
    residual, _ = term(case.state, start=(start, case.joints - 0.25))
    np.testing.assert_allclose(residual[:, :6], np.tile([0, 3, 0, 0, 0, 2.0], (COUNT, 1)), atol=1e-9)
    np.testing.assert_allclose(residual[:, 6:], 0.5)


def test_dexgraspnet_distance_is_the_rounded_absolute_value(case: Case):
    height = case.state.spheres[..., 1] + 0.02 - case.points.spheres.radius
    nearest = np.stack([height[:, m].min(axis=1) for m in case.points.link_members if len(m)], axis=1)
    residual, _ = dexgraspnet.contact_distance_energy(case.state)
    expected = 100 * (np.hypot(nearest, 5e-4) - 5e-4)
    np.testing.assert_allclose(0.5 * residual**2, expected, rtol=1e-3, atol=1e-6)
    assert np.all((residual < 0) == (nearest < 0))


def test_dexgraspnet_forces_on_a_wall_add_up_to_four(case: Case):
    residual, _ = dexgraspnet.force_closure_energy(case.state)
    np.testing.assert_allclose(0.5 * np.sum(residual[:, :3] ** 2, axis=1), 16.0, rtol=1e-6)


def test_dexgraspnet_penetration_sums_over_the_hand(case: Case):
    depth = np.maximum(-(case.state.spheres[..., 1] + 0.02 - case.points.spheres.radius), 0)
    depth = np.sort(depth, axis=1)[:, -48:]
    equations = NormalEquations(case.points, case.problem, [dexgraspnet.object_penetration_energy])
    found = equations.empty(np.ones(COUNT, dtype=bool))
    equations.evaluate(found, case.pose, case.joints)
    expected = 100 * np.sum(np.hypot(depth, 5e-4) - 5e-4, axis=1)
    np.testing.assert_allclose(found.cost, expected, rtol=1e-4)
