"""Response to an object that sinks in the hand during the lift."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.arrays import rows_like
from fungrasp.geometry.poses import Array, array_namespace, clip

SHARE = 0.3
"""Weight of a new measurement in the smoothed sinking at each control step; it reduces the tracker's jitter
from 2 mm to 0.8 mm."""
UNNOTICED = 0.004
"""Sinking below which the squeeze stays as planned [m]: fingers yield a little to any weight, and the largest
of many jitters is half of this."""
HARDEST = 2.0
"""Factor on the planned squeeze if the object has sunk by ``FAR`` beyond ``UNNOTICED``; servos are limited by
their torque anyway."""
FAR = 0.02
"""Sinking beyond ``UNNOTICED`` that gives the hardest squeeze [m]: the object then turns about the fingers or
slides between them."""
HIGHEST = 0.06
"""Largest additional height of the palm [m]."""
FRESH = 0.35
"""Largest age of a usable tracked pose [s]: more than the tracker's delay and two missing frames, and not a
multiple of a control period."""


class SlipResponse:
    """Watches the lifts of W robots. The palm rises by the distance that the object sinks, so that the object
    reaches its height."""

    def __init__(self, count: int, on: Array | None = None):
        """
        Args:
            on: array whose library and device are used; NumPy if None.
        """
        on = np.zeros(1) if on is None else on
        self.sunk = rows_like(on, np.zeros(count))
        """Largest smoothed sinking of the objects since the lift began [m], shape [W]."""
        self._smooth = rows_like(on, np.zeros(count))
        self._palm = rows_like(on, np.full(count, np.nan))

    def begin(self, ids: Array) -> None:
        """Reset some worlds. ids: shape [I]."""
        self.sunk[ids] = 0.0
        self._smooth[ids] = 0.0
        self._palm[ids] = np.nan

    def update(self, lifting: Array, palm_height: Array, risen: Array, age: Array) -> None:
        """Update with a new control step.

        Args:
            lifting: robots whose lift has begun, shape [W] bool.
            palm_height: measured heights of the palms [m], shape [W].
            risen: tracked rise of the objects' centers of mass [m], shape [W].
            age: age of the tracked poses [s], shape [W].
        """
        xp = array_namespace(palm_height)
        self._palm = xp.where(lifting & xp.isnan(self._palm), palm_height, self._palm)
        seen = lifting & (age <= FRESH)
        sunk = xp.where(seen, palm_height - self._palm - risen, self._smooth)
        self._smooth = self._smooth + SHARE * (sunk - self._smooth)
        self.sunk = xp.maximum(self.sunk, self._smooth)

    @property
    def raised(self) -> Array:
        """Height of the palm's goal above the planned goal [m], shape [W]."""
        return clip(self.sunk, 0.0, HIGHEST)

    @property
    def squeeze(self) -> Array:
        """Factor on the planned squeeze, shape [W]."""
        return 1.0 + (HARDEST - 1.0) * clip((self.sunk - UNNOTICED) / FAR, 0.0, 1.0)
