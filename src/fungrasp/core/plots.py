"""Plots with axes, units, legends and marked phases, as reproducible SVG by matplotlib."""

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
"""Approximate maximum number of plotted points per line."""


@dataclass(frozen=True, eq=False)
class PlotLine:
    """A line, with gaps at NaN."""

    x: np.ndarray
    """Shape [N]."""
    y: np.ndarray
    """Shape [N]."""
    label: str = ""
    """Label in the legend; "" for none."""
    color: str | None = None
    """Color in matplotlib; the next one of the cycle if None."""
    style: str = "-"
    """Style in matplotlib: "-", "--", ":", or "o" for markers only."""
    band: np.ndarray | None = None
    """Lower and upper end of a band around the line, shape [2, N]; no band if None."""


@dataclass(frozen=True, eq=False)
class PlotPanel:
    """Lines in one pair of axes."""

    title: str
    """Title of the panel."""
    x: str
    """Label of the x axis, with its unit."""
    y: str
    """Label of the y axis, with its unit."""
    lines: Sequence[PlotLine]
    """Lines to plot."""
    phases: Sequence[tuple[float, str]] = ()
    """Start (x value) and name of each phase."""
    limits: tuple[float, float] | None = None
    """Limits of the y axis; automatic if None."""


@dataclass(frozen=True, eq=False)
class RateBars:
    """N rates with intervals."""

    title: str
    """Title of the plot."""
    names: Sequence[str]
    """Labels of the bars, length N."""
    rates: np.ndarray
    """Rates, 0 to 1, shape [N]."""
    intervals: np.ndarray
    """Lower and upper end of each interval, shape [N, 2]."""
    counts: Sequence[str] = field(default_factory=tuple)
    """Text at the end of each bar, length N."""
    behind: np.ndarray | None = None
    """Larger rates, drawn in a pale color behind the bars, shape [N]."""


def panels_svg(panels: Sequence[PlotPanel], columns: int = 1, width: float = 9.0, height: float = 2.3) -> str:
    """Plot a grid of panels as SVG.

    Args:
        width: total width [inches of 96 pixels].
        height: height of a panel [inches of 96 pixels].
    """
    rows = -(-len(panels) // columns)
    with _figure(width, height * rows) as figure:
        for number, panel in enumerate(panels):
            axes = figure.add_subplot(rows, columns, number + 1)
            _draw_panel(axes, panel)
        return _svg(figure)


def rates_svg(bars: RateBars, width: float = 9.0) -> str:
    """Plot rates as bars with intervals, as SVG."""
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
    """Return line style and marker."""
    return ("", style) if style == "o" else (style, "")


@contextmanager
def _figure(width: float, height: float) -> Iterator[Any]:
    """Yield a figure with fixed settings, for reproducible output."""
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
