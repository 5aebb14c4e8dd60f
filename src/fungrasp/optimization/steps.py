"""One step of the solver for each problem of a batch."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fungrasp.geometry.compiling import compiled, compiled_part
from fungrasp.optimization.frames import Equations


class StepRule(NamedTuple):
    """Constants of the solver."""

    tolerance: float
    """Share of its objective that a problem must gain to go on."""
    patience: int
    """Steps without that gain after which it is left."""
    least_damping: float
    """Lower bound of the damping."""
    most_damping: float
    """Upper bound of the damping."""
    easing: float
    """Factor of the damping after a step that succeeded."""
    stiffening: float
    """Factor of the damping after a first one that failed."""


class StepState(NamedTuple):
    """Of N problems."""

    damping: np.ndarray
    """Share of the Hessian's diagonal that is added to it, shape [N]."""
    stiffening: np.ndarray
    """Factor of the damping where the next step fails, shape [N]."""
    stalled: np.ndarray
    """Steps in a row without enough gain, shape [N]."""


@compiled
def propose(
    equations: Equations,
    damping: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    pose: np.ndarray,
    independent: np.ndarray,
    new_pose: np.ndarray,
    new_independent: np.ndarray,
) -> None:
    """The damped Gauss-Newton step of each active problem, as ``levenberg_marquardt``: joints at a limit that
    would be pushed beyond it are held, long steps shortened, joints clipped.

    Args:
        damping: shape [N].
        lower, upper: limits [rad], shape [U].
        pose, independent: of the iterates, shape [N, 7] and [N, U].
        new_pose, new_independent: written.
    """
    size = equations.gradient.shape[1]
    free, factor, step = np.empty(size, np.int64), np.empty((size, size)), np.empty(size)
    turn = np.empty(3)
    for i in range(len(pose)):
        if not equations.active[i]:
            continue
        hessian, gradient = equations.hessian[i], equations.gradient[i]
        number = np.int64(0)
        for d in range(size):
            if d >= 6:
                low = independent[i, d - 6] <= lower[d - 6] + 1e-9 and gradient[d] > 0
                high = independent[i, d - 6] >= upper[d - 6] - 1e-9 and gradient[d] < 0
                if low or high:
                    continue
            free[number] = d
            number += 1
        largest = 0.0
        for a in range(number):
            if hessian[free[a], free[a]] > largest:
                largest = hessian[free[a], free[a]]
        for a in range(number):
            for b in range(a + 1):
                factor[a, b] = hessian[free[a], free[b]]
            factor[a, a] += damping[i] * (factor[a, a] + 1e-3 * largest) + 1e-9
            step[a] = -gradient[free[a]]
        _solve(factor, step, number)
        length = 0.0
        for a in range(number):
            length += step[a] * step[a]
        # Longer steps than 0.5 (meters and radians together) leave where the linearization holds.
        length = math.sqrt(length)
        scale = 0.5 / length if length > 0.5 else 1.0
        for k in range(independent.shape[1]):
            new_independent[i, k] = independent[i, k]
        for k in range(7):
            new_pose[i, k] = pose[i, k]
        for k in range(3):
            turn[k] = 0.0
        for a in range(number):
            d = free[a]
            if d < 3:
                new_pose[i, d] += scale * step[a]
            elif d < 6:
                turn[d - 3] = scale * step[a]
            else:
                value = independent[i, d - 6] + scale * step[a]
                value = lower[d - 6] if value < lower[d - 6] else value
                new_independent[i, d - 6] = upper[d - 6] if value > upper[d - 6] else value
        _rotate(new_pose[i, 3:], turn)


@compiled_part
def _solve(matrix, vector, number: int) -> None:
    """Solve by Cholesky factors in place; matrix: its lower triangle, positive definite."""
    for a in range(number):
        for b in range(a):
            total = matrix[a, b]
            for k in range(b):
                total -= matrix[a, k] * matrix[b, k]
            matrix[a, b] = total / matrix[b, b]
        total = matrix[a, a]
        for k in range(a):
            total -= matrix[a, k] * matrix[a, k]
        matrix[a, a] = math.sqrt(1e-300 if total < 1e-300 else total)
    for a in range(number):
        total = vector[a]
        for k in range(a):
            total -= matrix[a, k] * vector[k]
        vector[a] = total / matrix[a, a]
    for a in range(number - 1, -1, -1):
        total = vector[a]
        for k in range(a + 1, number):
            total -= matrix[k, a] * vector[k]
        vector[a] = total / matrix[a, a]


@compiled_part
def _rotate(q, turn) -> None:
    """Turn a quaternion by a rotation vector [rad], in place."""
    angle = math.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    half = 0.5 if angle < 1e-12 else math.sin(0.5 * angle) / angle
    a, b, c, d = math.cos(0.5 * angle), half * turn[0], half * turn[1], half * turn[2]
    w, x, y, z = q[0], q[1], q[2], q[3]
    q[0] = a * w - b * x - c * y - d * z
    q[1] = a * x + b * w + c * z - d * y
    q[2] = a * y - b * z + c * w + d * x
    q[3] = a * z + b * y - c * x + d * w
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for k in range(4):
        q[k] /= length


@compiled
def accept(
    equations: Equations,
    trial: Equations,
    progress: StepState,
    rule: StepRule,
    pose: np.ndarray,
    independent: np.ndarray,
    new_pose: np.ndarray,
    new_independent: np.ndarray,
) -> int:
    """Keep the trials that are better; problems that gained too little in a row become inactive.

    Returns:
        number of active problems.
    """
    damping, stiffening, stalled = progress.damping, progress.stiffening, progress.stalled
    left = 0
    for i in range(len(pose)):
        if not equations.active[i]:
            continue
        gain = equations.cost[i] - trial.cost[i]
        # A cost that is not a number gains nothing.
        stalled[i] = 0 if gain >= rule.tolerance * equations.cost[i] else stalled[i] + 1
        if gain > 0:
            for k in range(7):
                pose[i, k] = new_pose[i, k]
            for k in range(independent.shape[1]):
                independent[i, k] = new_independent[i, k]
            equations.cost[i] = trial.cost[i]
            for p in range(equations.gradient.shape[1]):
                equations.gradient[i, p] = trial.gradient[i, p]
                for q in range(equations.gradient.shape[1]):
                    equations.hessian[i, p, q] = trial.hessian[i, p, q]
            damping[i] *= rule.easing
            if damping[i] < rule.least_damping:
                damping[i] = rule.least_damping
            stiffening[i] = rule.stiffening
        else:
            damping[i] *= stiffening[i]
            if damping[i] > rule.most_damping:
                damping[i] = rule.most_damping
            stiffening[i] *= 2
        if stalled[i] >= rule.patience:
            equations.active[i] = False
        else:
            left += 1
    return left
