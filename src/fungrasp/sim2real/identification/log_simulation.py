"""A log's motion, simulated with the hand's model."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.hands import Hand
from fungrasp.sim2real.identification.fingertip_weights import hang_weights
from fungrasp.sim2real.identification.motion_log import MotionLog
from fungrasp.sim2real.joint_dynamics import JointDynamics, set_dynamics
from fungrasp.simulation.joint_response import STEP, joint_response

NOSLIP = 5
"""Iterations that take the creep out of dry friction."""


@dataclass(frozen=True, eq=False)
class DriveErrors:
    """What differs between a joint's drive and encoder and the joint, for J joints of a log."""

    offset: np.ndarray
    """What the encoder says less the joint's position [rad], shape [J]."""
    backlash: np.ndarray
    """Lost motion of the drive to each side [rad], shape [J]: what is commanded may run ahead of what moves
    the joint by so much (the play operator)."""


def simulate_log(
    hand: Hand,
    log: MotionLog,
    dynamics: Sequence[JointDynamics],
    start: np.ndarray | None = None,
    errors: Sequence[DriveErrors] | None = None,
) -> np.ndarray:
    """What the log's joints would measure at its times, shape [W, T, J], for W dynamics of those joints.

    The delay shifts the response: the joints do not change with time, and the log begins at rest. Shifting
    the commands would give a staircase in the delay, as a step drives a servo to its force limit.

    Args:
        hand: its model.
        log: commands, times and gravity.
        dynamics: of the joints of the log, length W.
        start: first positions of the log's joints [rad], shape [J]; measured ones by default.
        errors: of their drives, length W; none by default.
    """
    model = copy.copy(hand.model)
    model.opt.timestep = STEP
    # Dry friction holds a joint: without these it creeps.
    model.opt.noslip_iterations = NOSLIP
    model.opt.gravity = log.gravity
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    if log.weight:
        hang_weights(model, hand, log.weight)
    names = list(hand.actuators)
    columns = [names.index(joint) for joint in log.joints]
    first = log.positions[0] if start is None else start
    count, joints = len(dynamics), len(log.joints)
    offset, slack = np.zeros((2, count, joints))
    if errors is not None:
        offset, slack = np.stack([e.offset for e in errors]), np.stack([e.backlash for e in errors])
    begin = first - offset
    times = np.arange(log.times[0], log.times[-1] + STEP, STEP)
    held = np.searchsorted(log.times, times + STEP / 2, side="right") - 1
    low, high = _limits(hand)
    independent = np.tile(np.clip(np.zeros(len(names)), low, high), (count, 1))
    independent[:, columns] = begin
    controls = np.tile(independent[:, None], (1, len(times), 1))
    controls[:, :, columns] = play_operator(log.commands, slack)[:, held]
    changes = [lambda m, d=d: set_dynamics(m, d) for d in dynamics]
    response = joint_response(model, changes, hand.all_joints(independent), controls)
    rows = [hand.joint_names.index(joint) for joint in log.joints]
    response = np.concatenate([begin[:, None], response[:, :-1, rows]], axis=1) + offset[:, None]
    delays = np.array([d.delay for d in dynamics])
    at = np.maximum(log.times - log.times[0] - delays[:, None], 0.0) / STEP
    below = np.minimum(at.astype(int), len(times) - 2)
    share = (at - below)[..., None]
    worlds = np.arange(count)[:, None]
    return (1 - share) * response[worlds, below] + share * response[worlds, below + 1]


def play_operator(commands: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """What moves joints whose drives have lost motion, shape [W, T, J]: it stays until the command has gone
    ahead by the slack, then follows at that distance.

    Args:
        commands: shape [T, J].
        slack: shape [W, J].
    """
    moved = np.empty((len(slack), *commands.shape))
    last = np.tile(commands[0], (len(slack), 1))
    for row, command in enumerate(commands):
        last = np.clip(last, command - slack, command + slack)
        moved[:, row] = last
    return moved


def _limits(hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    limits = np.array([hand.joint_limits[hand.joint_names.index(joint)] for joint in hand.actuators])
    return limits[:, 0], limits[:, 1]
