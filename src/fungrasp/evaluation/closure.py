"""How well contact points can hold an object: balance of forces, and the weakest wrench they resist."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError

CONE_EDGES = 8
"""Of a friction cone, as a pyramid."""

FRICTION = 0.9
"""Of the dynamic test."""


def primitive_wrenches(
    points: np.ndarray, inward: np.ndarray, length: float, friction: float = FRICTION
) -> np.ndarray:
    """Wrenches of forces along the edges of the friction cones, normal part 1.

    Args:
        points: contacts relative to the centre of mass [m], shape [C, 3].
        inward: unit normals into the object, shape [C, 3].
        length: what torques are divided by [m].
        friction: coefficient.

    Returns:
        force and torque over ``length``, shape [C * CONE_EDGES, 6].
    """
    helper = np.where(np.abs(inward[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(inward, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(inward, first)
    angles = 2 * np.pi * np.arange(CONE_EDGES) / CONE_EDGES
    side = np.cos(angles)[:, None] * first[:, None] + np.sin(angles)[:, None] * second[:, None]
    forces = inward[:, None] + friction * side
    torques = np.cross(points[:, None] / length, forces)
    return np.concatenate([forces, torques], axis=-1).reshape(-1, 6)


def closure_residual(wrenches: np.ndarray) -> float:
    """Smallest norm of a sum of these wrenches with weights that are not negative and add up to 1.

    Zero: contact forces exist that cancel out (the condition on the grasp matrix). 1 without contacts.

    Args:
        wrenches: shape [K, 6].
    """
    if not len(wrenches):
        return 1.0
    heavy = 1e3
    weights, _ = nnls(np.vstack([wrenches.T, np.full(len(wrenches), heavy)]), np.array([0.0] * 6 + [heavy]))
    return float(np.linalg.norm(wrenches.T @ (weights / weights.sum())))


def closure_epsilon(wrenches: np.ndarray) -> float:
    """Radius of the largest ball around the origin within the convex hull of these wrenches: the weakest
    wrench that the contacts resist with normal forces that add up to 1 (Ferrari and Canny, 1992). Zero if the
    origin is not inside.

    Args:
        wrenches: shape [K, 6].
    """
    if len(wrenches) <= 6 or np.linalg.matrix_rank(wrenches - wrenches.mean(axis=0), tol=1e-6) < 6:
        return 0.0
    try:
        hull = ConvexHull(wrenches)
    except QhullError:
        return 0.0
    return float(max(0.0, -hull.equations[:, -1].max()))
