"""What notebooks show of grasps, plans and results: a picture and a small table. ``import fungrasp`` tells
Jupyter of it."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import LiftTestResult
from fungrasp.grasps import HumanGraspSet, RobotGraspSet, load_objects
from fungrasp.media.grasp_pages import rates_by_object
from fungrasp.media.page import figure
from fungrasp.media.pictures import grasp_picture, grid, spread_rows
from fungrasp.task import GraspPlan

PICTURES = 4
"""Grasps that are drawn."""

ROWS = 8
"""Lines of a table."""


def notebook_html(value: Any) -> str | None:
    """HTML of grasps, a plan or a result; None of anything else."""
    if isinstance(value, HumanGraspSet | RobotGraspSet):
        return _grasps(value)
    if isinstance(value, LiftTestResult):
        return f"{escape(repr(value))}{rates_by_object(value)}<pre>{escape(value.table())}</pre>"
    if isinstance(value, GraspPlan):
        return _plans(value)
    return None


def _grasps(grasps: HumanGraspSet | RobotGraspSet) -> str:
    task = np.full(len(grasps), "") if grasps.task is None else grasps.task
    rows = [
        (
            str(row),
            str(grasps.object_name[row]),
            str(task[row]),
            f"{1e3 * float(grasps.object_mass[row]):.0f} g",
        )
        for row in range(min(len(grasps), ROWS))
    ]
    words = _table(("row", "object", "task", "mass"), rows, len(grasps))
    return f"{escape(repr(grasps))}{_pictures(grasps)}{words}"


def _pictures(grasps: HumanGraspSet | RobotGraspSet) -> str:
    """A few of them; none where their objects are not built in."""
    chosen = spread_rows(grasps.object_name, PICTURES)
    try:
        objects = load_objects(grasps.select(np.array(chosen)))
        drawn = [grasp_picture(grasps, row, objects, 280, 210) for row in chosen]
    except FungraspError:
        return ""
    labels = [str(grasps.object_name[row]) for row in chosen]
    return figure(grid(drawn, labels, columns=PICTURES), f"{len(chosen)} of {len(grasps)} grasps")


def _plans(plans: GraspPlan) -> str:
    expected = plans.expected_success
    rows = [
        (
            str(row),
            str(plans.object_name[row]),
            f"{plans.control_period * int(plans.closing_step[row]):.1f} s",
            f"{plans.control_period * int(plans.lift_step[row]):.1f} s",
            "–" if expected is None else f"{100 * float(expected[row]):.0f} %",
        )
        for row in range(min(len(plans), ROWS))
    ]
    heads = ("row", "object", "closes at", "lifts at", "expected success")
    return f"{escape(f'<GraspPlan: {len(plans)} plans>')}{_table(heads, rows, len(plans))}"


def _table(heads: tuple[str, ...], rows: list[tuple[str, ...]], count: int) -> str:
    """A table, and how many rows are not in it."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    more = f"<p>and {count - len(rows)} more</p>" if count > len(rows) else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"
