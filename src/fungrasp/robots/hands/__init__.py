"""Drivers of robot hands, and what they take from the hand's model."""

from __future__ import annotations

import numpy as np

from fungrasp.robots.control_loop.device_loop import LoopGoal, LoopMode
from fungrasp.robots.device import JointLimits, RobotError

OPEN_SPEED = 0.5
"""Of opening after a fault [rad/s]: full stroke in about 3 s, so that an object is let go, not thrown."""


def hand_joint_limits(name: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest positions of a hand's independent joints [rad], shape [U] each, in model order: the
    order of drivers. count: of joints that the device has. Raises: RobotError: the model has another number
    of joints."""
    # Here, because the process of a device must start fast and needs no model.
    from fungrasp.hands import load_hand

    hand = load_hand(name)
    if len(hand.actuators) != count:
        raise RobotError(
            f"hand '{hand.name}' has {len(hand.actuators)} independent joints, the device {count}"
        )
    lower, upper = np.array([hand.joint_limits[hand.joint_names.index(j)] for j in hand.actuators]).T
    return lower, upper


def next_setpoint(
    setpoint: np.ndarray | None, goal: LoopGoal, measured: np.ndarray, limits: JointLimits, step: float
) -> np.ndarray | None:
    """Setpoint of a hand that is led by setpoints, a step later [rad], shape [U]; None where it has none.

    Args:
        setpoint: the last one [rad], shape [U]; None for none.
        measured: joint positions, where the first one is [rad], shape [U].
        step: time since the last one [s].
    """
    if goal.mode is LoopMode.POWER_OFF:
        return None
    if setpoint is None:
        if goal.mode in (LoopMode.IDLE, LoopMode.STAND_BY):
            return None
        setpoint = np.clip(measured, limits.lower, limits.upper)
    wanted, largest = setpoint, limits.velocity * step
    if goal.mode is LoopMode.FOLLOW:
        wanted = goal.positions
    elif goal.mode is LoopMode.OPEN:
        # Flat, as far as the limits allow: an Allegro's thumb does not reach zero.
        wanted, largest = np.clip(np.zeros(len(measured)), limits.lower, limits.upper), OPEN_SPEED * step
    # As ``np.clip``, in a third of its time.
    return setpoint + np.minimum(np.maximum(wanted - setpoint, -largest), largest)
