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
        """The factors of identified joints; those that were not identified are as in the model.

        Args:
            hand: with the model.
            dynamics: of some or all of its independent joints.
        """
        model, factors = model_dynamics(hand), np.ones((2, len(hand.joint_names)))
        for j, name in enumerate(dynamics.joints):
            joint, row = hand.joint_names.index(name), model.joints.index(name)
            factors[0, joint] = dynamics.stiffness[j] / model.stiffness[row]
            # What is identified is the sum of both dampings.
            factors[1, joint] = dynamics.damping[j] / max(model.damping[row], 1e-9)
        return cls(factors[1], factors[0], factors[1].copy())


@dataclass(frozen=True, eq=False)
class HandKnowledge:
    """Of one hand on one robot."""

    planned: Hand
    """The hand for planners: its servos make no more torque than the robot's."""
    dynamics: HandDynamics | None
    """What was identified; None for what the model says."""
    stiffness: np.ndarray | None
    """Identified stiffness of the servos [N m/rad], shape [U]; None for the model's."""


def hand_knowledge(cell: RobotCell, hand: Hand, dynamics: str | Path | None = None) -> HandKnowledge:
    """What a cell says of its hand.

    Args:
        cell: the robot.
        hand: the model of its hand.
        dynamics: file of identified dynamics, in place of the cell's.

    Raises:
        FungraspError: the file can't be read, or the cell's driver of the hand can't be.
    """
    path = dynamics or cell.hand_dynamics
    if not path:
        return HandKnowledge(limited_hand(cell, hand), None, None)
    found = load_dynamics(path, hand)
    return HandKnowledge(limited_hand(cell, hand, found), HandDynamics.of(hand, found), found.stiffness)
