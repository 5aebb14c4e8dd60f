"""Simulation of a log's motion with the hand's model and a fixed palm, for many dynamics at once."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from fungrasp.hands import Hand
from fungrasp.hands.kinematic_tree import carrier_of
from fungrasp.sim2real.identification.motion_log import JointSamples, MotionLog, joint_samples
from fungrasp.sim2real.joint_dynamics import JointDynamics, set_dynamics

STEP = 0.002
"""Timestep [s]."""

NOSLIP = 5
"""Iterations that remove creep from dry friction."""


@dataclass(frozen=True, eq=False)
class DriveErrors:
    """Errors of the drives and encoders of J joints."""

    offset: np.ndarray
    """Encoder reading minus joint position [rad], shape [J]."""
    backlash: np.ndarray
    """Backlash of the drive in each direction [rad], shape [J], by which the command may run ahead of the
    drive's output (the play operator)."""


def simulate_log(
    hand: Hand,
    log: MotionLog | JointSamples,
    dynamics: Sequence[JointDynamics],
    errors: Sequence[DriveErrors] | None = None,
) -> np.ndarray:
    """Return simulated measurements of a log's joints at its measurement times [rad], shape [W, T, J], for W
    dynamics. T is the number of rows of ``joint_samples``.

    The delay shifts the response, because the system is time-invariant and the log begins at rest. Shifting
    the commands would make the result a staircase function of the delay.

    Args:
        dynamics: dynamics of the log's joints, length W.
        errors: errors of their drives, length W; none by default.
    """
    samples = joint_samples(log) if isinstance(log, MotionLog) else log
    model = copy.copy(hand.model)
    model.opt.timestep = STEP
    # Without these iterations, joints held by dry friction creep.
    model.opt.noslip_iterations = NOSLIP
    model.opt.gravity = samples.gravity
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    if samples.weight:
        hang_weights(model, hand, samples.weight)
    names = list(hand.actuators)
    columns = [names.index(joint) for joint in samples.joints]
    count, joints = len(dynamics), len(samples.joints)
    offset, slack = np.zeros((2, count, joints))
    if errors is not None:
        offset, slack = np.stack([e.offset for e in errors]), np.stack([e.backlash for e in errors])
    begin = samples.positions[0] - offset
    end = max(samples.times[-1].max(), samples.measured[-1].max())
    times = np.arange(0.0, end + STEP, STEP)
    low, high = _limits(hand)
    independent = np.tile(np.clip(np.zeros(len(names)), low, high), (count, 1))
    independent[:, columns] = begin
    controls = np.tile(independent[:, None], (1, len(times), 1))
    controls[:, :, columns] = play_operator(driver_setpoints(samples, times), slack, begin)
    changes = [lambda m, d=d: set_dynamics(m, d) for d in dynamics]
    response = joint_response(model, changes, hand.all_joints(independent), controls)
    rows = [hand.joint_names.index(joint) for joint in samples.joints]
    response = np.concatenate([begin[:, None], response[:, :-1, rows]], axis=1) + offset[:, None]
    delays = np.array([d.delay for d in dynamics])
    at = np.maximum(samples.measured - delays[:, None, None], 0.0) / STEP
    below = np.minimum(at.astype(int), len(times) - 2)
    share = at - below
    lower, upper = (np.take_along_axis(response, below + i, axis=1) for i in (0, 1))
    return (1 - share) * lower + share * upper


def joint_response(
    model: mujoco.MjModel,
    changes: Sequence[Callable[[mujoco.MjModel], None]],
    start: np.ndarray,
    controls: np.ndarray,
) -> np.ndarray:
    """Return positions of all joints after each timestep [rad], shape [W, S, M].

    Args:
        model: a hand with position servos and a fixed palm.
        changes: functions that change each world's copy of the model, length W.
        start: initial positions of all joints, at rest [rad], shape [M] or, for each world, [W, M].
        controls: servo controls at each timestep of the model [rad], shape [W, S, U].
    """
    models = []
    for change in changes:
        world = copy.copy(model)
        change(world)
        models.append(world)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    data = mujoco.MjData(model)
    begin = np.zeros((len(models), mujoco.mj_stateSize(model, kind)))
    for world, positions in enumerate(np.broadcast_to(start, (len(models), model.nq))):
        data.qpos[:] = positions
        mujoco.mj_getState(model, data, begin[world], kind)
    threads = [mujoco.MjData(model) for _ in range(min(len(models), os.cpu_count() or 1))]
    states, _ = rollout.rollout(models, threads, begin, controls)
    # The full physics state begins with the time and the positions.
    return states[:, :, 1 : 1 + model.nq]


def prediction_rms(
    hand: Hand, logs: Sequence[MotionLog], dynamics: JointDynamics, errors: DriveErrors | None, after: float
) -> float:
    """Return the RMS error of simulated logs after a share of each segment [rad].

    Args:
        logs: logs of the joints in ``dynamics``.
        errors: errors of their drives; None for none.
        after: share of a segment, 0 to 1.
    """
    missed = []
    for log in logs:
        samples = joint_samples(log)
        found = simulate_log(hand, samples, [dynamics], errors=None if errors is None else [errors])[0]
        missed.append((found - samples.positions)[samples.known & (samples.share > after)])
    return float(np.sqrt(np.mean(np.concatenate(missed) ** 2)))


def driver_setpoints(samples: JointSamples, times: np.ndarray) -> np.ndarray:
    """Return the setpoints of a driver that follows the commands within its speed limit [rad], shape [S, J].

    Args:
        samples: commands and speed limits.
        times: evenly spaced, shape [S].
    """
    held = np.stack(
        [np.searchsorted(column, times + STEP / 2, side="right") - 1 for column in samples.times.T], axis=1
    )
    commands = np.take_along_axis(samples.commands, np.maximum(held, 0), axis=0)
    if np.isinf(samples.speed).all():
        return commands
    largest, setpoints = samples.speed * STEP, np.empty_like(commands)
    last = samples.commands[0]
    for row, command in enumerate(commands):
        last = last + np.clip(command - last, -largest, largest)
        setpoints[row] = last
    return setpoints


def play_operator(commands: np.ndarray, slack: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return the output of drives with backlash, shape [W, T, J]. It stays constant until the command is
    ahead by the slack, then follows at that distance.

    Args:
        commands: shape [T, J].
        slack: shape [W, J].
        start: initial joint positions [rad], shape [W, J]; drives begin there as far as the slack allows.
    """
    moved = np.empty((len(slack), *commands.shape))
    last = start
    for row, command in enumerate(commands):
        last = np.clip(last, command - slack, command + slack)
        moved[:, row] = last
    return moved


def _limits(hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    limits = np.array([hand.joint_limits[hand.joint_names.index(joint)] for joint in hand.actuators])
    return limits[:, 0], limits[:, 1]


def hang_weights(model: mujoco.MjModel, hand: Hand, mass: float) -> None:
    """Add a point mass to the middle of each fingertip, in place.

    Scaling stiffness, damping, friction and armature of a joint together changes its motion only through the
    weight and inertia of its links. If links are light compared with their drives, only a known weight makes
    the scale observable: 0.2 kg on a fingertip add half the armature of an Inspire's joint and 0.15 N m of
    weight.

    Args:
        model: compiled model of the hand or of a scene with it.
        mass: mass on each fingertip [kg].
    """
    for finger in hand.fingers.values():
        body, site = (
            carrier_of(model, finger.tip),
            mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, finger.tip),
        )
        place = model.site_pos[site].copy() if site >= 0 else np.zeros(3)
        own, center = float(model.body_mass[body]), model.body_ipos[body].copy()
        both = own + mass
        middle = (own * center + mass * place) / both
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
        axes = rotation.reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        inertia += _about(own, center - middle) + _about(mass, place - middle)
        moments, axes = np.linalg.eigh(inertia)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())
        model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = both, middle, moments
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _about(mass: float, offset: np.ndarray) -> np.ndarray:
    """Return the inertia of a point mass at an offset [kg m^2], shape [3, 3]. offset: [m], shape [3]."""
    return mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))


def chain_of(hand: Hand, joints: Sequence[str]) -> np.ndarray:
    """Return the number of each joint's chain from the palm, shape [J]. With a fixed palm, joints of
    different chains do not affect each other."""
    model, roots = hand.model, []
    palm = model.body(hand.palm).id
    for joint in joints:
        body = int(model.jnt_bodyid[model.joint(joint).id])
        while model.body_parentid[body] not in (palm, 0):
            body = int(model.body_parentid[body])
        roots.append(body)
    return np.unique(roots, return_inverse=True)[1]


def place_in_finger(hand: Hand, joints: Sequence[str]) -> np.ndarray:
    """Return the number of each joint within its chain, counted from the palm, shape [J]. If joints with the
    same number move equally, fingers stay side by side."""
    finger = chain_of(hand, joints)
    return np.array([np.sum(finger[:j] == finger[j]) for j in range(len(joints))])
