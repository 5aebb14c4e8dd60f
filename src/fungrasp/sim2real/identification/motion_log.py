"""Log of a hand's motion: commands and measurements with timestamps.

Fingers that were excited one after the other are simulated at the same time (``JointSamples``), because with
a fixed palm they do not affect each other.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any, NamedTuple, Self

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import check_file, read_bytes

SHORTEST = 0.5
"""Minimum duration of a joint's excitation [s]."""
LARGEST_TEXT = 50_000_000
"""Maximum size of a file [bytes]."""
HEAVIEST = 2.0
"""Upper bound of the mass on each fingertip [kg]."""
LEAST_MOTION = 0.05
"""Minimum motion of a joint for identification [rad]."""
LARGEST_LATENCY = 0.05
"""Maximum plausible latency according to a device's clock [s]; beyond it the clock is ignored."""
POLLED = 0.9
"""If the share of new measurements among a log's rows is lower, the device is polled less often than
commanded."""
KIND = "fungrasp motion log"
"""Value of "kind" in the first line of a file."""


@dataclass(frozen=True, eq=False)
class MotionLog:
    """T rows of commands and positions of J joints."""

    joints: tuple[str, ...]
    """Names of the joints, length J."""
    times: np.ndarray
    """Command times [s], shape [T], increasing."""
    commands: np.ndarray
    """Goals of the joints from each time on [rad], shape [T, J]."""
    positions: np.ndarray
    """Measured positions [rad], shape [T, J]."""
    gravity: np.ndarray
    """Gravity in the palm frame [m/s^2], shape [3]; zero to ignore it."""
    weight: float = 0.0
    """Mass attached to each fingertip [kg]."""
    measured: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Measurement times of the positions, on the clock of ``times`` [s], shape [T]; repeated without a new
    measurement. Default: ``times``."""
    speed: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Speed limits of the driver's setpoints [rad/s], shape [J]; unlimited by default."""
    moving: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))
    """Whether each joint is excited, shape [T, J]; other joints hold. All by default."""

    def __post_init__(self) -> None:
        shape = (len(self.times), len(self.joints))
        absent = {
            "measured": np.asarray(self.times),
            "speed": np.full(shape[1], np.inf),
            "moving": np.ones(shape, dtype=bool),
        }
        for name, value in absent.items():
            if not getattr(self, name).size:
                object.__setattr__(self, name, value)
        if self.commands.shape != shape or self.positions.shape != shape or self.gravity.shape != (3,):
            raise FungraspError(
                f"a motion log of {shape[1]} joints and {shape[0]} times needs as many commands and positions"
            )
        if self.measured.shape != shape[:1] or self.speed.shape != shape[1:] or self.moving.shape != shape:
            raise FungraspError("stamps, speeds or segments of a motion log do not fit its joints and times")
        numbers = (self.times, self.commands, self.positions, self.gravity, self.measured)
        if not all(np.isfinite(values).all() for values in numbers) or not (self.speed > 0).all():
            raise FungraspError("a motion log holds values that are not finite, or a speed that is none")
        if not 0 <= self.weight < HEAVIEST:
            raise FungraspError(
                f"the mass on each fingertip lies from 0 to {HEAVIEST} kg, not {self.weight:g} kg"
            )
        if len(self.times) < 2 or (np.diff(self.times) <= 0).any() or (np.diff(self.measured) < 0).any():
            raise FungraspError("the times of a motion log do not increase")

    @property
    def segments(self) -> list[np.ndarray]:
        """Rows of each part of the log during which the same joints are excited."""
        changes = (self.moving[1:] != self.moving[:-1]).any(axis=1)
        return np.split(np.arange(len(self.times)), np.flatnonzero(changes) + 1)

    def part(self, begin: float, end: float) -> MotionLog:
        """Return the rows between two shares, 0 to 1, of each segment's duration."""
        rows = []
        for segment in self.segments:
            times = self.times[segment]
            at = times[0] + np.array([begin, end]) * (times[-1] - times[0])
            rows.append(segment[slice(*np.searchsorted(times, at + np.array([0.0, 1e-9])))])
        return self.rows(np.concatenate(rows))

    def rows(self, rows: np.ndarray) -> MotionLog:
        """Return the log of some rows, shape [R]."""
        per_row = ("times", "commands", "positions", "measured", "moving")
        return replace(self, **{name: getattr(self, name)[rows] for name in per_row})

    def excited(self) -> MotionLog:
        """Return the log of the joints that were excited, for logs that were aborted.

        Raises:
            FungraspError: no joint was excited.
        """
        kept = np.flatnonzero([not self._too_little(joint) for joint in range(len(self.joints))])
        if not len(kept):
            self.check_excitation()
        return self.of_joints([self.joints[joint] for joint in kept])

    def of_joints(self, joints: Sequence[str]) -> MotionLog:
        """Return the log of some joints, with the rows in which one of them is excited."""
        kept = [self.joints.index(joint) for joint in joints]
        per_joint = ("commands", "positions", "moving")
        some = replace(
            self,
            joints=tuple(joints),
            speed=self.speed[kept],
            **{name: getattr(self, name)[:, kept] for name in per_joint},
        )
        return some.rows(np.flatnonzero(some.moving.any(axis=1)))

    def check_excitation(self) -> None:
        """Check the excitation of all joints.

        Raises:
            FungraspError: a joint is excited too briefly or hardly moves.
        """
        for joint in range(len(self.joints)):
            problem = self._too_little(joint)
            if problem:
                raise FungraspError(problem)

    def _too_little(self, joint: int) -> str:
        """Return the problem with a joint's excitation, or ""."""
        rows = np.flatnonzero(self.moving[:, joint])
        duration = self.times[rows[-1]] - self.times[rows[0]] if len(rows) else 0.0
        if duration < SHORTEST:
            return (
                f"joint '{self.joints[joint]}' is excited for {duration:.2f} s in the motion log; "
                f"identification needs {SHORTEST} s at least"
            )
        if np.ptp(self.positions[rows, joint]) < LEAST_MOTION:
            name = self.joints[joint]
            return f"joint '{name}' moves less than {LEAST_MOTION} rad in the log; excite it more"
        return ""


@dataclass(frozen=True, eq=False)
class MotionHeader:
    """Constant data of a log; see ``MotionLog``."""

    joints: tuple[str, ...]
    """Names of the joints, length J."""
    gravity: np.ndarray
    """Gravity in the palm frame [m/s^2], shape [3]."""
    weight: float
    """Mass on each fingertip [kg]."""
    speed: np.ndarray
    """Speed limits [rad/s], shape [J]."""


class MotionSample(NamedTuple):
    """A recorded row of a log."""

    commanded: float
    """Host time of the command since the start of the log [s]."""
    device_time: float
    """Timestamp of the positions on the device's clock [s]."""
    received: float
    """Host time at which the positions were received, since the start of the log [s]."""
    moving: tuple[int, ...]
    """Indices of the excited joints."""
    command: np.ndarray | Sequence[float]
    """Goals that were sent [rad], length J."""
    position: np.ndarray | Sequence[float]
    """Measured positions [rad], length J."""


class MotionLogWriter:
    """Writes a log line by line, so that at most the last line is lost if the process is killed. A context
    manager; the file is created with the first row, and an existing file is not changed."""

    def __init__(self, path: str | Path):
        """
        Raises:
            FungraspError: the file exists.
        """
        self.path, self.rows = Path(path), 0
        self._stream: IO[str] | None = None
        if self.path.exists():
            raise FungraspError(f"the log {path} already exists: give another name")

    def add(self, header: MotionHeader, sample: MotionSample) -> None:
        """Write a row, and the header before the first one. Raises: FungraspError: it can't be written."""
        row = [*np.round(sample[:3], 6).tolist(), list(sample.moving)]
        row += [np.round(values, 7).tolist() for values in sample[4:]]
        try:
            if self._stream is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._stream = self.path.open("x", encoding="utf-8", buffering=1)
                self._stream.write(json.dumps(_header_words(header)) + "\n")
            self._stream.write(json.dumps(row, separators=(",", ":")) + "\n")
        except OSError as error:
            raise FungraspError(f"cannot write {self.path}: {error.strerror or error}") from error
        self.rows += 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._stream is not None:
            self._stream.close()


def motion_log(header: MotionHeader, samples: Sequence[MotionSample]) -> MotionLog:
    """Create a log from samples.

    The state with the smallest latency aligns the device's clock with the host's. If the clocks are
    inconsistent, times of receipt are used.

    Raises:
        FungraspError: the samples are inconsistent.
    """
    count = len(header.joints)
    times, device, received = (np.array([sample[i] for sample in samples], dtype=float) for i in range(3))
    measured = device + (received - device).min(initial=np.inf)
    if (received - measured).max(initial=0.0) > LARGEST_LATENCY or (np.diff(measured) < 0).any():
        measured = received
    moving = np.zeros((len(samples), count), dtype=bool)
    for row, sample in zip(moving, samples, strict=True):
        row[list(sample.moving)] = True
    commands, positions = (
        np.array([sample[i] for sample in samples], dtype=float).reshape(len(samples), -1) for i in (4, 5)
    )
    return MotionLog(
        header.joints,
        times,
        commands,
        positions,
        header.gravity,
        header.weight,
        measured,
        header.speed,
        moving,
    )


def load_motion_log(path: str | Path) -> MotionLog:
    """Read a log of ``MotionLogWriter``, complete or truncated.

    Raises:
        FungraspError: the file is missing, of a different kind or inconsistent.
    """
    lines = read_bytes(path, "motion log", LARGEST_TEXT).split(b"\n")
    try:
        about = json.loads(lines[0])
        if about["kind"] != KIND:
            raise FungraspError(f"{path} is not a motion log")
        header = MotionHeader(
            tuple(str(name) for name in about["joints"]),
            np.array(about["gravity"], dtype=float),
            float(about["weight"]),
            np.array([np.inf if v is None else v for v in about["speed"]], dtype=float),
        )
        # Drop the last line: it is empty, or truncated if the writer was killed.
        samples = [MotionSample(*json.loads(line)) for line in lines[1:-1]]
        return motion_log(header, samples)
    except FungraspError as error:
        raise FungraspError(f"{path}: {error}") from error
    except (ValueError, TypeError, KeyError, IndexError, UnicodeDecodeError, RecursionError) as error:
        raise FungraspError(f"{path} is not a motion log, or a damaged one") from error


def _header_words(header: MotionHeader) -> dict[str, Any]:
    return {
        "kind": KIND,
        "joints": list(header.joints),
        "gravity": header.gravity.tolist(),
        "weight": header.weight,
        "speed": [None if np.isinf(v) else float(v) for v in header.speed],
    }


def read_step_csv(path: str | Path, joint: str, open_position: float, closed_position: float) -> MotionLog:
    """Read the log of one motor of an Inspire hand: columns time_s, target_value and measured_value, with
    values from 1000 (open) to 0 (closed).

    Args:
        open_position: joint position at 1000 [rad].
        closed_position: joint position at 0 [rad].
    """
    path = check_file(path, "step response", LARGEST_TEXT)
    try:
        table = np.genfromtxt(path, delimiter=",", names=True, max_rows=1_000_000)
        times, targets, measured = (table[c] for c in ("time_s", "target_value", "measured_value"))
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise FungraspError(f"cannot read the step response {path}: {error}") from error

    def radians(units: np.ndarray) -> np.ndarray:
        return (closed_position + units / 1000 * (open_position - closed_position))[:, None]

    # Rows may share a time if the recorder was faster than its clock's resolution.
    rows = np.flatnonzero(np.diff(times, prepend=-np.inf) > 0)
    return MotionLog((joint,), times[rows], radians(targets[rows]), radians(measured[rows]), np.zeros(3))


@dataclass(frozen=True, eq=False)
class JointSamples:
    """T samples of J joints for simulation, with separate times for each joint."""

    joints: tuple[str, ...]
    """Names of the joints, length J."""
    times: np.ndarray
    """Times at which the driver accepted each command [s], shape [T, J]; every joint begins at 0, at rest."""
    commands: np.ndarray
    """Goals [rad], shape [T, J]."""
    measured: np.ndarray
    """Measurement times of the positions [s], shape [T, J]."""
    positions: np.ndarray
    """Measured positions [rad], shape [T, J]; NaN without a new measurement."""
    speed: np.ndarray
    """Speed limits of the driver's setpoints [rad/s], shape [J]."""
    gravity: np.ndarray
    """Gravity in the palm frame [m/s^2], shape [3]."""
    weight: float
    """Mass on each fingertip [kg]."""

    @property
    def known(self) -> np.ndarray:
        """Mask of new measurements, shape [T, J]."""
        return np.isfinite(self.positions)

    @property
    def share(self) -> np.ndarray:
        """Elapsed share of the segment at each sample, 0 to 1, shape [T, J]."""
        last = np.where(self.known, self.times, 0.0).max(axis=0)
        return self.times / np.maximum(last, 1e-9)


def joint_samples(log: MotionLog) -> JointSamples:
    """Arrange the segments of a log side by side.

    A polled device accepts a command at the next poll and measures then, so that its delay begins there.
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
    """Return the times at which a driver accepted the commands given at ``times`` [s], shape [T]."""
    stamps = measured[np.diff(measured, prepend=-np.inf) > 0]
    if len(stamps) > POLLED * len(times) or len(stamps) < 2:
        return times
    stamps = np.append(stamps, max(stamps[-1], times[-1]) + np.median(np.diff(stamps)))
    return stamps[np.searchsorted(stamps, times, side="right")]
