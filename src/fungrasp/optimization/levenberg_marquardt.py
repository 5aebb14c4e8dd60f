"""Levenberg-Marquardt for many small problems at once, with bounds on the joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

import mujoco
import numpy as np

from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.terms import Residual

Term = Callable[[HandState[Any]], Residual]

COMPILED = find_spec("numba") is not None
"""Whether loops can be compiled: Numba is installed."""

TOLERANCE = 3e-3
"""Share of its objective that a grasp must gain to go on, at least in one of ``PATIENCE`` steps."""

PATIENCE = 4
"""Steps without enough gain after which a grasp is left as it is. As spheres and links enter and leave the
terms, a step may fail and the next, shorter one succeed."""

LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e4
"""Bounds of the damping, as a share of the Hessian's diagonal."""

EASING = 0.4
"""Factor of the damping after a step that lowered the objective."""

STIFFENING = 4.0
"""Factor of the damping after one that did not; twice the last factor where that one failed as well (Nielsen,
1999)."""


def minimize(
    points: HandPoints,
    problem: CollisionScene,
    terms: Sequence[Term],
    wrist_pose: np.ndarray,
    independent: np.ndarray,
    iterations: int,
    tolerance: float = TOLERANCE,
    compiled: bool = COMPILED,
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
        tolerance: share of its objective that a grasp must gain in ``PATIENCE`` steps to go on.
        compiled: by compiled loops, which need Numba and hinge joints, or by NumPy.

    Returns:
        wrist poses [N, 7], independent joints [N, U], objective [N].
    """
    kinematics = points.kinematics
    if compiled and only_hinges(kinematics.model):
        from fungrasp.optimization.compiled.solver import minimize_compiled
        from fungrasp.optimization.compiled.steps import StepRule

        rule = StepRule(tolerance, PATIENCE, LEAST_DAMPING, MOST_DAMPING, EASING, STIFFENING)
        return minimize_compiled(points, problem, terms, wrist_pose, independent, iterations, rule)
    wrist_pose, independent = wrist_pose.copy(), independent.copy()
    damping, stiffening = np.full(len(problem), 1e-2), np.full(len(problem), STIFFENING)
    stalled = np.zeros(len(problem), dtype=int)
    cost, hessian, gradient = objective_equations(HandState(points, problem, wrist_pose, independent), terms)
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
        new_cost, new_hessian, new_gradient = objective_equations(
            HandState(points, problem, new_pose, new_independent), terms
        )
        active = stalled < PATIENCE
        enough = cost - new_cost >= tolerance * cost
        stalled = np.where(active, np.where(enough, 0, stalled + 1), stalled)
        better = active & (new_cost < cost)
        damping = np.clip(damping * np.where(better, EASING, stiffening), LEAST_DAMPING, MOST_DAMPING)
        stiffening = np.where(better, STIFFENING, 2 * stiffening)
        for old, new in (
            (wrist_pose, new_pose),
            (independent, new_independent),
            (cost, new_cost),
            (hessian, new_hessian),
            (gradient, new_gradient),
        ):
            old[better] = new[better]
        if np.all(stalled >= PATIENCE):
            break
    return wrist_pose, independent, cost


def only_hinges(model: mujoco.MjModel) -> bool:
    """Whether a hand has no sliding joints, for which there are no compiled loops."""
    return bool(np.all(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE))


def objective_equations(state: HandState, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Objective [N], Gauss-Newton Hessian J^T J [N, D, D] and gradient J^T r [N, D]."""
    cost, hessian, gradient = 0.0, 0.0, 0.0
    for term in terms:
        residual, jacobian = term(state)
        transposed = np.swapaxes(jacobian, 1, 2)
        cost = cost + 0.5 * np.sum(residual**2, axis=1)
        hessian = hessian + transposed @ jacobian
        gradient = gradient + (transposed @ residual[..., None])[..., 0]
    return np.asarray(cost), np.asarray(hessian), np.asarray(gradient)
