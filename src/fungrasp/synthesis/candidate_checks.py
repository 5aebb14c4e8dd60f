"""What a try at a human grasp is worth: penetration, touch, and whether a person's hand bends like that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial import KDTree

from fungrasp.grasps import HUMAN_LINKS
from fungrasp.grasps.anatomy import DEVIATION_LIMIT, FLEXION_RANGE, SLACK, joint_bends
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.hand_problem import State, Surroundings
from fungrasp.synthesis.human_hand_terms import HumanPoints, part_samples
from fungrasp.synthesis.specification import GraspWish

TOUCH = 0.003
"""Links nearer to the object than this touch it [m]."""

FINE = 0.004
"""Between the balls that stand for the hand's surface [m]."""


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

    def good(self, most_penetration: float, most_cost: float) -> np.ndarray:
        """Which pass all checks, shape [N] bool.

        Args:
            most_penetration: of the object, and of the hand by itself [m].
            most_cost: of the objective.
        """
        return (
            (self.object_penetration <= most_penetration)
            & (self.self_penetration <= most_penetration)
            & (self.table_penetration <= 0.0)
            & (self.missed <= TOUCH)
            & (self.cost <= most_cost)
            & self.anatomical
        )


def judge(
    hand: Hand,
    around: Surroundings,
    wishes: Sequence[GraspWish],
    owner: np.ndarray,
    objects: Mapping[str, ObjectModel],
    pose: np.ndarray,
    independent: np.ndarray,
    cost: np.ndarray,
) -> Candidates:
    """Measure N tries on the hand's whole collision geometry.

    Args:
        hand: the human one.
        around: objects and table.
        wishes: of each try, length N.
        owner: index of each try's wish, shape [N].
        objects: by name.
        pose, independent, cost: of the tries, as ``minimise`` gives them.
    """
    points = HumanPoints(HandKinematics(hand, len(wishes)), spacing=FINE)
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


def _link_gaps(points: HumanPoints, balls: np.ndarray, tree: KDTree) -> np.ndarray:
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
