"""Plan tracking: inputs of a residual network from observations and plans, and actions for the robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from fungrasp.geometry.arrays import copied, is_numpy, moved_to, rows_like
from fungrasp.geometry.poses import (
    Array,
    array_namespace,
    clip,
    compose,
    interpolate_pose,
    quaternion_conjugate,
    quaternion_multiply,
    relative,
    rotate,
    rotation_matrix,
    rotation_vector,
    stack,
)
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import ArrayKinematics, HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.policies.residual_action import WRIST_ACTIONS, ResidualSettings, add_residual, smoothed
from fungrasp.policies.slip_response import SlipResponse
from fungrasp.task import Action, GraspPlan, LiftProtocol, Observation
from fungrasp.task.features import MeasuredState, PlanTarget, robot_features

ANCHOR_SHARE = 0.2
"""Fraction of the remaining distance that a plan's origin moves towards the tracked object at each control
step. A fraction s passes sqrt(s / (2 - s)) of the tracker's jitter, here a third. After the 14 or more steps
until the fingers close, less than 5 % of an object's displacement remains."""


@dataclass(frozen=True, eq=False)
class TrackingState:
    """Quantities for the network's inputs and the reward at one control step."""

    now: MeasuredState
    """Measured state at this step."""
    before: MeasuredState
    """Measured state at the previous step."""
    target: PlanTarget
    """Targets of the plan."""
    action: Array
    """Last action, smoothed, shape [W, A]."""

    def robot_features(self) -> dict[str, Array]:
        """Return the network's inputs from robot sensors, by name (``task.features``)."""
        return robot_features(self.now, self.before, self.target, self.action)


class PlanTracker:
    """Tracks plans for W robots, each from its own start.

    Until the fingers close, the plan follows the object, smoothed against the tracker's jitter; then it stays
    in place. It turns with the object only about the vertical: an object that has rolled or tipped is grasped
    from the planned side, because the rotated grasp may be below the table. An object that sinks in the hand
    during the lift is squeezed harder and lifted higher (``SlipResponse``).
    """

    def __init__(
        self,
        hand: Hand,
        objects: Mapping[str, ObjectModel],
        plans: GraspPlan,
        count: int,
        settings: ResidualSettings | None = None,
        on: Array | None = None,
    ):
        """
        Args:
            objects: object models of the plans, by name.
            plans: N plans to choose from.
            count: W, number of robots.
            settings: defaults if None.
            on: array whose library and device are used; NumPy if None.
        """
        self.settings, on = settings or ResidualSettings(), np.zeros(1) if on is None else on
        self._keypoints = _keypoints(hand, count, on)
        names = sorted(set(plans.object_name.tolist()))
        self._bank = SignedDistanceBank([objects[name].signed_distance for name in names])
        self._center = rows_like(on, [objects[name].center_of_mass for name in names])
        self._size = rows_like(on, [objects[name].size for name in names])
        self._object = rows_like(on, [names.index(name) for name in plans.object_name.tolist()])
        self._motions = plans = plans.mapped(lambda values: moved_to(on, values))
        self.plans = plans if self.settings.base == "plan" else without_motion(plans)
        self._target_surface = self._bank.query(self._object, plans.keypoints)
        self.size = WRIST_ACTIONS + len(hand.actuators)
        """Size of an action."""
        self.rows = rows_like(on, np.zeros(count, dtype=int))
        """Index of each robot's plan, shape [W]."""
        self.action = rows_like(on, np.zeros((count, self.size)))
        """Last action, smoothed, shape [W, A]."""
        self._anchor = rows_like(on, np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1)))
        self._reaction = SlipResponse(count, on)
        self._goal: tuple[Array, Array] | None = None
        """Palm goal and servo targets of this control step, computed on first use."""
        self._now: MeasuredState | None = None
        self._before: MeasuredState | None = None

    def begin(self, ids: np.ndarray, rows: np.ndarray, observation: Observation) -> None:
        """Switch to other plans in some worlds.

        Args:
            ids: worlds, shape [I].
            rows: indices of the plans, shape [I].
            observation: W rows.
        """
        ids, rows = (moved_to(self.rows, given) for given in (ids, rows))
        self.rows[ids] = rows
        self.action[ids] = 0.0
        self._choose()
        self._read(observation)
        fresh = self._measure(observation)
        self._anchor[ids] = self._origin(fresh)[ids]
        self._reaction.begin(ids)
        if self._now is None or self._before is None:
            self._now = self._before = fresh
            return
        for kept in (self._now, self._before):
            for field in fields(MeasuredState):
                getattr(kept, field.name)[ids] = getattr(fresh, field.name)[ids]

    def update(self, observation: Observation) -> None:
        """Update with the observation of a new control step. observation: of all W worlds."""
        self._read(observation)
        self._before, self._now = self._now, self._measure(observation)
        opened = array_namespace(self._step).astype(self._step < self._closing, self._anchor.dtype)
        share = ANCHOR_SHARE * opened
        self._anchor = interpolate_pose(self._anchor, self._origin(self._now), share[:, None])
        risen = self._center_height(self._now.object_pose) - self._center_height(self._anchor)
        palm, lifting = self._now.palm_pose[:, 2], self._since_lift >= 0
        self._reaction.update(lifting, palm, risen, observation.object_pose_age)

    def state(self) -> TrackingState:
        """Return the state at the last ``begin`` or ``update``."""
        if self._now is None or self._before is None:
            raise RuntimeError("begin comes before state")
        goal, fingers = self._planned()
        lifting, period = self._since_lift >= 0, self.plans.control_period
        goal = copied(goal)
        goal[:, 2] += LiftProtocol.lift_height * lifting
        target = PlanTarget(
            palm_goal_world=goal,
            servo_targets=fingers,
            since_closing=period * (self._step - self._closing),
            since_lift=self._since_lift,
            **self._aims,
        )
        return TrackingState(self._now, self._before, target, self.action)

    def act(self, action: Array) -> Action:
        """Return the robots' action. action: network output, shape [W, A]."""
        self.action = smoothed(action, self.action, self.settings)
        goal, fingers = add_residual(*self._base(), self.action, self.settings)
        if self.settings.base == "plan":
            goal[:, 2] += self._reaction.raised
            squeeze = self._planned()[1] - self.plans.grasp_joints[self.rows]
            fingers = fingers + (self._reaction.squeeze - 1.0)[:, None] * squeeze
        return Action(goal, fingers, self._step >= self._lift)

    def planned_action(self) -> Array:
        """Return the network action that best follows the planned motions, within [-1, 1], shape [W, A]."""
        s, (goal, fingers) = self.settings, self._motions.at(self._step, self.rows)
        base_goal, base_fingers = self._base()
        away = relative(base_goal, compose(self._anchor, goal))
        wrist = [away[:, :3] / s.position, rotation_vector(away[:, 3:]) / s.rotation]
        wanted = array_namespace(goal).concat([*wrist, (fingers - base_fingers) / s.fingers], axis=1)
        smooth = (clip(wanted, -1.0, 1.0) - s.smoothing * self.action) / (1.0 - s.smoothing)
        return clip(smooth, -1.0, 1.0)

    def _base(self) -> tuple[Array, Array]:
        """Return the base of the action: palm goal, world frame, shape [W, 7], and servo targets [rad], shape
        [W, U]."""
        if self.settings.base == "plan" or self._now is None:
            return self._planned()
        return self._planned()[0], self._now.joints

    def _planned(self) -> tuple[Array, Array]:
        """Return planned palm goal, world frame, shape [W, 7], and servo targets [rad], shape [W, U], of this
        step."""
        if self._goal is None:
            goal, fingers = self.plans.at(self._step, self.rows)
            self._goal = compose(self._anchor, goal), fingers
        return self._goal

    def _origin(self, seen: MeasuredState) -> Array:
        """Return object frames for the plans, world frame, shape [W, 7]: the center of mass and the rotation
        about the vertical are tracked, the remaining rotation is the planned one."""
        pose = seen.object_pose
        if self.settings.base != "plan":
            return pose
        turned = turned_upright(self.plans.object_pose[self.rows, 3:], pose[:, 3:])
        center = self._aims["center"]
        place = pose[:, :3] + rotate(pose[:, 3:], center) - rotate(turned, center)
        return array_namespace(place).concat([place, turned], axis=1)

    def _center_height(self, pose: Array) -> Array:
        """Return heights of the objects' centers of mass [m], shape [W]. pose: world frame, shape [W, 7]."""
        return pose[:, 2] + rotate(pose[:, 3:], self._aims["center"])[:, 2]

    def _choose(self) -> None:
        """Select quantities that are constant during an episode: fields of ``PlanTarget``, first steps of
        closing and lift."""
        plans, rows = self.plans, self.rows
        distance, normal = self._target_surface
        self._aims = {
            "palm_in_object": plans.grasp_palm_pose[rows],
            "keypoints": plans.keypoints[rows],
            "surface_distance": distance[rows],
            "surface_normal": normal[rows],
            "contacts": plans.link_contacts[rows],
            "settled_pose": plans.object_pose[rows],
            "mass": plans.object_mass[rows],
            "center": self._center[self._object[rows]],
            "size": self._size[self._object[rows]],
        }
        self._closing, self._lift = plans.closing_step[rows], plans.lift_step[rows]

    def _read(self, observation: Observation) -> None:
        self._goal = None
        xp = array_namespace(observation.time)
        self._step = xp.astype(xp.round(observation.time / self.plans.control_period), xp.int64)
        self._since_lift = observation.time_since_lift

    def _measure(self, observation: Observation) -> MeasuredState:
        palm, obj = observation.palm_pose, observation.object_pose
        keypoints = self._keypoints(observation.joint_positions)
        palm_turn, object_turn = rotation_matrix(stack(palm[:, 3:], obj[:, 3:]))
        # Rows are points: p_world = R p, so P_world = P R^T, and P = P_world R.
        in_world = keypoints @ palm_turn.mT + palm[:, None, :3]
        in_object = (in_world - obj[:, None, :3]) @ object_turn
        distance, normal = self._bank.query(self._object[self.rows], in_object)
        return MeasuredState(
            joints=copied(observation.joint_positions),
            joint_setpoints=copied(observation.joint_setpoints),
            palm_pose=copied(palm),
            palm_setpoint=copied(observation.palm_setpoint),
            object_pose=copied(obj),
            keypoints=keypoints,
            surface_distance=distance,
            surface_normal=normal,
        )


def _keypoints(hand: Hand, count: int, on: Array) -> Callable[[Array], Array]:
    """Return a function from joints [rad], shape [W, U], to key points [m], palm frame, shape [W, K, 3]: with
    MuJoCo on the CPU, batched on a device."""
    kinematics = HandKinematics(hand, count)
    points = kinematics.body_points(hand.keypoint_names)
    if not is_numpy(on):
        return ArrayKinematics(hand, points).points

    def made(joints: np.ndarray) -> np.ndarray:
        kinematics.update(None, joints)
        return kinematics.points(points)

    return made


def without_motion(plans: GraspPlan) -> GraspPlan:
    """Replace planned motions by the constant grasp; the steps of closing and lift are kept.

    From the closing on, the goal does not move: if it followed the object until the lift, the hand would
    chase an object that it pushes, by 35 mm in the median.
    """
    return replace(
        plans,
        palm_goal_object=plans.grasp_palm_pose[:, None],
        finger_targets=plans.grasp_joints[:, None],
        palm_setpoint_object=plans.palm_setpoint_object[:, :1],
        palm_velocity=plans.palm_velocity[:, :1],
    )


def turned_upright(before: Array, now: Array) -> Array:
    """Rotate ``before`` about the vertical by the twist of the rotation from ``before`` to ``now``
    (swing-twist decomposition). before, now: quaternions, shape [W, 4]."""
    xp = array_namespace(before)
    turn = quaternion_multiply(now, quaternion_conjugate(before))
    about = xp.concat([turn[:, :1], xp.zeros_like(turn[:, 1:3]), turn[:, 3:]], axis=1)
    length = xp.sqrt(xp.sum(about * about, axis=1))[:, None]
    # The twist is undefined for half a turn about a horizontal axis.
    none = xp.zeros_like(about)
    none[:, 0] = 1.0
    about = xp.where(length > 1e-6, about / xp.where(length > 1e-6, length, 1.0), none)
    return quaternion_multiply(about, before)


def link_directions_of(hand: Hand, keypoints: Array) -> Array:
    """Return vectors along the links of each finger; zero for missing links.

    Args:
        keypoints: key points [m], shape [W, K, 3].

    Returns:
        Vectors [m], shape [W, F, 3, 3].
    """
    shape = len(keypoints), len(hand.fingers), 3, 3
    result = array_namespace(keypoints).zeros(shape, dtype=keypoints.dtype, device=keypoints.device)
    first = 1
    for f, finger in enumerate(hand.fingers.values()):
        number = len(finger.links)
        chain = keypoints[:, first : first + number + 1]
        result[:, f, :number] = chain[:, 1:] - chain[:, :-1]
        first += number + 1
    return result
