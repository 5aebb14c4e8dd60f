"""Identification of a twin's hand as of a robot's: excite, record, fit; nothing is told."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fungrasp.geometry.poses import invert, rotate
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.kinematics.arm_model import ArmKinematics
from fungrasp.robots.single_devices import record_motion
from fungrasp.robots.twin.devices import TwinClock, TwinHand
from fungrasp.robots.twin.parameters import TwinParameters
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.sim2real.identification.excitation import Excitation, ExcitationLimits, safe_motion
from fungrasp.sim2real.identification.fit import FitSettings, IdentifiedDynamics, fit_dynamics
from fungrasp.sim2real.identification.log_simulation import hang_weights, place_in_finger, prediction_rms
from fungrasp.sim2real.identification.motion_log import MotionLog

ALL_ERRORS = FitSettings(errors=("offset", "backlash"), prior=1.0, iterations=20)
"""Encoder offsets and lost motion are fitted too; where a log says nothing the model's values are right
within a factor of e."""

WRIST_TURNS = ((-3.2, 0.0), (-3.2, 0.5 * np.pi), (-3.2, -0.5 * np.pi))
"""Positions of a UR's joints wrist 1 and wrist 3 that turn the palm so that the fingers' weight pulls them to
three sides [rad]."""

ENOUGH = 0.1
"""A joint that moves less in a log is excited more [rad]: dry friction alone holds the joints of a softly
driven hand still within some 0.04 rad of where they are told to be."""

GROWTH = 1.5
"""By so much."""

MOST_LOGS = 5
"""Logs of one pose that are recorded until every joint moves enough."""

ASIDE = np.array([0.0, 0.45, 0.1, 1.0, 0.0, 0.0, 0.0])
"""Where the object lies meanwhile, world frame."""


@dataclass(frozen=True, eq=False)
class TwinIdentification:
    """What identification has found of a twin's hand."""

    found: IdentifiedDynamics
    """From the first half of each log."""
    held_out_rms: float
    """Of positions that it predicts in the second halves [rad]."""


def record_on_twin(
    cell: RobotCell,
    hand: Hand,
    obj: ObjectModel,
    truth: TwinParameters,
    excitation: Excitation | None = None,
    weight: float = 0.0,
) -> MotionLog:
    """Excite the hand of a twin, the arm at home. Joints that hardly move are excited more, and those in the
    same place of other fingers with them, as fingers stay side by side.

    Args:
        cell: the robot.
        hand: on its arm.
        obj: an object, which lies aside.
        truth: what is true of the twin.
        excitation: of the joints; the default if None.
        weight: mass that is fixed to each fingertip [kg].
    """
    e = excitation or Excitation()
    world = TwinWorld(cell, hand, obj, truth)
    if weight:
        hang_weights(world.model, hand, weight)
    world.settle(ASIDE)
    palm = ArmKinematics(cell, hand).palm_pose(np.asarray(cell.arm.home))
    gravity = rotate(invert(palm)[3:], np.array([0.0, 0.0, -9.81]))
    driver, clock = TwinHand(world, cell, hand), TwinClock(world)
    with driver:
        rest = driver.read().positions
    names, limits = tuple(hand.actuators), driver.limits
    room = ExcitationLimits(limits.lower, limits.upper, limits.velocity, limits.torque)
    motion = safe_motion(e, hand, rest, room, gravity)
    alike, more = place_in_finger(hand, names), np.ones(len(names))
    for _ in range(MOST_LOGS):
        larger = np.clip(rest + more * (motion.commands - rest), limits.lower, limits.upper)
        with driver:
            log = record_motion(
                driver, names, replace(motion, commands=larger), e.rate, gravity, clock=clock, weight=weight
            )
        weak = [np.ptp(log.positions[log.moving[:, joint], joint]) < ENOUGH for joint in range(len(names))]
        if not any(weak):
            break
        more[np.isin(alike, alike[weak])] *= GROWTH
    return log


def identify_on_twin(
    cell: RobotCell,
    hand: Hand,
    obj: ObjectModel,
    truth: TwinParameters,
    excitation: Excitation | None = None,
    settings: FitSettings | None = None,
    weight: float = 0.0,
) -> TwinIdentification:
    """What identification finds of a twin's hand that a UR holds in three poses, in each of them once more
    with weights on its fingertips if there are any.

    Args:
        cell: the robot.
        hand: on its arm.
        obj: an object, which lies aside.
        truth: what is true of the twin; it is used to simulate, and hidden from the fit.
        excitation: of the joints; the default if None.
        settings: of the fit; ``ALL_ERRORS`` if None.
        weight: mass that a person fixes to each fingertip [kg]; 0 for none.
    """
    e = excitation or Excitation()
    logs = []
    turns = [(turn, mass) for mass in ((0.0, weight) if weight else (0.0,)) for turn in WRIST_TURNS]
    for number, ((wrist_1, wrist_3), mass) in enumerate(turns):
        home = (*cell.arm.home[:3], wrist_1, cell.arm.home[4], wrist_3)
        turned = replace(cell, arm=replace(cell.arm, home=home))
        logs.append(record_on_twin(turned, hand, obj, truth, replace(e, seed=e.seed + number), mass))
    found = fit_dynamics(hand, [log.part(0.0, 0.5) for log in logs], settings or ALL_ERRORS)
    missed = prediction_rms(hand, logs, found.dynamics, found.errors, after=0.5)
    return TwinIdentification(found, missed)
