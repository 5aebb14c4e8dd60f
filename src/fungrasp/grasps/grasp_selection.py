"""Grasps named by people (by object, by object and task, or by row), and the objects of grasps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.grasps.grasp_arguments import resolve_objects
from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.robot_grasp import RobotGraspSet
from fungrasp.objects import ObjectModel


def picked_rows(
    grasps: HumanGraspSet | RobotGraspSet, picks: Sequence[str], count: int = 1, favorites: Sequence[str] = ()
) -> list[int]:
    """Rows of the picked grasps; without picks, of the favorites, then of objects that they leave out.

    Args:
        grasps: N of them.
        picks: "object", "object:task" (the first of them) or a row number.
        count: how many if there are no picks.
        favorites: picks that come first then, as far as the grasps have them.

    Raises:
        FungraspError: there is no such grasp, or one is picked twice.
    """
    assert grasps.task is not None
    first: dict[str, int] = {}
    for row, (name, task) in enumerate(zip(grasps.object_name.tolist(), grasps.task.tolist(), strict=True)):
        first.setdefault(name, row)
        first.setdefault(f"{name}:{task}", row)
    if not picks:
        others = [row for name, row in first.items() if ":" not in name]
        rows = [first[name] for name in favorites if name in first]
        shown = {grasps.object_name[row] for row in rows}
        rows += [row for row in others if grasps.object_name[row] not in shown]
        rows += sorted(set(range(len(grasps))) - set(rows))
        return rows[:count]
    rows = []
    for pick in picks:
        if pick not in first and pick.isdecimal():
            if int(pick) >= len(grasps):
                raise FungraspError(f"--grasp {pick}: the grasps are numbered 0 to {len(grasps) - 1}")
            rows.append(int(pick))
        elif pick in first:
            rows.append(first[pick])
        else:
            raise UnknownNameError("grasp", pick, first)
    if len(set(rows)) < len(rows):
        raise FungraspError(f"--grasp {' '.join(picks)}: grasp {max(rows, key=rows.count)} is picked twice")
    return rows


def load_objects(
    grasps: HumanGraspSet | RobotGraspSet, folder: str | Path | None = None
) -> dict[str, ObjectModel]:
    """The objects of a grasp set, by name: those that it carries, else each with the mass of its first grasp.

    Args:
        folder: of meshes ``<name>.obj``, which come before other objects of their name.

    Raises:
        FungraspError: an object can't be found or read.
    """
    return resolve_objects(grasps, folder)
