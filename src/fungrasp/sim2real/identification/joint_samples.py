"""The segments of a log side by side: fingers that were excited one after the other are simulated at the same
time, as with the palm held still none moves another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.sim2real.identification.motion_log import MotionLog

POLLED = 0.9
"""Where fewer of a log's rows than this share are new measurements, the device is polled less often than it
is commanded."""


@dataclass(frozen=True, eq=False)
class JointSamples:
    """What a simulation needs of a log, each joint with times of its own: T samples of J joints."""

    joints: tuple[str, ...]
    """Names of the joints, length J."""
    times: np.ndarray
    """When the driver took each command [s], shape [T, J]; every joint begins at 0, at rest."""
    commands: np.ndarray
    """[rad], shape [T, J]."""
    measured: np.ndarray
    """When the positions were measured [s], shape [T, J]."""
    positions: np.ndarray
    """[rad], shape [T, J]; not a number where nothing new was measured."""
    speed: np.ndarray
    """Of the driver's setpoints [rad/s], shape [J]."""
    gravity: np.ndarray
    """In the palm's frame [m/s^2], shape [3]."""
    weight: float
    """On each fingertip [kg]."""

    @property
    def known(self) -> np.ndarray:
        """Where there is a new measurement, shape [T, J]."""
        return np.isfinite(self.positions)

    @property
    def share(self) -> np.ndarray:
        """How much of its segment is over at each sample, 0 to 1, shape [T, J]."""
        last = np.where(self.known, self.times, 0.0).max(axis=0)
        return self.times / np.maximum(last, 1e-9)


def joint_samples(log: MotionLog) -> JointSamples:
    """The segments of a log, side by side.

    A polled device takes a command when it is polled next, and measures then: its delay counts from there.
    """
    segments = [segment for segment in log.segments if log.moving[segment[0]].any()]
    longest, count = max(len(segment) for segment in segments), len(log.joints)
    times = np.tile(np.arange(longest, dtype=float)[:, None], (1, count))
    measured = times.copy()
    commands, positions = np.zeros((longest, count)), np.full((longest, count), np.nan)
    for segment in segments:
        columns = np.flatnonzero(log.moving[segment[0]])
        begin, rows = log.times[segment[0]], len(segment)
        taken = _taken(log.times[segment], log.measured[segment]) - begin
        new = np.diff(log.measured[segment], prepend=-np.inf) > 0
        late = taken[-1] + np.arange(1, longest - rows + 1) * (taken[-1] / max(rows - 1, 1))
        for joint in columns:
            times[:rows, joint] = taken
            times[rows:, joint] = late
            measured[:rows, joint] = log.measured[segment] - begin
            measured[rows:, joint] = times[rows:, joint]
            commands[:rows, joint] = log.commands[segment, joint]
            commands[rows:, joint] = commands[rows - 1, joint]
            positions[:rows, joint] = np.where(new, log.positions[segment, joint], np.nan)
    return JointSamples(log.joints, times, commands, measured, positions, log.speed, log.gravity, log.weight)


def _taken(times: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """When a driver took commands that were given at some times [s], shape [T]."""
    stamps = measured[np.diff(measured, prepend=-np.inf) > 0]
    if len(stamps) > POLLED * len(times) or len(stamps) < 2:
        return times
    stamps = np.append(stamps, max(stamps[-1], times[-1]) + np.median(np.diff(stamps)))
    return stamps[np.searchsorted(stamps, times, side="right")]
