"""Plots say what they show: titles, units, names, phases; the same bytes every time."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from fungrasp.core.plots import PlotLine, PlotPanel, RateBars, panels_svg, rates_svg

SVG = "{http://www.w3.org/2000/svg}"


def texts(svg: str) -> set[str]:
    return {(text.text or "").strip() for text in ElementTree.fromstring(svg).iter(f"{SVG}text")}


def test_a_panel_says_what_it_shows():
    time = np.linspace(0, 2, 5000)
    lines = [PlotLine(time, np.sin(time * k), f"joint {k}") for k in range(1, 13)]
    panel = PlotPanel("Hand", "time [s]", "angle [rad]", lines, phases=[(0.0, "approach"), (1.0, "lift")])
    svg = panels_svg([panel, panel], columns=2)
    assert {"Hand", "time [s]", "angle [rad]", "approach", "lift", "joint 1", "joint 12"} <= texts(svg)
    assert svg == panels_svg([panel, panel], columns=2)
    assert len(svg) < 600_000


def test_gaps_are_left_open():
    gap = PlotLine(np.arange(5.0), np.array([0, 1, np.nan, 1, 0.0]))
    svg = panels_svg([PlotPanel("", "x", "y", [gap])])
    lines = [g for g in ElementTree.fromstring(svg).iter(f"{SVG}g") if g.get("id") == "y 0"]
    path = next(lines[0].iter(f"{SVG}path")).get("d") or ""
    assert path.count("M") == 2


def test_rates_have_their_counts():
    bars = RateBars(
        "held", ["mug", "box"], np.array([0.5, 1.0]), np.array([[0.2, 0.8], [0.7, 1.0]]), ["1 of 2", "3 of 3"]
    )
    assert {"held", "mug", "box", "1 of 2", "3 of 3", "100 %"} <= texts(rates_svg(bars))
    behind = replace(bars, behind=np.array([1.0, 1.0]))
    assert rates_svg(behind).count("#bcd0e6") > rates_svg(bars).count("#bcd0e6")
