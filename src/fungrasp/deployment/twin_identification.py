"""Identification of a twin's hand as of a robot's: excite, record, fit; nothing is told."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
from fungrasp.sim2real.identification.excitation import Excitation, excitation_commands
from fungrasp.sim2real.identification.finger_chains import clear_of_itself, place_in_finger
from fungrasp.sim2real.identification.fingertip_weights import hang_weights
from fungrasp.sim2real.identification.fit import FitSettings, IdentifiedDynamics, fit_dynamics
from fungrasp.sim2real.identification.log_simulation import simulate_log
from fungrasp.sim2real.identification.motion_log import MotionLog

MULTI_SINE = Excitation(kind="multi-sine", seconds=6.0, rate=100.0, reach=0.12, hold=0.5, fastest=2.5)
"""On an Allegro twin servos then make at most 75 % of their torque."""

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
    thing: ObjectModel,
    truth: TwinParameters,
    excitation: Excitation | None = None,
    weight: float = 0.0,
) -> MotionLog:
    """Excite the hand of a twin, the arm at home. Joints that hardly move are excited more, and those in the
    same place of other fingers with them, as fingers stay side by side.

    Args:
        cell: the robot.
        hand: on its arm.
        thing: an object, which lies aside.
        truth: what is true of the twin.
        excitation: of the joints; ``MULTI_SINE`` if None.
        weight: mass that is fixed to each fingertip [kg].
    """
    e = excitation or MULTI_SINE
    world = TwinWorld(cell, hand, thing, truth)
    if weight:
        hang_weights(world.model, hand, weight)
    world.settle(ASIDE)
    palm = ArmKinematics(cell, hand).palm_pose(np.asarray(cell.arm.home))
    gravity = rotate(invert(palm)[3:], np.array([0.0, 0.0, -9.81]))
    driver, clock = TwinHand(world, cell, hand), TwinClock(world)
    with driver:
        rest = driver.read().positions
    names = tuple(hand.actuators)
    alike = place_in_finger(hand, names)
    e = replace(e, small_step=min(e.small_step, largest_step(hand)))
    low, high = driver.limits.lower, driver.limits.upper
    commands = excitation_commands(e, rest, low, high, alike)
    more = np.ones(len(names))
    for _ in range(MOST_LOGS):
        larger = clear_of_itself(hand, np.clip(rest + more * (commands - rest), low, high))
        with driver:
            log = record_motion(driver, names, larger, e.rate, gravity, clock=clock, weight=weight)
        weak = np.ptp(log.part(0.0, 0.5).positions, axis=0) < ENOUGH
        if not weak.any():
            break
        more[np.isin(alike, alike[weak])] *= GROWTH
    return log


def largest_step(hand: Hand) -> float:
    """A step of any joint, as a share of its range, for which its servo makes 40 % of its torque as it
    changes sides: those of stiff servos must be smaller."""
    shares = []
    for name, servo in hand.actuators.items():
        low, high = hand.joint_limits[hand.joint_names.index(name)]
        shares.append(0.2 * servo.force_limit / (servo.kp * (high - low)))
    return float(min(shares))


def identify_on_twin(
    cell: RobotCell,
    hand: Hand,
    thing: ObjectModel,
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
        thing: an object, which lies aside.
        truth: what is true of the twin; it is used to simulate, and hidden from the fit.
        excitation: of the joints; ``MULTI_SINE`` if None.
        settings: of the fit; ``ALL_ERRORS`` if None.
        weight: mass that a person fixes to each fingertip [kg]; 0 for none.
    """
    e = excitation or MULTI_SINE
    logs = []
    turns = [(turn, mass) for mass in ((0.0, weight) if weight else (0.0,)) for turn in WRIST_TURNS]
    for number, ((wrist_1, wrist_3), mass) in enumerate(turns):
        home = (*cell.arm.home[:3], wrist_1, cell.arm.home[4], wrist_3)
        turned = replace(cell, arm=replace(cell.arm, home=home))
        logs.append(record_on_twin(turned, hand, thing, truth, replace(e, seed=e.seed + number), mass))
    found = fit_dynamics(hand, [log.part(0.0, 0.5) for log in logs], settings or ALL_ERRORS)
    missed = [
        (simulate_log(hand, log, [found.dynamics], errors=[found.errors])[0] - log.positions)[
            len(log.times) // 2 :
        ]
        for log in logs
    ]
    return TwinIdentification(found, float(np.sqrt(np.mean(np.concatenate(missed) ** 2))))
