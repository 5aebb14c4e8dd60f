"""Each term: values worked out by hand, gradients against differences of the cost, Hessians that fit both."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from odd_hands import added, odd_hand
from retarget_scenes import around_field, field, problem_with
from scipy.spatial.transform import Rotation

from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.levenberg_marquardt import NormalEquations
from fungrasp.optimization.link_contacts import contacts_of_links
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.retargeting import dexgraspnet

COUNT = 3
WALL = field(lambda p: p[..., 1] + 0.02)
"""Solid below y = -0.02."""
BALL = field(lambda p: np.linalg.norm(p, axis=-1) - 0.08, spacing=0.0025, half=0.2)
FIELDS = ("joints", "contacts", "surface", "normals", "center", "extent")


class Case:
    """Hands in random poses, half closed, and what surrounds them."""

    def __init__(self, name: str, grid=WALL, table: float = -10.0, closed: float = 0.5):
        self.kinematics = kinematics = HandKinematics(load_hand(name), COUNT)
        self.points = HandPoints(kinematics)
        self.match = self.points.match
        random = np.random.default_rng(0)
        rotation = Rotation.random(COUNT, random).as_quat(scalar_first=True)
        self.pose = np.concatenate([random.uniform(-0.02, 0.02, (COUNT, 3)), rotation], axis=1)
        share = closed + random.uniform(-0.1, 0.1, (COUNT, 1))
        self.joints = kinematics.lower + share * (kinematics.upper - kinematics.lower)
        self.problem: RetargetingProblem = problem_with(
            around_field(grid, COUNT, table),
            joints=random.uniform(-0.1, 0.1, (COUNT, 21, 3)),
            contacts=np.ones((COUNT, 1 + len(self.match.far)), dtype=bool),
            surface=random.uniform(-0.1, 0.1, (COUNT, len(self.match.far), 3)),
            normals=np.broadcast_to([0.0, 1.0, 0.0], (COUNT, len(self.match.far), 3)),
        )

    @property
    def state(self) -> HandState[RetargetingProblem]:
        return HandState(self.points, self.problem, self.pose, self.joints)

    @property
    def heights(self) -> np.ndarray:
        """Of the spheres above the wall [m]."""
        return self.state.spheres[..., 1] + 0.02 - self.points.spheres.radius

    def change(self, **given: np.ndarray) -> None:
        self.problem = problem_with(self.problem, **{k: getattr(self.problem, k) for k in FIELDS} | given)

    def touch_with(self, links: np.ndarray) -> None:
        """Only these links should touch, shape [L - 1] bool."""
        self.change(contacts=np.tile([False, *links], (COUNT, 1)))

    def around_the_ball(self) -> None:
        """Fingertips about the ball, which alone should touch."""
        tips = self.match.far[self.match.is_last]
        self.pose[:, :3] -= self.state.keypoints[:, tips].mean(axis=1)
        self.pose[:, 0] -= 0.04
        self.touch_with(self.match.is_last)

    def equations(self, term: terms.Term, tangent: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
        """Cost, Hessian and gradient, after a step along a tangent vector."""
        pose, joints = self.pose, self.joints
        if tangent is not None:
            pose, joints = self.kinematics.step(pose, joints, np.tile(tangent, (COUNT, 1)))
        loops = NormalEquations(self.points, self.problem, [term])
        found = loops.empty(np.ones(COUNT, dtype=bool))
        loops.evaluate(found, pose, joints)
        lower = np.tril(found.hessian, -1)
        diagonal = found.hessian * np.eye(self.kinematics.size)
        return found.cost, lower + np.swapaxes(lower, 1, 2) + diagonal, found.gradient

    def cost(self, term: terms.Term) -> np.ndarray:
        return self.equations(term)[0]

    def differences(self, term: terms.Term, what: int, step: float | np.ndarray = 1e-6) -> np.ndarray:
        """Of the cost (0) or the gradient (2) along each tangent coordinate, on the last axis."""
        size = self.kinematics.size
        steps = np.broadcast_to(step, (size,))
        each = list(zip(steps, np.eye(size), strict=True))
        pairs = [[self.equations(term, sign * h * e)[what] for sign in (1, -1)] for h, e in each]
        return np.stack([(a - b) / (2 * h) for (a, b), h in zip(pairs, steps, strict=True)], axis=-1)


@pytest.fixture(params=["allegro", "inspire"])
def case(request: pytest.FixtureRequest) -> Case:
    """A hand with independent joints, and one with coupled ones."""
    return Case(request.param)


def near_start(case: Case) -> terms.Term:
    start = (case.pose + np.repeat([0.01, 0.0], [1, 6]), case.joints + 0.1)
    return partial(terms.stay_near, start=start, unit=0.5, position_unit=0.1, rotation_unit=0.2)


def own_term(case: Case) -> terms.Term:
    return terms.residual_terms([dexgraspnet.contact_distance_energy])


EVERY: dict[str, tuple[terms.Term | Callable[[Case], terms.Term], dict]] = {
    "fingertip_position": (terms.fingertip_position, {}),
    "link_direction": (terms.link_direction, {}),
    "links of the thumb": (partial(terms.link_direction, links=np.array([1, 2])), {}),
    "contact_position": (terms.contact_position, {}),
    "contact_gap": (terms.contact_gap, {}),
    "object_penetration": (terms.object_penetration, {}),
    "table_penetration": (terms.table_penetration, {"table": 0.0}),
    "self_penetration": (partial(terms.self_penetration, margin=0.02), {"closed": 0.8}),
    "stay_near": (near_start, {}),
    "dexgraspnet: distance": (own_term, {}),
    "dexgraspnet: object": (dexgraspnet.object_penetration_energy, {}),
    "dexgraspnet: self": (partial(dexgraspnet.self_penetration_energy, margin=0.02), {"closed": 0.8}),
}


def made(case: Case, term: terms.Term | Callable[[Case], terms.Term]) -> terms.Term:
    return term(case) if term in (near_start, own_term) else term


@pytest.mark.parametrize("hand", ["allegro", "inspire"])
@pytest.mark.parametrize("name", EVERY)
def test_gradient_is_the_derivative_of_the_cost(name: str, hand: str):
    term, given = EVERY[name]
    case = Case(hand, **given)
    term = made(case, term)
    cost, hessian, gradient = case.equations(term)
    assert np.any(cost > 0)
    expected = case.differences(term, 0)
    np.testing.assert_allclose(gradient, expected, atol=2e-4 * max(1.0, float(np.abs(expected).max())))
    # Of J^T J, with r^T J: what J explains of the residuals is no more than they are.
    explained = np.einsum("nd,nde,ne->n", gradient, np.linalg.pinv(hessian, 1e-9, True), gradient)
    assert np.all(explained <= 2 * cost * (1 + 1e-6))


@pytest.mark.parametrize("hand", ["allegro", "inspire"])
@pytest.mark.parametrize(
    "name", ["key point", "contact", "gap", "object", "table", "self", "stay_near", "force_closure"]
)
def test_a_few_residuals_are_explained_by_hessian_and_gradient(name: str, hand: str):
    """Where the rows of J are independent, g (J^T J)^+ g = |r|^2: the three belong together."""
    ball, table = name == "force_closure", 0.0 if name == "table" else -10.0
    closed = 0.8 if name == "self" else 0.3 if ball else 0.5
    case = Case(hand, BALL if ball else WALL, table, closed)
    one = np.arange(len(case.match.far)) == 2
    if ball:
        case.around_the_ball()
    else:
        case.touch_with(one)
    if name == "contact":
        # The rows of two spheres of one link would not be independent: the target is at that which touches.
        link, surface = case.points.link_members[3], case.problem.surface.copy()
        nearest = link[np.argmin(case.heights[:, link], axis=1)]
        surface[:, 2] = case.state.spheres[np.arange(COUNT), nearest] + 0.001
        case.change(surface=surface - case.points.spheres.radius[nearest][:, None, None] * [0.0, 1.0, 0.0])
    at = {"which": case.match.far[one], "target": np.zeros((COUNT, 1, 3)), "weight": np.full((COUNT, 1), 9.0)}
    term: terms.Term = {
        "key point": partial(terms.keypoint_position, **at),
        "contact": terms.contact_position,
        "gap": terms.contact_gap,
        "object": partial(terms.object_penetration, margin=0.2, count=2),
        "table": partial(terms.table_penetration, margin=0.2, count=2),
        "self": partial(terms.self_penetration, margin=0.02, count=1),
        "stay_near": near_start(case),
        "force_closure": terms.force_closure,
    }[name]
    cost, hessian, gradient = case.equations(term)
    some = cost > 1e-12
    assert some.any()
    explained = np.einsum("nd,nde,ne->n", gradient, np.linalg.pinv(hessian, 1e-10, True), gradient)
    np.testing.assert_allclose(explained[some], 2 * cost[some], rtol=1e-6)


def test_without_residuals_the_hessian_is_that_of_the_cost(case: Case):
    """Of directions: the person's links are laid along the robot's."""
    joints, match = np.zeros((COUNT, 21, 3)), case.match
    for s in range(len(match.far)):
        along = case.state.keypoints[:, match.far[s]] - case.state.keypoints[:, match.near[s]]
        joints[:, match.human_far[s]] = joints[:, match.human_near[s]] + 2 * along
    case.change(joints=joints)
    cost, hessian, _ = case.equations(terms.link_direction)
    np.testing.assert_allclose(cost, 0.0, atol=1e-12)
    expected = case.differences(terms.link_direction, 2)
    np.testing.assert_allclose(hessian, expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("hand", ["allegro", "inspire"])
@pytest.mark.parametrize(
    "term",
    [partial(terms.force_closure, friction=0.0), terms.residual_terms([dexgraspnet.force_closure_energy])],
    ids=["contact", "dexgraspnet"],
)
def test_force_closure_has_about_the_gradient_of_its_cost(term: terms.Term, hand: str):
    """About: the normals' derivative is itself a difference over some millimeters."""
    case = Case(hand, BALL, closed=0.3)
    case.around_the_ball()
    steps = np.repeat([0.01, 0.1], [3, case.kinematics.size - 3])
    gradient = case.equations(term)[2] * steps
    expected = case.differences(term, 0, steps) * steps
    norms = np.linalg.norm(gradient, axis=1) * np.linalg.norm(expected, axis=1)
    assert np.all(np.sum(gradient * expected, axis=1) > 0.95 * norms)


def test_fingertip_position_counts_units(case: Case):
    match, joints = case.match, case.problem.joints.copy()
    tips = match.far[match.is_last]
    joints[:, match.human_far[match.is_last]] = case.state.keypoints[:, tips] - [0.01, 0.0, -0.03]
    case.change(joints=joints)
    np.testing.assert_allclose(
        case.cost(partial(terms.fingertip_position, unit=0.01)), 0.5 * (1 + 9) * len(tips)
    )


def test_link_direction_is_the_chord_between_directions(case: Case):
    """All links turned by 60 degrees from the person's."""
    match, state = case.match, case.state
    links = state.keypoints[:, match.far] - state.keypoints[:, match.near]
    side = np.cross(links, [0.3, 0.5, 0.8])
    side *= np.linalg.norm(links, axis=-1, keepdims=True) / np.linalg.norm(side, axis=-1, keepdims=True)
    joints = np.zeros((COUNT, 21, 3))
    for s in range(len(match.far)):
        turned = np.cos(np.pi / 3) * links[:, s] + np.sin(np.pi / 3) * side[:, s]
        joints[:, match.human_far[s]] = joints[:, match.human_near[s]] + 2 * turned
    case.change(joints=joints + np.random.default_rng(0).normal(size=(COUNT, 1, 3)))
    chord = 1.0 / 0.5
    np.testing.assert_allclose(
        case.cost(partial(terms.link_direction, unit=0.5)), 0.5 * chord**2 * len(match.far)
    )


def test_contact_position_acts_where_a_link_touches_and_where_it_should(case: Case):
    """On the sphere nearest to the wall, and on that nearest to the target, a radius off it."""
    contacts = np.zeros_like(case.problem.contacts)
    contacts[0] = True
    case.change(contacts=contacts)
    surface, expected = case.problem.surface.copy(), 0.0
    for s in range(len(case.match.far)):
        members = case.points.link_members[s + 1]
        radius = case.points.spheres.radius[members]
        reached = case.state.spheres[0, members] - np.outer(radius, [0.0, 1.0, 0.0])
        # The target is near that sphere of the link which is farthest from the wall.
        surface[:, s] = reached[np.argmax(reached[:, 1])] + [0.0003, 0.0, 0.0]
        off = np.linalg.norm(reached - surface[0, s], axis=1)
        expected += 0.5 * sum((off[k] / 0.002) ** 2 for k in {np.argmin(reached[:, 1]), np.argmin(off)})
    case.change(surface=surface)
    cost = case.cost(partial(terms.contact_position, unit=0.002))
    assert cost[0] == pytest.approx(expected, rel=1e-6) and np.all(cost[1:] == 0)


def test_contact_gap_is_the_distance_of_the_nearest_ball(case: Case):
    contacts = case.problem.contacts.copy()
    contacts[2] = False
    case.change(contacts=contacts)
    links = range(1, len(case.points.link_members))
    gap = np.stack([case.heights[:, case.points.spheres.link == link].min(axis=1) for link in links], axis=1)
    cost = case.cost(partial(terms.contact_gap, unit=0.002))
    np.testing.assert_allclose(
        cost[:2], 0.5 * np.sum((np.maximum(gap, 0)[:2] / 0.002) ** 2, axis=1), rtol=1e-6
    )
    assert cost[2] == 0


def test_object_penetration_is_the_depth_of_the_deepest_balls(case: Case):
    depth = np.sort(np.maximum(0.003 - case.heights, 0))[:, -5:]
    cost = case.cost(partial(terms.object_penetration, unit=0.001, margin=0.003, count=5))
    np.testing.assert_allclose(cost, 0.5 * np.sum((depth / 0.001) ** 2, axis=1), rtol=1e-6)


def test_table_penetration_is_the_depth_of_the_lowest_balls():
    case = Case("allegro", table=0.01)
    below = 0.002 + 0.01 - case.state.spheres[..., 0] + case.points.spheres.radius
    depth = np.sort(np.maximum(below, 0))[:, -6:]
    cost = case.cost(partial(terms.table_penetration, unit=0.001, margin=0.002, count=6))
    np.testing.assert_allclose(cost, 0.5 * np.sum((depth / 0.001) ** 2, axis=1), rtol=1e-9)


def test_self_penetration_finds_the_closest_balls_of_two_fingers():
    case = Case("allegro", closed=0.9)
    centers, radius = case.state.spheres, case.points.spheres.radius
    finger = np.array([-1, *np.repeat(np.arange(4), 3)])[case.points.spheres.link]
    apart = np.linalg.norm(centers[:, :, None] - centers[:, None], axis=-1) - radius[:, None] - radius
    counts = (finger[:, None] < finger) & (finger[:, None] >= 0)
    depth = np.maximum(0.01 - np.sort(apart[:, counts], axis=1)[:, :4], 0.0)
    cost = case.cost(partial(terms.self_penetration, unit=0.001, margin=0.01, count=4))
    np.testing.assert_allclose(cost, 0.5 * np.sum((depth / 0.001) ** 2, axis=1), rtol=1e-6, atol=1e-6)
    assert cost.max() > 0


def test_force_closure_cannot_balance_a_wall(case: Case):
    """Normal parts sum to one, and nothing pushes back; along the wall and about its normal all cancels."""
    cost = case.cost(partial(terms.force_closure, unit=0.1, friction=0.3))
    assert np.all(cost >= 0.5 * (1 / 0.1) ** 2 - 1e-6)
    case.touch_with(np.arange(len(case.match.far)) == 0)
    assert np.all(case.cost(terms.force_closure) == 0), "one contact asks for no balance"


def test_stay_near_measures_position_rotation_and_joints(case: Case):
    start = case.pose.copy()
    start[:, :3] -= [0.0, 0.03, 0.0]
    turn = Rotation.from_rotvec([0.0, 0.0, 0.4]).inv() * Rotation.from_quat(start[:, 3:], scalar_first=True)
    start[:, 3:] = turn.as_quat(scalar_first=True)
    given = {"start": (start, case.joints - 0.25), "unit": 0.5, "position_unit": 0.01, "rotation_unit": 0.2}
    cost = case.cost(partial(terms.stay_near, **given))
    np.testing.assert_allclose(cost, 0.5 * (3.0**2 + 2.0**2 + 0.5**2 * (case.kinematics.size - 6)))


def test_dexgraspnet_counts_distances_forces_and_depths(case: Case):
    clearance = np.stack([case.heights[:, m].min(axis=1) for m in case.points.link_members if len(m)], axis=1)
    expected = 100 * np.sum(np.hypot(clearance, 5e-4) - 5e-4, axis=1)
    np.testing.assert_allclose(case.cost(own_term(case)), expected, rtol=1e-3)
    residual, _ = dexgraspnet.force_closure_energy(case.state)
    np.testing.assert_allclose(0.5 * np.sum(residual[:, :3] ** 2, axis=1), 16.0, rtol=1e-6)
    depth = np.sort(np.maximum(-case.heights, 0), axis=1)[:, -48:]
    expected = 100 * np.sum(np.hypot(depth, 5e-4) - 5e-4, axis=1)
    np.testing.assert_allclose(case.cost(dexgraspnet.object_penetration_energy), expected, rtol=1e-4)


def test_links_touch_with_their_nearest_ball(case: Case):
    """The wall is at y = -0.02; the point moves with the joints as differences say."""
    found = contacts_of_links(case.points, case.problem, case.pose, case.joints)
    for link, members in enumerate(case.points.link_members):
        np.testing.assert_allclose(found.clearance[:, link], case.heights[:, members].min(axis=1), atol=1e-6)
    np.testing.assert_allclose(found.inward, np.broadcast_to([0.0, -1.0, 0.0], found.inward.shape), atol=1e-6)
    np.testing.assert_allclose(found.place[..., 1], found.clearance - 0.02, atol=1e-6)
    step = 1e-6 * np.random.default_rng(0).normal(size=case.joints.shape)
    ahead, behind = (
        contacts_of_links(case.points, case.problem, case.pose, case.joints + s * step) for s in (1, -1)
    )
    # Across the wall's normal the ball may roll on, along it the point is the ball's.
    expected = (found.jacobian @ step[:, None, :, None])[..., 1, 0]
    np.testing.assert_allclose((ahead.clearance - behind.clearance) / 2, expected, atol=2e-9)
    near = contacts_of_links(case.points, case.problem, case.pose, case.joints, within=0.01)
    touching = found.clearance < 0.01
    assert np.any(touching) and not np.all(touching)
    np.testing.assert_array_equal(near.place[touching], found.place[touching])
    assert np.all(near.clearance[~touching] == np.inf)


def test_sliding_joints_move_along_their_axes(tmp_path: Path):
    """The compiled kinematics against MuJoCo's; the thumb slides and turns."""
    hand, _ = added(tmp_path, odd_hand(fingers=2))
    (joint,) = re.findall(r'<joint name="z2_j".*?/>', text := hand.model_path.read_text())
    sliding = joint.replace("/>", ' type="slide"/>').replace("-0.1 1.5", "0 0.05")
    hand.model_path.write_text(text.replace(joint, sliding))
    case = Case(str(hand.path))
    keypoints = np.arange(case.state.keypoints.shape[1])
    given = {"which": keypoints, "weight": np.ones((COUNT, len(keypoints)))}
    here = partial(terms.keypoint_position, target=case.state.keypoints, **given)
    np.testing.assert_allclose(case.cost(here), 0.0, atol=1e-18)
    away = partial(terms.keypoint_position, target=case.state.keypoints + 0.1, **given)
    np.testing.assert_allclose(case.equations(away)[2], case.differences(away, 0), atol=1e-6)
