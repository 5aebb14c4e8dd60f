"""Retargeting and judging of any number of grasps, a part at a time: memory does not grow with their number
but for the result, and an interrupted run goes on where it was."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from threading import Lock
from time import perf_counter

import numpy as np

from fungrasp import __version__
from fungrasp.errors import FungraspError
from fungrasp.evaluation.grasp_quality import StaticQuality, static_quality
from fungrasp.files import digest
from fungrasp.grasps import HumanGraspSet, RobotGraspSet, load_robot_grasps, save_robot_grasps
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.retargeting import retarget

GRASPS_PER_PART = 128
"""Grasps in a file, and one job on a cluster: some seconds of work."""

TOGETHER = 8
"""Parts that one process solves and judges together: its threads have more to share in this way."""


@dataclass(frozen=True)
class RetargetedGrasps:
    """Robot grasps and how they were made."""

    robot: RobotGraspSet
    """The numbers of ``StaticQuality`` are in ``extra``."""
    solved: int
    """How many of them were not there already from an interrupted run."""
    seconds: float
    """Time that was spent on solving those, judging not counted."""

    @property
    def quality(self) -> StaticQuality:
        """Of all grasps."""
        return StaticQuality(**{f.name: self.robot.extra[f.name] for f in fields(StaticQuality)})


def retarget_in_parts(
    human: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    method: str,
    threads: int,
    folder: Path,
    progress: Callable[[int], None] = lambda count: None,
    size: int = GRASPS_PER_PART,
) -> RetargetedGrasps:
    """Retarget and judge grasps.

    Args:
        human: N human grasps.
        objects: by name.
        hand: the robot hand.
        method: one of ``fungrasp.retargeting.METHODS``.
        threads: 0 means all processors.
        folder: for finished parts, where there are several; the caller removes it (``remove_parts``).
        progress: called with the number of grasps that have just been solved or read.
        size: grasps in a part.

    Raises:
        FungraspError: as ``retarget``, or a part can't be written.
    """
    sets, solved, seconds = grasp_parts(human, size), 0, 0.0
    files = [part_file(folder, part, hand, method) for part in sets]
    parts = [_finished(file, len(part)) for file, part in zip(files, sets, strict=True)]
    progress(sum(len(part) for part in parts if part is not None))
    missing = [number for number, part in enumerate(parts) if part is None]
    for first in range(0, len(missing), TOGETHER):
        numbers = missing[first : first + TOGETHER]
        some = HumanGraspSet.concatenate([sets[number] for number in numbers])
        began = perf_counter()
        robot = retarget(some, objects, hand, method, threads=threads, progress=_one_at_a_time(progress))
        seconds += perf_counter() - began
        solved += len(some)
        quality = static_quality(robot, some, objects, hand)
        measured = {f.name: getattr(quality, f.name) for f in fields(quality)}
        robot, done = replace(robot, extra={**robot.extra, **measured}), 0
        for number in numbers:
            part = robot.select(slice(done, done + len(sets[number])))
            done += len(part)
            if len(sets) > 1:
                save_robot_grasps(files[number], part)
            parts[number] = part
    return RetargetedGrasps(RobotGraspSet.concatenate([p for p in parts if p is not None]), solved, seconds)


def grasp_parts(human: HumanGraspSet, size: int = GRASPS_PER_PART) -> list[HumanGraspSet]:
    """Grasps that are solved, judged and written together, so many at most."""
    starts = range(0, max(len(human), 1), size)
    return [human.select(slice(start, start + size)) for start in starts]


def part_file(folder: Path, part: HumanGraspSet, hand: Hand, method: str) -> Path:
    """Where a finished part lies."""
    return folder / f"{_key(part, hand, method)}.npz"


def remove_parts(folder: Path) -> None:
    """Delete what ``retarget_in_parts`` kept."""
    for file in folder.glob("*.npz") if folder.is_dir() else ():
        file.unlink()
    if folder.is_dir():
        folder.rmdir()


def _finished(file: Path, count: int) -> RobotGraspSet | None:
    """A part that is there already and whole."""
    if not file.is_file():
        return None
    try:
        robot = load_robot_grasps(file)
    except FungraspError:
        return None
    has_quality = all(f.name in robot.extra for f in fields(StaticQuality))
    return robot if len(robot) == count and has_quality else None


def _key(human: HumanGraspSet, hand: Hand, method: str) -> str:
    """Digest of what a part's grasps depend on."""
    arrays = dict(_arrays(human))
    return digest(__version__, hand.path.read_bytes(), hand.model_path.read_bytes(), method, arrays)[:24]


def _arrays(human: HumanGraspSet) -> Iterator[tuple[str, np.ndarray]]:
    for name in human.FIELDS:
        value = getattr(human, name)
        if value is not None:
            yield name, value


def _one_at_a_time(progress: Callable[[int], None]) -> Callable[[int], None]:
    lock = Lock()

    def finished(count: int) -> None:
        with lock:
            progress(count)

    return finished
