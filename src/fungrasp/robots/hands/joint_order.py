"""Limits of a hand's independent joints, in the order that drivers use."""

from __future__ import annotations

import numpy as np

from fungrasp.robots.device import RobotError


def hand_joint_limits(name: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest positions of a hand's independent joints [rad], shape [U] each, in model order.

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
    limits = [hand.joint_limits[hand.joint_names.index(joint)] for joint in hand.actuators]
    lower, upper = np.array(limits).T
    return lower, upper


def hand_side(name: str) -> str:
    """ "right" or "left"; name: of a hand model."""
    from fungrasp.hands import load_hand

    return load_hand(name).side


def hand_joint_names(name: str) -> tuple[str, ...]:
    """Names of a hand's independent joints, in model order; name: of a hand model."""
    from fungrasp.hands import load_hand

    return tuple(load_hand(name).actuators)
