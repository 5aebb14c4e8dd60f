"""A hand that is told to make less torque than its cell says: for motions that nothing should be in the way
of."""

from __future__ import annotations

from dataclasses import replace

from fungrasp.robots.cell import RobotCell
from fungrasp.robots.device import RobotError


def with_torque_share(cell: RobotCell, share: float) -> RobotCell:
    """The cell, the torque of its hand limited to a share; as it is where its driver has no such option.

    Args:
        cell: the robot.
        share: above 0, at most 1.

    Raises:
        RobotError: the share is none.
    """
    if not 0 < share <= 1:
        raise RobotError(f"a share of the torque is above 0 and at most 1, not {share:g}")
    device = cell.hand_device
    options = dict(device.options)
    if device.driver == "allegro-can":
        options["torque_share"] = share * float(options.get("torque_share", 1.0))
    elif device.driver == "inspire":
        from fungrasp.robots.hands.inspire import InspireSettings

        options["force"] = max(1, round(share * options.get("force", InspireSettings.force)))
    elif device.driver == "leap-dynamixel":
        from fungrasp.robots.hands.leap import CURRENT_LIMITS

        full = options.get("current_limit") or CURRENT_LIMITS.get(options.get("build", ""), 0)
        options["current_limit"] = round(share * full)
    return replace(cell, hand_device=replace(device, options=options))
