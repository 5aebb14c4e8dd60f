"""Candidates for a human grasp and their checks: penetration, contact, anatomy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial import KDTree

from fungrasp.grasps import HUMAN_LINKS
from fungrasp.grasps.anatomy import DEVIATION_LIMIT, FLEXION_RANGE, JOINT_RANGE_SLACK, joint_bends
from fungrasp.hands import Hand
from fungrasp.hands.collision_spheres import self_collision_depth
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.hand_state import HandState
from fungrasp.optimization.link_contacts import CONTACT_DISTANCE
from fungrasp.optimization.problem import CollisionScene
from fungrasp.synthesis.grasp_specification import GraspSpecification
from fungrasp.synthesis.human_hand_terms import HumanPoints, part_samples

FINE_SPACING = 0.004
"""Largest gap between the collision spheres with which candidates are checked [m]."""


@dataclass(frozen=True)
class GraspCandidates:
    """N solved grasps, several per specification, and what the checks measured."""

    specification: np.ndarray
    """Index of the specification that each candidate solves, shape [N]."""
    joints: np.ndarray
    """Human joints [m], object frame, shape [N, 21, 3]."""
    contacts: np.ndarray
    """Links nearer than ``CONTACT_DISTANCE`` to the specified parts, shape [N, 16] bool."""
    cost: np.ndarray
    """Objective of the solver, shape [N]."""
    object_penetration: np.ndarray
    """Largest depth of the hand in the object [m], shape [N]."""
    table_penetration: np.ndarray
    """Largest depth of the hand below the table top [m], shape [N]."""
    self_penetration: np.ndarray
    """Largest depth of the hand in itself [m], shape [N]."""
    part_distance: np.ndarray
    """Largest distance of a link from the part that it must touch [m], shape [N]."""
    anatomical: np.ndarray
    """Whether all joints are within people's range of motion, shape [N] bool."""

    def good(self, max_penetration: float, max_cost: float) -> np.ndarray:
        """Which pass all checks, shape [N] bool.

        Args:
            max_penetration: of the object, and of the hand by itself [m].
            max_cost: of the objective.
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
    """The candidates of several batches of specifications.

    Args:
        batches: at least one.
        counts: specifications of each batch.
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
    hand: Hand,
    scene: CollisionScene,
    specs: Sequence[GraspSpecification],
    owner: np.ndarray,
    objects: Mapping[str, ObjectModel],
    pose: np.ndarray,
    independent: np.ndarray,
    cost: np.ndarray,
) -> GraspCandidates:
    """Measure N candidates on the hand's whole collision geometry.

    Args:
        hand: the human hand.
        scene: objects and table.
        specs: the specification of each candidate, length N.
        owner: index of each candidate's specification, shape [N].
        objects: by name.
        pose, independent, cost: of the candidates, as ``minimize`` returns them.
    """
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
    """Whether all joints are within people's range of motion, shape [N] bool. joints: [m], shape [N, 21,
    3]."""
    flexion, deviation = joint_bends(joints)
    within = (flexion >= FLEXION_RANGE[..., 0] - JOINT_RANGE_SLACK) & (
        flexion <= FLEXION_RANGE[..., 1] + JOINT_RANGE_SLACK
    )
    within &= np.abs(deviation) <= DEVIATION_LIMIT + JOINT_RANGE_SLACK
    return within.all(axis=(1, 2))


def _link_gaps(points: HumanPoints, spheres: np.ndarray, tree: KDTree) -> np.ndarray:
    """Distance of each link's surface from a part [m], shape [16]. spheres: shape [P, 3]."""
    gap = tree.query(spheres)[0] - points.spheres.radius
    return np.array([gap[members].min() for members in points.link_members])
