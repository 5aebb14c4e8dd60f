"""Several looks at one grasp: where an image leaves doubt, others of the same grasp are looked at too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from math import exp, log

import numpy as np
from scipy.spatial import KDTree

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.confidence import ACCEPT
from fungrasp.perception.perceived import Perceived
from fungrasp.perception.verdict import ACCEPTED_HAND

AGREE = 0.025
"""Poses of the object in the hand are the same answer if each vertex is nearer than this to another's, on
average [m]: those of a block held by one hand were 4 to 24 mm apart, as the hand is off in each look."""

RELATED = 0.35
"""How far two looks err alike: 0 not at all, 1 the second says nothing new. With 0.2 a wrong mesh was
accepted for that block."""

PRIOR = log(2.0)
"""Logarithm of the odds before any look: the verdict is fitted to two right answers for each wrong mesh."""

PALM = (0, 1, 5, 9, 13, 17)
"""Joints that move together, whatever the fingers do."""


def best_of_looks(
    captures: Iterable[Capture], perceived: Callable[[Capture], Perceived], most: int
) -> Perceived:
    """The surest look, with the verdict of all of them together; no more are taken once that is sure. An
    image that was looked at already says nothing new, nor does a later one in which nothing is found.

    Args:
        captures: of one grasp; camera and hand may move in between.
        perceived: looks at one.
        most: so many are taken at most.

    Raises:
        FungraspError: as ``perceived`` of the first.
    """
    looks: list[Perceived] = []
    seen: list[np.ndarray] = []
    for capture in captures:
        if any(np.array_equal(capture.color, color) for color in seen):
            continue
        seen.append(capture.color)
        try:
            looks.append(perceived(capture))
        except FungraspError:
            if not looks:
                raise
            continue
        best = together(looks)
        if best.confident or len(looks) >= most:
            break
    return best


def together(looks: Sequence[Perceived]) -> Perceived:
    """The look in whose object most is believed, with the probability that all looks give it.

    The logarithms of the odds are added, less where looks err alike; a look that sees the object elsewhere in
    the hand counts against it as much as it is believed.
    """
    best = max(looks, key=lambda look: look.verdict.object)
    if len(looks) == 1:
        return best
    mine, said = KDTree(_in_palm(best)), 0.0
    for look in looks:
        odds = _odds(look.verdict.object) - PRIOR
        agrees = mine.query(_in_palm(look))[0].mean() < AGREE
        said += odds if agrees else -max(odds, 0.0)
    said = PRIOR + said / (1.0 + (len(looks) - 1) * RELATED)
    thing = 1.0 / (1.0 + exp(-said))
    sure = thing >= ACCEPT and best.verdict.hand >= ACCEPTED_HAND and not best.verdict.doubt
    verdict = replace(best.verdict, object=thing, sure=sure, looks=len(looks))
    return replace(best, verdict=verdict)


def _odds(probability: float) -> float:
    """Logarithm of the odds."""
    p = min(max(probability, 1e-4), 1.0 - 1e-4)
    return log(p / (1.0 - p))


def _in_palm(look: Perceived) -> np.ndarray:
    """The mesh's vertices in a frame of the palm [m], shape [V, 3]."""
    palm = look.hand.joints_camera[list(PALM)]
    x = palm[3] - palm[0]
    z = np.cross(x, palm[5] - palm[2])
    axes = np.stack([x / np.linalg.norm(x), np.cross(z, x), z])
    axes[1] /= np.linalg.norm(axes[1])
    axes[2] /= np.linalg.norm(axes[2])
    surface = transform_points(look.object.pose_camera_object, np.asarray(look.object_model.vertices))
    return (surface - palm.mean(axis=0)) @ axes.T
