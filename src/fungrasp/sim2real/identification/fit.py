"""Fits joint dynamics to a log: bounded Gauss-Newton, and CMA-ES beside it.

minimize over (delay; logarithms of stiffness, damping, friction, armature of each joint; its drive's errors)
    sum (q_simulated(t) - q_measured(t))^2 / sigma^2 + sum (log factor)^2 / prior^2

The simulation is the hand's model from the log's first position, at rest, under the log's commands. Where the
links are light against the drives, the scale of all quantities of a joint is seen in nothing but its weight,
in logs with gravity from several sides, and the model's values, as a prior, say the rest.
"""

from __future__ import annotations

import io
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from mujoco import minimize

from fungrasp.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.sim2real.identification.finger_chains import chain_of, place_in_finger
from fungrasp.sim2real.identification.log_simulation import DriveErrors, simulate_log
from fungrasp.sim2real.identification.motion_log import MotionLog
from fungrasp.sim2real.joint_dynamics import QUANTITIES, JointDynamics, model_dynamics

METHODS = ("gauss-newton", "cma-es")
ERRORS = ("offset", "backlash")


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
    errors: tuple[str, ...] = ()
    """Errors of the drives that are fitted too: "offset" of the encoders, "backlash"."""
    largest_error: float = 0.05
    """Bound of both [rad]."""
    prior: float = float("inf")
    """Standard deviation of the logarithms of the factors on the model's values; infinite for none. It
    decides where the log does not."""
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
        for name in self.errors:
            if name not in ERRORS:
                raise FungraspError(f"errors of drives are {' and '.join(ERRORS)}, not '{name}'")


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
    errors: DriveErrors
    """Of the drives of the joints of the log; zero where they were not fitted."""


def fit_dynamics(
    hand: Hand, log: MotionLog | Sequence[MotionLog], settings: FitSettings | None = None
) -> IdentifiedDynamics:
    """Fit the dynamics of the joints of a log, or of several logs of the same joints, with gravity from
    several sides for instance.

    Where some of the logs are with weights on the fingertips and some without, each kind is fitted by itself:
    those with weights tell the stiffness, those without the ratios of all else to it. (In one fit of both,
    friction that falls with speed, which the model has not, is paid for by inertia.)

    Raises:
        FungraspError: a log is too short, does not excite a joint, or has joints that the hand has not.
    """
    settings = settings or FitSettings()
    logs = (log,) if isinstance(log, MotionLog) else tuple(log)
    for one in logs:
        one.check_excitation()
        if one.joints != logs[0].joints:
            raise FungraspError("logs that are fitted together must be of the same joints in the same order")
    for joint in logs[0].joints:
        if joint not in hand.actuators:
            raise FungraspError(f"hand '{hand.name}' has no driven joint '{joint}' that the log has")
    light, heavy = [one for one in logs if not one.weight], [one for one in logs if one.weight]
    if light and heavy:
        return _rescaled(_fit(hand, light, settings), _fit(hand, heavy, settings), settings)
    return _fit(hand, logs, settings)


def _fit(hand: Hand, logs: Sequence[MotionLog], settings: FitSettings) -> IdentifiedDynamics:
    problem = _Problem(hand, logs, settings)
    began = time.perf_counter()
    best = _from_gains(problem) if settings.method == "gauss-newton" else _cma_es(problem, problem.start(1.0))
    seconds = time.perf_counter() - began
    residual = problem.residuals(best[:, None])
    rms = float(np.sqrt(np.mean(residual[: problem.measured] ** 2)) * settings.noise)
    return IdentifiedDynamics(
        problem.dynamics(best),
        problem.uncertainty(best, residual),
        rms,
        problem.simulations,
        seconds,
        problem.errors(best),
    )


def _rescaled(
    light: IdentifiedDynamics, heavy: IdentifiedDynamics, settings: FitSettings
) -> IdentifiedDynamics:
    """The ratios of one fit with the stiffness of another. Of the standard deviations of all else, what they
    share with that of the stiffness is taken for the scale's."""
    scale = heavy.dynamics.stiffness / light.dynamics.stiffness
    free = [name for name in QUANTITIES if name not in settings.fixed]
    scaled = {name: scale * getattr(light.dynamics, name) for name in free}
    errors = dict(light.relative_error)
    if "stiffness" in free:
        new = heavy.relative_error["stiffness"]
        shared = errors["stiffness"] ** 2
        for name in free:
            errors[name] = np.sqrt(np.maximum(errors[name] ** 2 - shared, 0.0) + new**2)
    return replace(
        light,
        dynamics=replace(light.dynamics, **scaled),
        relative_error=errors,
        simulations=light.simulations + heavy.simulations,
        seconds=light.seconds + heavy.seconds,
    )


class _Problem:
    """Parameters: the delay [units of 10 ms]; then logarithms of each free quantity of each joint; then each
    free error of each joint's drive [units of 10 mrad]."""

    def __init__(self, hand: Hand, logs: Sequence[MotionLog], settings: FitSettings):
        self._hand, self._logs, self._settings = hand, logs, settings
        model = model_dynamics(hand)
        self._joints = joints = logs[0].joints
        columns = [model.joints.index(joint) for joint in joints]
        self.nominal = {
            name: np.maximum(getattr(model, name)[columns], settings.least)
            for name in ("stiffness", "damping", "friction", "armature")
        }
        self.free = [name for name in self.nominal if name not in settings.fixed]
        self.factors = len(self.free) * len(joints)
        self.count = 1 + self.factors + len(settings.errors) * len(joints)
        reach = np.log(settings.range)
        slack = settings.largest_error / ERROR_UNIT
        lowest = [np.full(len(joints), -slack if name == "offset" else 0.0) for name in settings.errors]
        highest = np.full(self.count - 1 - self.factors, slack)
        self.lower = np.concatenate([[0.0], np.full(self.factors, -reach), *lowest])
        self.upper = np.concatenate(
            [[settings.longest_delay / DELAY_UNIT], np.full(self.factors, reach), highest]
        )
        self.measured = sum(log.positions.size for log in logs)
        self.simulations = 0
        self._fingers, self._places = chain_of(hand, joints), place_in_finger(hand, joints)

    def dynamics(self, parameters: np.ndarray) -> JointDynamics:
        values = {name: value.copy() for name, value in self.nominal.items()}
        for i, name in enumerate(self.free):
            values[name] = self.nominal[name] * np.exp(self._part(parameters, i))
        delay = float(np.clip(parameters[0], 0, self.upper[0])) * DELAY_UNIT
        return JointDynamics(self._joints, **values, delay=delay)

    def errors(self, parameters: np.ndarray) -> DriveErrors:
        found = {"offset": np.zeros(len(self._joints)), "backlash": np.zeros(len(self._joints))}
        for i, name in enumerate(self._settings.errors):
            found[name] = ERROR_UNIT * self._part(parameters, len(self.free) + i)
        return DriveErrors(**found)

    def _part(self, parameters: np.ndarray, number: int) -> np.ndarray:
        """One kind of parameters of all joints, shape [J]."""
        return parameters[1 + number * len(self._joints) :][: len(self._joints)]

    def residuals(self, parameters: np.ndarray) -> np.ndarray:
        """Of the logs, then of the prior, shape [R, W]; parameters: shape [P, W]."""
        worlds = parameters.shape[1]
        self.simulations += worlds * len(self._logs)
        dynamics = [self.dynamics(column) for column in parameters.T]
        errors = [self.errors(column) for column in parameters.T] if self._settings.errors else None
        parts = []
        for log in self._logs:
            found = simulate_log(self._hand, log, dynamics, errors=errors)
            found = np.nan_to_num(found, nan=10.0, posinf=10.0, neginf=-10.0)
            parts.append(((found - log.positions) / self._settings.noise).reshape(worlds, -1).T)
        if np.isfinite(self._settings.prior):
            parts.append(parameters[1 : 1 + self.factors] / self._settings.prior)
        return np.concatenate(parts)

    def jacobian(self, parameters: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """By differences. The palm stands still, so that joints of one finger do not move another: one
        simulation serves a joint of each finger."""
        joints, step = len(self._joints), 1e-3
        finger, place = self._fingers, self._places
        kinds = (self.count - 1) // joints
        x, groups = parameters.reshape(-1), [np.array([0])]
        for kind in range(kinds):
            groups += [1 + kind * joints + np.flatnonzero(place == p) for p in range(place.max() + 1)]
        # At an upper bound the step goes back.
        signs = np.where(x + step > self.upper, -step, step)
        moved = np.tile(x[:, None], (1, len(groups)))
        for column, group in enumerate(groups):
            moved[group, column] += signs[group]
        changed = self.residuals(moved) - residual.reshape(-1, 1)
        jacobian = np.zeros((len(changed), self.count))
        jacobian[:, 0] = changed[:, 0] / signs[0]
        column_finger = finger[np.arange(self.measured) % joints]
        for column, group in enumerate(groups[1:], start=1):
            for parameter in group:
                own = column_finger == finger[(parameter - 1) % joints]
                jacobian[: self.measured][own, parameter] = (
                    changed[: self.measured][own, column] / signs[parameter]
                )
        if np.isfinite(self._settings.prior):
            rows = self.measured + np.arange(self.factors)
            jacobian[rows, 1 + np.arange(self.factors)] = 1.0 / self._settings.prior
        return jacobian

    def start(self, gain: float) -> np.ndarray:
        """The model's values, stiffness and damping times a gain, with the best of some delays: in the delay
        the fit has several minima."""
        tries = np.zeros((self.count, 16))
        tries[0] = np.linspace(self.lower[0], self.upper[0], 16)
        for i, name in enumerate(self.free):
            if name in ("stiffness", "damping"):
                self._part(tries, i)[:] = np.log(gain)
        return tries[:, np.argmin((self.residuals(tries) ** 2).sum(axis=0))]

    def uncertainty(self, best: np.ndarray, residual: np.ndarray) -> dict[str, np.ndarray]:
        jacobian = self.jacobian(best, residual)
        scale = max(1.0, float(np.mean(residual**2)))
        variance = scale * np.diag(np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12))
        deviation = np.sqrt(np.maximum(variance, 0.0))
        parts = {name: self._part(deviation, i) for i, name in enumerate(self.free)}
        return parts | {"delay": np.array([deviation[0] * DELAY_UNIT])}


STARTING_GAINS = (1.0, 0.25, 0.5, 2.0)
"""Common factors on stiffness and damping of the model that a fit starts from, one after the other until it
is good enough: hands are driven with gains that differ by as much, and from far off joints end in minima in
which friction holds them."""

GOOD_FIT = 5.0
"""Times the noise of measured positions: a fit that misses by less is good enough. Good ones of twins miss by
0.6 to 2 times, those in wrong minima by more than 15."""

DELAY_UNIT, ERROR_UNIT = 0.01, 0.01
"""[s] and [rad]: parameters of about the size of the others."""


def _gauss_newton(problem: _Problem, start: np.ndarray) -> np.ndarray:
    """Bounded Gauss-Newton of mujoco.minimize with finite differences."""
    bounds = [problem.lower[:, None], problem.upper[:, None]]
    found, _ = minimize.least_squares(
        np.clip(start, problem.lower, problem.upper)[:, None],
        problem.residuals,
        bounds=bounds,
        jacobian=problem.jacobian,
        eps=1e-3,
        max_iter=problem._settings.iterations,
        x_scale="jac",
        xtol=1e-5,
        verbose=minimize.Verbosity.SILENT,
        output=io.StringIO(),
    )
    return found[:, 0]


def _from_gains(problem: _Problem) -> np.ndarray:
    """The best fit from some gains, the first one that is good enough."""
    best, least = np.zeros(0), np.inf
    for gain in STARTING_GAINS:
        found = _gauss_newton(problem, problem.start(gain))
        misses = problem.residuals(found[:, None])[: problem.measured]
        cost = float(np.sqrt(np.mean(misses**2)))
        if cost < least:
            best, least = found, cost
        if cost < GOOD_FIT:
            break
    return best


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
