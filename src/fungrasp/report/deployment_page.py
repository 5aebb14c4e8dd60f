"""A page about a deployment, made from its log: phases, lateness, motion of palm, hand and object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from fungrasp.deployment.log import RecordedDeployment
from fungrasp.errors import FungraspError
from fungrasp.files import atomic_path
from fungrasp.hands import load_hand
from fungrasp.plots import PlotLine, PlotPanel, panels_svg
from fungrasp.report.page_parts import Quantity, badge, document, provenance_footer, quality_card


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
    phases = _begun([message["phase"] for message in setpoints], time)
    parts = [
        f"<h1>Deployment</h1><p>{verdict}</p>",
        quality_card(quality, "In figures"),
        _phases(phases),
        _plots(
            log,
            phases,
            time,
            {"palm": palm, "height": height, "late": late},
            (arm, arm_seen),
            (hand, hand_seen),
        ),
        provenance_footer(log.about),
    ]
    path = Path(path)
    with atomic_path(path) as temporary:
        temporary.write_text(document("Deployment", parts), encoding="utf-8")
    return path


def _begun(names: Sequence[str], time: np.ndarray) -> list[tuple[float, str]]:
    """Start [s] and name of each phase."""
    found: list[tuple[float, str]] = []
    for name, when in zip(names, time, strict=True):
        if not found or name != found[-1][1]:
            found.append((float(when), name))
    return found


def _phases(phases: Sequence[tuple[float, str]]) -> str:
    """A table of phases and when they began."""
    rows = [
        f'<tr><th scope="row">{escape(name)}</th><td class="number">{when:.2f} s</td></tr>'
        for when, name in phases
    ]
    return f'<section class="card"><h3>Phases</h3><table class="quality">{"".join(rows)}</table></section>'


def _plots(
    log: RecordedDeployment,
    phases: Sequence[tuple[float, str]],
    time: np.ndarray,
    curves: Mapping[str, np.ndarray],
    arm: tuple[np.ndarray, np.ndarray],
    hand: tuple[np.ndarray, np.ndarray],
) -> str:
    """Palm, object, hand and arm over time.

    Args:
        log: what is shown.
        phases: start [s] and name of each.
        time: of the setpoints [s], shape [N].
        curves: "palm" [m], shape [N, 3]; "height" of the object's origin [m], shape [N]; "late" [ms], of
            each control step.
        arm, hand: joints as told and as measured [rad], shape [N, J] each.
    """

    def panel(title: str, y: str, lines: Sequence[PlotLine]) -> PlotPanel:
        return PlotPanel(title, "time [s]", y, lines, phases)

    def joints(values: np.ndarray, names: Sequence[str]) -> list[PlotLine]:
        return [PlotLine(time, column, name) for column, name in zip(values.T, names, strict=True)]

    fingers, bones = _joint_names(log, hand[0].shape[1]), [f"joint {j + 1}" for j in range(arm[0].shape[1])]
    steps = np.linspace(0.0, float(time[-1]), len(curves["late"]))
    panels = [
        panel("Palm: setpoint", "place [m]", joints(curves["palm"], ("x", "y", "z"))),
        panel("Tracked object: height of its origin", "height [m]", [PlotLine(time, curves["height"])]),
        panel("Hand: setpoints", "angle [rad]", joints(hand[0], fingers)),
        panel("Hand: setpoint less measured", "angle [rad]", joints(hand[0] - hand[1], fingers)),
        panel("Arm: setpoint less measured", "angle [rad]", joints(arm[0] - arm[1], bones)),
        panel("Lateness of control steps", "time [ms]", [PlotLine(steps, curves["late"])]),
    ]
    return f"<figure>{panels_svg(panels)}</figure>"


def _joint_names(log: RecordedDeployment, count: int) -> list[str]:
    """Of the driven joints of the hand, by numbers where the hand is not known."""
    try:
        names = [] if log.plan is None else list(load_hand(log.plan.hand).actuators)
    except FungraspError:
        names = []
    return names if len(names) == count else [f"joint {j + 1}" for j in range(count)]
