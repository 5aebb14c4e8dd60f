"""The terms of the retargeting objective (paper IV.A).

The objective is half the sum of squares of all residuals. A term is a function of the hand's points and of N
grasps to solve, which says how it is added to their normal equations; ``functools.partial`` gives it its
other arguments. Residuals are divided by the length or angle at which they count as one unit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fungrasp.optimization.closure_term import force_closure
from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.optimization.collision_terms import (
    object_penetration,
    self_penetration,
    table_penetration,
)
from fungrasp.optimization.frames import AddTerm, Equations, Frames
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.link_contacts import contact_gap
from fungrasp.optimization.pose_terms import (
    contact_position,
    fingertip_position,
    keypoint_position,
    link_direction,
    stay_near,
)

__all__ = [
    "Residual",
    "ResidualTerm",
    "Term",
    "contact_gap",
    "contact_position",
    "fingertip_position",
    "force_closure",
    "keypoint_position",
    "link_direction",
    "object_penetration",
    "residual_terms",
    "self_penetration",
    "stay_near",
    "table_penetration",
]

Term = Callable[[HandPoints, Any], AddTerm]
"""A term of the objective."""

Residual = tuple[np.ndarray, np.ndarray]
"""Residuals, shape [N, R], and their Jacobian, shape [N, R, D]."""

ResidualTerm = Callable[[HandState[Any]], Residual]
"""A term that is written with NumPy."""


def residual_terms(terms: Sequence[ResidualTerm]) -> Term:
    """One term of several that are written with NumPy: simpler to write than compiled ones, and slower."""

    def bind(points: HandPoints, problem: CollisionScene) -> AddTerm:
        def add(frames: Frames, equations: Equations, pose: np.ndarray, independent: np.ndarray) -> None:
            state = HandState(points, problem, pose, independent)
            for term in terms:
                residual, jacobian = term(state)
                transposed = np.swapaxes(jacobian, 1, 2)
                equations.cost[:] += 0.5 * np.sum(residual**2, axis=1)
                equations.hessian[:] += transposed @ jacobian
                equations.gradient[:] += (transposed @ residual[..., None])[..., 0]

        return add

    return bind
