"""Whether a twin's object was lifted: the lift test's definition of success (docs/evaluate.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.robots.twin.world import TwinWorld
from fungrasp.task import LiftProtocol
from fungrasp.task.outcome import lifted_and_held
from fungrasp.task.setpoints import SETPOINT_PERIOD


@dataclass(frozen=True)
class HoldSample:
    """The truth at one moment."""

    time: float
    """Of the robot's clock [s]."""
    height: float
    """Of the center of mass above where it settled [m]."""
    alone: bool
    """Whether the object touches neither table nor arm."""
    in_hand: bool
    """Whether it touches the hand."""


def hold_sample(world: TwinWorld, settled: float) -> HoldSample:
    """The truth now.

    Args:
        settled: height at which the center of mass settled [m].
    """
    truth = world.look()
    height = float(world.center_of_mass()[2] - settled)
    return HoldSample(world.time, height, not truth.on_table, truth.in_hand)


def held_throughout(samples: list[HoldSample], seconds: float, protocol: LiftProtocol) -> bool:
    """Whether a twin's object was lifted and held (``fungrasp.task.outcome.lifted_and_held``), over a hold
    that was not cut short.

    Args:
        protocol: with height and time of the hold.
    """
    lowest = min((s.height for s in samples), default=-np.inf)
    share = sum(s.in_hand for s in samples) / max(len(samples), 1)
    touched = not all(s.alone for s in samples)
    held = lifted_and_held(np.array(lowest), np.array(share), np.array(touched), protocol)
    return bool(held) and seconds >= 0.95 * protocol.hold_time


class TwinJudge:
    """Watches one deployment, at every setpoint."""

    def __init__(self, world: TwinWorld, protocol: LiftProtocol | None = None):
        """
        Args:
            protocol: with the height; the published one if None.
        """
        self._world, self._protocol = world, protocol or LiftProtocol()
        self._settled = float(world.center_of_mass()[2])
        self._samples: list[HoldSample] = []

    def begin_attempt(self) -> None:
        """Another attempt begins: what was seen of the one before is forgotten, and the object counts from
        where it lies now."""
        self._settled = float(self._world.center_of_mass()[2])
        self._samples.clear()

    def watch(self, holding: bool) -> None:
        """After each setpoint. holding: whether it belongs to the hold."""
        if holding:
            self._samples.append(hold_sample(self._world, self._settled))

    @property
    def height(self) -> float:
        """Least height of the center of mass above where it settled during the hold [m]; infinite before."""
        return min((s.height for s in self._samples), default=np.inf)

    @property
    def success(self) -> bool:
        """``held_throughout``."""
        return held_throughout(self._samples, SETPOINT_PERIOD * len(self._samples), self._protocol)
