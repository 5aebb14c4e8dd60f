"""The torques that a robot's hand really makes: its driver's settings are the one place that says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.robots.assembly import TWIN, hand_driver
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.twin.parameters import twin_torque_limits
from fungrasp.sim2real.joint_dynamics import JointDynamics


def driver_torque_limits(cell: RobotCell, hand: Hand) -> np.ndarray:
    """Largest torques that a cell's driver asks of its hand's servos [N m], shape [U]; infinite where it
    leaves that to the hand. Nothing is connected.

    Args:
        cell: the robot.
        hand: the model of its hand.

    Raises:
        FungraspError: the cell's driver of the hand, or its options, can't be.
    """
    if cell.hand_device.driver == TWIN:
        return twin_torque_limits(cell, hand)
    return hand_driver(cell, hand).limits.torque


def limited_hand(cell: RobotCell, hand: Hand, dynamics: JointDynamics | None = None) -> Hand:
    """The hand as a planner has to know it: no servo makes more torque than its model says, or the file of
    identified dynamics where that says it, nor more than the cell's driver sends.

    Args:
        cell: the robot.
        hand: the model of its hand.
        dynamics: identified; their torque limits replace the model's, where they have some.

    Raises:
        FungraspError: as ``driver_torque_limits``, or no torque is left to a servo.
    """
    limits = driver_torque_limits(cell, hand)
    servos = {}
    for i, (name, servo) in enumerate(hand.actuators.items()):
        own = servo.force_limit
        if dynamics is not None and dynamics.torque_limit is not None and name in dynamics.joints:
            own = float(dynamics.torque_limit[dynamics.joints.index(name)])
        largest = min(own, float(limits[i]))
        if not largest > 0:
            raise FungraspError(
                f"cell '{cell.name}': no torque is left to '{name}': look at the options of the hand's "
                "driver and at the file of its dynamics"
            )
        servos[name] = replace(servo, force_limit=largest)
    return replace(hand, actuators=servos)
