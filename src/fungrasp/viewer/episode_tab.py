"""Tab that tests a grasp: plans, simulates and shows an episode."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import Trajectory
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import make_planner
from fungrasp.planning.selection.settings import SelectionSettings
from fungrasp.policies import StudentPolicy, default_policy, make_policy
from fungrasp.policies.registry import PLAN, REFERENCE
from fungrasp.sim2real import NOMINAL, MeasurementError, Randomization
from fungrasp.sim2real.episode_sample import draw_each
from fungrasp.simulation import build_scene
from fungrasp.task import Action, LiftEnvironment, PrivilegedPolicy
from fungrasp.viewer.episode_stage import (
    EpisodePlayer,
    EpisodeScene,
    EpisodeState,
    EpisodeStates,
    place_in_front,
)
from fungrasp.viewer.page import BrowserPage


@dataclass(frozen=True)
class EpisodeSettings:
    """Policy and world of an episode."""

    policy: str = "reference"
    """Name or file of the policy."""
    mass: float = 1.0
    """Factor on the mass of the object."""
    friction: float | None = None
    """Sliding friction of hand, object and table; the nominal one if None."""
    position_error: float = 0.0
    """Error of the object's estimated position [m], in a random direction."""
    rotation_error: float = 0.0
    """Error of the object's estimated rotation [rad], about a random axis."""
    rollouts: bool = False
    """Whether the planner compares candidates in rollouts, which takes longer."""
    seed: int = 0
    """Random seed."""

    @property
    def randomization(self) -> Randomization:
        """The settings as a ``Randomization``."""
        return replace(
            NOMINAL,
            mass=(self.mass, self.mass),
            friction=None if self.friction is None else (self.friction, self.friction),
            object_position_error=MeasurementError(offset=self.position_error),
            object_rotation_error=MeasurementError(offset=self.rotation_error),
        )


@dataclass(frozen=True)
class EpisodeEnd:
    """Outcome of an episode."""

    success: bool
    """Whether the object was lifted and held."""
    reason: str
    """Reason of failure; "" on success."""


class LiveEpisode:
    """Plans and simulates one grasp. ``push`` may be set while it runs."""

    def __init__(self, hand: Hand, model: ObjectModel, grasp: RobotGraspSet, settings: EpisodeSettings):
        self.hand, self.model, self._grasp, self._settings = hand, model, grasp, settings
        self.frames = EpisodeStates()
        """States so far."""
        self.push = np.zeros(3)
        """Force on the object's center of mass [N], world frame."""

    def run(self, say: Callable[[str], None], watch: Callable[[EpisodeState], bool]) -> EpisodeEnd | None:
        """Plan and simulate.

        Args:
            say: called with the current activity.
            watch: called with each state; returning False ends the episode.

        Returns:
            The outcome, or None if ``watch`` ended the episode.

        Raises:
            FungraspError: the policy is unknown or does not support this hand.
        """
        s, objects = self._settings, {self.model.name: self.model}
        r = s.randomization
        say("planning")
        policy = make_policy(s.policy, self.hand, objects)
        selection = SelectionSettings.for_protocol("nominal", s.rollouts, False)
        planner = make_planner(s.policy, self.hand, objects, selection, threads=1)
        scene = build_scene(self.hand, objects)
        environment = LiftEnvironment(scene, 1, r, rng=np.random.default_rng(s.seed), threads=1)
        sample = draw_each(r, s.seed, np.array([0]), len(self.hand.joint_names))
        belief = environment.settle(self._grasp, sample)
        plan = planner.plan(self._grasp, belief, s.seed)
        environment.move_objects()
        task, wanted = environment.task, True

        def state() -> None:
            nonlocal wanted
            frame = self._frame(environment, policy)
            self.frames.add(frame)
            environment.engine.push_object(self.push[None])
            wanted = wanted and watch(frame)

        observation = environment.observe()
        policy.reset(plan, observation)
        state()
        say("playing")
        while wanted and not task.done.all():
            action: Action
            if isinstance(policy, PrivilegedPolicy):
                action = policy.act_privileged(observation, environment.privileged())
            else:
                action = policy.act(observation)
            environment.step(action, state)
            observation = environment.observe()
        if not wanted:
            return None
        outcomes = task.outcomes()
        return EpisodeEnd(bool(outcomes.success[0]), str(outcomes.reason[0]))

    def _frame(self, environment: LiftEnvironment, policy: object) -> EpisodeState:
        task, engine, hand = environment.task, environment.engine, self.hand
        phase = (
            "hold"
            if np.isfinite(task.hold_time[0])
            else "lift"
            if np.isfinite(task.lift_time[0])
            else "approach"
        )
        estimated = None
        if isinstance(policy, StudentPolicy) and policy.estimates_contacts and len(self.frames):
            estimated = policy.outputs["contacts"][0] > 0.5
        return EpisodeState(
            time=float(task.time[0]),
            phase=phase,
            object_pose=engine.object_pose[0],
            palm_pose=engine.palm_pose[0],
            joints=engine.joint_positions[0],
            contacts=engine.link_contacts[0],
            forces=engine.link_forces[0],
            commanded_palm=task.setpoints.wrist.pose[0].copy(),
            commanded_joints=hand.all_joints(task.setpoints.fingers[0]),
            estimated_contacts=estimated,
        )


STIFFNESS = 40.0
"""Force of a mouse drag on the object per distance [N/m]."""

STRONGEST = 6.0
"""Largest force of a mouse drag [N]."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A grasp to test."""

    hand: Hand
    """The robot hand."""
    model: ObjectModel
    """The object."""
    grasp: RobotGraspSet
    """Set of one grasp."""


class EpisodeTab:
    """Controls of an episode. The grasp is requested when the episode begins."""

    def __init__(self, page: BrowserPage, trial: Callable[[], Trial], begin: Callable[[], None]):
        """
        Args:
            page: page of the tab.
            trial: returns the grasp to test.
            begin: called before the scene changes to the episode.
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
                "Policy", [REFERENCE, PLAN, "student", "teacher"], hint="What moves the hand"
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
        """Player of the episode."""
        self._film = gui.add_button("Save film (.mp4)", disabled=True)
        self._start.on_click(lambda _: page.worker.ask("episode", self._run))
        self._stop.on_click(lambda _: self.stop())
        self._film.on_click(lambda _: page.worker.ask("film", self._save_film))

    def choose_policy(self, hand: Hand) -> None:
        """Select the best policy that comes with a hand."""
        self._policy.value = PLAN if default_policy(hand.name) == PLAN else "student"

    def stop(self) -> None:
        """Stop the running episode."""
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
        """Let the mouse pull the object."""

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
