"""The numbers of the dynamic test (docs/evaluation.md)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Protocol:
    """Start, motion limits, lift and hold."""

    settle_time: float = 1.0
    """The object settles from its rest pose [s]."""
    start_distance: float = 0.30
    """Wrist to object centre at the start [m]."""
    start_closing: float = 0.5
    """Fingers at the start, as a fraction of their target angles."""
    control_period: float = 0.1
    """A policy acts this often [s]."""
    approach_time: float = 6.0
    """The lift begins after this at the latest [s]."""
    lift_height: float = 0.15
    """The wrist's goal rises by this [m]."""
    hold_time: float = 3.0
    """[s]."""
    success_height: float = 0.10
    """The object's centre of mass stays this far above where it settled [m]."""
    wrist_speed: float = 0.25
    """[m/s]."""
    wrist_acceleration: float = 0.3
    """[m/s^2]."""
    wrist_rotation_speed: float = 1.0
    """[rad/s]."""
