"""What a score is worth: fitting a logistic score to answers known to be right or wrong, and checking it on
others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.evaluation.perception import RIGHT_MM
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.perception.object_pose.confidence import FEATURES

RIDGE = 0.1
"""Pull of the weights of standardised features towards 0, in answers: keeps separable data finite."""


@dataclass(frozen=True, eq=False)
class Answers:
    """N answers, and whether they were right."""

    evidence: np.ndarray
    """Shape [N, F], see ``FEATURES``."""
    right: np.ndarray
    """Shape [N] bool."""
    score: np.ndarray
    """What they were given when they were found, shape [N]."""
    group: np.ndarray
    """Name of the object in the image, shape [N]."""


def answers_of(rows: Sequence[Mapping[str, Any]]) -> Answers:
    """The pose answers in the "each" of ``fungrasp bench perception --json``: with mask, without, of wrong
    meshes and absent objects. Those that found nothing at all (no evidence) are left out: their score is 0
    by rule.

    Raises:
        FungraspError: there is none.
    """
    found = []
    for row in rows:
        absent = None if row["absent"] is None else row["absent"]["pose"]
        for answer in (row["masked"], row["unmasked"], row["wrong_mesh"], absent):
            if answer is None or not answer["evidence"]:
                continue
            # None stands for infinite: no pose is right.
            right = answer["add_s_mm"] is not None and answer["add_s_mm"] < RIGHT_MM
            found.append(
                ([answer["evidence"][name] for name in FEATURES], right, answer["score"], row["object_name"])
            )
    if not found:
        raise FungraspError("there are no pose answers to calibrate on")
    evidence, right, score, group = zip(*found, strict=True)
    return Answers(np.array(evidence, dtype=float), np.array(right), np.array(score), np.array(group))


def fit_logistic(evidence: np.ndarray, right: np.ndarray, ridge: float = RIDGE) -> np.ndarray:
    """Weights ``[w0, w1 ... wF]`` that make ``1 / (1 + exp(-(w0 + sum wi xi)))`` the likeliest probabilities.

    Newton's method on the mean negative log likelihood, with ``ridge / N`` times half the squared weights of
    the features brought to mean 0 and standard deviation 1 added.

    Args:
        evidence: shape [N, F].
        right: shape [N] bool.
        ridge: see above.

    Returns:
        Shape [1 + F], for the features as they are given.
    """
    middle, spread = evidence.mean(axis=0), evidence.std(axis=0)
    spread = np.where(spread > 0, spread, 1.0)
    x = np.column_stack([np.ones(len(evidence)), (evidence - middle) / spread])
    pull = np.full(x.shape[1], ridge)
    pull[0] = 1e-6
    weights = np.zeros(x.shape[1])
    for _ in range(50):
        probability = _logistic(x @ weights)
        slope = x.T @ (probability - right) + pull * weights
        curvature = (x * (probability * (1 - probability))[:, None]).T @ x + np.diag(pull)
        step = np.linalg.solve(curvature, slope)
        step *= min(1.0, 3.0 / max(float(np.abs(step).max()), 1e-12))
        weights -= step
        if np.abs(step).max() < 1e-9:
            break
    raw = weights[1:] / spread
    return np.concatenate([[weights[0] - raw @ middle], raw])


def scored(weights: np.ndarray, evidence: np.ndarray) -> np.ndarray:
    """Probabilities, shape [N]. weights: see ``fit_logistic``. evidence: shape [N, F]."""
    return _logistic(weights[0] + evidence @ weights[1:])


def cross_validated(answers: Answers, columns: Sequence[int], ridge: float = RIDGE) -> np.ndarray:
    """Each answer's score by weights that were fitted to the other objects' answers, shape [N].

    Args:
        answers: of at least two objects.
        columns: features that are used.
        ridge: see ``fit_logistic``.
    """
    evidence = answers.evidence[:, list(columns)]
    result = np.zeros(len(evidence))
    for name in np.unique(answers.group):
        mine = answers.group == name
        weights = fit_logistic(evidence[~mine], answers.right[~mine], ridge)
        result[mine] = scored(weights, evidence[mine])
    return result


def log_loss(score: np.ndarray, right: np.ndarray) -> float:
    """Mean of ``-log`` of the probability that was given to what was the case."""
    given = np.clip(np.where(right, score, 1.0 - score), 1e-6, 1.0)
    return float(-np.log(given).mean())


def lowest_threshold(score: np.ndarray, right: np.ndarray, share: float = 0.97) -> float:
    """The lowest score from which on at least this share of answers is right; infinite if there is none."""
    order = np.argsort(-score, kind="stable")
    rate = np.cumsum(right[order]) / np.arange(1, len(order) + 1)
    last = np.append(np.diff(score[order]) != 0, True)
    good = np.flatnonzero((rate >= share) & last)
    return float(score[order][good[-1]]) if len(good) else float("inf")


def reliability(score: np.ndarray, right: np.ndarray, edges: np.ndarray) -> list[dict[str, Any]]:
    """For each range of scores how many answers there are, their mean score, and how many are right.

    Args:
        score: shape [N].
        right: shape [N] bool.
        edges: ascending, shape [B + 1]; the last range includes its upper edge.
    """
    rows = []
    for low, high in pairwise(edges.tolist()):
        mine = (score >= low) & ((score < high) | (high == edges[-1]) & (score == high))
        count, good = int(mine.sum()), int(right[mine].sum())
        if count:
            rows.append(
                {
                    "from": float(low),
                    "to": float(high),
                    "count": count,
                    "mean_score": float(score[mine].mean()),
                    "right": good / count,
                    "interval": wilson_interval(good, count),
                }
            )
    return rows


def _logistic(value: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-np.clip(value, -500, 500)))
