"""Whether a twin's object was lifted: the lift test's definition of success (docs/evaluation.md)."""

from __future__ import annotations

import numpy as np

from fungrasp.robots.twin.world import TwinWorld
from fungrasp.task import LiftProtocol


class TwinJudge:
    """Watches one deployment."""

    def __init__(self, world: TwinWorld, protocol: LiftProtocol | None = None):
        """
        Args:
            world: whose object has settled.
            protocol: with the height; the published one if None.
        """
        self._world, self._protocol = world, protocol or LiftProtocol()
        self._settled = world.center_of_mass()[2]
        self.height = np.inf
        """Least height of the centre of mass above where it settled during the hold [m]."""
        self._alone = True
        self._samples = self._touching = 0

    def watch(self, holding: bool) -> None:
        """After each setpoint. holding: whether it belongs to the hold."""
        if not holding:
            return
        truth = self._world.look()
        self.height = min(self.height, float(self._world.center_of_mass()[2] - self._settled))
        self._alone &= not truth.on_table
        self._samples += 1
        self._touching += truth.in_hand

    @property
    def success(self) -> bool:
        """Whether the object stayed up, in the hand, and touched nothing else."""
        enough = self._samples * 0.02 >= 0.95 * self._protocol.hold_time
        high = self.height >= self._protocol.success_height
        return enough and high and self._alone and self._touching > 0.5 * self._samples
