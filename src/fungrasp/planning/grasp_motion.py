"""One motion per grasp: targets of wrist and fingers at every control step, planned from a belief."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.core.files import digest
from fungrasp.core.records import CheckedRecord
from fungrasp.geometry.poses import compose, invert, quaternion_conjugate, rotate
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand, as_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import GRAVITY
from fungrasp.optimization.grip_forces import squeeze_torques
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.problem import CollisionScene
from fungrasp.optimization.wrench_resistance import grip_of, lift_loads
from fungrasp.planning.approach_path import Approach, ApproachSettings, FollowedPath, plan_approach
from fungrasp.planning.grasp_adaptation import AdaptSettings, adapt_to_settled_object
from fungrasp.task import Belief, GraspPlan, LiftProtocol
from fungrasp.task.setpoints import SETPOINT_PERIOD, WristSetpoint

TABLE_TOLERANCE = 0.005
"""Distance of a resting object from the nominal table [m] beyond which the table height is set to the
object's lowest point."""


@dataclass(frozen=True)
class MotionSettings(CheckedRecord):
    """Settings of approach, closing, squeeze and lift."""

    least_force: float = 2.0
    """Smallest sum of the normal forces [N]; with more, objects of 10 g are pushed out of the hand."""
    least_force_per_kg: float = 80.0
    """Additional force per kilogram of the object [N/kg]."""
    most_least_force: float = 10.0
    """Largest force by this rule [N]; heavy objects are squeezed as hard as their loads require."""
    disturbance: float = 0.5
    """Load that the squeeze should withstand in addition to the weight, in units of the weight."""
    squeeze_limit: float = 0.6
    """Largest offset of a joint's servo target from the grasp [rad]."""
    close_time: float = 0.6
    """Duration of closing [s]."""
    squeeze_time: float = 0.6
    """Duration of the squeeze [s]."""
    pause: float = 0.2
    """Time before the lift [s]."""
    press_down: float = 0.003
    """Distance of the wrist below its target while the fingers close [m], because fingers yield upward."""
    press_in: float = 0.006
    """Distance of the wrist beyond its target along the palm normal [m]."""
    lookahead: float = 0.06
    """Largest look-ahead of the wrist on its path [m]."""
    lookahead_share: float = 0.25
    """Look-ahead as a share of the remaining path: near the object, a large look-ahead would cut corners
    through it."""
    least_lookahead: float = 0.015
    """Smallest look-ahead of the wrist [m]."""
    finger_lookahead: float = 0.005
    """Look-ahead of the fingers, which lag behind their servo targets [m]."""
    adapt: AdaptSettings | None = AdaptSettings()
    """Adaptation of grasps to the settled object; None: the grasp stays unchanged relative to the object."""
    approach: ApproachSettings = ApproachSettings()
    """Clearances of the approach."""


def table_below(
    names: Sequence[str],
    object_pose: np.ndarray,
    nominal_height: np.ndarray,
    objects: Mapping[str, ObjectModel],
) -> np.ndarray:
    """Return the height of the table below resting objects, world frame [m], shape [N].

    It is the nominal height unless an object's lowest point differs by more than ``TABLE_TOLERANCE``.

    Args:
        names: object names, length N.
        object_pose: rest poses of the objects, world frame, shape [N, 7].
        nominal_height: nominal height of the table [m], shape [N].
    """
    up = rotate(invert(object_pose)[:, 3:], np.array([0.0, 0.0, 1.0]))
    lowest = np.array([np.min(objects[name].vertices @ u) for name, u in zip(names, up, strict=True)])
    height = object_pose[:, 2] + lowest
    return np.where(np.abs(height - nominal_height) > TABLE_TOLERANCE, height, nominal_height)


def lowered(belief: Belief, height: np.ndarray) -> Belief:
    """Move a belief to a frame with the table at zero. height: height of the table [m], shape [N]."""
    down = np.zeros((len(belief), 7))
    down[:, 2] = height
    return replace(
        belief,
        object_pose=belief.object_pose - down,
        palm_pose=belief.palm_pose - down,
        table_height=np.zeros(len(belief)),
    )


class MotionPlanner:
    """Plans one motion per grasp (approach, close, squeeze, lift) without simulation."""

    def __init__(
        self,
        hand: Hand | str,
        objects: Mapping[str, ObjectModel],
        settings: MotionSettings | None = None,
        protocol: LiftProtocol | None = None,
    ):
        """
        Args:
            hand: robot hand, or its name.
            settings: defaults if None.
            protocol: protocol with motion limits and control period; the published one if None.
        """
        self.hand, self.objects = as_hand(hand), objects
        self.settings, self.protocol = MotionSettings.given(settings), LiftProtocol.given(protocol)
        self.key = digest(self.settings, self.protocol)
        """Digest of everything that plans depend on besides hand, objects and the arguments of ``plan``."""

    def plan(
        self,
        grasps: RobotGraspSet,
        belief: Belief,
        seed: int = 0,
        progress: Callable[[float], None] = lambda done: None,
    ) -> GraspPlan:
        """Plan N motions.

        Args:
            grasps: N grasps of the hand; ``extra`` may contain ``force_scale``, ``press_in`` and
                ``press_down``.
            belief: N rows.
            seed: not used.
            progress: called once, with N.
        """
        hand, objects, s = self.hand, self.objects, self.settings
        names = grasps.object_name.tolist()
        # From here on, the table is at zero, and plans are in the object frame.
        b = lowered(belief, table_below(names, belief.object_pose, belief.table_height, objects))
        palm, joints = grasps.wrist_pose_object, hand.independent(grasps.joint_positions)
        if s.adapt is not None:
            palm, joints = adapt_to_settled_object(
                hand, grasps, objects, b.object_pose, palm, joints, s.adapt
            )
        approach = plan_approach(hand, names, b.object_pose, objects, palm, joints, s.approach)
        squeeze = squeeze_offsets(hand, grasps, objects, b, palm, joints, s)
        closing = compose(b.object_pose, palm)
        closing[:, :3] += _setting(grasps, "press_in", s.press_in) * rotate(closing[:, 3:], hand.palm_normal)
        closing[:, 2:3] -= _setting(grasps, "press_down", s.press_down)
        steps = _follow_path(b, approach, closing, joints, squeeze, s, self.protocol)
        progress(len(grasps))
        return GraspPlan(
            hand=hand.name,
            control_period=self.protocol.control_period,
            object_name=grasps.object_name,
            object_mass=belief.object_mass,
            object_pose=belief.object_pose,
            link_contacts=grasps.link_contacts,
            keypoints=HandKinematics(hand, len(grasps)).keypoints(palm, hand.all_joints(joints)),
            grasp_palm_pose=palm,
            grasp_joints=joints,
            path_collision=approach.collision,
            shown_places=grasps.shown_places,
            shown_normals=grasps.shown_normals,
            **steps,
        )


def _follow_path(
    belief: Belief,
    approach: Approach,
    closing_pose: np.ndarray,
    grasp: np.ndarray,
    squeeze: np.ndarray,
    s: MotionSettings,
    p: LiftProtocol,
) -> dict[str, np.ndarray]:
    """Follow the planned path with a setpoint within the wrist's speed limits. Return the fields of
    ``GraspPlan`` with one value per step.

    Args:
        belief: table at zero, N rows.
        approach: N paths.
        closing_pose: palm poses while the fingers close, world frame, shape [N, 7].
        grasp: independent joints in the grasps [rad], shape [N, U].
        squeeze: offsets of the servo targets from the grasps [rad], shape [N, U].
    """
    path = FollowedPath(belief.palm_pose, belief.joint_positions, approach, belief.object_pose)
    setpoint = WristSetpoint(belief.palm_pose, p)
    arrived = np.full(len(grasp), np.inf)
    to_object = invert(belief.object_pose)
    substeps = round(p.control_period / SETPOINT_PERIOD)
    after = s.close_time + s.squeeze_time + s.pause
    table: list[tuple[np.ndarray, ...]] = []
    for step in range(round(p.approach_time / p.control_period) + 1):
        time = step * p.control_period
        path.advance(setpoint.pose[:, :3], s.lookahead)
        left = path.length - path.progress
        goal, _ = path.at(path.progress + np.clip(s.lookahead_share * left, s.least_lookahead, s.lookahead))
        _, fingers = path.at(path.progress + s.finger_lookahead)
        arrived = np.where((path.length - path.progress < 2e-3) & ~np.isfinite(arrived), time, arrived)
        since = np.where(np.isfinite(arrived), time - arrived, -1.0)[:, None]
        closing = np.clip((since + p.control_period) / s.close_time, 0.0, 1.0)
        squeezing = np.clip((since + p.control_period - s.close_time) / s.squeeze_time, 0.0, 1.0)
        goal = np.where(closing > 0, closing_pose, goal)
        lifting = since[:, 0] >= after - 1e-9
        fingers = fingers + closing * (grasp - fingers) + squeezing * squeeze
        table.append(
            (
                compose(to_object, goal),
                fingers,
                compose(to_object, setpoint.pose),
                setpoint.velocity.copy(),
                lifting,
            )
        )
        if lifting.all():
            break
        for _ in range(substeps):
            setpoint.advance(goal, SETPOINT_PERIOD)
    goals, targets, points, velocities, lift = (
        np.stack(column, axis=1) for column in zip(*table, strict=True)
    )
    last = len(table) - 1
    closing_step = np.where(np.isfinite(arrived), np.rint(arrived / p.control_period), last)
    return {
        "palm_goal_object": goals,
        "finger_targets": targets,
        "palm_setpoint_object": points,
        "palm_velocity": velocities,
        "closing_step": closing_step.astype(int),
        "lift_step": np.where(lift.any(axis=1), lift.argmax(axis=1), last),
    }


def _setting(grasps: RobotGraspSet, name: str, default: float) -> np.ndarray:
    """Return a setting that a grasp may override in ``extra``, shape [N, 1]."""
    return np.asarray(grasps.extra.get(name, np.full(len(grasps), default)))[:, None]


def squeeze_offsets(
    hand: Hand,
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    belief: Belief,
    palm: np.ndarray,
    joints: np.ndarray,
    settings: MotionSettings | None = None,
) -> np.ndarray:
    """Return offsets of the servo targets that squeeze the object [rad], shape [N, U].

    Args:
        grasps: N grasps; ``extra`` may contain ``force_scale``.
        belief: N rows, table at zero.
        palm: poses in the grasps, object frame, shape [N, 7].
        joints: independent joints in the grasps [rad], shape [N, U].
        settings: defaults if None.
    """
    s = MotionSettings.given(settings)
    models = [objects[name] for name in grasps.object_name.tolist()]
    around = CollisionScene.settled(grasps.object_name.tolist(), belief.object_pose, objects)
    stiffness = np.tile([servo.kp for servo in hand.actuators.values()], (len(grasps), 1))
    if belief.servo_stiffness is not None:
        driven = [hand.joint_names.index(name) for name in hand.actuators]
        stiffness = stiffness * belief.servo_stiffness[:, driven]
    mass = belief.object_mass
    up = rotate(quaternion_conjugate(belief.object_pose[:, 3:]), np.array([0.0, 0.0, 1.0]))
    loads = lift_loads(up, GRAVITY * mass, s.disturbance)
    least = np.minimum(s.least_force + s.least_force_per_kg * mass, s.most_least_force)
    points = HandPoints(HandKinematics(hand, len(grasps)))
    grip = grip_of(points, around, models, palm, joints)
    torques = squeeze_torques(grip, grasps.link_contacts, stiffness, loads, least)
    torques *= _setting(grasps, "force_scale", 1.0)
    return np.clip(torques / stiffness, -s.squeeze_limit, s.squeeze_limit)
