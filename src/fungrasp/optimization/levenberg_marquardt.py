"""Levenberg-Marquardt for many small problems at once, with bounds on the joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fungrasp.geometry.compiling import plain
from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.optimization.frames import Equations, clear, empty_frames, move_hands
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.steps import StepRule, StepState, accept, propose
from fungrasp.optimization.terms import Term

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
    free: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Minimize half the sum of squares of all terms for each grasp by itself.

    Joints at a limit that would be pushed beyond it are held there; steps are clipped to the limits.

    Args:
        points: kinematics made for N hands.
        problem: N grasps, object frame.
        terms: as in ``fungrasp.optimization.terms``.
        wrist_pose: start, object frame, shape [N, 7].
        independent: start [rad], shape [N, U].
        iterations: number of steps tried.
        tolerance: share of its objective that a grasp must gain in ``PATIENCE`` steps to go on.
        free: which entries of the tangent vector may change, shape [D] bool; all if None.

    Returns:
        wrist poses [N, 7], independent joints [N, U], objective [N].
    """
    lower, upper = plain(points.kinematics.lower), plain(points.kinematics.upper)
    pose, joints = plain(wrist_pose), plain(independent)
    new_pose, new_joints = pose.copy(), joints.copy()
    count = len(problem)
    rule = StepRule(tolerance, PATIENCE, LEAST_DAMPING, MOST_DAMPING, EASING, STIFFENING)
    progress = StepState(np.full(count, 1e-2), np.full(count, STIFFENING), np.zeros(count, dtype=np.int64))
    equations = NormalEquations(points, problem, terms, free)
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


class NormalEquations:
    """The objective of N grasps, its gradient and Gauss-Newton Hessian, at any iterate."""

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
        """Zeros. active: which grasps will be evaluated, shape [N] bool."""
        count, size = len(active), self._size
        return Equations(np.zeros(count), np.zeros((count, size, size)), np.zeros((count, size)), active)

    def evaluate(self, equations: Equations, pose: np.ndarray, independent: np.ndarray) -> None:
        """Write the active grasps' equations at wrist poses [N, 7] and independent joints [N, U]."""
        clear(equations)
        move_hands(self._hand.tree, pose, independent, equations.active, self._frames)
        for add in self._terms:
            add(self._frames, equations, pose, independent)
        if self._held is not None:
            equations.gradient[:, self._held] = 0.0
            equations.hessian[:, self._held] = 0.0
            equations.hessian[:, :, self._held] = 0.0
