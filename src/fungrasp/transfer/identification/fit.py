"""Fits joint dynamics to a log: bounded Gauss-Newton, and CMA-ES beside it.

minimize over (delay, logarithms of stiffness, damping, friction, armature of each joint)
    sum (q_simulated(t) - q_measured(t))^2 / sigma^2

The simulation is the hand's model from the log's first position, at rest, under the log's commands.
"""

from __future__ import annotations

import copy
import io
import time
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import minimize

from fungrasp.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.simulation.joint_response import STEP, joint_response
from fungrasp.transfer.identification.motion_log import MotionLog
from fungrasp.transfer.joint_dynamics import JointDynamics, model_dynamics, set_dynamics

METHODS = ("gauss-newton", "cma-es")


@dataclass(frozen=True)
class FitSettings:
    """What is fitted, and between which bounds."""

    method: str = "gauss-newton"
    """"gauss-newton" or "cma-es"."""
    fixed: tuple[str, ...] = ()
    """Quantities that keep the model's values: "stiffness" where the host computes the torques."""
    range: float = 30.0
    """Each quantity stays within this factor of the model's value."""
    longest_delay: float = 0.15
    """[s]."""
    least: float = 1e-4
    """Quantities that are zero in the model start here."""
    noise: float = 1e-3
    """Standard deviation of measured positions, for the uncertainties' floor [rad]."""
    iterations: int = 60
    """Of Gauss-Newton."""
    evaluations: int = 3000
    """Simulations of CMA-ES."""
    seed: int = 0
    """Of CMA-ES."""

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise FungraspError(
                f"the method of identification is {' or '.join(METHODS)}, not '{self.method}'"
            )


@dataclass(frozen=True, eq=False)
class IdentifiedDynamics:
    """What a fit has found."""

    dynamics: JointDynamics
    """Of the joints of the log."""
    relative_error: dict[str, np.ndarray]
    """Standard deviation by quantity, relative to it, shape [J], by the curvature; delay: [s]."""
    rms: float
    """Of positions on the log that was fitted [rad]."""
    simulations: int
    """Simulated motions."""
    seconds: float
    """Time the fit took [s]."""


def simulate_log(
    hand: Hand, log: MotionLog, dynamics: list[JointDynamics], start: np.ndarray | None = None
) -> np.ndarray:
    """Positions of the log's joints at the log's times, shape [W, T, J], for W dynamics of those joints.

    The delay shifts the response: the joints do not change with time, and the log begins at rest. Shifting
    the commands would give a staircase in the delay, as a step drives a servo to its force limit.

    Args:
        hand: its model.
        log: commands, times and gravity.
        dynamics: of the joints of the log, length W.
        start: first positions of the log's joints [rad], shape [J]; measured ones by default.
    """
    model = copy.copy(hand.model)
    model.opt.timestep = STEP
    model.opt.gravity = log.gravity
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    names = list(hand.actuators)
    columns = [names.index(joint) for joint in log.joints]
    first = log.positions[0] if start is None else start
    independent = np.clip(np.zeros(len(names)), *_limits(hand))
    independent[columns] = first
    times = np.arange(log.times[0], log.times[-1] + STEP, STEP)
    controls = np.tile(independent, (len(dynamics), len(times), 1))
    held = np.searchsorted(log.times, times + STEP / 2, side="right") - 1
    controls[:, :, columns] = log.commands[held]
    changes = [lambda m, d=d: set_dynamics(m, d) for d in dynamics]
    response = joint_response(model, changes, hand.all_joints(independent), controls)
    rows = [hand.joint_names.index(joint) for joint in log.joints]
    response = np.concatenate([np.tile(first, (len(dynamics), 1, 1)), response[:, :-1, rows]], axis=1)
    delays = np.array([d.delay for d in dynamics])
    at = np.maximum(log.times - log.times[0] - delays[:, None], 0.0) / STEP
    below = np.minimum(at.astype(int), len(times) - 2)
    share = (at - below)[..., None]
    worlds = np.arange(len(dynamics))[:, None]
    return (1 - share) * response[worlds, below] + share * response[worlds, below + 1]


def fit_dynamics(hand: Hand, log: MotionLog, settings: FitSettings | None = None) -> IdentifiedDynamics:
    """Fit the dynamics of the log's joints.

    Raises:
        FungraspError: the log is too short, does not excite a joint, or has joints that the hand has not.
    """
    settings = settings or FitSettings()
    log.check_excitation()
    for joint in log.joints:
        if joint not in hand.actuators:
            raise FungraspError(f"hand '{hand.name}' has no driven joint '{joint}' that the log has")
    problem = _Problem(hand, log, settings)
    began = time.perf_counter()
    best = problem.start()
    best = _gauss_newton(problem, best) if settings.method == "gauss-newton" else _cma_es(problem, best)
    seconds = time.perf_counter() - began
    residual = problem.residuals(best[:, None])
    rms = float(np.sqrt(np.mean(residual**2)) * settings.noise)
    return IdentifiedDynamics(
        problem.dynamics(best), problem.uncertainty(best, residual), rms, problem.simulations, seconds
    )


class _Problem:
    """Parameters: the delay [units of 10 ms], then logarithms of each free quantity of each joint."""

    def __init__(self, hand: Hand, log: MotionLog, settings: FitSettings):
        self._hand, self._log, self._settings = hand, log, settings
        model = model_dynamics(hand)
        columns = [model.joints.index(joint) for joint in log.joints]
        self.nominal = {
            name: np.maximum(getattr(model, name)[columns], settings.least)
            for name in ("stiffness", "damping", "friction", "armature")
        }
        self.free = [name for name in self.nominal if name not in settings.fixed]
        self.count = 1 + len(self.free) * len(log.joints)
        reach = np.log(settings.range)
        self.lower = np.concatenate([[0.0], np.full(self.count - 1, -reach)])
        self.upper = np.concatenate([[settings.longest_delay / DELAY_UNIT], np.full(self.count - 1, reach)])
        self.simulations = 0

    def dynamics(self, parameters: np.ndarray) -> JointDynamics:
        values = {name: value.copy() for name, value in self.nominal.items()}
        for i, name in enumerate(self.free):
            part = parameters[1 + i * len(self._log.joints) :][: len(self._log.joints)]
            values[name] = self.nominal[name] * np.exp(part)
        delay = float(np.clip(parameters[0], 0, self.upper[0])) * DELAY_UNIT
        return JointDynamics(self._log.joints, **values, delay=delay)

    def residuals(self, parameters: np.ndarray) -> np.ndarray:
        """Shape [T J, W]; parameters: shape [P, W]."""
        self.simulations += parameters.shape[1]
        found = simulate_log(self._hand, self._log, [self.dynamics(column) for column in parameters.T])
        found = np.nan_to_num(found, nan=10.0, posinf=10.0, neginf=-10.0)
        return ((found - self._log.positions) / self._settings.noise).reshape(parameters.shape[1], -1).T

    def start(self) -> np.ndarray:
        """The model's values with the best of some delays: in the delay the fit has several minima."""
        tries = np.zeros((self.count, 16))
        tries[0] = np.linspace(self.lower[0], self.upper[0], 16)
        return tries[:, np.argmin((self.residuals(tries) ** 2).sum(axis=0))]

    def uncertainty(self, best: np.ndarray, residual: np.ndarray) -> dict[str, np.ndarray]:
        step = 1e-3
        moved = best[:, None] + step * np.eye(self.count)
        jacobian = (self.residuals(moved) - residual) / step
        scale = max(1.0, float(np.mean(residual**2)))
        variance = scale * np.diag(np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12))
        joints = len(self._log.joints)
        deviation = np.sqrt(np.maximum(variance, 0.0))
        parts = {name: deviation[1 + i * joints :][:joints] for i, name in enumerate(self.free)}
        return parts | {"delay": np.array([deviation[0] * DELAY_UNIT])}


DELAY_UNIT = 0.01
"""[s]: a parameter of about the size of the others."""


def _gauss_newton(problem: _Problem, start: np.ndarray) -> np.ndarray:
    """Bounded Gauss-Newton of mujoco.minimize with finite differences."""
    bounds = [problem.lower[:, None], problem.upper[:, None]]
    found, _ = minimize.least_squares(
        np.clip(start, problem.lower, problem.upper)[:, None],
        problem.residuals,
        bounds=bounds,
        eps=1e-3,
        max_iter=problem._settings.iterations,
        x_scale="jac",
        xtol=1e-5,
        verbose=minimize.Verbosity.SILENT,
        output=io.StringIO(),
    )
    return found[:, 0]


def _cma_es(problem: _Problem, start: np.ndarray) -> np.ndarray:
    try:
        import cma
    except ImportError as error:
        raise FungraspError(
            "the method cma-es needs the package cma: pip install 'fungrasp[sysid]'"
        ) from error
    settings = problem._settings
    options = {
        "bounds": [problem.lower.tolist(), problem.upper.tolist()],
        "seed": settings.seed + 1,
        "maxfevals": settings.evaluations,
        "verbose": -9,
        "verb_log": 0,
    }
    search = cma.CMAEvolutionStrategy(
        np.clip(start, problem.lower + 1e-3, problem.upper - 1e-3), 0.5, options
    )
    while not search.stop():
        tries = np.array(search.ask()).T
        search.tell(list(tries.T), ((problem.residuals(tries) ** 2).sum(axis=0)).tolist())
    assert search.result.xbest is not None
    return np.asarray(search.result.xbest)


def _limits(hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    limits = np.array([hand.joint_limits[hand.joint_names.index(joint)] for joint in hand.actuators])
    return limits[:, 0], limits[:, 1]
