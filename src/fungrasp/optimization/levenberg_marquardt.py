"""Levenberg-Marquardt for many small problems at once, with bounds on the joints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fungrasp.geometry.compiling import compiled, compiled_part, plain
from fungrasp.optimization.frames import Equations, empty_frames, move_hands
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.problem import CollisionScene
from fungrasp.optimization.terms import Term

TOLERANCE = 3e-3
"""Minimum relative decrease of the objective in at least one of ``PATIENCE`` consecutive steps."""

PATIENCE = 4
"""Consecutive steps without enough decrease after which a grasp stops. Spheres and links enter and leave the
terms, so that a step may fail and the next, shorter one succeed."""

LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e4
"""Bounds of the damping, relative to the Hessian's diagonal."""

EASING = 0.4
"""Factor of the damping after a successful step."""

STIFFENING = 4.0
"""Factor of the damping after a failed step, doubled with each consecutive failure (Nielsen, 1999)."""


def minimize(
    points: HandPoints,
    problem: CollisionScene,
    terms: Sequence[Term],
    wrist_pose: np.ndarray,
    independent: np.ndarray,
    iterations: int,
    free: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Minimize half the sum of squared residuals of all terms, for each grasp separately.

    Joints that a step would push beyond their limit are held there; steps are clipped to the limits.

    Args:
        points: kinematics of N hands.
        problem: N grasps, object frame.
        terms: as in ``fungrasp.optimization.terms``.
        wrist_pose: initial poses, object frame, shape [N, 7].
        independent: initial joints [rad], shape [N, U].
        iterations: maximum number of steps.
        free: entries of the tangent vector that may change, shape [D] bool; all if None.

    Returns:
        wrist poses [N, 7], independent joints [N, U], objective [N].
    """
    lower, upper = plain(points.kinematics.lower), plain(points.kinematics.upper)
    at, new = (Iterates(plain(wrist_pose), plain(independent)) for _ in range(2))
    count = len(problem)
    state = StepState(np.full(count, 1e-2), np.full(count, STIFFENING), np.zeros(count, dtype=np.int64))
    equations = NormalEquations(points, problem, terms, free)
    current = equations.empty(np.ones(count, dtype=bool))
    trial = equations.empty(current.active)
    equations.evaluate(current, *at)
    for _ in range(iterations):
        propose(current, state.damping, lower, upper, at, new)
        equations.evaluate(trial, *new)
        if not accept(current, trial, state, at, new):
            break
    return at.pose, at.independent, current.cost


class NormalEquations:
    """The objective of N grasps, its gradient and its Gauss-Newton Hessian."""

    def __init__(
        self,
        points: HandPoints,
        problem: CollisionScene,
        terms: Sequence[Term],
        free: np.ndarray | None = None,
    ):
        """Args: as for ``minimize``."""
        self._hand, self._size = points.arrays, points.kinematics.size
        self._terms = [term(points, problem) for term in terms]
        self._held = None if free is None else ~free
        self._frames = empty_frames(len(problem), self._hand)

    def empty(self, active: np.ndarray) -> Equations:
        """Return equations of zeros. active: grasps to evaluate, shape [N] bool."""
        count, size = len(active), self._size
        return Equations(np.zeros(count), np.zeros((count, size, size)), np.zeros((count, size)), active)

    def evaluate(self, equations: Equations, pose: np.ndarray, independent: np.ndarray) -> None:
        """Write the equations of the active grasps at wrist poses [N, 7] and independent joints [N, U]."""
        for array in (equations.cost, equations.gradient, equations.hessian):
            array[equations.active] = 0.0
        move_hands(self._hand.tree, pose, independent, equations.active, self._frames)
        for add in self._terms:
            add(self._frames, equations, pose, independent)
        if self._held is not None:
            equations.gradient[:, self._held] = 0.0
            equations.hessian[:, self._held] = 0.0
            equations.hessian[:, :, self._held] = 0.0


class Iterates(NamedTuple):
    """Iterates of N problems."""

    pose: np.ndarray
    """Wrist poses, object frame, shape [N, 7]."""
    independent: np.ndarray
    """Independent joints [rad], shape [N, U]."""


class StepState(NamedTuple):
    """Step control of N problems."""

    damping: np.ndarray
    """Share of the Hessian's diagonal that is added to it, shape [N]."""
    stiffening: np.ndarray
    """Factor of the damping if the next step fails, shape [N]."""
    stalled: np.ndarray
    """Consecutive steps without enough decrease, shape [N]."""


@compiled
def propose(
    equations: Equations,
    damping: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    at: Iterates,
    new: Iterates,
) -> None:
    """Write the damped Gauss-Newton step of each active problem to ``new``.

    Joints that the gradient pushes beyond their limit are held, long steps are shortened and joints are
    clipped to their limits.

    Args:
        damping: shape [N].
        lower, upper: limits [rad], shape [U].
        at: current iterates.
        new: output.
    """
    pose, independent, new_pose, new_independent = at.pose, at.independent, new.pose, new.independent
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
        # The linearization does not hold for steps longer than 0.5 (meters and radians together).
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
    """Solve by Cholesky factorization in place. matrix: lower triangle, positive definite."""
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
    """Rotate a quaternion by a rotation vector [rad], in place."""
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
def accept(equations: Equations, trial: Equations, state: StepState, at: Iterates, new: Iterates) -> int:
    """Accept the trials with lower cost and deactivate stalled problems. Return the number of active
    problems."""
    damping, stiffening, stalled = state
    pose, independent, new_pose, new_independent = at.pose, at.independent, new.pose, new.independent
    left = 0
    for i in range(len(pose)):
        if not equations.active[i]:
            continue
        gain = equations.cost[i] - trial.cost[i]
        # A NaN cost counts as no decrease.
        stalled[i] = 0 if gain >= TOLERANCE * equations.cost[i] else stalled[i] + 1
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
            damping[i] *= EASING
            if damping[i] < LEAST_DAMPING:
                damping[i] = LEAST_DAMPING
            stiffening[i] = STIFFENING
        else:
            damping[i] *= stiffening[i]
            if damping[i] > MOST_DAMPING:
                damping[i] = MOST_DAMPING
            stiffening[i] *= 2
        if stalled[i] >= PATIENCE:
            equations.active[i] = False
        else:
            left += 1
    return left
