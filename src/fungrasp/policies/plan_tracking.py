"""Between a residual policy and a task: reads the worlds, follows the reference, applies actions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.poses import compose, rotation_matrix, stack
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.planning.references import References, object_tables
from fungrasp.policies.residual_action import WRIST_ACTIONS, ResidualSettings, apply, smoothed
from fungrasp.task import Action, LiftTask
from fungrasp.task.observation import Readings, Sensed, Wanted


class SensorNoise(Protocol):
    """What stands between the truth and what is measured; each method gives what is measured."""

    def joints(self, joints: np.ndarray) -> np.ndarray:
        """Joint positions [rad], shape [W, U]."""
        ...

    def palm(self, pose: np.ndarray) -> np.ndarray:
        """Palm pose, shape [W, 7]."""
        ...

    def object(self, pose: np.ndarray) -> np.ndarray:
        """Tracked object pose, shape [W, 7]."""
        ...


@dataclass(frozen=True, eq=False)
class View:
    """All that observations and rewards are made of, at one control step."""

    now: Readings
    before: Readings
    wanted: Wanted
    action: np.ndarray
    """The last one, smoothed, shape [W, A]."""


class Tracker:
    """Follows references in W worlds, each from its own beginning.

    Until the fingers close, the reference goes where the object goes; from then on it stays where it was.
    """

    def __init__(
        self,
        task: LiftTask,
        objects: Mapping[str, ObjectModel],
        references: References,
        settings: ResidualSettings | None = None,
        noise: SensorNoise | None = None,
    ):
        """
        Args:
            task: its worlds are read and, through actions, moved.
            objects: by name.
            references: to choose from.
            settings: of the actions; the defaults if None.
            noise: of the sensors; none if None.
        """
        self.task, self.references, self.noise = task, references, noise
        self.settings = settings or ResidualSettings()
        count = len(task.worlds)
        self.kinematics = HandKinematics(task.scene.hand, count)
        self._keypoints = self.kinematics.body_points(task.scene.hand.keypoint_names)
        known = task.scene.objects
        self._bank = SignedDistanceBank([objects[name].signed_distance for name in known])
        self._center, self._size = object_tables(known, objects)
        index = task.scene.indices(references.object_name.tolist())
        self._target_surface = self._bank.query(index, references.keypoints)
        self.size = WRIST_ACTIONS + self.kinematics.matrix.shape[1]
        """Numbers in an action."""
        self.rows = np.zeros(count, dtype=int)
        self.action = np.zeros((count, self.size))
        self._aims, self._closing, self._lift = self._chosen()
        self._anchor = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1))
        self._step = task.control_step
        self._before: Readings | None = None
        self._now: Readings | None = None
        # Made when first asked for after each reading.
        self._goal: tuple[np.ndarray, np.ndarray] | None = None
        self._view: View | None = None
        self._sensed: Sensed | None = None

    def begin(self, ids: np.ndarray, rows: np.ndarray) -> None:
        """Follow other references in some worlds. ids: worlds, shape [I]; rows: of the references, [I]."""
        self.rows[ids] = rows
        self.action[ids] = 0.0
        self._aims, self._closing, self._lift = self._chosen()
        self._goal = self._view = self._sensed = None
        fresh = self._read()
        self._anchor[ids] = fresh.object_pose[ids]
        if self._now is None or self._before is None:
            self._now = self._before = fresh
            return
        for kept in (self._now, self._before):
            for field in fields(Readings):
                getattr(kept, field.name)[ids] = getattr(fresh, field.name)[ids]

    def advance(self) -> None:
        """Read the worlds, once in each control step."""
        if self._now is None:
            raise RuntimeError("begin comes before advance")
        self._goal = self._view = self._sensed = None
        self._before, self._now = self._now, self._read()
        before_closing = (self._step < self._closing)[:, None]
        self._anchor = np.where(before_closing, self._now.object_pose, self._anchor)

    def view(self) -> View:
        """The worlds as they were last read, by ``begin`` or ``advance``."""
        if self._view is not None:
            return self._view
        task = self.task
        if self._now is None or self._before is None:
            raise RuntimeError("begin comes before view")
        goal, fingers = self._asked()
        since_lift = np.maximum(task.time - task.lift_time, -1.0)
        lifted = goal.copy()
        lifted[:, 2] += task.protocol.lift_height * (since_lift >= 0)
        wanted = Wanted(
            palm_goal=lifted,
            servo_targets=fingers,
            since_closing=task.protocol.control_period * (self._step - self._closing),
            since_lift=since_lift,
            **self._aims,
        )
        self._view = View(self._now, self._before, wanted, self.action)
        return self._view

    def act(self, action: np.ndarray) -> Action:
        """What the task is asked for. action: of the policy, shape [W, A]."""
        self.action = smoothed(action, self.action, self.settings)
        self._view = None
        goal, fingers = apply(*self._asked(), self.action, self.settings)
        return Action(goal, fingers, self._step >= self._lift)

    def sensed(self) -> Sensed:
        """What only a simulation knows, when the worlds were last read."""
        if self._sensed is None:
            worlds = self.task.worlds
            self._sensed = Sensed(
                worlds.link_contacts,
                worlds.link_forces,
                worlds.object_velocity,
                worlds.table_forces,
                worlds.hand_on_hand,
                worlds.object_on_table,
            )
        return self._sensed

    def _asked(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the reference for this control step: palm, world frame, shape [W, 7]; servo targets, [W, U]."""
        if self._goal is None:
            goal, fingers = self.references.motion.at(self._step, self.rows)
            self._goal = compose(self._anchor, goal), fingers
        return self._goal

    def _chosen(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
        """What stays the same during a trial: fields of ``Wanted``; first steps of closing and of lift, shape
        [W] int each."""
        refs, rows, index = self.references, self.rows, self.task.worlds.object_index
        distance, normal = self._target_surface
        aims = {
            "palm_in_object": refs.motion.wrist[rows],
            "keypoints": refs.keypoints[rows],
            "surface_distance": distance[rows],
            "surface_normal": normal[rows],
            "contacts": refs.contacts[rows],
            "settled_pose": refs.settled_pose[rows],
            "mass": refs.mass[rows],
            "center": self._center[index],
            "size": self._size[index],
        }
        return aims, refs.motion.closing[rows], refs.motion.lift[rows]

    def _read(self) -> Readings:
        task, noise = self.task, self.noise
        self._step = task.control_step
        joints = task.independent(task.worlds.joint_positions)
        palm, thing = task.worlds.palm_pose, task.tracked_object_pose
        if noise is not None:
            joints, palm, thing = noise.joints(joints), noise.palm(palm), noise.object(thing)
        self.kinematics.update(None, joints)
        keypoints = self.kinematics.points(self._keypoints)
        palm_turn, object_turn = rotation_matrix(stack(palm[:, 3:], thing[:, 3:]))
        in_world = keypoints @ palm_turn.mT + palm[:, None, :3]
        in_object = (in_world - thing[:, None, :3]) @ object_turn
        distance, normal = self._bank.query(task.worlds.object_index, in_object)
        return Readings(
            joints,
            task.finger_set_point.copy(),
            palm,
            task.set_point.pose.copy(),
            thing,
            keypoints,
            distance,
            normal,
        )


def link_directions(hand: Hand, keypoints: np.ndarray) -> np.ndarray:
    """Vectors along the links of each finger, from key points; zero where a finger has fewer.

    Args:
        hand: the key points' hand.
        keypoints: [m], shape [W, K, 3].

    Returns:
        [m], shape [W, F, 3, 3].
    """
    result = np.zeros((len(keypoints), len(hand.fingers), 3, 3))
    first = 1
    for f, finger in enumerate(hand.fingers.values()):
        number = len(finger.links)
        chain = keypoints[:, first : first + number + 1]
        result[:, f, :number] = np.diff(chain, axis=1)
        first += number + 1
    return result
