"""Learning curves as SVG."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fungrasp.plots import PlotLine, PlotPanel, panels_svg

ACROSS = ((0, 1e-6, "control steps [millions]"), (1, 1 / 60, "time [min]"))
"""Column, factor and title of what the panels beside each other are over."""
DOWN = ((2, "success", (0.0, 1.0)), (3, "contact ratio", (0.0, 1.0)), (4, "slip [mm/s]", None))
"""Column, title and limits of what the panels below each other show."""


def curve_svg(curves: Mapping[str, np.ndarray]) -> str:
    """Success, contact ratio and slip over control steps and over time.

    Args:
        curves: columns of ``CurvePoint``, shape [N, 5] each, by the name of the training.
    """
    panels = []
    for row, (measure, title, limits) in enumerate(DOWN):
        for column, (over, factor, across) in enumerate(ACROSS):
            # One legend is enough.
            named = row == 0 and column == len(ACROSS) - 1
            lines = [
                PlotLine(factor * points[:, over], points[:, measure], name if named else "")
                for name, points in curves.items()
            ]
            panels.append(PlotPanel(title if column == 0 else "", across, title, lines, limits=limits))
    return panels_svg(panels, columns=2) + "\n"
