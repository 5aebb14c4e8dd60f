"""Plots with axes, units, legends and marked phases, as SVG that fits into a page or a file. Drawn by
matplotlib, the same bytes every time."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

MOST_POINTS = 1500
"""Of a line: more would not be seen."""


@dataclass(frozen=True, eq=False)
class PlotLine:
    """A line; gaps where it is NaN."""

    x: np.ndarray
    """Shape [N]."""
    y: np.ndarray
    """Shape [N]."""
    label: str = ""
    """For the legend; "" for none."""
    color: str | None = None
    """Of matplotlib; the next one of its cycle if None."""
    style: str = "-"
    """Of matplotlib: "-", "--", ":", or "o" for marks alone."""
    band: np.ndarray | None = None
    """Lower and upper end of a band around the line, shape [2, N]; no band if None."""


@dataclass(frozen=True, eq=False)
class PlotPanel:
    """Lines in one pair of axes."""

    title: str
    """Above it."""
    x: str
    """What is to the right, with its unit."""
    y: str
    """What is up, with its unit."""
    lines: Sequence[PlotLine]
    """What is drawn."""
    phases: Sequence[tuple[float, str]] = ()
    """Start and name of each phase of the time to the right."""
    limits: tuple[float, float] | None = None
    """Of what is up; they follow from the lines if None."""


@dataclass(frozen=True, eq=False)
class RateBars:
    """Rates of several things with their intervals."""

    title: str
    """Above it."""
    names: Sequence[str]
    """Of the things, length N."""
    rates: np.ndarray
    """0 to 1, shape [N]."""
    intervals: np.ndarray
    """Lower and upper end of each, shape [N, 2]."""
    counts: Sequence[str] = field(default_factory=tuple)
    """Words at the end of each bar, length N."""
    behind: np.ndarray | None = None
    """Larger rates, drawn pale behind them, shape [N]."""


def panels_svg(panels: Sequence[PlotPanel], columns: int = 1, width: float = 9.0, height: float = 2.3) -> str:
    """Panels below and beside each other.

    Args:
        width: of it all [inches of 96 pixels].
        height: of a panel [inches of 96 pixels].

    Returns:
        SVG.
    """
    rows = -(-len(panels) // columns)
    with _figure(width, height * rows) as figure:
        for number, panel in enumerate(panels):
            axes = figure.add_subplot(rows, columns, number + 1)
            _draw_panel(axes, panel)
        return _svg(figure)


def rates_svg(bars: RateBars, width: float = 9.0) -> str:
    """Rates as bars with their intervals.

    Returns:
        SVG.
    """
    count = len(bars.names)
    with _figure(width, 0.9 + 0.24 * count) as figure:
        axes = figure.add_subplot()
        place = np.arange(count)[::-1]
        rates, ends = np.asarray(bars.rates, dtype=float), np.asarray(bars.intervals, dtype=float)
        reach = np.abs(ends - rates[:, None]).T
        if bars.behind is not None:
            axes.barh(place, bars.behind, color="#bcd0e6", height=0.7)
        axes.barh(place, rates, xerr=reach, color="#3b78b5", ecolor="#555555", capsize=2, height=0.7)
        axes.set_yticks(place, [str(name) for name in bars.names])
        axes.set_xlim(0, 1.0)
        axes.xaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
        axes.set_title(bars.title, loc="left")
        axes.grid(axis="x", alpha=0.4)
        for y, words in zip(place, bars.counts, strict=False):
            axes.annotate(words, (1.005, y), va="center", fontsize=7, annotation_clip=False)
        return _svg(figure)


def _draw_panel(axes: Any, panel: PlotPanel) -> None:
    import matplotlib as mpl

    many = len(panel.lines) > 10
    if many:
        axes.set_prop_cycle(color=[*mpl.color_sequences["tab10"]] * 2, linestyle=["-"] * 10 + ["--"] * 10)
    for number, line in enumerate(panel.lines):
        step = max(len(line.x) // MOST_POINTS, 1)
        style: dict[str, Any] = {} if many else dict(zip(("ls", "marker"), _style(line.style), strict=True))
        if line.color is not None:
            style["color"] = line.color
        name = f"{panel.title or panel.y} {number}"
        (drawn,) = axes.plot(
            line.x[::step], line.y[::step], label=line.label or None, lw=1.2, gid=name, **style
        )
        if line.band is not None:
            axes.fill_between(line.x[::step], *line.band[:, ::step], color=drawn.get_color(), alpha=0.2)
    axes.set_title(panel.title, loc="left")
    axes.set_xlabel(panel.x)
    axes.set_ylabel(panel.y)
    axes.grid(alpha=0.4)
    axes.margins(x=0.01)
    if panel.limits is not None:
        axes.set_ylim(*panel.limits)
    for number, (start, name) in enumerate(panel.phases):
        axes.axvline(start, color="#999999", lw=0.7, ls=":")
        if name:
            axes.annotate(
                name,
                (start, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(2, -8 - 8 * (number % 2)),
                textcoords="offset points",
                fontsize=7,
                color="#666666",
            )
    labels = [line for line in panel.lines if line.label]
    if labels:
        many = len(labels) > 6
        axes.legend(
            loc="center left",
            bbox_to_anchor=(1.0, 0.5),
            fontsize=6 if many else 8,
            frameon=False,
            ncols=2 if len(labels) > 12 else 1,
            handlelength=1.4,
        )


def _style(style: str) -> tuple[str, str]:
    """Line and mark of a style."""
    return ("", style) if style == "o" else (style, "")


@contextmanager
def _figure(width: float, height: float) -> Iterator[Any]:
    """A figure that is the same wherever it is drawn."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    settings: Any = {
        "svg.hashsalt": "fungrasp",
        "svg.fonttype": "none",
        "font.family": ["sans-serif"],
        "font.size": 9,
        "axes.titlesize": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
    }
    with mpl.rc_context(settings):
        yield Figure(figsize=(width, height), dpi=96, layout="constrained")


def _svg(figure: Any) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
