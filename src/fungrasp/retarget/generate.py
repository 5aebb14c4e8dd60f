"""Human grasps from wishes: the retargeter's optimiser with the human hand and contact targets on named parts.

from fungrasp.retarget.generate import generate
from fungrasp.retarget.wishes import GraspWish

wish = GraspWish("can", "drink", "body", "wrap", at=(0, 0, 0), palm=(0, 1, 0), fingers=(1, 0, 0))
grasps = generate([wish], seed=0)
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.errors import UnknownNameError
from fungrasp.geometry.poses import quaternion_from_rotation_vector, quaternion_multiply, transform_points
from fungrasp.grasps import HUMAN_LINKS, HumanGraspSet
from fungrasp.grasps.anatomy import DEVIATION_LIMIT, FLEXION_RANGE, SLACK, joint_bends
from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel, load_object
from fungrasp.retarget import terms
from fungrasp.retarget.human_terms import (
    HumanPoints,
    Targets,
    natural_posture,
    part_gap,
    part_place,
    part_samples,
)
from fungrasp.retarget.problem import Problem, State, Surroundings, nearest_surface
from fungrasp.retarget.solver import Term, minimise
from fungrasp.retarget.wishes import KINDS, GraspWish

TOUCH = 0.003
"""Links nearer to the object than this touch it [m]."""

HAND = "human"


@dataclass(frozen=True)
class GenerateSettings:
    """How grasps are made, and which are good enough."""

    starts: int = 5
    """Tries per wish: the wish itself, then turned and shifted at random."""
    shift: float = 0.006
    """Standard deviation of the random shifts of the wrist [m]."""
    turn: float = 0.12
    """Standard deviation of its random turns [rad]."""
    gap_unit: float = 0.0015
    """Distance of a link from its part that counts as one unit [m]; likewise below."""
    place_unit: float = 0.006
    """[m]."""
    object_unit: float = 0.0006
    """Penetration of the object [m]."""
    table_unit: float = 0.0006
    """Penetration of the table [m]."""
    table_margin: float = 0.0015
    """Distance to keep from the table [m]."""
    self_unit: float = 0.001
    """Penetration of the hand by itself [m]."""
    closure_unit: float = 0.2
    """Unbalanced part of contact forces that sum to one."""
    wrist_unit: float = 0.02
    """Distance of the wrist from where the wish puts it [m]."""
    wrist_turn_unit: float = 0.3
    """Its turn from there [rad]."""
    first_iterations: int = 20
    second_iterations: int = 40
    most_penetration: float = 0.002
    """Deepest allowed penetration of the object, and of the hand by itself [m]."""
    most_cost: float = 25.0
    """Largest objective of a grasp that looks natural."""
    least_difference: float = 0.006
    """Grasps of one object whose joints are nearer than this on average are the same grasp [m]."""


@dataclass(frozen=True)
class Candidates:
    """N tries and what is wrong with them."""

    wish: np.ndarray
    """Index of the wish, shape [N]."""
    joints: np.ndarray
    """Human joints [m], object frame, shape [N, 21, 3]."""
    contacts: np.ndarray
    """Links nearer than ``TOUCH`` to the wish's parts, shape [N, 16] bool."""
    cost: np.ndarray
    """Objective, shape [N]."""
    object_penetration: np.ndarray
    """[m], shape [N]; likewise below."""
    table_penetration: np.ndarray
    self_penetration: np.ndarray
    missed: np.ndarray
    """Largest distance of a link from the part that it must touch [m], shape [N]."""
    anatomical: np.ndarray
    """Whether a person's joints bend like that, shape [N] bool."""

    def good(self, settings: GenerateSettings) -> np.ndarray:
        """Which pass all checks, shape [N] bool."""
        return (
            (self.object_penetration <= settings.most_penetration)
            & (self.self_penetration <= settings.most_penetration)
            & (self.table_penetration <= 0.0)
            & (self.missed <= TOUCH)
            & (self.cost <= settings.most_cost)
            & self.anatomical
        )


def generate(
    wishes: Sequence[GraspWish],
    seed: int = 0,
    settings: GenerateSettings | None = None,
    progress: Callable[[int], None] = lambda count: None,
) -> HumanGraspSet:
    """Make human grasps of built-in objects as they stand on the table; wishes that can't be met are left out.

    Every grasp has bones of exactly the human hand's lengths, joints within its limits, no more than 2 mm of
    penetration, nothing below the table, and its links on their parts; no two are alike.

    Args:
        wishes: what to make. The grasps keep their order.
        seed: of the random starts. A wish's grasp does not depend on the other wishes, but for those like it.
        settings: the defaults if None.
        progress: called with the number of wishes that have just been worked on.

    Raises:
        FungraspError: an object or part does not exist, or none of the wishes can be met.
    """
    settings = settings or GenerateSettings()
    tries = attempt(wishes, seed, settings, progress)
    rows = _best(tries, wishes, settings)
    names = [wishes[i].object for i in tries.wish[rows]]
    things = {name: load_object(name) for name in set(names)}
    pose = np.array([wishes[i].rest_pose(things[wishes[i].object]) for i in tries.wish[rows]]).reshape(-1, 7)
    return HumanGraspSet(
        object_name=np.array(names),
        object_mass=np.array([things[name].mass for name in names]),
        object_pose=pose,
        object_rest_pose=pose,
        hand_joints=transform_points(pose, tries.joints[rows]),
        link_contacts=tries.contacts[rows],
        task=np.array([wishes[i].task for i in tries.wish[rows]]),
    )


def attempt(
    wishes: Sequence[GraspWish],
    seed: int = 0,
    settings: GenerateSettings | None = None,
    progress: Callable[[int], None] = lambda count: None,
) -> Candidates:
    """All tries of all wishes, good or not: what to look at when a wish is left out. See ``generate``."""
    settings = settings or GenerateSettings()
    objects = {name: load_object(name) for name in dict.fromkeys(wish.object for wish in wishes)}
    for wish in wishes:
        for part in wish.all_parts:
            if part not in objects[wish.object].parts:
                raise UnknownNameError(f"part of object '{wish.object}'", part, objects[wish.object].parts)
    chunks = []
    size = 12
    for start in range(0, len(wishes), size):
        part = wishes[start : start + size]
        found = _attempt(part, objects, seed, settings)
        chunks.append({f.name: getattr(found, f.name) for f in fields(found)} | {"wish": found.wish + start})
        progress(len(part))
    return Candidates(
        **{f.name: np.concatenate([chunk[f.name] for chunk in chunks]) for f in fields(Candidates)}
    )


def _attempt(
    wishes: Sequence[GraspWish], objects: Mapping[str, ObjectModel], seed: int, settings: GenerateSettings
) -> Candidates:
    owner = np.repeat(np.arange(len(wishes)), settings.starts)
    each = [wishes[i] for i in owner]
    hand = load_hand(HAND)
    points = HumanPoints(HandKinematics(hand, len(each)))
    names = [wish.object for wish in each]
    rest = np.array([wish.rest_pose(objects[wish.object]) for wish in each])
    around = Surroundings.settled(names, rest, objects)
    shaken = _random_starts(wishes, seed, settings)
    pose = _approached(points, around, each, _wished_pose(each, shaken))
    independent = _closed(points, around, each, pose)
    targets = Targets.of(each, objects)
    problem = _problem(points, around, each, objects, pose, independent)
    kinds = [wish.kind for wish in each]
    start = (pose, independent)
    wrist = partial(
        terms.stay_near,
        start=start,
        unit=np.inf,
        position_unit=settings.wrist_unit,
        rotation_unit=settings.wrist_turn_unit,
    )
    table = partial(terms.table_penetration, margin=settings.table_margin)
    first: list[Term] = [
        wrist,
        partial(natural_posture, kinds=kinds),
        partial(part_gap, targets=targets, unit=4 * settings.gap_unit),
        partial(part_place, targets=targets, unit=2 * settings.place_unit),
        partial(terms.object_penetration, unit=4 * settings.object_unit),
        partial(table, unit=4 * settings.table_unit),
        partial(terms.self_penetration, unit=4 * settings.self_unit),
    ]
    pose, independent, _ = minimise(points, problem, first, pose, independent, settings.first_iterations)
    second: list[Term] = [
        wrist,
        partial(natural_posture, kinds=kinds),
        partial(part_gap, targets=targets, unit=settings.gap_unit),
        partial(part_place, targets=targets, unit=settings.place_unit),
        partial(terms.object_penetration, unit=settings.object_unit),
        partial(table, unit=settings.table_unit),
        partial(terms.self_penetration, unit=settings.self_unit),
        partial(terms.force_closure, unit=settings.closure_unit),
    ]
    pose, independent, cost = minimise(points, problem, second, pose, independent, settings.second_iterations)
    return _judged(hand, around, each, owner, objects, pose, independent, cost)


def _random_starts(wishes: Sequence[GraspWish], seed: int, settings: GenerateSettings) -> np.ndarray:
    """Shift [m] and turn [rad] of each start, zero for the first of a wish, shape [N, 6]."""
    result = []
    for wish in wishes:
        random = np.random.default_rng([seed, zlib.crc32(repr(wish).encode())])
        shaken = random.normal(size=(settings.starts, 6)) * np.repeat([settings.shift, settings.turn], 3)
        shaken[0] = 0.0
        result.append(shaken)
    return np.concatenate(result)


def _wished_pose(wishes: Sequence[GraspWish], shaken: np.ndarray) -> np.ndarray:
    """Wrist with the kind's center at the wish's place, object frame, shape [N, 7]."""
    x = np.array([wish.palm for wish in wishes], dtype=float)
    z = np.array([wish.fingers for wish in wishes], dtype=float)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    z -= np.sum(z * x, axis=1, keepdims=True) * x
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    matrix = np.stack([x, np.cross(z, x), z], axis=-1)
    center = np.array([KINDS[wish.kind].center for wish in wishes])
    place = np.array([wish.at for wish in wishes], dtype=float)
    rotation = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
    rotation = quaternion_multiply(quaternion_from_rotation_vector(shaken[:, 3:]), rotation)
    turned = Rotation.from_quat(rotation, scalar_first=True).apply(center)
    return np.concatenate([place + shaken[:, :3] - turned, rotation], axis=1)


def _approached(
    points: HumanPoints, around: Surroundings, wishes: Sequence[GraspWish], pose: np.ndarray
) -> np.ndarray:
    """The wrist moved in along the palm's direction until the palm touches, or for kinds that don't use the palm until the
    held place is between the fingers."""
    into = Rotation.from_quat(pose[:, 3:], scalar_first=True).apply([1.0, 0.0, 0.0])
    deepest = np.array([0.05 if KINDS[wish.kind].palm else 0.0 for wish in wishes])
    base = np.isin(
        points.balls.link, [0, *(i for i, name in enumerate(HUMAN_LINKS) if name.endswith("proximal"))]
    )
    opened = np.array([KINDS[wish.kind].open for wish in wishes])
    depth, free = np.full(len(pose), -0.15), np.ones(len(pose), dtype=bool)
    for step in np.arange(-0.15, 0.0501, 0.002):
        moved = pose.copy()
        moved[:, :3] += step * into
        state = State(points, around, moved, opened)
        clear = np.minimum(state.clearance, state.heights)[:, base].min(axis=1)
        free &= (clear > -0.001) & (step <= deepest + 1e-9)
        depth[free] = step
    result = pose.copy()
    result[:, :3] += depth[:, None] * into
    return result


def _closed(
    points: HumanPoints, around: Surroundings, wishes: Sequence[GraspWish], pose: np.ndarray
) -> np.ndarray:
    """Joints with each finger closed until it touches object or table, shape [N, 21]."""
    opened = np.array([KINDS[wish.kind].open for wish in wishes])
    closed = np.array([KINDS[wish.kind].closed for wish in wishes])
    finger_of_joint = np.repeat(np.arange(5), [4, 4, 4, 4, 5])
    finger_of_ball = np.where(points.balls.link > 0, (points.balls.link - 1) // 3, -1)
    share, free = np.zeros((len(wishes), 5)), np.ones((len(wishes), 5), dtype=bool)
    for step in np.linspace(0.0, 1.0, 21):
        state = State(points, around, pose, opened + step * (closed - opened))
        clear = np.minimum(state.clearance, state.heights)
        for finger in range(5):
            free[:, finger] &= clear[:, finger_of_ball == finger].min(axis=1) > -0.001
        share[free] = step
    return opened + share[:, finger_of_joint] * (closed - opened)


def _problem(
    points: HumanPoints,
    around: Surroundings,
    wishes: Sequence[GraspWish],
    objects: Mapping[str, ObjectModel],
    pose: np.ndarray,
    independent: np.ndarray,
) -> Problem:
    """The wishes as the retargeter's problem: the links that must touch, the hand where it starts."""
    contacts = np.array([[link in wish.links for link in HUMAN_LINKS] for wish in wishes])
    joints = State(points, around, pose, independent).keypoints
    surface, normals = nearest_surface(around.bank, around.grid, joints)
    return Problem(
        **{f.name: getattr(around, f.name) for f in fields(around)},
        joints=joints,
        contacts=contacts,
        surface=surface,
        normals=normals,
        center=np.array([objects[wish.object].center_of_mass for wish in wishes]),
        extent=np.array([0.5 * np.linalg.norm(objects[wish.object].size) for wish in wishes]),
    )


def _judged(
    hand,
    around: Surroundings,
    wishes: Sequence[GraspWish],
    owner: np.ndarray,
    objects: Mapping[str, ObjectModel],
    pose: np.ndarray,
    independent: np.ndarray,
    cost: np.ndarray,
) -> Candidates:
    points = HumanPoints(HandKinematics(hand, len(wishes)), spacing=0.004)
    state = State(points, around, pose, independent)
    contacts = np.zeros((len(wishes), len(HUMAN_LINKS)), dtype=bool)
    missed = np.zeros(len(wishes))
    for row, wish in enumerate(wishes):
        thing = objects[wish.object]
        gaps = {
            part: _link_gaps(points, state.balls[row], part_samples(thing, part)) for part in wish.all_parts
        }
        contacts[row] = np.min([gaps[part] for part in wish.all_parts], axis=0) <= TOUCH
        missed[row] = max(gaps[part][HUMAN_LINKS.index(link)] for link, part in wish.part_of_link.items())
    return Candidates(
        wish=owner,
        joints=state.keypoints,
        contacts=contacts,
        cost=cost,
        object_penetration=np.maximum(-state.clearance.min(axis=1), 0.0),
        table_penetration=np.maximum(-state.heights.min(axis=1), 0.0),
        self_penetration=_self_penetration(hand.model, independent),
        missed=missed,
        anatomical=_anatomical(state.keypoints),
    )


def _anatomical(joints: np.ndarray) -> np.ndarray:
    """Whether all joints bend within people's ranges, shape [N] bool. joints: [m], shape [N, 21, 3]."""
    flexion, deviation = joint_bends(joints)
    within = (flexion >= FLEXION_RANGE[..., 0] - SLACK) & (flexion <= FLEXION_RANGE[..., 1] + SLACK)
    within &= np.abs(deviation) <= DEVIATION_LIMIT + SLACK
    return within.all(axis=(1, 2))


def _link_gaps(points: HumanPoints, balls: np.ndarray, tree) -> np.ndarray:
    """Distance of each link's surface from a part [m], shape [16]. balls: shape [P, 3]."""
    gap = tree.query(balls)[0] - points.balls.radius
    return np.array([gap[members].min() for members in points.link_members])


def _self_penetration(model: mujoco.MjModel, joint_positions: np.ndarray) -> np.ndarray:
    """Deepest contact of the hand with itself [m], shape [N]."""
    data = mujoco.MjData(model)
    depths = np.zeros(len(joint_positions))
    for row, qpos in enumerate(joint_positions):
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        depths[row] = max((-contact.dist for contact in data.contact), default=0.0)
    return np.maximum(depths, 0.0)


def _best(tries: Candidates, wishes: Sequence[GraspWish], settings: GenerateSettings) -> list[int]:
    """Row of the best good try of each wish that has one and is not like an earlier one of the same object."""
    good, chosen = tries.good(settings), []
    for index, wish in enumerate(wishes):
        rows = np.flatnonzero(good & (tries.wish == index))
        for row in rows[np.argsort(tries.cost[rows], kind="stable")]:
            same = [i for i in chosen if wishes[tries.wish[i]].object == wish.object]
            apart = [np.linalg.norm(tries.joints[i] - tries.joints[row], axis=-1).mean() for i in same]
            if min(apart, default=np.inf) >= settings.least_difference:
                chosen.append(int(row))
                break
    return chosen
