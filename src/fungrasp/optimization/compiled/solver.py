"""Levenberg-Marquardt by compiled loops; ``fungrasp.optimization.levenberg_marquardt`` says what it does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.optimization.compiled.contact_loads import LoadRule, Loads, unresisted_shares
from fungrasp.optimization.compiled.frames import Equations, empty_frames, move_hands
from fungrasp.optimization.compiled.steps import StepRule, StepState, accept, clear, propose
from fungrasp.optimization.compiled.terms import compiled_term
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.retargeting_problem import RetargetingProblem


class NormalEquations:
    """The objective of N grasps, its gradient and Gauss-Newton Hessian, at any iterate.

    Terms without loops of their own are evaluated by NumPy, for all grasps.
    """

    def __init__(self, points: HandPoints, problem: CollisionScene, terms: Sequence[Callable[..., Any]]):
        self._points, self._problem = points, problem
        self._hand = points.arrays
        loops = [compiled_term(term, points, problem) for term in terms]
        self._loops = [loop for loop in loops if loop is not None]
        self._others = [term for term, loop in zip(terms, loops, strict=True) if loop is None]
        count, bodies, joints = len(problem), len(self._hand.tree.parent), len(self._hand.tree.zero)
        self._frames = empty_frames(count, bodies, joints)

    def empty(self, active: np.ndarray) -> Equations:
        """Zeros. active: which grasps will be evaluated, shape [N] bool."""
        count, size = len(self._problem), self._points.kinematics.size
        return Equations(np.zeros(count), np.zeros((count, size, size)), np.zeros((count, size)), active)

    def evaluate(self, equations: Equations, pose: np.ndarray, independent: np.ndarray) -> None:
        """Write the active grasps' equations at wrist poses [N, 7] and independent joints [N, U]."""
        clear(equations)
        move_hands(self._hand.tree, pose, independent, equations.active, self._frames)
        for add in self._loops:
            add(self._hand, self._frames, equations, pose, independent)
        if self._others:
            state = HandState(self._points, self._problem, pose, independent)
            for term in self._others:
                residual, jacobian = term(state)
                transposed = np.swapaxes(jacobian, 1, 2)
                equations.cost[:] += 0.5 * np.sum(residual**2, axis=1)
                equations.hessian[:] += transposed @ jacobian
                equations.gradient[:] += (transposed @ residual[..., None])[..., 0]


def minimize_compiled(
    points: HandPoints,
    problem: CollisionScene,
    terms: Sequence[Callable[..., Any]],
    wrist_pose: np.ndarray,
    independent: np.ndarray,
    iterations: int,
    rule: StepRule,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As ``levenberg_marquardt.minimize``."""
    lower, upper = points.kinematics.lower, points.kinematics.upper
    pose, joints = np.array(wrist_pose, dtype=float), np.array(independent, dtype=float)
    new_pose, new_joints = pose.copy(), joints.copy()
    count = len(problem)
    progress = StepState(
        np.full(count, 1e-2), np.full(count, rule.stiffening), np.zeros(count, dtype=np.int64)
    )
    equations = NormalEquations(points, problem, terms)
    current = equations.empty(np.ones(count, dtype=bool))
    trial = equations.empty(current.active)
    equations.evaluate(current, pose, joints)
    for _ in range(iterations):
        propose(current, progress.damping, lower, upper, pose, joints, new_pose, new_joints)
        equations.evaluate(trial, new_pose, new_joints)
        left = accept(current, trial, progress, rule, pose, joints, new_pose, new_joints)
        if not left:
            break
    return pose, joints, current.cost


def compiled_shares(
    points: HandPoints,
    problem: RetargetingProblem,
    wrist_pose: np.ndarray,
    independent: np.ndarray,
    which: np.ndarray,
    torque_limit: np.ndarray,
    rule: LoadRule,
) -> np.ndarray:
    """As ``firmness.unresisted_share``."""
    hand, count = points.arrays, len(problem)
    frames = empty_frames(count, len(hand.tree.parent), len(hand.tree.zero))
    pose, joints = np.array(wrist_pose, dtype=float), np.array(independent, dtype=float)
    which, grid = np.array(which, dtype=bool), np.array(problem.grid, dtype=np.int64)
    loads = Loads(
        *(
            np.array(x, dtype=float, order="C")
            for x in (problem.center, problem.extent, problem.weight, problem.up[:, -1], torque_limit)
        )
    )
    result = np.full(count, np.inf)
    move_hands(hand.tree, pose, joints, which, frames)
    unresisted_shares(hand, frames, problem.bank.arrays, grid, loads, which, rule, result)
    return result
