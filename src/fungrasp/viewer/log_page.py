"""Page of a deployment log: motion of hand and object, setpoints, events."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.plots import PlotLine, PlotPanel, panels_svg
from fungrasp.deployment.log import RecordedDeployment
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import load_object
from fungrasp.robots.cell import load_cell
from fungrasp.robots.kinematics.arm_model import ArmKinematics
from fungrasp.viewer.episode_stage import (
    EpisodePlayer,
    EpisodeScene,
    EpisodeState,
    EpisodeStates,
    place_in_front,
)
from fungrasp.viewer.page import BrowserPage, add_table, look_at

if TYPE_CHECKING:
    from viser import ClientHandle

WIDE_MODAL = "<style>.mantine-Modal-content { flex-basis: min(62em, 96vw) !important; }</style>"
"""Widens viser's modals, which are too narrow for curves."""

PHASES = {"approach": "approach", "lift": "lift", "hold": "hold"}
"""Phases of a deployment that episodes have too; other phases count as approach."""


def check_log(log: RecordedDeployment, path: Path) -> None:
    """Check that a log can be shown.

    Raises:
        FungraspError: the log has no plan or no setpoints.
    """
    if log.plan is None:
        raise FungraspError(f"{path} ends before a plan was made: there is nothing to show")
    if not log.messages["/setpoint"]:
        raise FungraspError(f"{path} holds no setpoint: there is nothing to show")


class LogPage(BrowserPage):
    """Page of a deployment."""

    def __init__(self, client: ClientHandle, log: RecordedDeployment):
        """
        Args:
            log: a log with a plan and setpoints.
        """
        super().__init__(client)
        self._log = log
        add_table(client, 2.0)
        about = "\n".join(f"- {name}: {value}" for name, value in log.about.items())
        whole = "" if log.complete else "\n\n**It breaks off: its writer was killed, or the disk was full.**"
        client.gui.add_markdown(f"**Deployment**{whole}\n\n{about}")
        self._events = client.gui.add_dropdown("Event", ["none"], hint="Jump to where it happened")
        curves = client.gui.add_button("Curves", hint="Setpoints, what was measured, lateness")
        curves.on_click(lambda _: self.worker.ask("curves", self._show_curves))
        self._player = EpisodePlayer(self)
        self._events.on_update(lambda _: self._jump())
        self._times: dict[str, float] = {}
        self.worker.ask("show", self._show)

    def _show(self) -> None:
        log = self._log
        plan = log.plan
        assert plan is not None
        hand, name = load_hand(plan.hand), str(plan.object_name[0])
        frames, start = logged_states(log, hand, plan.object_pose[0], _measured_palm(log, hand))
        look_at(self.client, (0.0, 0.0, 0.15), 0.9)
        try:
            model = load_object(name)
        except FungraspError as error:
            raise FungraspError(f"the object of the log is no built-in one ({error})") from error
        with self.client.atomic():
            place = place_in_front(plan.object_pose[0])
            scene = EpisodeScene(self.client.scene, "/deployment", place, hand, model)
        self._player.begin(scene, frames)
        self._player.finish()
        held = [frames[i].time for i in range(len(frames)) if frames[i].phase == "hold"]
        if held:
            self._player.go_to(held[-1])
        fault = _fault(log)
        self._player.status.content = f"**fault: {fault}**" if fault else "no fault"
        for event in log.messages["/event"]:
            time = max(float(event["time"]) - start, 0.0)
            self._times[f"{time:.1f} s {event['what']}: {event['text']}"] = time
        self._events.options = ["none", *self._times]

    def _show_curves(self) -> None:
        gui = self.client.gui
        with gui.add_modal("Curves") as modal:
            close = gui.add_button("Close")
            gui.add_html(WIDE_MODAL + curves(self._log))
        close.on_click(lambda _: modal.close())

    def _jump(self) -> None:
        time = self._times.get(str(self._events.value))
        if time is not None:
            self._player.go_to(time)


def logged_states(
    log: RecordedDeployment,
    hand: Hand,
    object_pose: np.ndarray,
    measured_palm: Callable[..., np.ndarray] | None,
) -> tuple[EpisodeStates, float]:
    """Return the states of a log and the time of its first setpoint.

    Args:
        log: a log with setpoints.
        object_pose: object pose before tracking, shape [7].
        measured_palm: function from arm joints to the palm pose; the palm is shown at its setpoints if None.
    """
    setpoints = log.messages["/setpoint"]
    start = float(setpoints[0]["time"])
    frames, pose = EpisodeStates(), np.asarray(object_pose, dtype=float)
    for message in setpoints:
        told = np.asarray(message["sent"]["palm"], dtype=float)
        palm = (
            told if measured_palm is None else measured_palm(np.asarray(message["arm"]["positions"], float))
        )
        pose = pose if message["object"] is None else np.asarray(message["object"], dtype=float)
        frames.add(
            EpisodeState(
                float(message["time"]) - start,
                PHASES.get(str(message["phase"]), "approach"),
                pose,
                palm,
                hand.all_joints(np.asarray(message["hand"]["positions"], dtype=float)),
                np.zeros(len(hand.links), dtype=bool),
                commanded_palm=None if measured_palm is None else told,
                commanded_joints=hand.all_joints(np.asarray(message["sent"]["hand"], dtype=float)),
            )
        )
    return frames, start


def _measured_palm(log: RecordedDeployment, hand: Hand) -> Callable[..., np.ndarray] | None:
    """Return the forward kinematics of the log's arm, or None if its cell can't be loaded."""
    try:
        return ArmKinematics(load_cell(str(log.about.get("cell", ""))), hand).palm_pose
    except FungraspError:
        return None


def _fault(log: RecordedDeployment) -> str:
    """Return the first fault of a deployment, or ""."""
    return next((str(e["text"]) for e in log.messages["/event"] if e["what"] == "fault"), "")


def curves(log: RecordedDeployment) -> str:
    """Plot palm, object, hand, arm and lateness over time as SVG. log: a log with setpoints."""
    setpoints, phases = log.messages["/setpoint"], _phases(log)
    time = _times(log)
    (arm, arm_seen), (hand, hand_seen), late = _joints(log, "arm"), _joints(log, "hand"), _lateness(log)
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
    """Return the times of setpoints since the first one [s], shape [N]."""
    times = np.array([message["time"] for message in log.messages["/setpoint"]])
    return times - times[0]


def _joints(log: RecordedDeployment, part: str) -> tuple[np.ndarray, np.ndarray]:
    """Return commanded and measured joints of "arm" or "hand" [rad], shape [N, J] each."""
    setpoints = log.messages["/setpoint"]
    told = [message["sent"][part] for message in setpoints]
    return np.array(told), np.array([message[part]["positions"] for message in setpoints])


def _lateness(log: RecordedDeployment) -> np.ndarray:
    """Return the lateness of each control step [ms]."""
    return 1e3 * np.array([step["late"] for step in log.messages["/step"]] or [0.0])


def _phases(log: RecordedDeployment) -> list[tuple[float, str]]:
    """Return start [s] and name of each phase."""
    found: list[tuple[float, str]] = []
    for message, when in zip(log.messages["/setpoint"], _times(log), strict=True):
        if not found or message["phase"] != found[-1][1]:
            found.append((float(when), str(message["phase"])))
    return found


def _names(log: RecordedDeployment, count: int) -> list[str]:
    """Return names of the hand's driven joints, or numbers if the hand is unknown."""
    try:
        names = [] if log.plan is None else list(load_hand(log.plan.hand).actuators)
    except FungraspError:
        names = []
    return names if len(names) == count else [f"joint {j + 1}" for j in range(count)]
