"""Friction cones, and contact forces within them that balance, for many grasps at once."""

from __future__ import annotations

import numpy as np

CONTACT_DISTANCE = 0.003
"""A link of a retargeted or synthesized hand nearer to the object than this touches it [m]."""

BALANCE_CONE_EDGES = 6
"""Edges of the pyramids that stand for friction cones in ``balanced_forces``."""

BALANCE_ITERATIONS = 40
"""Iterations of ``balanced_forces``."""


def balanced_forces(
    lever: np.ndarray,
    inward: np.ndarray,
    used: np.ndarray,
    friction: float,
    iterations: int = BALANCE_ITERATIONS,
) -> np.ndarray:
    """Contact forces within friction cones whose sum and moment are as small as possible; their normal parts
    sum to one.

    Minimizes |sum f|^2 + |sum lever x f|^2 + 1e-3 |w|^2 + (sum w - 1)^2 over the weights w >= 0 of the cones'
    edges, by accelerated projected gradient descent (Nesterov), then scales the sum of the weights to one.

    Args:
        lever: contact points relative to the center, over a length of the caller's, shape [N, C, 3].
        inward: unit normals into the object, shape [N, C, 3].
        used: which contacts may press, shape [N, C] bool.
        friction: coefficient.
        iterations: of the descent.

    Returns:
        shape [N, C, 3]; zero where no contact may press.
    """
    count, number, _ = inward.shape
    edges = friction_cone_edges(inward, friction, BALANCE_CONE_EDGES)
    moments = np.cross(lever[:, :, None], edges)
    ones = np.ones((*edges.shape[:-1], 1))
    # Rows are the C * BALANCE_CONE_EDGES edges; columns are force, moment, and the normal part with its goal
    # of one.
    matrix = np.concatenate([edges, moments, ones], axis=-1).reshape(count, number * BALANCE_CONE_EDGES, 7)
    allowed = np.repeat(used, BALANCE_CONE_EDGES, axis=1)
    matrix = matrix * allowed[..., None]
    goal = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    regular = 1e-3
    # The step is one over the largest eigenvalue of the objective's Hessian, the Lipschitz constant.
    step = 1.0 / (largest_eigenvalue_bound(np.swapaxes(matrix, 1, 2) @ matrix)[:, None] + regular)
    weights = allowed / np.maximum(allowed.sum(axis=1, keepdims=True), 1)
    ahead, momentum = weights, 1.0
    for _ in range(iterations):
        error = np.einsum("nke,nk->ne", matrix, ahead) - goal
        gradient = np.einsum("nke,ne->nk", matrix, error) + regular * ahead
        moved = np.maximum(ahead - step * gradient, 0.0) * allowed
        next_momentum = 0.5 * (1 + np.sqrt(1 + 4 * momentum**2))
        ahead = moved + (momentum - 1) / next_momentum * (moved - weights)
        weights, momentum = moved, next_momentum
    weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
    return (weights.reshape(count, number, BALANCE_CONE_EDGES, 1) * edges).sum(axis=2)


def largest_eigenvalue_bound(matrix: np.ndarray) -> np.ndarray:
    """Largest eigenvalue of symmetric, positive semidefinite matrices, from above: the sixteenth root of the
    sum of the sixteenth powers of all E eigenvalues, by at most E^(1/16) too large.

    Args:
        matrix: shape [N, E, E].

    Returns:
        shape [N].
    """
    trace = np.trace(matrix, axis1=1, axis2=2)
    power = matrix / np.maximum(trace, 1e-300)[:, None, None]
    for _ in range(3):
        power = power @ power
    return trace * np.sum(power**2, axis=(1, 2)) ** (1 / 16)


def friction_cone_edges(normals: np.ndarray, friction: float, count: int) -> np.ndarray:
    """Edges of the pyramids inscribed in friction cones, each with a normal part of one.

    Args:
        normals: unit vectors along the cones' axes, into the object, shape [..., 3].
        friction: coefficient, the tangent of the cones' half angle.
        count: E, the number of edges.

    Returns:
        shape [..., E, 3].
    """
    # Any vector that is not parallel to the normal gives a first tangent.
    helper = np.where(np.abs(normals[..., :1]) < 0.9, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    first = np.cross(normals, helper)
    first = first / np.maximum(np.linalg.norm(first, axis=-1, keepdims=True), 1e-9)
    second = np.cross(normals, first)
    angles = 2 * np.pi * np.arange(count) / count
    tangents = np.cos(angles)[:, None] * first[..., None, :] + np.sin(angles)[:, None] * second[..., None, :]
    return normals[..., None, :] + friction * tangents
