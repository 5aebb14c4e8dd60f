"""A log of a hand's motion: what was commanded and what was measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.files import atomic_path
from fungrasp.formats.file_bytes import check_file
from fungrasp.formats.numpy_files import read_npz

SHORTEST = 0.5
"""Of a log [s]."""
LARGEST_TEXT = 50_000_000
"""Of a step response [bytes]."""
HEAVIEST = 2.0
"""Of the masses on fingertips [kg]."""
LEAST_MOTION = 0.05
"""A joint that moves less is not identified [rad]."""


@dataclass(frozen=True, eq=False)
class MotionLog:
    """Commands and positions at the same times."""

    joints: tuple[str, ...]
    """Names of the joints, length J."""
    times: np.ndarray
    """[s], shape [T], increasing."""
    commands: np.ndarray
    """Goals of the joints that held from each time on [rad], shape [T, J]."""
    positions: np.ndarray
    """Measured positions [rad], shape [T, J]."""
    gravity: np.ndarray
    """Gravity in the palm's frame [m/s^2], shape [3]; zero where it is to be left out."""
    weight: float = 0.0
    """Mass that was fixed to each fingertip [kg]."""

    def __post_init__(self) -> None:
        shape = (len(self.times), len(self.joints))
        if self.commands.shape != shape or self.positions.shape != shape or self.gravity.shape != (3,):
            raise FungraspError(
                f"a motion log of {shape[1]} joints and {shape[0]} times needs as many commands and positions"
            )
        if not all(np.isfinite(a).all() for a in (self.times, self.commands, self.positions, self.gravity)):
            raise FungraspError("a motion log holds values that are not finite")
        if not 0 <= self.weight < HEAVIEST:
            raise FungraspError(
                f"the mass on each fingertip lies from 0 to {HEAVIEST} kg, not {self.weight:g} kg"
            )
        if len(self.times) < 2 or (np.diff(self.times) <= 0).any():
            raise FungraspError("the times of a motion log do not increase")

    def part(self, begin: float, end: float) -> MotionLog:
        """The rows between two shares of the duration, 0 to 1."""
        at = self.times[0] + np.array([begin, end]) * (self.times[-1] - self.times[0])
        first, last = np.searchsorted(self.times, at + np.array([0.0, 1e-9]))
        return self.rows(np.arange(first, last))

    def rows(self, rows: np.ndarray) -> MotionLog:
        """Some rows, shape [R]."""
        return replace(
            self, times=self.times[rows], commands=self.commands[rows], positions=self.positions[rows]
        )

    def check_excitation(self) -> None:
        """Raises FungraspError: the log is too short, or a joint hardly moves."""
        duration = self.times[-1] - self.times[0]
        if duration < SHORTEST:
            raise FungraspError(
                f"the motion log is {duration:.2f} s long; identification needs {SHORTEST} s at least"
            )
        still = np.ptp(self.positions, axis=0) < LEAST_MOTION
        if still.any():
            name = self.joints[int(np.flatnonzero(still)[0])]
            raise FungraspError(
                f"joint '{name}' moves less than {LEAST_MOTION} rad in the log; excite it more"
            )


def save_motion_log(path: str | Path, log: MotionLog) -> None:
    """Write a log as ``.npz``."""
    arrays: dict[str, Any] = {
        "joints": np.array(log.joints),
        "times": log.times,
        "commands": log.commands,
        "positions": log.positions,
        "gravity": log.gravity,
        "weight": np.array(log.weight),
    }
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load_motion_log(path: str | Path) -> MotionLog:
    """Read what ``save_motion_log`` has written.

    Raises:
        FungraspError: the file is missing, of another kind or inconsistent.
    """
    arrays = read_npz(path, "motion log")
    for name in ("joints", "times", "commands", "positions", "gravity"):
        if name not in arrays:
            raise FungraspError(f"{path} is no motion log: '{name}' is missing")
    joints = tuple(str(name) for name in arrays.pop("joints"))
    try:
        weight = float(arrays.pop("weight", np.zeros(())))
        return MotionLog(joints, **{k: np.asarray(v, dtype=float) for k, v in arrays.items()}, weight=weight)
    except (FungraspError, TypeError, ValueError) as error:
        raise FungraspError(f"{path}: {error}") from error


def read_step_csv(path: str | Path, joint: str, open_position: float, closed_position: float) -> MotionLog:
    """Log of one motor of an Inspire hand: columns time_s, target_value and measured_value, the latter two
    from 1000 (open) to 0 (closed).

    Args:
        path: the file.
        joint: name of the joint.
        open_position: of the joint at 1000 [rad].
        closed_position: at 0 [rad].
    """
    path = check_file(path, "step response", LARGEST_TEXT)
    try:
        table = np.genfromtxt(path, delimiter=",", names=True, max_rows=1_000_000)
        times, targets, measured = (table[c] for c in ("time_s", "target_value", "measured_value"))
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise FungraspError(f"cannot read the step response {path}: {error}") from error

    def radians(units: np.ndarray) -> np.ndarray:
        return (closed_position + units / 1000 * (open_position - closed_position))[:, None]

    # Several rows may have one time, where the recorder read faster than its clock told.
    rows = np.flatnonzero(np.diff(times, prepend=-np.inf) > 0)
    return MotionLog((joint,), times[rows], radians(targets[rows]), radians(measured[rows]), np.zeros(3))
