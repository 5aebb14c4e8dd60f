"""Motions of the use test: data with named tasks (``motions.toml``), which users can extend."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.formats.text_files import read_toml, type_faults
from fungrasp.hands import FINGERS

USE_MOTIONS = Path(__file__).with_name("motions.toml")
"""The motions that come with the package."""

OPENING_TIME = 1.0
"""Time for the hand to open and to lose contact [s]."""

_SCHEMA: dict[str, Any] = {
    "tasks": [str],
    "turn": str,
    "shift": str,
    "segments": [[float]],
    "press": {"force": float, "stiffness": float, "friction": float},
    "torque": float,
    "trigger": {"finger": str, "part": str, "force": float},
    "pull": float,
    "duration": float,
}


@dataclass(frozen=True)
class SurfacePress:
    """A compliant surface that the object's far end is pressed against from above."""

    force: float
    """Force at the start of the motion [N]."""
    stiffness: float
    """Loss of force per meter of upward displacement of the far end [N/m]."""
    friction: float
    """Friction against the motion, as a fraction of the force."""


@dataclass(frozen=True)
class TriggerPress:
    """A finger that presses a part of the object."""

    finger: str
    """One of ``FINGERS``."""
    part: str
    """Name of the part; any part if empty."""
    force: float
    """Required force [N]."""


@dataclass(frozen=True)
class UseMotion:
    """Motion of the wrist and loads on the object after the hold."""

    name: str
    """Name of the motion."""
    tasks: tuple[str, ...]
    """Tasks that use this motion."""
    duration: float
    """Duration [s]."""
    turn: Literal["", "tilt", "swing"] = ""
    """Axis about which the palm turns; none if empty."""
    shift: Literal["", "across"] = ""
    """Line along which the palm moves; none if empty."""
    segments: tuple[tuple[float, float, float], ...] = ()
    """Turn [rad] or shift [m] at the end of each segment, its duration [s], and the time for accelerating and
    for braking [s]."""
    press: SurfacePress | None = None
    """Surface that the far end is pressed against."""
    torque: float = 0.0
    """Torque about the line to the far end [N m], in each direction for half of the duration."""
    trigger: TriggerPress | None = None
    """Finger that presses a part."""
    pull: float = 0.0
    """Force at the far end, away from the palm [N]; the hand opens afterwards."""

    @property
    def whole_duration(self) -> float:
        """Duration including the opening of the hand [s]."""
        return self.duration + OPENING_TIME * (self.pull > 0)

    @property
    def only_moves(self) -> bool:
        """Whether there is no load on the object and no pressing finger."""
        return not (self.press or self.torque or self.trigger or self.pull)

    def displacement(self, time: float) -> tuple[float, float]:
        """Return turn [rad] or shift [m] of the palm, and its rate per second. time: since the beginning
        [s]."""
        start, begin = 0.0, 0.0
        for end, duration, ramp in self.segments:
            if time < begin + duration:
                share, rate = _trapezoid(time - begin, duration, ramp)
                return start + share * (end - start), rate * (end - start)
            start, begin = end, begin + duration
        return start, 0.0


def _trapezoid(time: float, duration: float, ramp: float) -> tuple[float, float]:
    """Return the completed fraction of a segment and its rate [1/s]; the speed profile is a trapezoid."""
    speed = 1.0 / (duration - ramp)
    if time < ramp:
        return 0.5 * speed * time**2 / ramp, speed * time / ramp
    left = duration - time
    if left < ramp:
        return 1.0 - 0.5 * speed * left**2 / ramp, speed * left / ramp
    return speed * (time - 0.5 * ramp), speed


def load_use_motions(path: str | Path = USE_MOTIONS) -> dict[str, UseMotion]:
    """Read motions, by name.

    Args:
        path: TOML file like ``motions.toml``, which explains its fields.

    Raises:
        FungraspError: the file is missing or damaged, a motion is impossible, or two motions have the same
            task.
    """
    data = read_toml(path, "file of use motions")
    motions = {name: _motion(path, name, entry) for name, entry in data.items()}
    of_task: dict[str, str] = {}
    for motion in motions.values():
        for task in motion.tasks:
            if task in of_task:
                raise FungraspError(
                    f"{path}: the task '{task}' has two motions, {of_task[task]} and {motion.name}"
                )
            of_task[task] = motion.name
    return motions


def motion_of(task: str, motions: Iterable[UseMotion]) -> UseMotion | None:
    """Return the motion of a task; None if it has none."""
    return next((motion for motion in motions if task in motion.tasks), None)


def _motion(path: str | Path, name: str, entry: Any) -> UseMotion:
    if not isinstance(entry, dict):
        raise FungraspError(f"{path}: '{name}' must be a table, [{name}]")
    for fault in type_faults(entry, _SCHEMA):
        raise FungraspError(f"{path}: [{name}] {fault}")
    unknown = sorted(set(entry) - set(_SCHEMA))
    if unknown:
        raise FungraspError(f"{path}: [{name}] {UnknownNameError('field', unknown[0], _SCHEMA)}")
    for field, allowed in (("turn", ("", "tilt", "swing")), ("shift", ("", "across"))):
        if entry.get(field, "") not in allowed:
            raise FungraspError(f"{path}: [{name}] {UnknownNameError(field, entry[field], allowed[1:])}")
    turn, shift = entry.get("turn", ""), entry.get("shift", "")
    rows = entry.get("segments", [])
    if bool(rows) != bool(turn or shift) or (turn and shift):
        raise FungraspError(f"{path}: [{name}] needs segments and either turn or shift, or none of the three")
    for row in rows:
        if len(row) != 3 or not (np.isfinite(row).all() and 0 < 2 * row[2] <= row[1]):
            raise FungraspError(
                f"{path}: [{name}] a segment is [end, duration, ramp] with 0 < 2 ramp <= duration, not {row}"
            )
    unit = np.pi / 180 if turn else 1.0
    duration = float(sum(row[1] for row in rows)) if rows else float(entry.get("duration", 0.0))
    if not 0 < duration <= 60:
        raise FungraspError(f"{path}: [{name}] must take up to 60 s, not {duration:g} s")
    for number in (entry.get("torque", 0.0), entry.get("pull", 0.0)):
        if not (np.isfinite(number) and number >= 0):
            raise FungraspError(f"{path}: [{name}] torque and pull must not be negative, not {number}")
    trigger = TriggerPress(**entry["trigger"]) if _complete(path, name, entry, "trigger") else None
    if trigger is not None and trigger.finger not in FINGERS:
        raise FungraspError(f"{path}: [{name}] {UnknownNameError('finger', trigger.finger, FINGERS)}")
    return UseMotion(
        name=name,
        tasks=tuple(entry.get("tasks", ())),
        duration=duration,
        turn=turn,
        shift=shift,
        segments=tuple((unit * row[0], float(row[1]), float(row[2])) for row in rows),
        press=SurfacePress(**entry["press"]) if _complete(path, name, entry, "press") else None,
        torque=float(entry.get("torque", 0.0)),
        trigger=trigger,
        pull=float(entry.get("pull", 0.0)),
    )


def _complete(path: str | Path, name: str, entry: dict[str, Any], field: str) -> bool:
    """Return whether an entry has a table, and check that the table has all its fields."""
    if field not in entry:
        return False
    missing = set(_SCHEMA[field]) - set(entry[field])
    unknown = set(entry[field]) - set(_SCHEMA[field])
    if missing or unknown:
        raise FungraspError(f"{path}: [{name}] {field} needs exactly {', '.join(sorted(_SCHEMA[field]))}")
    return True
