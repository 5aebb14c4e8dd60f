"""The reference controller: opens, approaches, closes, squeezes, lifts; after its start it does not look at
the object again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fungrasp.geometry.poses import compose, rotate
from fungrasp.objects import ObjectModel
from fungrasp.policies.adapt import AdaptSettings, adapt
from fungrasp.policies.approach import ApproachSettings, Path, plan_approach
from fungrasp.policies.squeeze import squeeze_torques
from fungrasp.retarget.problem import Surroundings
from fungrasp.task import Action, LiftTask


@dataclass(frozen=True)
class ReferenceSettings:
    """How the reference controller moves."""

    force: float = 5.0
    """Sum of the normal forces to squeeze a light object with [N]."""
    force_per_kg: float = 80.0
    """More of it for each kilogram of the object [N/kg]."""
    squeeze_limit: float = 0.6
    """Largest offset of a joint's servo target from the grasp [rad]."""
    close_time: float = 0.6
    """[s]."""
    squeeze_time: float = 0.6
    """[s]."""
    pause: float = 0.2
    """Before the lift [s]."""
    press_down: float = 0.006
    """How far the wrist goes below its target while the fingers close, as the fingers yield upwards [m]."""
    press_in: float = 0.008
    """How far it goes beyond its target along the palm's normal [m]."""
    lookahead: float = 0.06
    """How far ahead on its way the wrist aims [m]."""
    adapt: AdaptSettings = AdaptSettings()
    approach: ApproachSettings = ApproachSettings()


class ReferenceController:
    """Plays retargeted grasps in W worlds.

    A grasp's ``extra`` may hold its own ``force_scale``, ``press_in`` and ``press_down`` (see ``refine``).
    """

    def __init__(
        self, task: LiftTask, objects: Mapping[str, ObjectModel], settings: ReferenceSettings | None = None
    ):
        """
        Args:
            task: reset; the grasps come from it.
            objects: by name.
            settings: the defaults if None.
        """
        self._task, self.settings = task, settings or ReferenceSettings()
        hand, grasps, s = task.scene.hand, task.grasps, self.settings
        names = grasps.object_name.tolist()
        self._wrist, self._grasp = adapt(
            hand,
            grasps,
            objects,
            task.settled_pose,
            task.wrist_in_object,
            task.independent(grasps.joint_positions),
            s.adapt,
        )
        target = compose(task.settled_pose, self._wrist)
        approach = plan_approach(
            hand, names, task.settled_pose, objects, self._wrist, self._grasp, s.approach
        )
        self.collision = approach.collision
        """Deepest intrusion of the planned way into the margins [m], shape [W]."""
        self._path = Path(task.set_point.pose, task.finger_set_point, approach, task.settled_pose)
        self._squeeze = self._servo_offsets(hand, names, objects)
        self._closing_pose = target.copy()
        press_in, press_down = (
            self._setting("press_in", s.press_in),
            self._setting("press_down", s.press_down),
        )
        self._closing_pose[:, :3] += press_in * rotate(target[:, 3:], hand.palm_normal)
        self._closing_pose[:, 2:3] -= press_down
        self._arrived = np.full(len(names), np.inf)

    def act(self) -> Action:
        """What to do in the next control period."""
        task, path, s = self._task, self._path, self.settings
        path.advance(task.set_point.pose[:, :3], s.lookahead)
        goal, _ = path.at(path.progress + s.lookahead)
        _, fingers = path.at(path.progress + 0.02)
        close = path.length - path.progress < 2e-3
        self._arrived = np.where(close & ~np.isfinite(self._arrived), task.time, self._arrived)
        since = np.where(np.isfinite(self._arrived), task.time - self._arrived, -1.0)[:, None]
        closing = np.clip((since + task.protocol.control_period) / s.close_time, 0.0, 1.0)
        squeezing = np.clip((since + task.protocol.control_period - s.close_time) / s.squeeze_time, 0.0, 1.0)
        goal = np.where(closing > 0, self._closing_pose, goal)
        fingers = fingers + closing * (self._grasp - fingers) + squeezing * self._squeeze
        lift = since[:, 0] >= s.close_time + s.squeeze_time + s.pause
        return Action(goal, fingers, lift)

    def _setting(self, name: str, default: float) -> np.ndarray:
        """A number that refinement may have set for each grasp, shape [W, 1]."""
        grasps = self._task.grasps
        return np.asarray(grasps.extra.get(name, np.full(len(grasps), default)))[:, None]

    def _servo_offsets(self, hand, names: list[str], objects: Mapping[str, ObjectModel]) -> np.ndarray:
        """Of the joints' servo targets, that make the torques of the squeeze [rad], shape [W, U]."""
        task, s = self._task, self.settings
        around = Surroundings.settled(names, task.settled_pose, objects)
        models = [objects[name] for name in names]
        torques = squeeze_torques(hand, around, models, self._wrist, self._grasp, task.grasps.link_contacts)
        force = self._setting("force_scale", 1.0)[:, 0] * (s.force + s.force_per_kg * task.grasps.object_mass)
        stiffness = np.array([servo.kp for servo in hand.actuators.values()])
        return np.clip(force[:, None] * torques / stiffness, -s.squeeze_limit, s.squeeze_limit)
