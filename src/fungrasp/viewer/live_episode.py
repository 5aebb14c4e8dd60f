"""One episode that is planned and simulated while somebody watches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionSettings, make_planner
from fungrasp.planning.selection import SelectionSettings
from fungrasp.policies import StudentPolicy, make_policy
from fungrasp.sim2real import NOMINAL, MeasurementError, Randomization
from fungrasp.sim2real.episode_sample import draw_each
from fungrasp.simulation import build_scene
from fungrasp.task import Action, LiftEnvironment, PrivilegedPolicy
from fungrasp.viewer.episode_states import EpisodeState, EpisodeStates


@dataclass(frozen=True)
class EpisodeSettings:
    """How the world differs from what is planned for."""

    policy: str = "reference"
    """Name or file of what moves the hand."""
    mass: float = 1.0
    """Factor on the mass of the object."""
    friction: float | None = None
    """Sliding friction of hand, object and table; the nominal one if None."""
    position_error: float = 0.0
    """Distance between where the object is and where it is seen [m], in a direction drawn by the seed."""
    rotation_error: float = 0.0
    """Angle between how it lies and how it is seen to [rad], about an axis drawn by the seed."""
    rollouts: bool = False
    """Whether a planner that chooses among candidates tries them in simulation first: it takes longer."""
    seed: int = 0
    """Of everything that is drawn."""

    @property
    def randomization(self) -> Randomization:
        """The same as what worlds are drawn from."""
        return replace(
            NOMINAL,
            mass=(self.mass, self.mass),
            friction=None if self.friction is None else (self.friction, self.friction),
            object_position_error=MeasurementError(offset=self.position_error),
            object_rotation_error=MeasurementError(offset=self.rotation_error),
        )


@dataclass(frozen=True)
class EpisodeEnd:
    """How an episode ended."""

    success: bool
    """Whether the object was lifted and held."""
    reason: str
    """Why not; "" on success."""


class LiveEpisode:
    """Plans and plays one grasp. ``push`` may be set while it runs."""

    def __init__(self, hand: Hand, model: ObjectModel, grasp: RobotGraspSet, settings: EpisodeSettings):
        """
        Args:
            hand: the robot hand.
            model: the object.
            grasp: of it, a single one.
            settings: of the world.
        """
        self.hand, self.model, self._grasp, self._settings = hand, model, grasp, settings
        self.frames = EpisodeStates()
        """What has happened so far."""
        self.push = np.zeros(3)
        """Force on the object's center of mass [N], world frame."""

    def run(self, say: Callable[[str], None], watch: Callable[[EpisodeState], bool]) -> EpisodeEnd | None:
        """Plan and play.

        Args:
            say: called with what is being done.
            watch: called with each state; False ends the episode.

        Returns:
            None where it was ended.

        Raises:
            FungraspError: no such policy, or none for the hand.
        """
        s, objects = self._settings, {self.model.name: self.model}
        r = s.randomization
        say("planning")
        policy = make_policy(s.policy, self.hand, objects)
        selection = SelectionSettings.for_protocol("nominal", s.rollouts, False)
        planner = make_planner(
            s.policy, self.hand, objects, selection, threads=1, motions=MotionSettings(for_use=False)
        )
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
