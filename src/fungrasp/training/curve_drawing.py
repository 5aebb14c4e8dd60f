"""Learning curves as SVG."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

WIDTH, HEIGHT, LEFT, TOP, GAP = 300, 120, 50, 30, 60
"""Of the drawing [pixels]: size of a panel, space to its left, above the first, and between them."""
COLORS = ("#27c", "#c60", "#393", "#a3a", "#555", "#b22", "#088", "#960")
ACROSS = ((0, 1.0, "control steps"), (1, 1 / 60, "time [min]"))
"""Column, factor and title of what the panels beside each other are over."""
DOWN = ((2, "success"), (3, "contact ratio"), (4, "slip [mm/s]"))
"""Column and title of what the panels below each other show."""


def curve_svg(curves: Mapping[str, np.ndarray]) -> str:
    """Success, contact ratio and slip over control steps and over time.

    Args:
        curves: columns of ``CurvePoint``, shape [N, 5] each, by the name of the training.
    """
    width, height = 2 * (LEFT + WIDTH) + 20, TOP + 3 * (HEIGHT + GAP) + 16 * len(curves)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        'font-family="sans-serif" font-size="12">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for i, (over, factor, below) in enumerate(ACROSS):
        for j, (measure, title) in enumerate(DOWN):
            x, y = LEFT + i * (WIDTH + LEFT), TOP + j * (HEIGHT + GAP)
            parts += _panel(curves, over, factor, measure, x, y)
            parts.append(f'<text x="{x}" y="{y - 8}">{escape(title)}</text>')
            parts.append(
                f'<text x="{x + WIDTH / 2}" y="{y + HEIGHT + 18}" text-anchor="middle">{escape(below)}</text>'
            )
    for k, name in enumerate(curves):
        down = TOP + 3 * (HEIGHT + GAP) + 16 * k
        parts.append(f'<text x="{LEFT}" y="{down}" fill="{COLORS[k % len(COLORS)]}">{escape(name)}</text>')
    return "\n".join([*parts, "</svg>"]) + "\n"


def _panel(
    curves: Mapping[str, np.ndarray], over: int, factor: float, measure: int, x: float, y: float
) -> list[str]:
    """One panel, its upper left corner at x, y. over, measure: columns."""
    most = max((factor * float(c[:, over].max(initial=0.0)) for c in curves.values()), default=0.0) or 1.0
    values = np.concatenate([c[:, measure] for c in curves.values()])
    high = 1.0 if measure != DOWN[-1][0] else float(np.nanmax(values, initial=1.0))
    parts = [
        f'<rect x="{x}" y="{y}" width="{WIDTH}" height="{HEIGHT}" fill="none" stroke="#888"/>',
        f'<text x="{x - 6}" y="{y + 10}" text-anchor="end">{high:.3g}</text>',
        f'<text x="{x - 6}" y="{y + HEIGHT}" text-anchor="end">0</text>',
        f'<text x="{x}" y="{y + HEIGHT + 18}" text-anchor="middle">0</text>',
        f'<text x="{x + WIDTH}" y="{y + HEIGHT + 18}" text-anchor="end">{most:,.0f}</text>',
    ]
    for k, points in enumerate(curves.values()):
        seen = points[np.isfinite(points[:, measure])]
        right, up = factor * seen[:, over] / most, seen[:, measure] / high
        line = " ".join(
            f"{x + WIDTH * a:.1f},{y + HEIGHT * (1 - b):.1f}" for a, b in zip(right, up, strict=True)
        )
        color = COLORS[k % len(COLORS)]
        parts.append(f'<polyline fill="none" stroke="{color}" stroke-width="1.5" points="{line}"/>')
    return parts
