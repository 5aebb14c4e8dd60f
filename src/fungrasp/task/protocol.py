"""Parameters of the lift test (docs/evaluate.md)."""

from __future__ import annotations

from dataclasses import dataclass

from fungrasp.core.records import CheckedRecord


@dataclass(frozen=True)
class LiftProtocol(CheckedRecord):
    """Parameters of start, motion limits, lift and hold."""

    settle_time: float = 2.0
    """Time for the object to settle from its rest pose [s]. A pitcher on its side rolls by 23 mm in the
    second second. Later, no object of 375 DexYCB and 120 built-in grasps moves by more than 2 mm/s."""
    start_distance: float = 0.30
    """Distance between wrist and object center at the start [m]. If the palm's origin is far from the hand, a
    point near it is used."""
    start_closing: float = 0.5
    """Finger angles at the start, as a fraction of their target angles."""
    control_period: float = 0.1
    """Control period [s]."""
    approach_time: float = 6.0
    """Latest start of the lift [s]."""
    lift_height: float = 0.15
    """Height of the lift [m]."""
    rise_time: float = 6.0
    """Longest time from lift to hold [s], because a wrist that follows a rolling object never comes to rest.
    A lift takes 1.4 s at the wrist's largest speed."""
    hold_time: float = 3.0
    """Duration of the hold [s]."""
    success_height: float = 0.10
    """Height that the object's center of mass must keep above its settled height [m]."""
    wrist_speed: float = 0.25
    """Largest speed of the wrist's setpoint [m/s]."""
    wrist_acceleration: float = 0.3
    """Largest acceleration of the wrist's setpoint [m/s^2]."""
    wrist_rotation_speed: float = 1.0
    """Largest rotation speed of the wrist's setpoint [rad/s]."""
    wrist_rotation_acceleration: float | None = None
    """Largest angular acceleration [rad/s^2]; None in simulation, which has no ramps for rotations."""
    lost_height: float = 0.03
    """The object is lost if it is less than this above its settled height [m] at ``lost_after`` or later."""
    lost_after: float = 1.0
    """Time after the start of the lift from which an object can be lost [s]."""
