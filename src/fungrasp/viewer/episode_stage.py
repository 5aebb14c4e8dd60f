"""An episode in a page: its states, the scene at any time, and plots."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fungrasp.evaluation import Trajectory
from fungrasp.evaluation.trajectory import PHASES
from fungrasp.geometry.poses import relative
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.optimization.link_contacts import LinkDistances
from fungrasp.viewer.figures import ContactMarks, ObjectFigure, RobotFigure
from fungrasp.viewer.page import BrowserPage

if TYPE_CHECKING:
    from viser import SceneApi


@dataclass(frozen=True, eq=False)
class EpisodeState:
    """A state of an episode with a hand of M joints and L links, world frame."""

    time: float
    """Time since the start of the episode [s]."""
    phase: str
    """Name of the phase."""
    object_pose: np.ndarray
    """Object pose, shape [7]."""
    palm_pose: np.ndarray
    """Palm pose, shape [7]."""
    joints: np.ndarray
    """All joints [rad], shape [M]."""
    contacts: np.ndarray
    """Links that touch the object, shape [L] bool."""
    forces: np.ndarray | None = None
    """Net force of each link on the object [N], shape [L]; None if unknown."""
    commanded_palm: np.ndarray | None = None
    """Setpoint of the palm, shape [7]."""
    commanded_joints: np.ndarray | None = None
    """Setpoints of all joints [rad], shape [M]."""
    estimated_contacts: np.ndarray | None = None
    """Links that touch according to the policy's estimate, shape [L] bool."""


@dataclass(frozen=True, eq=False)
class Curves:
    """Plotted quantities over the time of an episode, F values each."""

    time: np.ndarray
    """Time [s]."""
    height: np.ndarray
    """Height of the object above its initial height [mm]."""
    slip: np.ndarray
    """Displacement of the object in the hand since the start of the lift [mm]; zero before the lift and after
    the hold."""
    force: np.ndarray
    """Sum of the forces on the object [N]; NaN if unknown."""
    palm_error: np.ndarray
    """Distance of the palm from its setpoint [mm]; NaN if unknown."""


class EpisodeStates:
    """States of an episode; a simulation may add states while a page reads them."""

    def __init__(self) -> None:
        self._frames: list[EpisodeState] = []
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> EpisodeState:
        return self._frames[index]

    def add(self, frame: EpisodeState) -> None:
        """Add the next state."""
        with self._lock:
            self._frames.append(frame)

    def index_at(self, time: float) -> int:
        """Return the index of the last state at or before a time [s]."""
        times = [frame.time for frame in self._frames]
        return max(int(np.searchsorted(times, time + 1e-6, side="right")) - 1, 0)

    def curves(self) -> Curves:
        """Return the plotted quantities."""
        with self._lock:
            frames = list(self._frames)
        time = np.array([frame.time for frame in frames])
        placed = np.array([frame.object_pose for frame in frames])
        palms = np.array([frame.palm_pose for frame in frames])
        held = relative(palms, placed)[:, :3]
        # Putting the object down after the hold is not slip.
        lifted = np.flatnonzero([frame.phase not in ("approach", "close") for frame in frames])
        slip = np.zeros(len(frames))
        if len(lifted):
            slip[lifted] = np.linalg.norm(held[lifted] - held[lifted[0]], axis=1)
        force = np.array([np.nan if f.forces is None else f.forces.sum() for f in frames])
        off = [
            np.nan if f.commanded_palm is None else np.linalg.norm(f.commanded_palm[:3] - f.palm_pose[:3])
            for f in frames
        ]
        return Curves(time, 1e3 * (placed[:, 2] - placed[0, 2]), 1e3 * slip, force, 1e3 * np.array(off))

    def as_trajectory(
        self, hand: str, object_name: str, mass: float, success: bool, reason: str
    ) -> Trajectory:
        """Return the episode as ``evaluate`` records it, without the simulation state."""
        frames = list(self._frames)
        return Trajectory(
            hand=hand,
            object_name=object_name,
            object_mass=mass,
            index=0,
            success=success,
            reason=reason,
            times=np.array([f.time for f in frames]),
            qpos=np.zeros((len(frames), 0)),
            wrist_reference=np.array([0.0, 0, 0, 1, 0, 0, 0]),
            object_pose=np.array([f.object_pose for f in frames]),
            palm_pose=np.array([f.palm_pose for f in frames]),
            joint_positions=np.array([f.joints for f in frames]),
            link_contacts=np.array([f.contacts for f in frames]),
            phase=np.array([PHASES.index(f.phase) for f in frames]),
        )


def recorded_states(trajectory: Trajectory) -> EpisodeStates:
    """Return the states of a recorded episode."""
    frames = EpisodeStates()
    for i, seconds in enumerate(trajectory.times):
        frames.add(
            EpisodeState(
                float(seconds),
                PHASES[int(trajectory.phase[i])],
                trajectory.object_pose[i].astype(float),
                trajectory.palm_pose[i].astype(float),
                trajectory.joint_positions[i].astype(float),
                trajectory.link_contacts[i],
            )
        )
    return frames


PLOT_PERIOD = 0.5
"""Update period of the plots while an episode runs [s]."""

PICTURE_PERIOD = 1 / 25
"""Update period of the scene [s]."""


class EpisodeScene:
    """Scene with hand, commanded hand, object and forces."""

    def __init__(self, scene: SceneApi, name: str, place: np.ndarray, hand: Hand, model: ObjectModel):
        """
        Args:
            name: name of the root node.
            place: position of the root node [m], shape [3].
        """
        self.hand, self.model = hand, model
        self._root = scene.add_frame(name, show_axes=False, position=place)
        self._hand = RobotFigure(scene, f"{name}/hand", hand)
        self._told = RobotFigure(scene, f"{name}/commanded", hand, opacity=0.25)
        self.object = ObjectFigure(scene, f"{name}/object", model)
        self._marks = ContactMarks(scene, f"{name}/object")
        self._distances = LinkDistances(hand, model)
        self.show_commanded, self.show_forces, self.show_estimates = True, True, False

    def show(self, frame: EpisodeState) -> None:
        """Show a state."""
        self._hand.place(frame.palm_pose, frame.joints)
        self.object.place(frame.object_pose)
        estimated = frame.estimated_contacts if self.show_estimates else None
        self._hand.paint(frame.contacts, estimated)
        told = self.show_commanded and frame.commanded_palm is not None
        self._told.show(told)
        if told and frame.commanded_palm is not None and frame.commanded_joints is not None:
            self._told.place(frame.commanded_palm, frame.commanded_joints)
        if not self.show_forces or frame.forces is None or not frame.forces.any():
            self._marks.forces(np.zeros((1, 3)), np.zeros((1, 3)))
            return
        # Magnitudes are from the simulation, directions are surface normals at the nearest points.
        touch = self._distances.of(frame.palm_pose, frame.joints, frame.object_pose)
        self._marks.forces(touch.place, frame.forces[:, None] * touch.inward)

    def remove(self) -> None:
        """Remove the nodes from the scene."""
        self._marks.clear()
        self._root.remove()


class EpisodePlayer:
    """Controls and plots of an episode, in a tab of a page."""

    def __init__(self, page: BrowserPage):
        self._page, gui = page, page.client.gui
        self._scene: EpisodeScene | None = None
        self._frames = EpisodeStates()
        self._plotted = self._shown = 0.0
        self._playing = False
        self._syncing = False
        self.status = gui.add_markdown("")
        """Current activity or outcome."""
        self._time = gui.add_slider("Time [s]", 0.0, 10.0, 0.02, 0.0, disabled=True)
        self._play = gui.add_button("Play again", disabled=True)
        self._commanded = gui.add_checkbox("Commanded hand", True, hint="Where the hand was told to be")
        self._forces = gui.add_checkbox("Contact forces", True, hint="1.5 cm of arrow for 1 N")
        self._estimates = gui.add_checkbox(
            "Policy's estimated contacts",
            False,
            hint="Orange: touches, and the policy knows. Pink: only it says so. Yellow: it does not know",
        )
        empty = np.zeros(2)
        self._motion_plot = gui.add_uplot(
            (empty, empty, empty, empty), _series("height [mm]", "slip [mm]", "palm off [mm]"), **_style("mm")
        )
        self._force_plot = gui.add_uplot((empty, empty), _series("force on the object [N]"), **_style("N"))
        self._time.on_update(lambda _: self._scrub())
        self._play.on_click(lambda _: self._toggle())
        for box in (self._commanded, self._forces, self._estimates):
            box.on_update(lambda _: self._scrub())

    def begin(self, scene: EpisodeScene, frames: EpisodeStates) -> None:
        """Start showing an episode."""
        if self._scene is not None and self._scene is not scene:
            self._scene.remove()
        self._scene, self._frames = scene, frames
        self._playing = False
        self._time.disabled = self._play.disabled = True

    def live(self, frame: EpisodeState) -> None:
        """Show the newest state, at most once per ``PICTURE_PERIOD``."""
        now = time.perf_counter()
        if now - self._shown >= PICTURE_PERIOD:
            self._shown = now
            self._show(frame)
        if now - self._plotted >= PLOT_PERIOD and len(self._frames) > 1:
            self._plotted = now
            self._plot(self._frames.curves())

    def finish(self) -> None:
        """Enable replay at the end of an episode."""
        if not len(self._frames):
            return
        last = self._frames[len(self._frames) - 1]
        self._syncing = True
        self._time.max = max(last.time, 0.02)
        self._time.value = last.time
        self._syncing = False
        self._time.disabled = self._play.disabled = False
        self._plot(self._frames.curves())
        self._show(last)

    def go_to(self, time: float) -> None:
        """Show the state at a time [s]."""
        self._playing = False
        self._time.value = min(time, float(self._time.max))
        self._page.worker.ask("scrub", self._show_time)

    def trajectory(self, mass: float, success: bool, reason: str) -> Trajectory | None:
        """Return the episode for a video, or None."""
        if self._scene is None or not len(self._frames):
            return None
        return self._frames.as_trajectory(
            self._scene.hand.name, self._scene.model.name, mass, success, reason
        )

    def clear(self) -> None:
        """Remove the episode from the scene."""
        self._playing = False
        if self._scene is not None:
            self._scene.remove()
        self._scene = None

    def _scrub(self) -> None:
        if not self._syncing and not self._playing:
            self._page.worker.ask("scrub", self._show_time)

    def _show_time(self) -> None:
        if len(self._frames):
            self._show(self._frames[self._frames.index_at(float(self._time.value))])

    def _toggle(self) -> None:
        if self._playing:
            self._playing = False
            return
        self._playing = True
        self._page.worker.ask("replay", self._replay)

    def _replay(self) -> None:
        end = self._frames[len(self._frames) - 1].time
        self._play.label = "Pause"
        begin = float(self._time.value)
        begin = 0.0 if begin > end - 0.1 else begin
        start = time.perf_counter()
        # Any other job ends the replay.
        while self._playing and not self._page.worker.closed and not self._page.worker.busy:
            now = begin + time.perf_counter() - start
            self._show(self._frames[self._frames.index_at(now)])
            self._syncing = True
            self._time.value = round(min(now, end), 2)
            self._syncing = False
            if now >= end:
                break
            time.sleep(PICTURE_PERIOD)
        self._playing = False
        self._play.label = "Play again"

    def _show(self, frame: EpisodeState) -> None:
        if self._scene is None:
            return
        self._scene.show_commanded = self._commanded.value
        self._scene.show_forces = self._forces.value
        self._scene.show_estimates = self._estimates.value
        with self._page.client.atomic():
            self._scene.show(frame)

    def _plot(self, curves: Curves) -> None:
        step = max(len(curves.time) // 400, 1)
        some = slice(None, None, step)
        self._motion_plot.data = (
            curves.time[some],
            curves.height[some],
            curves.slip[some],
            np.nan_to_num(curves.palm_error[some]),
        )
        # Recordings have no forces.
        self._force_plot.visible = bool(np.isfinite(curves.force).any())
        self._force_plot.data = (curves.time[some], np.nan_to_num(curves.force[some]))


def place_in_front(object_pose: np.ndarray) -> np.ndarray:
    """Return the position of a scene that centers its object [m], shape [3]."""
    return np.array([-object_pose[0], -object_pose[1], 0.0])


def _series(*names: str) -> tuple[Any, ...]:
    colors = ("#1f77b4", "#d62728", "#7f7f7f")
    lines = [{"label": name, "stroke": color, "width": 2} for name, color in zip(names, colors, strict=False)]
    return ({"label": "time [s]"}, *lines)


def _style(unit: str) -> dict[str, Any]:
    return {
        "axes": ({"label": "time [s]"}, {"label": unit}),
        "scales": {"x": {"time": False}},
        "aspect": 1.6,
        "padding": (14, 24, 0, 0),
        "legend": {"show": True, "live": True},
    }
