"""Friction cones: the loop of ``planning.grip_forces``."""

from __future__ import annotations

import math

import numpy as np

from fungrasp.optimization.compiled.compiling import compiled


@compiled
def outside_cones(
    force: np.ndarray, answers: np.ndarray, floor: np.ndarray, axis: np.ndarray, friction: float
) -> np.ndarray:
    """From the nearest points of the friction cones to the forces under all loads, summed over the loads [N],
    shape [N, C, 3]; zero for a force within its cone.

    Args:
        force: without a load [N], shape [N, C, 3].
        answers: what each load adds to it [N], shape [N, K, C, 3].
        floor: where the cones have their tips [N], shape [N, C, 3].
        axis: of the cones, unit vectors, shape [N, C, 3].
        friction: coefficient, the tangent of their half angle.
    """
    total = np.zeros_like(force)
    x, tangent = np.empty(3), np.empty(3)
    for n in range(answers.shape[0]):
        for k in range(answers.shape[1]):
            for c in range(answers.shape[2]):
                a = axis[n, c]
                for i in range(3):
                    x[i] = force[n, c, i] + answers[n, k, c, i] - floor[n, c, i]
                normal = x[0] * a[0] + x[1] * a[1] + x[2] * a[2]
                for i in range(3):
                    tangent[i] = x[i] - normal * a[i]
                size = math.sqrt(tangent[0] ** 2 + tangent[1] ** 2 + tangent[2] ** 2)
                if size <= friction * normal:
                    continue
                if friction * size <= -normal:
                    for i in range(3):
                        total[n, c, i] += x[i]
                    continue
                along = (normal + friction * size) / (1.0 + friction * friction)
                least = max(size, 1e-12)
                for i in range(3):
                    total[n, c, i] += x[i] - along * (a[i] + friction * tangent[i] / least)
    return total
