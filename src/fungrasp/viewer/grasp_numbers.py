"""The numbers beside grasps that are shown, and the side from which they are seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fungrasp.evaluation import StaticQuality
from fungrasp.grasps import HumanGrasp
from fungrasp.viewer.robot_view import RobotView

LEGEND = (
    "Orange: asked to touch, and touches. Pink: asked to, and does not. Yellow: touches without being asked. "
    "Points: green on the surface, red inside the object."
)

QUANTITIES = {
    "object_penetration_mm": ("Penetration of the object", "mm"),
    "contact_gap_mm": ("Gap at wanted contacts", "mm"),
    "contact_error_mm": ("Contacts off the person's", "mm"),
    "link_direction_error_deg": ("Directions off the person's", "°"),
    "force_closure_residual": ("Forces that stay unbalanced", ""),
    "force_closure_epsilon": ("Weakest wrench resisted", ""),
}
"""Numbers of ``StaticQuality`` that are shown: title and unit."""


def quality_rows(robots: Sequence[RobotView], quality: Sequence[StaticQuality]) -> list[tuple[str, ...]]:
    """Lines of a table, a column for each hand.

    Args:
        robots: that are shown.
        quality: of each; none while something is dragged: then there is only what costs nothing.
    """
    rows: list[tuple[str, ...]] = []
    if quality:
        for name, (title, unit) in QUANTITIES.items():
            values = [float(getattr(each, name)[0]) for each in quality]
            rows.append((title, *(_worded(name, value, unit) for value in values)))
    else:
        deepest = [max(0.0, -float(r.touch.clearance.min())) if r.touch else 0.0 for r in robots]
        rows.append(("Penetration of the object", *(f"{1e3 * d:.1f} mm" for d in deepest)))
    touches = []
    for robot in robots:
        if robot.touch is not None and robot.grasp is not None:
            asked = np.asarray(robot.grasp.link_contacts, dtype=bool)
            touches.append(f"{int((robot.touch.reached & asked).sum())} of {int(asked.sum())}")
    return [*rows, ("Contacts reached", *touches)]


def view_across(grasp: HumanGrasp) -> np.ndarray:
    """The unit vector to the right of somebody who looks at the grasp from where thumb and fingertips are
    seen, across the forearm; horizontal, shape [3]."""
    forearm = (grasp.hand_joints[0] - grasp.hand_joints[9])[:2]
    size = float(np.linalg.norm(forearm))
    aside = forearm / size if size > 0.02 else np.array([1.0, 0.0])
    towards = np.array([aside[1], -aside[0]])
    # The eye is at that side of the knuckles where the tips are.
    tips = grasp.hand_joints[[4, 8, 12, 20]][:, :2].mean(axis=0) - grasp.hand_joints[[5, 17]][:, :2].mean(
        axis=0
    )
    if float(tips @ towards) < 0:
        aside = -aside
    return np.array([aside[0], aside[1], 0.0])


def _worded(name: str, value: float, unit: str) -> str:
    """A number, marked where it is good or bad."""
    if not np.isfinite(value):
        return "–"
    good = {"object_penetration_mm": value < 2.0, "force_closure_residual": value < 0.1}.get(name)
    mark = "" if good is None else " ✓" if good else " ✗"
    return f"{value:.2f} {unit}".strip() + mark
