"""Candidates of human grasps: checks (penetration, contact, anatomy) and selection."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial import KDTree

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import HUMAN_LINKS, HumanGraspSet
from fungrasp.grasps.human_hand import DEVIATION_LIMIT, FLEXION_RANGE, JOINT_RANGE_SLACK, joint_bends
from fungrasp.hands import load_hand
from fungrasp.hands.collisions import self_collision_depth
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.hand_state import HandState
from fungrasp.optimization.link_contacts import CONTACT_DISTANCE
from fungrasp.optimization.problem import CollisionScene
from fungrasp.synthesis.grasp_specification import GraspSpecification
from fungrasp.synthesis.human_hand_terms import HumanPoints, part_samples

HAND = "human"

FINE_SPACING = 0.004
"""Largest gap between the collision spheres used to check candidates [m]."""


@dataclass(frozen=True)
class GraspCandidates:
    """N solved grasps, several per specification, and the results of the checks."""

    specification: np.ndarray
    """Index of each candidate's specification, shape [N]."""
    joints: np.ndarray
    """Human joints [m], object frame, shape [N, 21, 3]."""
    contacts: np.ndarray
    """Links closer than ``CONTACT_DISTANCE`` to the specified parts, shape [N, 16] bool."""
    cost: np.ndarray
    """Objective of the solver, shape [N]."""
    object_penetration: np.ndarray
    """Largest depth of the hand in the object [m], shape [N]."""
    table_penetration: np.ndarray
    """Largest depth of the hand below the table top [m], shape [N]."""
    self_penetration: np.ndarray
    """Largest self-penetration of the hand [m], shape [N]."""
    part_distance: np.ndarray
    """Largest distance of a link from the part that it must touch [m], shape [N]."""
    anatomical: np.ndarray
    """Whether all joints are within the human range of motion, shape [N] bool."""

    def good(self, max_penetration: float, max_cost: float) -> np.ndarray:
        """Return whether candidates pass all checks, shape [N] bool.

        Args:
            max_penetration: largest penetration of the object, and self-penetration [m].
        """
        return (
            (self.object_penetration <= max_penetration)
            & (self.self_penetration <= max_penetration)
            & (self.table_penetration <= 0.0)
            & (self.part_distance <= CONTACT_DISTANCE)
            & (self.cost <= max_cost)
            & self.anatomical
        )


def join_candidates(batches: Sequence[GraspCandidates], counts: Sequence[int]) -> GraspCandidates:
    """Join the candidates of several batches of specifications.

    Args:
        batches: at least one.
        counts: number of specifications in each batch.
    """
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    parts = [
        replace(batch, specification=batch.specification + start)
        for batch, start in zip(batches, starts, strict=True)
    ]
    return GraspCandidates(
        **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(GraspCandidates)}
    )


def check_candidates(
    scene: CollisionScene,
    specs: Sequence[GraspSpecification],
    owner: np.ndarray,
    objects: Mapping[str, ObjectModel],
    solution: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> GraspCandidates:
    """Check N candidates with the hand's whole collision geometry.

    Args:
        specs: specification of each candidate, length N.
        owner: index of each candidate's specification, shape [N].
        solution: wrist poses, joints and costs of the candidates, as returned by ``minimize``.
    """
    hand, (pose, independent, cost) = load_hand(HAND), solution
    points = HumanPoints(HandKinematics(hand, len(specs)), spacing=FINE_SPACING)
    state = HandState(points, scene, pose, independent)
    contacts = np.zeros((len(specs), len(HUMAN_LINKS)), dtype=bool)
    part_distance = np.zeros(len(specs))
    for row, spec in enumerate(specs):
        model = objects[spec.object]
        gaps = {
            part: _link_gaps(points, state.spheres[row], part_samples(model, part)) for part in spec.all_parts
        }
        contacts[row] = np.min([gaps[part] for part in spec.all_parts], axis=0) <= CONTACT_DISTANCE
        part_distance[row] = max(
            gaps[part][HUMAN_LINKS.index(link)] for link, part in spec.part_of_link.items()
        )
    return GraspCandidates(
        specification=owner,
        joints=state.keypoints,
        contacts=contacts,
        cost=cost,
        object_penetration=np.maximum(-state.clearance.min(axis=1), 0.0),
        table_penetration=np.maximum(-state.heights.min(axis=1), 0.0),
        self_penetration=self_collision_depth(hand.model, independent),
        part_distance=part_distance,
        anatomical=_anatomical(state.keypoints),
    )


def _anatomical(joints: np.ndarray) -> np.ndarray:
    """Return whether all joints are within the human range of motion, shape [N] bool. joints: [m], shape
    [N, 21, 3]."""
    flexion, deviation = joint_bends(joints)
    within = (flexion >= FLEXION_RANGE[..., 0] - JOINT_RANGE_SLACK) & (
        flexion <= FLEXION_RANGE[..., 1] + JOINT_RANGE_SLACK
    )
    within &= np.abs(deviation) <= DEVIATION_LIMIT + JOINT_RANGE_SLACK
    return within.all(axis=(1, 2))


def _link_gaps(points: HumanPoints, spheres: np.ndarray, tree: KDTree) -> np.ndarray:
    """Return the distance of each link's surface from a part [m], shape [16]. spheres: shape [P, 3]."""
    gap = tree.query(spheres)[0] - points.spheres.radius
    return np.array([gap[members].min() for members in points.link_members])


def choose_grasps(
    candidates: GraspCandidates,
    specs: Sequence[GraspSpecification],
    objects: Mapping[str, ObjectModel],
    max_penetration: float,
    max_cost: float,
    min_difference: float,
) -> HumanGraspSet:
    """Choose the cheapest good candidate of each specification that differs from those chosen before.
    Specifications without one are skipped.

    Args:
        specs: in the order of the grasps.
        max_penetration, max_cost: see ``GraspCandidates.good``.
        min_difference: smallest mean joint distance between grasps of one object [m].

    Raises:
        FungraspError: no candidate is good.
    """
    good = candidates.good(max_penetration, max_cost)
    rows = _best(candidates, specs, good, min_difference)
    if not rows:
        raise FungraspError("no grasp meets any of the specifications")
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
        objects={name: objects[name] for name in names},
    )


def _best(
    candidates: GraspCandidates, specs: Sequence[GraspSpecification], good: np.ndarray, min_difference: float
) -> list[int]:
    """Return the row of the cheapest good candidate of each specification, if any, that differs from those
    chosen before."""
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
            if apart.min(initial=np.inf) >= min_difference:
                there[found[spec.object]] = candidates.joints[row]
                found[spec.object] += 1
                chosen.append(row)
                break
    return chosen
