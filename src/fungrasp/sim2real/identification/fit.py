"""Fit of joint dynamics to a log by bounded Gauss-Newton.

minimize over (delay; logarithms of stiffness, damping, friction, armature of each joint; its drive's errors)
    sum (q_simulated(t) - q_measured(t))^2 / sigma^2 + sum (log factor)^2 / prior^2

The hand's model is simulated from the log's first position, at rest, under the log's commands. If links are
light compared with their drives, the common scale of a joint's quantities is observable only through its
weight, in logs with different gravity directions; a prior at the model's values determines the rest.
"""

from __future__ import annotations

import io
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from mujoco import minimize

from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.sim2real.identification.log_simulation import (
    DriveErrors,
    chain_of,
    place_in_finger,
    simulate_log,
)
from fungrasp.sim2real.identification.motion_log import MotionLog, joint_samples
from fungrasp.sim2real.joint_dynamics import QUANTITIES, JointDynamics, model_dynamics

ERRORS = ("offset", "backlash")


@dataclass(frozen=True)
class FitSettings:
    """Settings of the fit."""

    fixed: tuple[str, ...] = ()
    """Quantities that keep the model's values, for example "stiffness" if the computer controls torques."""
    range: float = 30.0
    """Each quantity stays within this factor of the model's value."""
    longest_delay: float = 0.15
    """Upper bound of the delay [s]."""
    errors: tuple[str, ...] = ()
    """Drive errors to fit too: "offset" (of the encoders), "backlash"."""
    largest_error: float = 0.05
    """Bound of both drive errors [rad]."""
    bound: float = 0.5
    """Largest relative standard deviation of an identified quantity. Other quantities keep the model's
    values."""
    prior: float = float("inf")
    """Prior: standard deviation of the logarithms of factors on the model's values; infinite for no prior. It
    matters for quantities that the log does not determine."""
    least: float = 1e-4
    """Start value of quantities that are zero in the model."""
    noise: float = 1e-3
    """Noise of measured positions, a lower bound for uncertainties [rad]."""
    iterations: int = 60
    """Iterations of Gauss-Newton."""

    def __post_init__(self) -> None:
        for name in self.fixed:
            if name not in QUANTITIES:
                raise FungraspError(f"fixed quantities are {', '.join(QUANTITIES)}, not '{name}'")
        for name in self.errors:
            if name not in ERRORS:
                raise FungraspError(f"errors of drives are {' and '.join(ERRORS)}, not '{name}'")


@dataclass(frozen=True, eq=False)
class IdentifiedDynamics:
    """Result of a fit."""

    dynamics: JointDynamics
    """Dynamics of the log's joints."""
    relative_error: dict[str, np.ndarray]
    """Relative standard deviation of each quantity, shape [J], from the curvature; absolute for the delay
    [s]. For unidentified quantities it is that of the log alone, although they have the model's values."""
    identified: dict[str, np.ndarray]
    """Whether the logs determine each quantity, shape [J]; other quantities have the model's values."""
    rms: float
    """RMS position error on the fitted logs [rad]."""
    simulations: int
    """Number of simulated motions."""
    seconds: float
    """Duration of the fit [s]."""
    errors: DriveErrors
    """Errors of the drives of the log's joints; zero if not fitted."""


def fit_dynamics(
    hand: Hand, log: MotionLog | Sequence[MotionLog], settings: FitSettings | None = None
) -> IdentifiedDynamics:
    """Fit joint dynamics to a log, or to several logs of the same joints, for example with different
    directions of gravity.

    If only some logs have weights on the fingertips, the two kinds are fitted separately: logs with weights
    determine the stiffness, logs without weights the ratios of the other quantities to it. (In a common fit,
    inertia would compensate for friction that decreases with speed, which the model lacks.)

    Raises:
        FungraspError: a log is too short, does not excite a joint, or has unknown joints.
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
    best = _from_gains(problem)
    errors = _withhold(problem, best)
    if problem.withheld.any():
        best[problem.withheld] = 0.0
        best = _gauss_newton(problem, best)
    seconds = time.perf_counter() - began
    residual = problem.residuals(best[:, None])
    rms = float(np.sqrt(np.mean(residual[: problem.measured] ** 2)) * settings.noise)
    return IdentifiedDynamics(
        problem.dynamics(best),
        problem.by_quantity(errors),
        {name: ~problem.by_quantity(problem.withheld)[name] for name in problem.free},
        rms,
        problem.simulations,
        seconds,
        problem.errors(best),
    )


def _withhold(problem: _Problem, best: np.ndarray) -> np.ndarray:
    """Withhold quantities that the logs do not determine at a solution.

    For each joint the stiffness is withheld first, because the ratios to it may be observable if the scale is
    not, then the most uncertain quantity, until the others are determined.

    Returns:
        standard deviations, shape [P], if withheld stiffnesses are exact and other withheld quantities as
        uncertain as the model; those of withheld quantities are from the logs alone.
    """
    information = problem.information(best)
    joints, factors = problem.joint_of_factor, slice(1, 1 + problem.factors)
    scale = np.zeros(problem.count, dtype=bool)
    if problem.free[:1] == ["stiffness"]:
        scale[1 : 1 + len(np.unique(joints))] = True
    final = np.zeros(problem.count)
    while True:
        free = ~(problem.withheld & scale)
        assumed = np.diag(np.where(problem.withheld, MODEL_DEVIATION**-2.0, 0.0))
        deviation = np.zeros(problem.count)
        deviation[free] = np.sqrt(np.diag(np.linalg.inv((information + assumed)[np.ix_(free, free)])))
        final[~problem.withheld] = deviation[~problem.withheld]
        vague = np.zeros(problem.count, dtype=bool)
        vague[factors] = deviation[factors] > problem.settings.bound
        vague &= ~problem.withheld
        if not vague.any():
            return final
        for joint in np.unique(joints[vague[factors]]):
            own = 1 + np.flatnonzero(joints == joint)
            worst = own[np.argmax(np.where(vague[own], deviation[own], 0.0))]
            problem.withheld[own[0] if vague[own[0]] and scale[own[0]] else worst] = True


def _rescaled(
    light: IdentifiedDynamics, heavy: IdentifiedDynamics, settings: FitSettings
) -> IdentifiedDynamics:
    """Combine the ratios of ``light`` with the stiffness of ``heavy``. The part of the standard deviations
    shared with the stiffness is attributed to the scale."""
    scale = heavy.dynamics.stiffness / light.dynamics.stiffness
    free = [name for name in QUANTITIES if name not in settings.fixed]
    scaled = {}
    for name in free:
        own = getattr(light.dynamics, name)
        told = light.identified[name] | (name == "stiffness")
        scaled[name] = np.where(told, scale * own, own)
    errors, identified = dict(light.relative_error), dict(light.identified)
    if "stiffness" in free:
        new, identified["stiffness"] = heavy.relative_error["stiffness"], heavy.identified["stiffness"]
        # If the stiffness was withheld, the other deviations already are those of ratios to it.
        shared = np.where(light.identified["stiffness"], errors["stiffness"] ** 2, 0.0)
        for name in free:
            ratio = np.maximum(errors[name] ** 2 - shared, 0.0) * (name != "stiffness")
            errors[name] = np.sqrt(ratio + new**2)
    return replace(
        light,
        dynamics=replace(light.dynamics, **scaled),
        relative_error=errors,
        identified=identified,
        simulations=light.simulations + heavy.simulations,
        seconds=light.seconds + heavy.seconds,
    )


class _Problem:
    """Parameters: the delay [units of 10 ms]; then logarithms of each free quantity of each joint; then each
    free error of each joint's drive [units of 10 mrad]."""

    def __init__(self, hand: Hand, logs: Sequence[MotionLog], settings: FitSettings):
        self._hand, self.settings = hand, settings
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
        self.joint_of_factor = np.arange(self.factors) % len(joints)
        self.withheld = np.zeros(self.count, dtype=bool)
        reach = np.log(settings.range)
        highest_factor = np.full(self.factors, reach)
        if "friction" in self.free:
            # The model's friction may be almost zero.
            limits = np.array([hand.actuators[joint].force_limit for joint in joints])
            most = np.log(MOST_FRICTION * limits / self.nominal["friction"])
            begin = self.free.index("friction") * len(joints)
            highest_factor[begin : begin + len(joints)] = np.maximum(reach, most)
        slack = settings.largest_error / ERROR_UNIT
        lowest = [np.full(len(joints), -slack if name == "offset" else 0.0) for name in settings.errors]
        highest = np.full(self.count - 1 - self.factors, slack)
        self.lower = np.concatenate([[0.0], np.full(self.factors, -reach), *lowest])
        self.upper = np.concatenate([[settings.longest_delay / DELAY_UNIT], highest_factor, highest])
        self._samples = [joint_samples(log) for log in logs]
        self._column = np.concatenate([np.nonzero(one.known)[1] for one in self._samples])
        self.measured = len(self._column)
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
        for i, name in enumerate(self.settings.errors):
            found[name] = ERROR_UNIT * self._part(parameters, len(self.free) + i)
        return DriveErrors(**found)

    def _part(self, parameters: np.ndarray, number: int) -> np.ndarray:
        """Return one kind of parameter of all joints, shape [J]."""
        return parameters[1 + number * len(self._joints) :][: len(self._joints)]

    def residuals(self, parameters: np.ndarray) -> np.ndarray:
        """Return residuals of the logs, then of the prior, shape [R, W]. parameters: shape [P, W]."""
        worlds = parameters.shape[1]
        self.simulations += worlds * len(self._samples)
        dynamics = [self.dynamics(column) for column in parameters.T]
        errors = [self.errors(column) for column in parameters.T] if self.settings.errors else None
        parts = []
        for one in self._samples:
            found = simulate_log(self._hand, one, dynamics, errors=errors)[:, one.known]
            found = np.nan_to_num(found, nan=10.0, posinf=10.0, neginf=-10.0)
            parts.append((found - one.positions[one.known]).T / self.settings.noise)
        if np.isfinite(self.settings.prior):
            parts.append(parameters[1 : 1 + self.factors] / self.settings.prior)
        return np.concatenate(parts)

    def jacobian(self, parameters: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Return the Jacobian by finite differences. With a fixed palm, fingers do not affect each other, so
        that one simulation serves one joint of each finger."""
        joints, step = len(self._joints), 1e-3
        finger, place = self._fingers, self._places
        kinds = (self.count - 1) // joints
        x, groups = parameters.reshape(-1), [np.array([0])]
        for kind in range(kinds):
            groups += [1 + kind * joints + np.flatnonzero(place == p) for p in range(place.max() + 1)]
        # At an upper bound the step is negative.
        signs = np.where(x + step > self.upper, -step, step)
        moved = np.tile(x[:, None], (1, len(groups)))
        for column, group in enumerate(groups):
            moved[group, column] += signs[group]
        changed = self.residuals(moved) - residual.reshape(-1, 1)
        jacobian = np.zeros((len(changed), self.count))
        jacobian[:, 0] = changed[:, 0] / signs[0]
        column_finger = finger[self._column]
        for column, group in enumerate(groups[1:], start=1):
            for parameter in group:
                own = column_finger == finger[(parameter - 1) % joints]
                jacobian[: self.measured][own, parameter] = (
                    changed[: self.measured][own, column] / signs[parameter]
                )
        if np.isfinite(self.settings.prior):
            rows = self.measured + np.arange(self.factors)
            jacobian[rows, 1 + np.arange(self.factors)] = 1.0 / self.settings.prior
        return jacobian

    def start(self, gain: float) -> np.ndarray:
        """Return the model's values with stiffness and damping times a gain and the best of 16 delays: the
        objective has several minima in the delay."""
        tries = np.zeros((self.count, 16))
        tries[0] = np.linspace(self.lower[0], self.upper[0], 16)
        for i, name in enumerate(self.free):
            if name in ("stiffness", "damping"):
                self._part(tries, i)[:] = np.log(gain)
        return tries[:, np.argmin((self.residuals(tries) ** 2).sum(axis=0))]

    def information(self, best: np.ndarray) -> np.ndarray:
        """Return the information matrix of the logs alone at a solution (inverse covariance), shape [P, P].

        Residuals are not white noise: the variance is scaled by their integrated autocorrelation.
        """
        residual = self.residuals(best[:, None])
        data = self.jacobian(best, residual)[: self.measured]
        misses = residual[: self.measured, 0]
        variance = max(1.0, float(np.mean(misses**2)) * self._alike(misses))
        widest = np.concatenate(
            [[self.upper[0]], np.full(self.factors, WIDEST), self.upper[1 + self.factors :]]
        )
        return data.T @ data / variance + np.diag(widest**-2.0)

    def _alike(self, misses: np.ndarray) -> float:
        """Return the integrated autocorrelation of the residuals, in samples, averaged over joints."""
        begin, times = 0, []
        for one in self._samples:
            grid = np.zeros(one.positions.shape)
            grid[one.known] = misses[begin : begin + int(one.known.sum())]
            begin += int(one.known.sum())
            spectrum = np.abs(np.fft.rfft(grid, 2 * len(grid), axis=0)) ** 2
            correlation = np.fft.irfft(spectrum, axis=0)[: len(grid)]
            correlation /= np.maximum(correlation[0], 1e-12)
            # Sum up to the first value below the noise level.
            lost = np.argmax(correlation < CORRELATED, axis=0)
            times += [1.0 + 2.0 * c[1:end].sum() for c, end in zip(correlation.T, lost, strict=True)]
        return max(1.0, float(np.mean(times)))

    def by_quantity(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """Split parameter values, shape [P], by quantity, shape [J], and the delay [s], shape [1]."""
        parts = {name: self._part(values, i) for i, name in enumerate(self.free)}
        return parts | {"delay": values[:1] * DELAY_UNIT}


MODEL_DEVIATION = 0.5
"""Standard deviation of the logarithms of the model's quantities, about that of randomized twins."""

WIDEST = 3.0
"""Standard deviation of the logarithm of an unknown quantity: a factor of 20."""

CORRELATED = 0.05
"""Correlation below which samples count as uncorrelated."""

STARTING_GAINS = (1.0, 0.25, 0.5, 2.0)
"""Initial factors on the model's stiffness and damping, tried until a fit is good enough. Gains of real hands
differ by such factors, and a poor initial value leads to minima in which friction holds the joints."""

GOOD_FIT = 5.0
"""Maximum RMS error of a good fit, in units of the measurement noise. Good fits of twins have 0.6 to 2, wrong
minima more than 15."""

MOST_FRICTION = 0.2
"""Maximum friction as a share of a servo's torque limit."""

DELAY_UNIT, ERROR_UNIT = 0.01, 0.01
"""Units of the delay [s] and of drive errors [rad], which scale them like the other parameters."""


def _gauss_newton(problem: _Problem, start: np.ndarray) -> np.ndarray:
    """Minimize by the bounded Gauss-Newton of mujoco.minimize; withheld parameters stay zero."""
    free = ~problem.withheld

    def full(some: np.ndarray) -> np.ndarray:
        parameters = np.zeros((problem.count, some.shape[1]))
        parameters[free] = some
        return parameters

    found, _ = minimize.least_squares(
        np.clip(start, problem.lower, problem.upper)[free, None],
        lambda some: problem.residuals(full(some)),
        bounds=[problem.lower[free, None], problem.upper[free, None]],
        jacobian=lambda some, residual: problem.jacobian(full(some.reshape(-1, 1))[:, 0], residual)[:, free],
        eps=1e-3,
        max_iter=problem.settings.iterations,
        x_scale="jac",
        xtol=1e-5,
        verbose=minimize.Verbosity.SILENT,
        output=io.StringIO(),
    )
    return full(found)[:, 0]


def _from_gains(problem: _Problem) -> np.ndarray:
    """Return the first good fit over the starting gains, or the best one."""
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
