"""Robust Gauss-Newton steps from blocks of residuals."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.perception.hand.skeleton import PARAMETERS

LONGEST_STEP = {"position": 0.05, "turn": 0.5, "angles": 0.5}
"""Largest change of a parameter in one step [m] or [rad]: the derivatives know no farther."""


@dataclass(frozen=True, eq=False)
class HandEvidence:
    """One block of residuals, with their derivatives by the parameters."""

    residual: np.ndarray
    """Residuals in standard deviations, shape [R]."""
    jacobian: np.ndarray
    """Derivatives by the parameters, shape [R, n]; n may be less than the number of parameters."""
    outlier: float | np.ndarray = np.inf
    """Residuals beyond this hardly count: one limit for all, or one per group, shape [R / group]."""
    group: int = 1
    """Number of consecutive residuals that are one measurement, judged by their norm."""
    random: bool = False
    """Whether its errors are random: a sample of the hand is fitted to others that might have been."""


def redrawn(evidence: Iterable[HandEvidence], seed: int, spread: float) -> list[HandEvidence]:
    """The blocks with other random errors, the same ones for the same seed.

    Least squares of them gives a sample of what the parameters may be ("randomize then optimize", Bardsley et
    al., SIAM J. Sci. Comput. 36, 2014): the fit's own distribution, where the problem is linear.

    Args:
        evidence: blocks.
        seed: of the errors.
        spread: standard deviation of the errors, 1 where residuals are in standard deviations.
    """
    found = []
    for number, block in enumerate(evidence):
        if block.random:
            errors = np.random.default_rng([seed, number]).normal(size=len(block.residual))
            block = replace(block, residual=block.residual + spread * errors)
        found.append(block)
    return found


def normal_equations(evidence: Iterable[HandEvidence], size: int) -> tuple[np.ndarray, np.ndarray]:
    """Weighted normal matrix, shape [size, size], and gradient, [size].

    A residual (or group) of norm r with outlier limit c weighs ``(c^2 / (c^2 + r^2))^2``: the loss of Geman
    and McClure, on which outliers pull the less the farther out they are.

    Args:
        evidence: blocks; those with fewer than ``size`` columns leave the last parameters alone.
        size: number of parameters.
    """
    matrix, gradient = np.zeros((size, size)), np.zeros(size)
    for block in evidence:
        columns = block.jacobian.shape[1]
        weighted = (block.jacobian * robust_weights(block)[:, None]).T
        matrix[:columns, :columns] += weighted @ block.jacobian
        gradient[:columns] += weighted @ block.residual
    return matrix, gradient


def robust_weights(block: HandEvidence) -> np.ndarray:
    """Weight of each residual, 0 to 1, shape [R]."""
    square = (block.residual**2).reshape(-1, block.group).sum(axis=1)
    return np.repeat((1.0 + square / np.square(block.outlier)) ** -2.0, block.group)


def damped_step(matrix: np.ndarray, gradient: np.ndarray, damping: float = 1e-3) -> np.ndarray:
    """Step towards the least-squares solution, shortened where it would be too long to trust.

    Args:
        matrix, gradient: normal equations; the first parameters are those of a skeleton.
        damping: added to each parameter's curvature, as a part of it.
    """
    step = -np.linalg.solve(matrix + np.diag(damping * np.diag(matrix) + 1e-9), gradient)
    largest = max(float(np.abs(step[PARAMETERS[kind]]).max()) / most for kind, most in LONGEST_STEP.items())
    return step / max(1.0, largest)


def robust_cost(evidence: Iterable[HandEvidence]) -> float:
    """Sum over all residuals (or groups) of ``r^2 / (1 + r^2 / c^2)``, of a norm r with outlier limit c."""
    total = 0.0
    for block in evidence:
        square = (block.residual**2).reshape(-1, block.group).sum(axis=1)
        total += float(np.sum(square / (1.0 + square / np.square(block.outlier))))
    return total
