"""Fit of joint dynamics to a log by bounded Gauss-Newton.

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
    """Quantities that keep the model's values: "stiffness" if the computer controls the torques."""
    range: float = 30.0
    """Each quantity stays within this factor of the model's value."""
    longest_delay: float = 0.15
    """[s]."""
    errors: tuple[str, ...] = ()
    """Drive errors to fit too: "offset" (of the encoders), "backlash"."""
    largest_error: float = 0.05
    """Bound of both [rad]."""
    bound: float = 0.5
    """Largest relative standard deviation of an identified quantity. Other quantities keep the model's
    values."""
    prior: float = float("inf")
    """Prior: standard deviation of the logarithms of factors on the model's values; infinite for no prior. It
    decides what the log does not determine."""
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
    """Of the joints of the log."""
    relative_error: dict[str, np.ndarray]
    """Standard deviation by quantity, relative to it, shape [J], by the curvature; delay: [s]. Of what is not
    identified: by the log alone; what stands beside it is as good as the model's value."""
    identified: dict[str, np.ndarray]
    """By quantity, which joints' the logs tell, shape [J]; the others have the model's values."""
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
    """Fit joint dynamics to a log, or to several logs of the same joints, for example with different
    directions of gravity.

    Where some of the logs are with weights on the fingertips and some without, each kind is fitted by itself:
    those with weights tell the stiffness, those without the ratios of all else to it. (In one fit of both,
    friction that falls with speed, which the model has not, is paid for by inertia.)

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
    """Decide at a solution which quantities the logs do not tell, and mark them: of each joint the stiffness
    first, because where the scale of a joint's dynamics is not seen the ratios to it are, then the worst one,
    until the others are known.

    Returns:
        the standard deviations, shape [P]: with stiffnesses that are withheld as they are, and other
        quantities that are withheld as uncertain as the model; of those withheld, what they were by the logs.
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
    """The ratios of one fit with the stiffness of another. Of the standard deviations of all else, what they
    share with that of the stiffness is taken for the scale's."""
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
        # Where the stiffness was withheld, the others' are those of ratios to it already.
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
            # The model's may be next to nothing.
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
        """One kind of parameters of all joints, shape [J]."""
        return parameters[1 + number * len(self._joints) :][: len(self._joints)]

    def residuals(self, parameters: np.ndarray) -> np.ndarray:
        """Of the logs, then of the prior, shape [R, W]; parameters: shape [P, W]."""
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
        """The model's values, stiffness and damping times a gain, with the best of some delays: in the delay
        the fit has several minima."""
        tries = np.zeros((self.count, 16))
        tries[0] = np.linspace(self.lower[0], self.upper[0], 16)
        for i, name in enumerate(self.free):
            if name in ("stiffness", "damping"):
                self._part(tries, i)[:] = np.log(gain)
        return tries[:, np.argmin((self.residuals(tries) ** 2).sum(axis=0))]

    def information(self, best: np.ndarray) -> np.ndarray:
        """What the logs alone say of the parameters at a solution: inverse of their covariance, shape [P, P].

        What the simulation misses is no white noise: samples that miss alike count as one.
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
        """How many samples of a joint in a row miss alike: its integrated autocorrelation, mean of all."""
        begin, times = 0, []
        for one in self._samples:
            grid = np.zeros(one.positions.shape)
            grid[one.known] = misses[begin : begin + int(one.known.sum())]
            begin += int(one.known.sum())
            spectrum = np.abs(np.fft.rfft(grid, 2 * len(grid), axis=0)) ** 2
            correlation = np.fft.irfft(spectrum, axis=0)[: len(grid)]
            correlation /= np.maximum(correlation[0], 1e-12)
            # Up to where it first is lost in the noise.
            lost = np.argmax(correlation < CORRELATED, axis=0)
            times += [1.0 + 2.0 * c[1:end].sum() for c, end in zip(correlation.T, lost, strict=True)]
        return max(1.0, float(np.mean(times)))

    def by_quantity(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """Values of parameters, shape [P], by quantity, shape [J], and of the delay [s], shape [1]."""
        parts = {name: self._part(values, i) for i, name in enumerate(self.free)}
        return parts | {"delay": values[:1] * DELAY_UNIT}


MODEL_DEVIATION = 0.5
"""Standard deviation of the logarithm of the model's own quantities: those of twins are drawn about so."""

WIDEST = 3.0
"""Standard deviation of the logarithm of a quantity of which nothing is known: a factor of 20."""

CORRELATED = 0.05
"""Correlation below which two samples count as different."""

STARTING_GAINS = (1.0, 0.25, 0.5, 2.0)
"""Common factors on stiffness and damping of the model that a fit starts from, one after the other until it
is good enough: hands are driven with gains that differ by as much, and from far off joints end in minima in
which friction holds them."""

GOOD_FIT = 5.0
"""Times the noise of measured positions: a fit that misses by less is good enough. Good ones of twins miss by
0.6 to 2 times, those in wrong minima by more than 15."""

MOST_FRICTION = 0.2
"""Of a servo's torque limit."""

DELAY_UNIT, ERROR_UNIT = 0.01, 0.01
"""[s] and [rad]: parameters of about the size of the others."""


def _gauss_newton(problem: _Problem, start: np.ndarray) -> np.ndarray:
    """Bounded Gauss-Newton of mujoco.minimize with finite differences; what is withheld stays at zero."""
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
