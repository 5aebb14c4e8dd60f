"""Human grasps from wishes: the retargeter's optimiser, the human hand, contact targets on named parts.

from fungrasp.synthesis.synthesize import generate
from fungrasp.synthesis.specification import GraspWish

wish = GraspWish("can", "drink", "body", "wrap", at=(0, 0, 0), palm=(0, 1, 0), fingers=(1, 0, 0))
grasps = generate([wish], seed=0)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import HUMAN_LINKS, HumanGraspSet
from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel, load_object
from fungrasp.optimization import terms
from fungrasp.optimization.hand_problem import Problem, State, Surroundings, nearest_surface
from fungrasp.optimization.levenberg_marquardt import Term, minimise
from fungrasp.synthesis.candidate_checks import Candidates, judge
from fungrasp.synthesis.human_hand_terms import (
    HumanPoints,
    Targets,
    natural_posture,
    part_gap,
    part_place,
    part_samples,
)
from fungrasp.synthesis.initial_poses import approached, closed_hand, random_offsets, wished_pose
from fungrasp.synthesis.specification import GraspWish

HAND = "human"

CHUNK = 12
"""Wishes worked on together."""


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
    closure_unit: float = 0.06
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


def generate(
    wishes: Sequence[GraspWish],
    seed: int = 0,
    settings: GenerateSettings | None = None,
    objects: Mapping[str, ObjectModel] | None = None,
    progress: Callable[[int], None] = lambda count: None,
) -> HumanGraspSet:
    """Make human grasps of objects at rest on the table; wishes that can't be met are left out.

    Every grasp has bones of exactly the human hand's lengths, joints within its limits, no more than 2 mm of
    penetration, nothing below the table, and its links on their parts; no two are alike.

    Args:
        wishes: what to make. The grasps keep their order.
        seed: of the random starts. The same wishes and seed give the same grasps.
        settings: the defaults if None.
        objects: by name; built-in ones that are not in it are found by themselves.
        progress: called with the number of wishes that have just been worked on.

    Raises:
        FungraspError: an object or part does not exist, or none of the wishes can be met.
    """
    settings = settings or GenerateSettings()
    things = _objects(wishes, objects)
    tries = attempt(wishes, seed, settings, things, progress)
    rows = _best(tries, wishes, settings)
    if not rows:
        raise FungraspError("none of the wished grasps can be met; see fungrasp.synthesis.synthesize.attempt")
    chosen = tries.wish[rows].tolist()
    names = [wishes[i].object for i in chosen]
    pose = np.array([wishes[i].rest_pose(things[wishes[i].object]) for i in chosen]).reshape(-1, 7)
    return HumanGraspSet(
        object_name=np.array(names),
        object_mass=np.array([things[name].mass for name in names]),
        object_pose=pose,
        object_rest_pose=pose,
        hand_joints=transform_points(pose, tries.joints[rows]),
        link_contacts=tries.contacts[rows],
        task=np.array([wishes[i].task for i in chosen]),
    )


def attempt(
    wishes: Sequence[GraspWish],
    seed: int = 0,
    settings: GenerateSettings | None = None,
    objects: Mapping[str, ObjectModel] | None = None,
    progress: Callable[[int], None] = lambda count: None,
) -> Candidates:
    """All tries of all wishes, good or not: what to look at when a wish is left out. See ``generate``."""
    settings = settings or GenerateSettings()
    things = _objects(wishes, objects)
    chunks = []
    for start in range(0, len(wishes), CHUNK):
        part = wishes[start : start + CHUNK]
        found = _attempt(part, things, seed, settings)
        chunks.append({f.name: getattr(found, f.name) for f in fields(found)} | {"wish": found.wish + start})
        progress(len(part))
    return Candidates(
        **{f.name: np.concatenate([chunk[f.name] for chunk in chunks]) for f in fields(Candidates)}
    )


def _objects(wishes: Sequence[GraspWish], known: Mapping[str, ObjectModel] | None) -> dict[str, ObjectModel]:
    """The wishes' objects by name, their parts checked."""
    known = known or {}
    names = dict.fromkeys(wish.object for wish in wishes)
    objects = {name: known[name] if name in known else load_object(name) for name in names}
    for wish in wishes:
        for part in wish.all_parts:
            part_samples(objects[wish.object], part)
    return objects


def _attempt(
    wishes: Sequence[GraspWish], objects: Mapping[str, ObjectModel], seed: int, settings: GenerateSettings
) -> Candidates:
    owner = np.repeat(np.arange(len(wishes)), settings.starts)
    each = [wish for wish in wishes for _ in range(settings.starts)]
    hand = load_hand(HAND)
    points = HumanPoints(HandKinematics(hand, len(each)))
    names = [wish.object for wish in each]
    rest = np.array([wish.rest_pose(objects[wish.object]) for wish in each])
    around = Surroundings.settled(names, rest, objects)
    shaken = random_offsets(wishes, seed, settings.starts, settings.shift, settings.turn)
    pose = approached(points, around, each, wished_pose(each, shaken))
    independent = closed_hand(points, around, each, pose)
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
    return judge(hand, around, each, owner, objects, pose, independent, cost)


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


def _best(tries: Candidates, wishes: Sequence[GraspWish], settings: GenerateSettings) -> list[int]:
    """Row of the best good try of each wish that is not like an earlier one of the same object, if any."""
    good, chosen = tries.good(settings.most_penetration, settings.most_cost), []
    for index, wish in enumerate(wishes):
        rows = np.flatnonzero(good & (tries.wish == index))
        for row in rows[np.argsort(tries.cost[rows], kind="stable")]:
            same = [i for i in chosen if wishes[int(tries.wish[i])].object == wish.object]
            apart = [np.linalg.norm(tries.joints[i] - tries.joints[row], axis=-1).mean() for i in same]
            if min(apart, default=np.inf) >= settings.least_difference:
                chosen.append(int(row))
                break
    return chosen
