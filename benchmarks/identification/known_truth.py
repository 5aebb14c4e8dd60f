"""How well identification finds dynamics that are known, and predicts a real hand's step."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.sim2real.identification.excitation import Excitation, JointRoom, excitation_motion
from fungrasp.sim2real.identification.fit import FitSettings, fit_dynamics
from fungrasp.sim2real.identification.log_simulation import prediction_rms, simulate_log
from fungrasp.sim2real.identification.motion_log import MotionLog, read_step_csv
from fungrasp.sim2real.joint_dynamics import JointDynamics, model_dynamics

SPREAD = 2.0
"""True quantities lie within this factor of the model's."""
DELAYS = (0.01, 0.05)
"""True delays lie between these [s]."""
FITTED = ("damping", "friction", "armature")


@dataclass(frozen=True)
class KnownTruthFit:
    """One fit to the log of a simulated finger whose dynamics are known."""

    method: str
    """Of the fit."""
    seed: int
    """Of the truth and the motion."""
    median_error: float
    """Over damping, friction and armature of the joints, of the truth."""
    largest_error: float
    """Over the same, of the truth."""
    delay_error: float
    """[s]."""
    held_out_rms: float
    """Of positions on the part of the log that was not fitted [rad]."""
    simulations: int
    """Simulated motions."""
    seconds: float
    """Time the fit took [s]."""


def known_truth_fit(hand: Hand, finger: str, method: str, seed: int, evaluations: int) -> KnownTruthFit:
    """Fit a finger to 8 s of motion of a truth drawn from a seed: half of it fitted, half held out.

    Stiffness is given, as where a host computes torques; positions come in counts of 0.088°.

    Args:
        hand: its model is right in all but the joints' dynamics.
        finger: whose joints are moved.
        method: of the fit.
        seed: of truth and motion.
        evaluations: of CMA-ES.
    """
    model, rng = model_dynamics(hand), np.random.default_rng(seed)
    bodies = hand.fingers[finger].links if finger in hand.fingers else ()
    if not bodies:
        raise FungraspError(f"hand '{hand.name}' has no finger '{finger}'")
    joints = tuple(j for j in model.joints if _moves(hand, j, bodies[-1]))
    columns = [model.joints.index(joint) for joint in joints]
    factors = np.exp(rng.uniform(-1, 1, (3, len(joints))) * np.log(SPREAD))
    values = {name: getattr(model, name)[columns] * f for name, f in zip(FITTED, factors, strict=True)}
    truth = JointDynamics(joints, model.stiffness[columns], **values, delay=float(rng.uniform(*DELAYS)))
    limits = np.array([hand.joint_limits[hand.joint_names.index(joint)] for joint in joints])
    rest, excitation = limits.mean(axis=1), Excitation(seconds=8.0, seed=seed)
    motion = excitation_motion(excitation, rest, JointRoom(*limits.T), np.zeros(len(joints)))
    commands, times = motion.commands, np.arange(len(motion.commands)) / excitation.rate
    gravity = np.array([0.0, 0.0, -9.81])
    log = MotionLog(joints, times, commands, np.tile(rest, (len(times), 1)), gravity)
    count = np.deg2rad(0.088)
    positions = np.rint(simulate_log(hand, log, [truth])[0] / count) * count
    log = MotionLog(joints, times, commands, positions, gravity)
    settings = FitSettings(method=method, fixed=("stiffness",), evaluations=evaluations)
    found = fit_dynamics(hand, log.part(0.0, 0.5), settings)
    errors = np.concatenate([np.abs(getattr(found.dynamics, n) / getattr(truth, n) - 1) for n in FITTED])
    return KnownTruthFit(
        method,
        seed,
        float(np.median(errors)),
        float(errors.max()),
        found.dynamics.delay - truth.delay,
        prediction_rms(hand, [log], found.dynamics, None, after=0.5),
        found.simulations,
        found.seconds,
    )


@dataclass(frozen=True)
class StepFit:
    """One fit to a real hand's step response: every other row fitted, the others held out."""

    method: str
    """Of the fit."""
    delay: float
    """Measured until 2 % of the step, on the held-out rows [s]."""
    delay_predicted: float
    """The same, simulated [s]."""
    rise: float
    """Measured from 10 to 90 % of the step, on the held-out rows [s]."""
    rise_predicted: float
    """The same, simulated [s]."""
    held_out_rms: float
    """[rad]."""
    seconds: float
    """Time the fit took [s]."""


def step_fit(hand: Hand, path: str | Path, joint: str, method: str, evaluations: int) -> StepFit:
    """Fit one joint to a step response of an Inspire hand.

    Args:
        hand: its model.
        path: a .csv as ``read_step_csv`` takes it.
        joint: that moved.
        method: of the fit.
        evaluations: of CMA-ES.
    """
    low, high = hand.joint_limits[hand.joint_names.index(joint)]
    log = read_step_csv(path, joint, float(low), float(high)).part(0.0, 0.25)
    even, odd = np.arange(0, len(log.times), 2), np.arange(1, len(log.times), 2)
    found = fit_dynamics(hand, log.rows(even), FitSettings(method=method, evaluations=evaluations))
    predicted = simulate_log(hand, log, [found.dynamics])[0][odd, 0]
    times, measured = log.times[odd], log.positions[odd, 0]
    first, last = measured[0], measured[-1]
    delay, rise = step_times(times, (measured - first) / (last - first))
    delay_predicted, rise_predicted = step_times(times, (predicted - first) / (last - first))
    rms = float(np.sqrt(np.mean((predicted - measured) ** 2)))
    return StepFit(method, delay, delay_predicted, rise, rise_predicted, rms, found.seconds)


def step_times(times: np.ndarray, share: np.ndarray) -> tuple[float, float]:
    """Delay until 2 %, and rise time from 10 to 90 % of a step [s].

    Args:
        times: since the command [s], shape [T].
        share: of the step that is done, shape [T].
    """
    end = int(np.argmax(share >= 0.95)) + 1
    at = np.interp([0.02, 0.1, 0.9], np.maximum.accumulate(share[:end]), times[:end])
    return float(at[0]), float(at[2] - at[1])


def _moves(hand: Hand, joint: str, body: str) -> bool:
    """Whether a joint lies between the palm and a body."""
    model = hand.model
    at, owner = model.body(body).id, int(model.joint(joint).bodyid[0])
    while at:
        if at == owner:
            return True
        at = int(model.body_parentid[at])
    return False
