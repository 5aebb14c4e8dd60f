"""The numbers of the lift test (docs/evaluate.md)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LiftProtocol:
    """Start, motion limits, lift and hold."""

    settle_time: float = 1.0
    """Time in which the object settles from its rest pose [s]."""
    start_distance: float = 0.30
    """Distance from the wrist to the object's center at the start [m]; of a palm whose origin lies far from
    the hand, from a place near it."""
    start_closing: float = 0.5
    """Fingers at the start, as a fraction of their target angles."""
    control_period: float = 0.1
    """A policy acts this often [s]."""
    approach_time: float = 6.0
    """The lift begins after this at the latest [s]."""
    lift_height: float = 0.15
    """The wrist's goal rises by this [m]."""
    rise_time: float = 6.0
    """The hold begins this long after the lift at the latest [s]: a wrist that follows what rolls away never
    comes to rest. A rise takes 1.4 s at the wrist's largest speed."""
    hold_time: float = 3.0
    """The object is held for this long [s]."""
    success_height: float = 0.10
    """The object's center of mass stays this far above where it settled [m]."""
    wrist_speed: float = 0.25
    """Largest speed of the wrist's setpoint [m/s]."""
    wrist_acceleration: float = 0.3
    """Largest acceleration of the wrist's setpoint [m/s^2]."""
    wrist_rotation_speed: float = 1.0
    """Largest rotation speed of the wrist's setpoint [rad/s]."""
    wrist_rotation_acceleration: float | None = None
    """Largest acceleration of that rotation [rad/s^2]; None in simulation: turns have no ramp."""
    lost_height: float = 0.03
    """An object that is lower than this above where it settled [m] ``lost_after`` the lift began is lost."""
    lost_after: float = 1.0
    """Time since the beginning of the lift from which an object can be lost [s]."""
