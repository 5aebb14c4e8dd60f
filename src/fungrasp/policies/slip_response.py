"""What is done about an object that is seen to sink in the hand as it is lifted."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.arrays import rows_like
from fungrasp.geometry.poses import Array, array_namespace, clip

SHARE = 0.3
"""Share of a seen difference that is taken over at each control step: 2 mm of the tracker's jitter become
0.8 mm."""
UNNOTICED = 0.004
"""An object that has sunk by no more than this [m] is not pressed harder: fingers yield a little to any
weight, and the largest of many jitters is half of it."""
HARDEST = 2.0
"""Factor on the planned squeeze of an object that has sunk by ``FAR`` more; servos stop at their torque
limits by themselves."""
FAR = 0.02
"""How far that is [m]: an object seen to have sunk so far turns about the fingers or slides between them."""
HIGHEST = 0.06
"""How far the palm rises beyond the lift at most [m]."""
FRESH = 0.35
"""A tracked pose that is older [s] says nothing: more than the tracker's delay and two missing frames, and no
multiple of a control period."""


class SlipResponse:
    """Watches the lifts of W robots. The palm rises by as much as the object has been seen to sink, so that
    the object rises by what was asked."""

    def __init__(self, count: int, on: Array | None = None):
        """
        Args:
            on: an array of the library and the device of what is seen; NumPy's if None.
        """
        on = np.zeros(1) if on is None else on
        self.sunk = rows_like(on, np.zeros(count))
        """How far objects have been seen to sink at most, since the lift began [m], shape [W]."""
        self._smooth = rows_like(on, np.zeros(count))
        self._palm = rows_like(on, np.full(count, np.nan))

    def begin(self, ids: Array) -> None:
        """Forget the past of some worlds. ids: shape [I]."""
        self.sunk[ids] = 0.0
        self._smooth[ids] = 0.0
        self._palm[ids] = np.nan

    def update(self, lifting: Array, palm_height: Array, risen: Array, age: Array) -> None:
        """See a control step.

        Args:
            lifting: robots whose lift has begun, shape [W] bool.
            palm_height: measured [m], shape [W].
            risen: how far the object's center of mass is seen to have risen [m], shape [W].
            age: of what is seen of it [s], shape [W].
        """
        xp = array_namespace(palm_height)
        self._palm = xp.where(lifting & xp.isnan(self._palm), palm_height, self._palm)
        seen = lifting & (age <= FRESH)
        sunk = xp.where(seen, palm_height - self._palm - risen, self._smooth)
        self._smooth = self._smooth + SHARE * (sunk - self._smooth)
        self.sunk = xp.maximum(self.sunk, self._smooth)

    @property
    def raised(self) -> Array:
        """How far the palm's goal is to be above the planned one [m], shape [W]."""
        return clip(self.sunk, 0.0, HIGHEST)

    @property
    def squeeze(self) -> Array:
        """Factor on the planned squeeze, shape [W]."""
        return 1.0 + (HARDEST - 1.0) * clip((self.sunk - UNNOTICED) / FAR, 0.0, 1.0)
