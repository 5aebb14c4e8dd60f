"""Human grasps from specifications: the solver of retargeting, applied to the human hand, with contact
targets on named parts of the object."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import HUMAN_LINKS, HumanGraspSet
from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel, load_object
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandState
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.problem import GRAVITY, CollisionScene, RetargetingProblem, project_to_surface
from fungrasp.optimization.terms import Term
from fungrasp.synthesis.grasp_candidates import GraspCandidates, check_candidates
from fungrasp.synthesis.grasp_specification import GraspSpecification
from fungrasp.synthesis.human_hand_terms import (
    HumanPoints,
    PartTargets,
    natural_posture,
    part_gap,
    part_samples,
    place_error,
)
from fungrasp.synthesis.initial_poses import (
    approach_until_contact,
    close_until_contact,
    random_offsets,
    specified_wrist_pose,
)

HAND = "human"

BATCH_SIZE = 12
"""Number of specifications solved together."""


@dataclass(frozen=True)
class SynthesisSettings:
    """Random starts, the size at which each term counts as one unit, and what a good grasp satisfies."""

    starts: int = 5
    """Candidates per specification: the first starts as specified, the others shifted and turned at
    random."""
    shift: float = 0.006
    """Standard deviation of the random shifts of the wrist [m]."""
    turn: float = 0.12
    """Standard deviation of the random turns of the wrist [rad]."""
    gap_unit: float = 0.0015
    """Distance of a link from its part that counts as one unit [m]."""
    place_unit: float = 0.006
    """Distance of a link from its specified place that counts as one unit [m]."""
    object_unit: float = 0.0006
    """Penetration of the object that counts as one unit [m]."""
    table_unit: float = 0.0006
    """Penetration of the table that counts as one unit [m]."""
    table_margin: float = 0.0015
    """Distance to keep from the table [m]."""
    self_unit: float = 0.001
    """Penetration of the hand by itself that counts as one unit [m]."""
    closure_unit: float = 0.06
    """Unbalanced part of contact forces that sum to one, at which it counts as one unit [-]."""
    wrist_unit: float = 0.02
    """Distance of the wrist from its start that counts as one unit [m]."""
    wrist_turn_unit: float = 0.3
    """Turn of the wrist from its start that counts as one unit [rad]."""
    first_iterations: int = 20
    """Solver iterations with units four times as large."""
    second_iterations: int = 40
    """Solver iterations with the units above and force closure."""
    max_penetration: float = 0.002
    """Deepest allowed penetration of the object, and of the hand by itself [m]."""
    max_cost: float = 25.0
    """Largest objective of a grasp that looks natural."""
    min_difference: float = 0.006
    """Grasps of one object whose joints are nearer than this on average are the same grasp [m]."""


def specification_batches(specs: Sequence[GraspSpecification]) -> list[Sequence[GraspSpecification]]:
    """Specifications that are solved together. Batches do not depend on each other."""
    return [specs[start : start + BATCH_SIZE] for start in range(0, len(specs), BATCH_SIZE)]


def specified_objects(
    specs: Sequence[GraspSpecification], known: Mapping[str, ObjectModel] | None = None
) -> dict[str, ObjectModel]:
    """The specifications' objects by name, their parts checked.

    Args:
        specs: of grasps.
        known: objects by name; built-in ones that are not in it are found by themselves.

    Raises:
        FungraspError: an object or part does not exist.
    """
    known = known or {}
    names = dict.fromkeys(spec.object for spec in specs)
    objects = {name: known[name] if name in known else load_object(name) for name in names}
    for spec in specs:
        for part in spec.all_parts:
            part_samples(objects[spec.object], part)
    return objects


def solve_batch(
    specs: Sequence[GraspSpecification],
    objects: Mapping[str, ObjectModel],
    seed: int,
    settings: SynthesisSettings,
) -> GraspCandidates:
    """Candidates of a few specifications, solved together.

    Args:
        specs: one of ``specification_batches``.
        objects: by name.
        seed: of the random starts.
        settings: of the solver.
    """
    owner = np.repeat(np.arange(len(specs)), settings.starts)
    each = [spec for spec in specs for _ in range(settings.starts)]
    hand = load_hand(HAND)
    points = HumanPoints(HandKinematics(hand, len(each)))
    names = [spec.object for spec in each]
    rest = np.array([spec.rest_pose(objects[spec.object]) for spec in each])
    scene = CollisionScene.settled(names, rest, objects)
    offsets = random_offsets(specs, seed, settings.starts, settings.shift, settings.turn)
    pose = approach_until_contact(points, scene, each, specified_wrist_pose(each, offsets))
    independent = close_until_contact(points, scene, each, pose)
    targets = PartTargets.from_specifications(each, objects)
    problem = _problem(points, scene, each, objects, pose, independent)
    wrist = partial(
        terms.stay_near,
        start=(pose, independent),
        unit=np.inf,
        position_unit=settings.wrist_unit,
        rotation_unit=settings.wrist_turn_unit,
    )
    table = partial(terms.table_penetration, margin=settings.table_margin)

    def objective(factor: float, *more: Term) -> list[Term]:
        """``more``, and terms whose units of contact and penetration are ``factor`` times as large, of places
        its root."""
        specified = [
            partial(natural_posture, kinds=[spec.kind for spec in each]),
            partial(part_gap, targets=targets, unit=factor * settings.gap_unit),
            partial(place_error, targets=targets, unit=factor**0.5 * settings.place_unit),
        ]
        return [
            wrist,
            partial(terms.object_penetration, unit=factor * settings.object_unit),
            partial(table, unit=factor * settings.table_unit),
            partial(terms.self_penetration, unit=factor * settings.self_unit),
            *more,
            terms.residual_terms(specified),
        ]

    first, second = settings.first_iterations, settings.second_iterations
    pose, independent, _ = minimize(points, problem, objective(4.0), pose, independent, first)
    closure = partial(terms.force_closure, unit=settings.closure_unit)
    pose, independent, cost = minimize(points, problem, objective(1.0, closure), pose, independent, second)
    return check_candidates(hand, scene, each, owner, objects, pose, independent, cost)


def choose_grasps(
    candidates: GraspCandidates,
    specs: Sequence[GraspSpecification],
    settings: SynthesisSettings,
    objects: Mapping[str, ObjectModel],
) -> HumanGraspSet:
    """The cheapest good candidate of each specification that differs from those chosen before it; a
    specification without one is left out.

    Args:
        candidates: of all specifications.
        specs: in the order of the grasps.
        settings: what is good, and what is different.
        objects: by name.

    Raises:
        FungraspError: there is none.
    """
    rows = _best(candidates, specs, settings)
    if not rows:
        raise FungraspError("none of the specified grasps can be met")
    chosen = candidates.specification[rows].tolist()
    names = [specs[i].object for i in chosen]
    pose = np.array([specs[i].rest_pose(objects[specs[i].object]) for i in chosen]).reshape(-1, 7)
    return HumanGraspSet(
        object_name=np.array(names),
        object_mass=np.array([objects[name].mass for name in names]),
        object_pose=pose,
        object_rest_pose=pose,
        hand_joints=transform_points(pose, candidates.joints[rows]),
        link_contacts=candidates.contacts[rows],
        task=np.array([specs[i].task for i in chosen]),
    )


def _problem(
    points: HumanPoints,
    scene: CollisionScene,
    specs: Sequence[GraspSpecification],
    objects: Mapping[str, ObjectModel],
    pose: np.ndarray,
    independent: np.ndarray,
) -> RetargetingProblem:
    """The specifications as a retargeting problem: the links that must touch, the human hand at its start."""
    contacts = np.array([[link in spec.links for link in HUMAN_LINKS] for spec in specs])
    joints = HandState(points, scene, pose, independent).keypoints
    surface, normals = project_to_surface(scene.bank, scene.grid, joints)
    return RetargetingProblem(
        **{f.name: getattr(scene, f.name) for f in fields(scene)},
        joints=joints,
        contacts=contacts,
        surface=surface,
        normals=normals,
        center=np.array([objects[spec.object].center_of_mass for spec in specs]),
        extent=np.array([0.5 * np.linalg.norm(objects[spec.object].size) for spec in specs]),
        weight=GRAVITY * np.array([objects[spec.object].mass for spec in specs]),
    )


def _best(
    candidates: GraspCandidates, specs: Sequence[GraspSpecification], settings: SynthesisSettings
) -> list[int]:
    """Row of the cheapest good candidate of each specification, if any, that differs from those chosen
    before."""
    good = candidates.good(settings.max_penetration, settings.max_cost)
    order = np.lexsort((candidates.cost, candidates.specification))
    order = order[good[order]]
    first = np.searchsorted(candidates.specification[order], np.arange(len(specs) + 1))
    counts = Counter(spec.object for spec in specs)
    # Joints of the chosen grasps of each object, in the leading rows.
    joints = {name: np.empty((count, *candidates.joints.shape[1:])) for name, count in counts.items()}
    found, chosen = dict.fromkeys(counts, 0), []
    for index, spec in enumerate(specs):
        there = joints[spec.object]
        for row in order[first[index] : first[index + 1]].tolist():
            before = there[: found[spec.object]]
            apart = np.linalg.norm(before - candidates.joints[row], axis=-1).mean(axis=-1)
            if apart.min(initial=np.inf) >= settings.min_difference:
                there[found[spec.object]] = candidates.joints[row]
                found[spec.object] += 1
                chosen.append(row)
                break
    return chosen
