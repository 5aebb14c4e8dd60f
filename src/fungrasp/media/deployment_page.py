"""A deployment in figures and curves, from its log: a page on disk; the interactive one shows the curves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.plots import PlotLine, PlotPanel, panels_svg
from fungrasp.deployment.log import RecordedDeployment
from fungrasp.hands import load_hand
from fungrasp.media.page_parts import Quantity, badge, document, provenance_footer, quality_card


def write_deployment_page(path: str | Path, log: RecordedDeployment) -> Path:
    """Write a page that needs no other file.

    Raises:
        FungraspError: the log holds no setpoint, or the page can't be written.
    """
    setpoints, steps = log.messages["/setpoint"], log.messages["/step"]
    if not setpoints:
        raise FungraspError("the log holds no setpoint: there is nothing to show")
    fault, late = deployment_fault(log), _late(log)
    behind = _joints(log, "arm")
    quality = [
        Quantity("Control steps", len(steps)),
        Quantity("Setpoints", len(setpoints)),
        Quantity("Lateness, median", float(np.median(late)), "ms", "Of the beginning of a control step."),
        Quantity("Lateness, largest", float(late.max()), "ms", "", 20.0),
        Quantity(
            "Arm behind its setpoint",
            float(np.abs(behind[0] - behind[1]).max()),
            "rad",
            "The largest of all joints.",
        ),
    ]
    rows = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td class="number">{when:.2f} s</td></tr>'
        for when, name in _phases(log)
    )
    parts = [
        f"<h1>Deployment</h1><p>{badge('bad', fault) if fault else badge('good', 'no fault')}</p>",
        quality_card(quality, "In figures"),
        f'<section class="card"><h3>Phases</h3><table class="quality">{rows}</table></section>',
        f"<figure>{deployment_curves(log)}</figure>",
        provenance_footer(log.about),
    ]
    path = Path(path)
    with atomic_path(path) as temporary:
        temporary.write_text(document("Deployment", parts), encoding="utf-8")
    return path


def deployment_fault(log: RecordedDeployment) -> str:
    """The first fault of a deployment; "" if there was none."""
    return next((str(e["text"]) for e in log.messages["/event"] if e["what"] == "fault"), "")


def deployment_curves(log: RecordedDeployment) -> str:
    """Palm, object, hand, arm and lateness over time, as SVG. log: with setpoints."""
    setpoints, phases = log.messages["/setpoint"], _phases(log)
    time = _times(log)
    (arm, arm_seen), (hand, hand_seen), late = _joints(log, "arm"), _joints(log, "hand"), _late(log)
    palm = np.array([message["sent"]["palm"][:3] for message in setpoints])
    height = np.array([message["object"] or [np.nan] * 7 for message in setpoints])[:, 2]
    fingers, bones = _names(log, hand.shape[1]), [f"joint {j + 1}" for j in range(arm.shape[1])]

    def lines(values: np.ndarray, names: Sequence[str]) -> Iterator[PlotLine]:
        return (PlotLine(time, column, name) for column, name in zip(values.T, names, strict=True))

    panels = (
        ("Palm: setpoint", "place [m]", lines(palm, ("x", "y", "z"))),
        ("Tracked object: height of its origin", "height [m]", [PlotLine(time, height)]),
        ("Hand: setpoints", "angle [rad]", lines(hand, fingers)),
        ("Hand: setpoint less measured", "angle [rad]", lines(hand - hand_seen, fingers)),
        ("Arm: setpoint less measured", "angle [rad]", lines(arm - arm_seen, bones)),
        (
            "Lateness of control steps",
            "time [ms]",
            [PlotLine(np.linspace(0.0, float(time[-1]), len(late)), late)],
        ),
    )
    return panels_svg([PlotPanel(title, "time [s]", y, list(drawn), phases) for title, y, drawn in panels])


def _times(log: RecordedDeployment) -> np.ndarray:
    """Of the setpoints, from the first one on [s], shape [N]."""
    times = np.array([message["time"] for message in log.messages["/setpoint"]])
    return times - times[0]


def _joints(log: RecordedDeployment, part: str) -> tuple[np.ndarray, np.ndarray]:
    """Joints of "arm" or "hand" as told and as measured [rad], shape [N, J] each."""
    setpoints = log.messages["/setpoint"]
    told = [message["sent"][part] for message in setpoints]
    return np.array(told), np.array([message[part]["positions"] for message in setpoints])


def _late(log: RecordedDeployment) -> np.ndarray:
    """How late each control step began [ms]."""
    return 1e3 * np.array([step["late"] for step in log.messages["/step"]] or [0.0])


def _phases(log: RecordedDeployment) -> list[tuple[float, str]]:
    """Start [s] and name of each phase."""
    found: list[tuple[float, str]] = []
    for message, when in zip(log.messages["/setpoint"], _times(log), strict=True):
        if not found or message["phase"] != found[-1][1]:
            found.append((float(when), str(message["phase"])))
    return found


def _names(log: RecordedDeployment, count: int) -> list[str]:
    """Of the driven joints of the hand, by numbers where the hand is not known."""
    try:
        names = [] if log.plan is None else list(load_hand(log.plan.hand).actuators)
    except FungraspError:
        names = []
    return names if len(names) == count else [f"joint {j + 1}" for j in range(count)]
