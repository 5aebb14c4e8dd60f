"""What a policy does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.core.records import BatchRecord


@dataclass(frozen=True, eq=False, repr=False)
class Action(BatchRecord):
    """What a policy asks of W robots during the next control period."""

    palm_goal: np.ndarray
    """Goal of the palm body, world frame, before any lift is added, shape [W, 7]. The wrist moves there
    within its speed limits."""
    finger_targets: np.ndarray
    """Targets of the finger servos at the end of the period [rad], shape [W, U]."""
    lift: np.ndarray
    """Whether the lift may begin (it can't be taken back), shape [W] bool."""
