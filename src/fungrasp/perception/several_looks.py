"""Several looks at one grasp: where an image leaves doubt, others of the same grasp are looked at too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from math import exp, log

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.confidence import ACCEPT
from fungrasp.perception.perceived import Perceived
from fungrasp.perception.verdict import ACCEPTED_HAND

LEAST = 1e-4
"""Nothing is taken to be less probable: one look can't decide alone."""


def best_of_looks(
    captures: Iterable[Capture],
    perceived: Callable[[Capture], Perceived],
    most: int,
    unsure: Callable[[Perceived], None] = lambda together: None,
) -> Perceived:
    """The surest look, with the verdict of all of them together; no more are taken once that is sure. An
    image that was looked at already says nothing new, nor does one in which nothing is found.

    Args:
        captures: of one grasp; camera and hand may move in between.
        perceived: looks at one.
        most: so many are taken at most.
        unsure: is given what is known so far, where another look may follow.

    Raises:
        FungraspError: nothing is found in any; as ``perceived`` of the first.
    """
    looks: list[Perceived] = []
    seen: list[np.ndarray] = []
    known: Perceived | None = None
    nothing: FungraspError | None = None
    for capture in captures:
        if any(np.array_equal(capture.color, color) for color in seen):
            continue
        seen.append(capture.color)
        try:
            looks.append(perceived(capture))
        except FungraspError as error:
            nothing = nothing or error
            continue
        known = together(looks)
        if known.confident or len(looks) >= most:
            break
        unsure(known)
    if known is None:
        raise nothing or FungraspError("there is no image to look at")
    return known


def together(looks: Sequence[Perceived]) -> Perceived:
    """The look whose object is the most probable, of those that make a sure answer if there are any, with the
    verdict of all of them."""
    if len(looks) == 1:
        return looks[0]
    thing = probability_of_looks([look.verdict.object for look in looks])
    answers = []
    for look in looks:
        sure = thing >= ACCEPT and look.verdict.hand >= ACCEPTED_HAND and not look.verdict.doubt
        answers.append((sure, look.verdict.object, look))
    sure, _, best = max(answers, key=lambda answer: answer[:2])
    # A look that is sure of itself has no advice; what the others lack would have helped.
    least = min(looks, key=lambda look: look.verdict.object)
    advice = () if sure else best.verdict.help or least.verdict.help
    return replace(
        best, verdict=replace(best.verdict, object=thing, sure=sure, help=advice, looks=len(looks))
    )


def probability_of_looks(said: Sequence[float]) -> float:
    """Probability that the object is right, as all looks say: the mean of the logarithms of the odds.

    What a look makes of a mesh is mostly the mesh's doing: a wrong one that is believed from one side is
    believed from another, too, so that odds must not be multiplied (decision 0104).

    Args:
        said: each look's own probability.
    """
    odds = [log(p / (1.0 - p)) for p in (min(max(p, LEAST), 1.0 - LEAST) for p in said)]
    return 1.0 / (1.0 + exp(-sum(odds) / len(odds)))
