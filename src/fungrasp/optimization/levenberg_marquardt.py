"""Levenberg-Marquardt for many small problems at once, with bounds on the joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.terms import Residual

Term = Callable[[HandState[Any]], Residual]


def minimize(
    points: HandPoints,
    problem: CollisionScene,
    terms: Sequence[Term],
    wrist_pose: np.ndarray,
    independent: np.ndarray,
    iterations: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Minimise half the sum of squares of all terms for each grasp by itself.

    Joints at a limit that would be pushed beyond it are held there; steps are clipped to the limits.

    Args:
        points: kinematics made for N hands.
        problem: N grasps, object frame.
        terms: functions of a ``HandState`` as in ``fungrasp.optimization.terms``.
        wrist_pose: start, object frame, shape [N, 7].
        independent: start [rad], shape [N, U].
        iterations: number of steps tried.

    Returns:
        wrist poses [N, 7], independent joints [N, U], objective [N].
    """
    kinematics = points.kinematics
    wrist_pose, independent = wrist_pose.copy(), independent.copy()
    damping = np.full(len(problem), 1e-2)
    cost, hessian, gradient = _normal_equations(HandState(points, problem, wrist_pose, independent), terms)
    diagonal = np.arange(kinematics.size)
    for _ in range(iterations):
        h, g = hessian.copy(), gradient.copy()
        # Active set: a joint at a limit whose descent step (minus the gradient) points outwards is held
        # there, by a zero gradient, zero off-diagonals and one on the diagonal of its row. Columns 0 to 5 are
        # the wrist.
        stuck = np.zeros(g.shape, dtype=bool)
        stuck[:, 6:] = ((independent <= kinematics.lower + 1e-9) & (g[:, 6:] > 0)) | (
            (independent >= kinematics.upper - 1e-9) & (g[:, 6:] < 0)
        )
        g[stuck] = 0.0
        h *= ~(stuck[:, :, None] | stuck[:, None, :])
        scale = h[:, diagonal, diagonal]
        h[:, diagonal, diagonal] += (
            damping[:, None] * (scale + 1e-3 * scale.max(axis=1, keepdims=True)) + stuck + 1e-9
        )
        step = -np.linalg.solve(h, g[..., None])[..., 0]
        # Longer steps than 0.5 (meters and radians together) leave where the linearization holds.
        step *= np.minimum(1.0, 0.5 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9))
        new_pose, new_independent = kinematics.step(wrist_pose, independent, step)
        new_cost, new_hessian, new_gradient = _normal_equations(
            HandState(points, problem, new_pose, new_independent), terms
        )
        better = new_cost < cost
        damping = np.clip(np.where(better, damping * 0.4, damping * 4.0), 1e-6, 1e4)
        for old, new in (
            (wrist_pose, new_pose),
            (independent, new_independent),
            (cost, new_cost),
            (hessian, new_hessian),
            (gradient, new_gradient),
        ):
            old[better] = new[better]
    return wrist_pose, independent, cost


def _normal_equations(state: HandState, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Objective [N], Gauss-Newton Hessian J^T J [N, D, D] and gradient J^T r [N, D]."""
    cost, hessian, gradient = 0.0, 0.0, 0.0
    for term in terms:
        residual, jacobian = term(state)
        transposed = np.swapaxes(jacobian, 1, 2)
        cost = cost + 0.5 * np.sum(residual**2, axis=1)
        hessian = hessian + transposed @ jacobian
        gradient = gradient + (transposed @ residual[..., None])[..., 0]
    return np.asarray(cost), np.asarray(hessian), np.asarray(gradient)
