"""Contact forces that balance: the inner problem of force closure, for many grasps at once."""

from __future__ import annotations

import numpy as np

CONE_EDGES = 6


def balanced_forces(
    lever: np.ndarray, inward: np.ndarray, used: np.ndarray, friction: float, iterations: int = 40
) -> np.ndarray:
    """Contact forces within friction cones that cancel out as well as they can; their normal parts sum to
    one.

    Minimises |sum f|^2 + |sum lever x f|^2 + small |f|^2 over the edges of the (linearised) cones, by
    accelerated projected gradient descent.

    Args:
        lever: contact points relative to the centre, over a length of the caller's, shape [N, C, 3].
        inward: unit normals into the object, shape [N, C, 3].
        used: which contacts may press, shape [N, C] bool.
        friction: coefficient.
        iterations: of the descent.

    Returns:
        shape [N, C, 3]; zero where no contact may press.
    """
    count, number, _ = inward.shape
    edges = cone_edges(inward, friction)
    moments = np.cross(lever[:, :, None], edges)
    ones = np.ones((*edges.shape[:-1], 1))
    matrix = np.concatenate([edges, moments, ones], axis=-1).reshape(count, number * CONE_EDGES, 7)
    allowed = np.repeat(used, CONE_EDGES, axis=1)
    matrix = matrix * allowed[..., None]
    goal = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    regular = 1e-3
    steepest = np.linalg.eigvalsh(np.swapaxes(matrix, 1, 2) @ matrix)[:, -1:]
    step = 1.0 / (steepest + regular)
    strength = allowed / np.maximum(allowed.sum(axis=1, keepdims=True), 1)
    ahead, momentum = strength, 1.0
    for _ in range(iterations):
        error = np.einsum("nke,nk->ne", matrix, ahead) - goal
        gradient = np.einsum("nke,ne->nk", matrix, error) + regular * ahead
        moved = np.maximum(ahead - step * gradient, 0.0) * allowed
        faster = 0.5 * (1 + np.sqrt(1 + 4 * momentum**2))
        ahead = moved + (momentum - 1) / faster * (moved - strength)
        strength, momentum = moved, faster
    strength = strength / np.maximum(strength.sum(axis=1, keepdims=True), 1e-9)
    return (strength.reshape(count, number, CONE_EDGES, 1) * edges).sum(axis=2)


def cone_edges(inward: np.ndarray, friction: float) -> np.ndarray:
    """Edges of the friction cones with a normal part of one. inward: shape [..., 3]; returns [...,
    CONE_EDGES, 3]."""
    helper = np.where(np.abs(inward[..., :1]) < 0.9, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    first = np.cross(inward, helper)
    first = first / np.maximum(np.linalg.norm(first, axis=-1, keepdims=True), 1e-9)
    second = np.cross(inward, first)
    angles = 2 * np.pi * np.arange(CONE_EDGES) / CONE_EDGES
    side = np.cos(angles)[:, None] * first[..., None, :] + np.sin(angles)[:, None] * second[..., None, :]
    return inward[..., None, :] + friction * side
