"""Fits the weights of the verdict to trials: logistic regression in which each number counts one way only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import minimize

from benchmarks.perception.verdict_trials import RIGHT, HandTrial, VerdictTrial
from fungrasp.core.errors import FungraspError
from fungrasp.perception.object_pose.confidence import features
from fungrasp.perception.object_pose.evidence import PoseEvidence
from fungrasp.perception.object_pose.verdict_weights import Logistic

OBJECT_SIGNS: Mapping[str, int] = {
    "agreement": 1,
    "larger": -1,
    "off": -1,
    "left_over": -1,
    "mask_piece": -1,
    "told": 1,
    "other_size": -1,
    "other_side": -1,
    "rival": -1,
}
"""Whether more of a number speaks for the answer, or against it."""

HAND_SIGNS: Mapping[str, int] = {
    "hand_score": 1,
    "joints": 1,
}

OBJECT_PRIOR: Mapping[str, float] = {"agreement": 1.07, "left_over": -0.6, "rival": -3.0}
"""Weights that few trials are to change little. A different pose that fits as well makes either as likely,
but hardly any of the trials has one. In the trials the outline tells what agreement does, and the mask's
piece what is left over; where they can't be seen, those must count as without them."""

HAND_PRIOR: Mapping[str, float] = {"hand_score": 6.0}
"""Weights that few trials are to change little: of 85 rendered hands of earlier measurements those with a
score of 0.6 or more had joints 9.7 mm off, the others 32 mm."""

FIRM = 40.0
"""How many times as firmly the prior weights are held: with twice as many captures as 20 was chosen with,
twice as much, or the trials would outweigh them."""

RIDGE = 1.0
"""Weight of the squares of the weights' differences from the prior ones (0 where there is none), in that of
one trial, numbers scaled to spread 1."""

WRONG_MESHES = 1.0 / 3.0
"""Part of the trials, by weight, in which the mesh is wrong: people seldom give a wrong one."""

RIGHT_HAND_MM = 20.0
"""A hand is right if its joints are off by less on average."""


def object_data(answers: Sequence[VerdictTrial]) -> tuple[list[dict[str, float]], np.ndarray]:
    """Features of the answers that rest on evidence, and whether they are right."""
    judged = [answer for answer in answers if answer.evidence]
    return [features(evidence_of(answer)) for answer in judged], np.array([one.right for one in judged])


def evidence_of(answer: VerdictTrial) -> PoseEvidence:
    """The record of an answer.

    Raises:
        FungraspError: it was measured before one of the numbers was.
    """
    names = PoseEvidence.__dataclass_fields__.keys()
    if missing := sorted(names - answer.evidence.keys()):
        raise FungraspError(f"trials of {answer.capture} lack {', '.join(missing)}: delete and measure again")
    return PoseEvidence(**{name: answer.evidence[name] for name in names})


def hand_data(hands: Sequence[HandTrial]) -> tuple[list[dict[str, float]], np.ndarray]:
    """Features of the hands that were found, and whether they are right: that it is another person's shows by
    the object."""
    found = [one for one in hands if one.found]
    return [one.features for one in found], np.array([one.mean_mm < RIGHT_HAND_MM for one in found])


def trial_weights(answers: Sequence[VerdictTrial]) -> np.ndarray:
    """Weight of each answer, 1 on average, shape [N]: wrong meshes are ``WRONG_MESHES`` of all."""
    wrong = np.array([answer.mesh != RIGHT for answer in answers])
    share = wrong.mean()
    return np.where(wrong, WRONG_MESHES / max(share, 1e-9), (1.0 - WRONG_MESHES) / max(1.0 - share, 1e-9))


def fitted_weights(answers: Sequence[VerdictTrial], hands: Sequence[HandTrial]) -> dict[str, Logistic]:
    """Weights for answers and for hands."""
    return {
        "OBJECT_WEIGHTS": fit_logistic(
            *object_data(answers),
            OBJECT_SIGNS,
            trial_weights([one for one in answers if one.evidence]),
            OBJECT_PRIOR,
        ),
        "HAND_WEIGHTS": fit_logistic(
            *hand_data(hands), HAND_SIGNS, np.ones(sum(one.found for one in hands)), HAND_PRIOR
        ),
    }


def fit_logistic(
    rows: Sequence[Mapping[str, float]],
    right: np.ndarray,
    signs: Mapping[str, int],
    weights: np.ndarray,
    prior: Mapping[str, float] | None = None,
    ridge: float = RIDGE,
) -> Logistic:
    """Logistic regression with a sign for each weight.

    Args:
        rows: numbers of each trial, by name.
        right: whether it is right, shape [N] bool.
        signs: 1 or -1 for each number.
        weights: of the trials, shape [N].
        prior: weights that are likely; 0 if None.
        ridge: see ``RIDGE``.
    """
    names = list(signs)
    x = np.array([[row[name] for name in names] for row in rows])
    usual = np.median(x[right], axis=0)
    spread = np.maximum(x.std(axis=0), 1e-6)
    firm = ridge * np.array([FIRM if name in (prior or {}) else 1.0 for name in names])
    likely = np.array([(prior or {}).get(name, 0.0) for name in names]) * spread
    z, y = (x - usual) / spread, np.where(right, 1.0, -1.0)

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        margin = y * (w[0] + z @ w[1:])
        slope = -weights * y / (1.0 + np.exp(np.minimum(margin, 500.0)))
        gradient = np.concatenate([[slope.sum()], z.T @ slope + 2 * firm * (w[1:] - likely)])
        return float(weights @ np.logaddexp(0.0, -margin) + firm @ np.square(w[1:] - likely)), gradient

    limits = [(None, None), *(((0.0, None) if signs[name] > 0 else (None, 0.0)) for name in names)]
    found = minimize(loss, np.zeros(1 + len(names)), jac=True, bounds=limits, method="L-BFGS-B").x
    return Logistic(
        float(found[0]),
        {name: float(w) for name, w in zip(names, found[1:] / spread, strict=True)},
        {name: float(u) for name, u in zip(names, usual, strict=True)},
    )


def written_weights(weights: Mapping[str, Logistic]) -> str:
    """Lines for ``fungrasp.perception.object_pose.verdict_weights``."""
    lines = []
    for name, one in weights.items():
        lines += [f"{name} = Logistic(", f"    {one.constant:.3g},"]
        for values in (one.weights, one.usual):
            lines += ["    {", *(f'        "{key}": {value:.3g},' for key, value in values.items()), "    },"]
        lines.append(")")
    return "\n".join(lines)
