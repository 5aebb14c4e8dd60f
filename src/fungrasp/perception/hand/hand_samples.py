"""Several hands that an image may show, with probabilities: where an object hides fingers, one answer is not
all."""

from __future__ import annotations

import numpy as np

from fungrasp.perception.hand.finger_search import search_fingers
from fungrasp.perception.hand.fit_problem import HandFitProblem, HandFitStage, HandParameters

DRAWS = 16
"""Hands that are drawn; those that are returned stand for these."""


def sampled_hands(
    problem: HandFitProblem, best: HandParameters, stage: HandFitStage, iterations: int, seed: int
) -> list[HandParameters]:
    """Hands that the evidence allows, equally probable, ``DRAWS`` of them.

    Each has hidden fingers in postures chosen at random, better ones more often, and is fitted to evidence
    with other random errors.

    Args:
        problem: of a held hand.
        best: its best fit.
        stage: of the fit.
        iterations: Gauss-Newton steps.
        seed: of everything random.
    """
    assert problem.seen is not None and problem.view is not None
    found = []
    for number in range(DRAWS):
        skeleton = search_fingers(
            best.skeleton,
            problem.view,
            problem.seen.pixels,
            np.random.default_rng([seed, number]),
            spread=problem.seen.spread,
            draw=True,
        )
        problem.find_background(skeleton)
        found.append(problem.solve(HandParameters(skeleton, best.turn), stage, iterations, number))
    return found


def representatives(joints: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The hands that stand for all with least mean distance, the first among them.

    Args:
        joints: S hands [m], shape [S, 21, 3].
        count: how many are wanted.

    Returns:
        Rows of at most ``count``, the first one and then by probability; the part of all hands that each
        stands for.
    """
    apart = np.linalg.norm(joints[:, None] - joints, axis=-1).mean(axis=-1)
    rows = [0]
    while len(rows) < min(count, len(joints)):
        gain = np.minimum(apart[rows].min(axis=0), apart).sum(axis=1)
        gain[rows] = np.inf
        rows.append(int(gain.argmin()))
    part = np.bincount(apart[rows].argmin(axis=0), minlength=len(rows)) / len(joints)
    order = sorted(range(len(rows)), key=lambda i: (i > 0, -part[i]))
    return np.array(rows)[order], part[order]
