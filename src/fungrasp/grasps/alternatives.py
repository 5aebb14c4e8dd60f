"""Alternatives of a robot grasp: what becomes of several human hands that one image allows.

They are kept in ``RobotGraspSet.extra``, so that one row remains one grasp; a planner that knows them chooses
among them, others take the first.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.grasps.robot_grasp import RobotGraspSet

PROBABILITY = "alternative_probability"
"""Name in ``extra`` of the alternatives' probabilities, shape [N, H], the grasp itself first; 0 where a grasp
has fewer."""

FIELDS = ("wrist_pose", "joint_positions", "keypoints", "link_contacts")
"""In what alternatives differ; in ``extra`` they are called ``alternative_...``, of shape [N, H, ...]."""

SUM_TOLERANCE = 1e-6
"""How far the sum of the probabilities of one grasp may be from 1."""


def alternative_rows(probability: np.ndarray) -> list[np.ndarray]:
    """Rows of the alternatives of each grasp.

    Args:
        probability: of each row, shape [R]; see ``HumanGraspSet.probability``.

    Raises:
        FungraspError: they don't sum to one.
    """
    groups, total, first = [], 0.0, 0
    for row, value in enumerate(probability.tolist()):
        total += value
        if abs(total - 1.0) <= SUM_TOLERANCE:
            groups.append(np.arange(first, row + 1))
            total, first = 0.0, row + 1
        elif total > 1.0:
            break
    if first < len(probability):
        raise FungraspError(
            f"field 'probability', row {first}: the probabilities of the alternatives of a grasp must sum "
            "to 1; take all rows of an image or none"
        )
    return groups


def join_alternatives(grasps: RobotGraspSet, probability: np.ndarray) -> RobotGraspSet:
    """One row of each grasp, its alternatives in ``extra``.

    Args:
        grasps: R rows, one of each alternative.
        probability: of each row, shape [R].

    Raises:
        FungraspError: the probabilities of a grasp don't sum to one.
    """
    groups = alternative_rows(probability)
    most = max(len(rows) for rows in groups)
    # Those with fewer alternatives repeat their first, with probability 0.
    rows = np.array([np.append(rows, np.full(most - len(rows), rows[0])) for rows in groups])
    real = np.arange(most) < np.array([len(rows) for rows in groups])[:, None]
    extra = {f"alternative_{name}": getattr(grasps, name)[rows] for name in FIELDS}
    first = grasps.select(rows[:, 0])
    return replace(first, extra={**first.extra, **extra, PROBABILITY: np.where(real, probability[rows], 0.0)})


def share_out(grasps: RobotGraspSet, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Which alternative each of some candidates is made from: the first from the first, all as often as is
    probable.

    Args:
        grasps: G of them.
        count: candidates of each.

    Returns:
        Number of the alternative, and how many candidates before have the same, both shape [count, G].
    """
    probability = grasps.extra.get(PROBABILITY)
    if probability is None:
        probability = np.ones((len(grasps), 1))
    which, number = np.zeros((2, count, len(grasps)), dtype=int)
    each, taken = np.arange(len(grasps)), np.zeros(probability.shape, dtype=int)
    for k in range(count):
        which[k] = (probability * (k + 1) - taken).argmax(axis=1) if k else 0
        number[k] = taken[each, which[k]]
        taken[each, which[k]] += 1
    return which, number


def take_alternatives(grasps: RobotGraspSet, which: np.ndarray) -> RobotGraspSet:
    """The grasps with an alternative in place of each. which: its number, shape [N]."""
    if PROBABILITY not in grasps.extra:
        return grasps
    rows = np.arange(len(grasps))
    return replace(grasps, **{name: grasps.extra[f"alternative_{name}"][rows, which] for name in FIELDS})
