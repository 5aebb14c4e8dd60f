"""The tab in which a grasp is tried: an episode is planned, played and watched."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import Trajectory
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.policies import default_policy
from fungrasp.policies.registry import REFERENCE
from fungrasp.viewer.episode_stage import EpisodePlayer, EpisodeScene, place_in_front
from fungrasp.viewer.live_episode import EpisodeEnd, EpisodeSettings, LiveEpisode
from fungrasp.viewer.page import BrowserPage

if TYPE_CHECKING:
    from fungrasp.viewer.episode_states import EpisodeState

STIFFNESS = 40.0
"""Force with which a drag of the mouse pulls at the object [N/m]."""

STRONGEST = 6.0
"""The largest such force [N]."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A grasp to be tried."""

    hand: Hand
    """The robot hand."""
    model: ObjectModel
    """The object."""
    grasp: RobotGraspSet
    """A single one."""


class EpisodeTab:
    """Controls of an episode. What is tried is asked for when it begins."""

    def __init__(self, page: BrowserPage, trial: Callable[[], Trial], begin: Callable[[], None]):
        """
        Args:
            page: that it is a part of.
            trial: gives the grasp to be tried.
            begin: called when the scene is about to change to the episode's.
        """
        self._page, self._trial, self._begin = page, trial, begin
        self._episode: LiveEpisode | None = None
        self._end: EpisodeEnd | None = None
        self._stopped = False
        gui = page.client.gui
        self._start = gui.add_button("Play", hint="Plan the grasp and play it in simulation")
        self._stop = gui.add_button("Stop", visible=False)
        with gui.add_folder("World", expand_by_default=False):
            self._policy = gui.add_dropdown(
                "Policy", [REFERENCE, "student", "teacher"], hint="What moves the hand"
            )
            self._rollouts = gui.add_checkbox(
                "Rollouts", False, hint="Try candidate plans first; takes longer"
            )
            self._mass = gui.add_slider("Mass, factor", 0.25, 4.0, 0.05, 1.0)
            self._friction = gui.add_slider("Friction", 0.2, 1.5, 0.05, 1.0)
            self._shift = gui.add_slider("Pose error [mm]", 0, 40, 1, 0)
            self._turn = gui.add_slider("Pose error [°]", 0, 40, 1, 0)
            self._seed = gui.add_number("Seed", 0, min=0, step=1)
            self._speed = gui.add_slider(
                "Speed", 0.25, 4.0, 0.25, 1.0, hint="Seconds of the episode in a second"
            )
        self.player = EpisodePlayer(page)
        """What shows it."""
        self._film = gui.add_button("Save film (.mp4)", disabled=True)
        self._start.on_click(lambda _: page.worker.ask("episode", self._run))
        self._stop.on_click(lambda _: self.stop())
        self._film.on_click(lambda _: page.worker.ask("film", self._save_film))

    def choose_policy(self, hand: Hand) -> None:
        """Take the best policy that comes with a hand."""
        self._policy.value = REFERENCE if default_policy(hand.name) == REFERENCE else "student"

    def stop(self) -> None:
        """End an episode that runs."""
        self._stopped = True

    def _run(self) -> None:
        trial, page = self._trial(), self._page
        nominal_friction = 1.0
        friction = float(self._friction.value)
        settings = EpisodeSettings(
            policy=self._policy.value,
            mass=float(self._mass.value),
            friction=None if friction == nominal_friction else friction,
            position_error=1e-3 * float(self._shift.value),
            rotation_error=float(np.radians(self._turn.value)),
            rollouts=bool(self._rollouts.value),
            seed=int(self._seed.value),
        )
        self._begin()
        self._stopped, self._end = False, None
        self._start.visible, self._stop.visible, self._film.disabled = False, True, True
        episode = LiveEpisode(trial.hand, trial.model, trial.grasp, settings)
        place = place_in_front(trial.grasp.object_rest_pose[0])
        with page.client.atomic():
            scene = EpisodeScene(page.client.scene, "/episode", place, trial.hand, trial.model)
        self._let_push(scene, episode)
        self.player.begin(scene, episode.frames)
        self._episode = episode
        begun: float | None = None

        def watch(frame: EpisodeState) -> bool:
            nonlocal begun
            now = time.perf_counter()
            begun = now - frame.time if begun is None else begun
            ahead = frame.time / float(self._speed.value) - (now - begun)
            if ahead > 0:
                time.sleep(min(ahead, 0.2))
            else:
                begun -= ahead
            self.player.live(frame)
            return not (self._stopped or page.worker.closed or page.worker.busy)

        try:
            self._end = episode.run(lambda words: self._say(f"*{words} …*"), watch)
        finally:
            if not page.worker.closed:
                self._start.visible, self._stop.visible = True, False
                self.player.finish()
        if self._end is None:
            self._say("stopped")
        else:
            self._say("**lifted and held**" if self._end.success else f"**failed: {self._end.reason}**")
            self._film.disabled = False

    def _say(self, words: str) -> None:
        if not self._page.worker.closed:
            self.player.status.content = words

    def _let_push(self, scene: EpisodeScene, episode: LiveEpisode) -> None:
        """Let the mouse pull at the object."""

        async def pull(event: Any) -> None:
            away = np.subtract(event.end_position, event.start_position)
            size = max(float(np.linalg.norm(away)), 1e-9)
            force = min(STIFFNESS * size, STRONGEST) * away / size
            episode.push = np.zeros(3) if event.phase == "end" else force

        for surface in scene.object.surfaces:
            surface.on_drag(pull)

    def _save_film(self) -> None:
        from fungrasp.media.episode_film import episode_film
        from fungrasp.media.video import write_video

        episode, end = self._episode, self._end
        if episode is None or end is None:
            raise FungraspError("there is no episode yet")
        trajectory: Trajectory | None = self.player.trajectory(episode.model.mass, end.success, end.reason)
        assert trajectory is not None
        self._page.note("the film is being drawn; it takes some seconds")
        title = f"{episode.hand.name}, {episode.model.name}"
        with TemporaryDirectory() as folder:
            frames = episode_film(trajectory, episode.hand, episode.model, title=title, threads=1)
            content = write_video(Path(folder) / "film.mp4", frames, 15.0).read_bytes()
        self._page.client.send_file_download(f"{episode.model.name}-{episode.hand.name}.mp4", content)
