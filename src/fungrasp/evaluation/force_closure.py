"""Force closure of contact points: balance of forces, and the weakest wrench they resist."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError

from fungrasp.optimization.friction_cones import friction_cone_edges
from fungrasp.simulation.scene import SceneSettings

CLOSURE_CONE_EDGES = 8
"""Edges of the pyramids that stand for friction cones in the wrenches that are measured."""


def primitive_wrenches(
    points: np.ndarray, inward: np.ndarray, length: float, friction: float = SceneSettings.friction
) -> np.ndarray:
    """Wrenches of forces along the edges of the friction cones, normal part 1.

    Args:
        points: contacts relative to the center of mass [m], shape [C, 3].
        inward: unit normals into the object, shape [C, 3].
        length: what torques are divided by [m].
        friction: coefficient; by default that of the lift test.

    Returns:
        force and torque over ``length``, shape [C * CLOSURE_CONE_EDGES, 6].
    """
    forces = friction_cone_edges(inward, friction, CLOSURE_CONE_EDGES)
    torques = np.cross(points[:, None] / length, forces)
    return np.concatenate([forces, torques], axis=-1).reshape(-1, 6)


def closure_residual(wrenches: np.ndarray) -> float:
    """Smallest norm of a sum of these wrenches with non-negative weights that add up to 1.

    Exact, by non-negative least squares, and with more edges than the solver, whose
    own error it must not share.

    Zero: contact forces exist that cancel out (the condition on the grasp matrix). 1 without contacts.

    Args:
        wrenches: shape [K, 6].
    """
    if not len(wrenches):
        return 1.0
    # The sum of the weights is one more equation, with a large factor; ``nnls`` keeps the weights
    # non-negative.
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
