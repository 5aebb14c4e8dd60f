"""Whether an object could be used, and where the hand touched it (docs/evaluate.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.geometry.poses import quaternion_conjugate, quaternion_multiply, rotation_vector

LARGEST_SHIFT = 0.01
"""Largest displacement of the object's center of mass in the palm [m]."""

LARGEST_TURN = np.deg2rad(10.0)
"""Largest turn of the object in the palm [rad]."""


@dataclass(frozen=True, eq=False, repr=False)
class UseOutcomes(BatchRecord):
    """Outcomes of W use tests, shape [W] each; NaN and "" where nothing was tested."""

    motion: np.ndarray
    """Name of the motion, "" where the task has none or the object was not held, str."""
    success: np.ndarray
    """Whether the object stayed in the palm and did what it is for, bool."""
    shift_m: np.ndarray
    """Largest displacement of the object's center of mass in the palm during the motion [m]."""
    turn_rad: np.ndarray
    """Largest turn of the object in the palm during the motion [rad]."""
    trigger_force_n: np.ndarray
    """Force between the pressing finger and the object at the end [N]; NaN without a trigger."""
    functional_contact: np.ndarray
    """Share of the links that should touch that touch the part which the person held there, when the motion
    begins."""
    reason: np.ndarray
    """Why the test failed, "" on success, str."""


def displacement(
    start: tuple[np.ndarray, np.ndarray], now: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """How far objects have moved [m] and turned [rad] in the palm, shape [I] each.

    Args:
        start: centers of mass [m], shape [I, 3], and rotations, shape [I, 4], in the palm's frame; or one of
            each, without the first axis.
        now: the same, later.
    """
    turn = rotation_vector(quaternion_multiply(now[1], quaternion_conjugate(start[1])))
    return np.linalg.norm(now[0] - start[0], axis=-1), np.linalg.norm(turn, axis=-1)


def moved_too_far(shift: float, turn: float) -> str:
    """Why an object has not stayed in the palm, "" if it has. The largest displacement [m] and turn [rad]."""
    if shift > LARGEST_SHIFT:
        return "the object slipped in the palm"
    if turn > LARGEST_TURN:
        return "the object turned in the palm"
    return ""
