"""Drivers of robot hands, and what they take from the hand's model."""

from __future__ import annotations

import numpy as np

from fungrasp.robots.device import RobotError


def hand_joint_limits(name: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest positions of a hand's independent joints [rad], shape [U] each, in model order: the
    order of drivers.

    Args:
        count: of joints that the device has.

    Raises:
        RobotError: the model has another number of joints.
    """
    # Here, because the process of a device must start fast and needs no model.
    from fungrasp.hands import load_hand

    hand = load_hand(name)
    if len(hand.actuators) != count:
        raise RobotError(
            f"hand '{hand.name}' has {len(hand.actuators)} independent joints, the device {count}"
        )
    lower, upper = np.array([hand.joint_limits[hand.joint_names.index(j)] for j in hand.actuators]).T
    return lower, upper
