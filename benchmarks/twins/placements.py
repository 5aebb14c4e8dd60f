"""An object that the robot can't reach is put elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

from fungrasp.deployment.preparation import UnreachableError

OutcomeT = TypeVar("OutcomeT")

MOST_PLACEMENTS = 3
"""Places where the object is put before a grasp counts as one that the robot can't reach."""


def deploy_where_reached(
    placements: Iterable[np.ndarray], deploy: Callable[[np.ndarray], OutcomeT]
) -> tuple[OutcomeT | None, int, str]:
    """Deploy with the object at a placement, and elsewhere where the robot says that it can't reach it, as a
    person would do: at ``MOST_PLACEMENTS`` at most.

    Args:
        placements: of the object, world frame, each of shape [7]; looking for them may fail as well.
        deploy: with the object there; raises ``UnreachableError`` before anything moves.

    Returns:
        what came of it, None if all were refused; number of placements; and why the last was refused, "" if
        none was.
    """
    count, said, left = 0, "", iter(placements)
    while count < MOST_PLACEMENTS:
        try:
            where = next(left, None)
            if where is None:
                break
            count += 1
            return deploy(where), count, said
        except UnreachableError as error:
            said = str(error)
    return None, count, said
