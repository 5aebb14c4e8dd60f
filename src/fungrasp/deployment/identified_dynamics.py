"""What is known of the hand on a robot beyond its model: for planner, policy and gravity compensation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fungrasp.hands import Hand
from fungrasp.robots.assembly import limited_hand
from fungrasp.robots.cell import RobotCell
from fungrasp.sim2real.joint_dynamics import JointDynamics, load_dynamics, model_dynamics


@dataclass(frozen=True, eq=False)
class HandDynamics:
    """Identified dynamics of a hand, as factors on the model's."""

    joint_damping: np.ndarray
    """Damping of each joint, shape [M]."""
    servo_stiffness: np.ndarray
    """Stiffness of each joint's servo, shape [M]."""
    servo_damping: np.ndarray
    """Damping of each joint's servo, shape [M]."""

    @classmethod
    def of(cls, hand: Hand, dynamics: JointDynamics) -> HandDynamics:
        """The factors of identified joints, some or all of the independent ones; those that were not
        identified are as in the model."""
        model, factors = model_dynamics(hand), np.ones((2, len(hand.joint_names)))
        for j, name in enumerate(dynamics.joints):
            joint, row = hand.joint_names.index(name), model.joints.index(name)
            factors[0, joint] = dynamics.stiffness[j] / model.stiffness[row]
            # What is identified is the sum of both dampings.
            factors[1, joint] = dynamics.damping[j] / max(model.damping[row], 1e-9)
        return cls(factors[1], factors[0], factors[1].copy())

    def stiffness(self, hand: Hand) -> np.ndarray:
        """Stiffness of the servos [N m/rad], shape [U]."""
        driven = [hand.joint_names.index(name) for name in hand.actuators]
        return np.array([servo.kp for servo in hand.actuators.values()]) * self.servo_stiffness[driven]


def identified_dynamics(
    cell: RobotCell, hand: Hand, file: str | Path = ""
) -> tuple[Hand, HandDynamics | None]:
    """What a cell says of its hand.

    Args:
        file: of identified dynamics, in place of the cell's.

    Returns:
        The hand for planners, whose servos make no more torque than the robot's; and what was identified,
        None where nothing was.

    Raises:
        FungraspError: the file can't be read, or the cell's driver of the hand can't be.
    """
    path = file or cell.hand_dynamics
    if not path:
        return limited_hand(cell, hand), None
    found = load_dynamics(path, hand)
    return limited_hand(cell, hand, found), HandDynamics.of(hand, found)
