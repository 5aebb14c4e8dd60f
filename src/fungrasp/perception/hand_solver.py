"""Robust Gauss-Newton steps from blocks of evidence."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fungrasp.perception.hand_evidence import Evidence


def normal_equations(evidence: Iterable[Evidence], size: int) -> tuple[np.ndarray, np.ndarray]:
    """Weighted normal matrix and gradient.

    A residual (or group) of norm r with an outlier limit c weighs ``(c^2 / (c^2 + r^2))^2``: the loss of Geman
    and McClure, which outliers pull less the farther out they are.

    Args:
        evidence: blocks; those with fewer than ``size`` columns leave the last parameters alone.
        size: number of parameters.

    Returns:
        Normal matrix, shape [size, size]; gradient, shape [size].
    """
    matrix, gradient = np.zeros((size, size)), np.zeros(size)
    for block in evidence:
        weight = robust_weights(block)
        columns = block.jacobian.shape[1]
        weighted = block.jacobian * weight[:, None]
        matrix[:columns, :columns] += weighted.T @ block.jacobian
        gradient[:columns] += weighted.T @ block.residual
    return matrix, gradient


def robust_weights(block: Evidence) -> np.ndarray:
    """Weight of each residual, 0 to 1, shape [R]."""
    if np.ndim(block.outlier) == 0 and np.isinf(block.outlier):
        return np.ones(len(block.residual))
    square = (block.residual**2).reshape(-1, block.group).sum(axis=1)
    weight = (block.outlier**2 / (block.outlier**2 + square)) ** 2
    return np.repeat(weight, block.group)


def damped_step(matrix: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    """Step to the least-squares solution, each parameter damped by a part of its own curvature."""
    diagonal = np.diag(matrix)
    return -np.linalg.solve(matrix + np.diag(damping * diagonal + 1e-9), gradient)
