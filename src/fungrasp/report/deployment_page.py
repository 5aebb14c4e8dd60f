"""A page about a deployment, made from its log: phases, lateness, motion of palm, hand and object."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from fungrasp.deployment.log import RecordedDeployment
from fungrasp.errors import FungraspError
from fungrasp.files import atomic_path
from fungrasp.report.page_parts import Quantity, badge, document, provenance_footer, quality_card

WIDTH, HEIGHT = 900, 180
"""Size of a chart [pixels]."""

COLORS = ("#3366cc", "#dc3912", "#109618", "#ff9900", "#990099", "#0099c6", "#dd4477", "#66aa00")
"""Of the lines of a chart, by turns."""


def write_deployment_page(path: str | Path, log: RecordedDeployment) -> Path:
    """Write a page that needs no other file.

    Raises:
        FungraspError: the log holds no setpoint, or the page can't be written.
    """
    setpoints, steps = log.messages["/setpoint"], log.messages["/step"]
    if not setpoints:
        raise FungraspError("the log holds no setpoint: there is nothing to show")
    time = np.array([message["time"] for message in setpoints])
    time = time - time[0]
    palm = np.array([message["sent"]["palm"][:3] for message in setpoints])
    arm = np.array([message["sent"]["arm"] for message in setpoints])
    arm_seen = np.array([message["arm"]["positions"] for message in setpoints])
    hand = np.array([message["sent"]["hand"] for message in setpoints])
    hand_seen = np.array([message["hand"]["positions"] for message in setpoints])
    things = [message["object"] or [np.nan] * 7 for message in setpoints]
    height = np.array(things)[:, 2]
    faults = [event["text"] for event in log.messages["/event"] if event["what"] == "fault"]
    verdict = badge("bad", faults[0]) if faults else badge("good", "no fault")
    late = 1e3 * np.array([step["late"] for step in steps] or [0.0])
    quality = [
        Quantity("Control steps", len(steps)),
        Quantity("Setpoints", len(setpoints)),
        Quantity("Lateness, median", float(np.median(late)), "ms", "Of the beginning of a control step."),
        Quantity("Lateness, largest", float(late.max()), "ms", "", 20.0),
        Quantity(
            "Arm behind its setpoint",
            float(np.abs(arm - arm_seen).max()),
            "rad",
            "The largest of all joints.",
        ),
    ]
    parts = [
        f"<h1>Deployment</h1><p>{verdict}</p>",
        quality_card(quality, "In figures"),
        _phases([message["phase"] for message in setpoints], time),
        _chart("Palm: x, y, z of the setpoint [m]", time, palm),
        _chart("Tracked height of the object's origin [m]", time, height[:, None]),
        _chart("Hand: setpoints [rad]", time, hand),
        _chart("Hand: measured [rad]", time, hand_seen),
        _chart("Arm: setpoint less measured [rad]", time, arm - arm_seen),
        provenance_footer(log.about),
    ]
    path = Path(path)
    with atomic_path(path) as temporary:
        temporary.write_text(document("Deployment", parts), encoding="utf-8")
    return path


def _phases(names: Sequence[str], time: np.ndarray) -> str:
    """A table of phases and when they began."""
    rows, last = [], None
    for name, when in zip(names, time, strict=True):
        if name != last:
            rows.append(f'<tr><th scope="row">{escape(name)}</th><td class="number">{when:.2f} s</td></tr>')
            last = name
    return f'<section class="card"><h3>Phases</h3><table class="quality">{"".join(rows)}</table></section>'


def _chart(title: str, time: np.ndarray, values: np.ndarray) -> str:
    """Lines over time. time: [s], shape [N]; values: shape [N, K], gaps where they are NaN."""
    low, high = float(np.nanmin(values, initial=0.0)), float(np.nanmax(values, initial=0.0))
    span, end = max(high - low, 1e-6), max(float(time[-1]), 1e-6)
    lines = []
    for k, column in enumerate(values.T):
        seen = np.isfinite(column)
        x, y = WIDTH * time[seen] / end, HEIGHT * (high - column[seen]) / span
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        color = COLORS[k % len(COLORS)]
        lines.append(f'<polyline fill="none" stroke="{color}" stroke-width="1.5" points="{points}"/>')
    return (
        f'<figure><svg viewBox="0 0 {WIDTH} {HEIGHT}" width="100%" role="img" '
        f'aria-label="{escape(title)}">'
        f"{''.join(lines)}</svg><figcaption>{escape(title)}: {low:.3g} to {high:.3g}, {end:.1f} s"
        "</figcaption></figure>"
    )
