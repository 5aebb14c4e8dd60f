"""Identification of a twin's hand as of a robot's: excite, record, fit; nothing is told."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import invert, rotate
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.kinematics.arm_model import ArmKinematics
from fungrasp.robots.motion_recording import record_motion
from fungrasp.robots.twin.clocks import TwinClock
from fungrasp.robots.twin.devices import TwinHand
from fungrasp.robots.twin.parameters import TwinParameters
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.transfer.identification.excitation import Excitation, excitation_commands
from fungrasp.transfer.identification.fit import FitSettings, IdentifiedDynamics, fit_dynamics
from fungrasp.transfer.identification.motion_log import MotionLog

SMALL_STEPS = Excitation(reach=0.1)
"""Steps so small that servos hardly reach their torque limit. On an Allegro twin without imperfections the
stiffness is then 3 % off at the median, where 30 % of a joint's range gave 39 %; the probable reason is that
the fitted model does not count damping towards that limit. Not tried on twins with drawn parameters."""

ASIDE = np.array([0.0, 0.45, 0.1, 1.0, 0.0, 0.0, 0.0])
"""Where the object lies meanwhile, world frame."""


def record_on_twin(
    cell: RobotCell,
    hand: Hand,
    thing: ObjectModel,
    truth: TwinParameters,
    excitation: Excitation | None = None,
) -> MotionLog:
    """Excite the hand of a twin, the arm at home.

    Args:
        cell: the robot.
        hand: on its arm.
        thing: an object, which lies aside.
        truth: what is true of the twin.
        excitation: of the joints; ``SMALL_STEPS`` if None.
    """
    e = excitation or SMALL_STEPS
    world = TwinWorld(cell, hand, thing, truth)
    world.settle(ASIDE)
    palm = ArmKinematics(cell, hand).palm_pose(np.asarray(cell.arm.home))
    gravity = rotate(invert(palm)[3:], np.array([0.0, 0.0, -9.81]))
    driver, clock = TwinHand(world, cell, hand), TwinClock(world)
    with driver:
        rest = driver.read().positions
        commands = excitation_commands(e, rest, driver.limits.lower, driver.limits.upper)
        return record_motion(driver, tuple(hand.actuators), commands, e.rate, gravity, clock=clock)


def identify_on_twin(
    cell: RobotCell,
    hand: Hand,
    thing: ObjectModel,
    truth: TwinParameters,
    excitation: Excitation | None = None,
    settings: FitSettings | None = None,
) -> IdentifiedDynamics:
    """What identification finds of a twin's hand.

    Args:
        cell: the robot.
        hand: on its arm.
        thing: an object, which lies aside.
        truth: what is true of the twin; it is used to simulate, and hidden from the fit.
        excitation: of the joints; ``SMALL_STEPS`` if None.
        settings: of the fit; the default if None.
    """
    return fit_dynamics(hand, record_on_twin(cell, hand, thing, truth, excitation), settings)
