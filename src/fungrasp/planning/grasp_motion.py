"""The reference controller's motion, planned once for each grasp: where wrist and fingers should be at every
control step. It depends on where the object has settled, and on nothing that happens later."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from fungrasp.geometry.poses import clip, compose, invert, rotate
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.planning.approach_path import Approach, ApproachSettings, Path, plan_approach
from fungrasp.planning.grasp_adaptation import AdaptSettings, adapt
from fungrasp.planning.grip_forces import squeeze_torques
from fungrasp.task import Protocol
from fungrasp.task.setpoints import SET_POINT_PERIOD
from fungrasp.task.wrist_limits import WristSetPoint

TABLE_DOUBT = 0.005
"""An object at rest that is farther from the table [m] says that the table is elsewhere."""


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
    lift_margin: float = 0.03
    """How much higher the wrist goes than the lift asks for, as what swings hangs lower [m]."""
    lookahead: float = 0.06
    """How far ahead on its way the wrist aims [m]."""
    adapt: AdaptSettings = AdaptSettings()
    approach: ApproachSettings = ApproachSettings()


@dataclass(frozen=True, eq=False)
class Motion:
    """What N hands are asked for at each control step, T steps; from the last on it stays the same."""

    wrist_goal: np.ndarray
    """Palm, settled object's frame, shape [N, T, 7]."""
    finger_targets: np.ndarray
    """Servo targets of the independent joints [rad], shape [N, T, U]."""
    set_point: np.ndarray
    """Where the wrist's set point is when the step begins, settled object's frame, shape [N, T, 7]."""
    velocity: np.ndarray
    """And its velocity, world frame [m/s], shape [N, T, 3]."""
    closing: np.ndarray
    """First step at which the fingers close, shape [N] int."""
    lift: np.ndarray
    """First step of the lift, shape [N] int."""
    wrist: np.ndarray
    """Palm in the grasp, settled object's frame, shape [N, 7]."""
    grasp: np.ndarray
    """Independent joints in the grasp [rad], shape [N, U]."""
    collision: np.ndarray
    """Deepest intrusion of the planned way into the margins [m], shape [N]."""

    def __len__(self) -> int:
        return len(self.closing)

    def at(self, step: np.ndarray, rows: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Wrist goals [I, 7] and finger targets [I, U] of some rows at their steps, shape [I] int."""
        step = clip(step, 0, self.wrist_goal.shape[1] - 1)
        index = np.arange(len(self))[rows]
        return self.wrist_goal[index, step], self.finger_targets[index, step]

    def select(self, rows: np.ndarray) -> Motion:
        """Some of the hands."""
        return Motion(*(getattr(self, f.name)[rows] for f in fields(self)))


def table_height(
    names: Sequence[str], settled_pose: np.ndarray, objects: Mapping[str, ObjectModel]
) -> np.ndarray:
    """How high the table must be on which objects rest, world frame [m], shape [N].

    Zero, as agreed, unless their lowest points say otherwise by more than ``TABLE_DOUBT``.

    Args:
        names: of the objects, length N.
        settled_pose: of the objects, world frame, shape [N, 7].
        objects: by name.
    """
    up = rotate(invert(settled_pose)[:, 3:], np.array([0.0, 0.0, 1.0]))
    lowest = np.array([np.min(objects[name].vertices @ u) for name, u in zip(names, up, strict=True)])
    height = settled_pose[:, 2] + lowest
    return np.where(np.abs(height) > TABLE_DOUBT, height, 0.0)


def raised(pose: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Poses [N, 7], higher by [N] metres."""
    result = pose.copy()
    result[:, 2] += height
    return result


def plan_motion(
    hand: Hand,
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    settled_pose: np.ndarray,
    start_pose: np.ndarray,
    start_fingers: np.ndarray,
    settings: ReferenceSettings | None = None,
    protocol: Protocol | None = None,
) -> Motion:
    """Plan: go to the grasp, close, squeeze, lift.

    Args:
        hand: the robot hand.
        grasps: N grasps; ``extra`` may hold their own ``force_scale``, ``press_in`` and ``press_down``.
        objects: by name.
        settled_pose: of the objects, world frame, shape [N, 7].
        start_pose: of the palm, world frame, shape [N, 7].
        start_fingers: independent joints at the start [rad], shape [N, U].
        settings: the defaults if None.
        protocol: the published one if None.
    """
    s, p = settings or ReferenceSettings(), protocol or Protocol()
    names = grasps.object_name.tolist()
    matrix, offset = hand.coupling
    given = (grasps.joint_positions - offset) @ np.linalg.pinv(matrix).T
    in_object = compose(invert(grasps.object_pose), grasps.wrist_pose)
    # All below has the table at zero; what is planned is in the object's frame.
    table = table_height(names, settled_pose, objects)
    settled_pose, start_pose = raised(settled_pose, -table), raised(start_pose, -table)
    wrist, grasp = adapt(hand, grasps, objects, settled_pose, in_object, given, s.adapt)
    approach = plan_approach(hand, names, settled_pose, objects, wrist, grasp, s.approach)
    squeeze = _servo_offsets(hand, grasps, objects, settled_pose, wrist, grasp, s)
    closing_pose = compose(settled_pose, wrist)
    press_in = _setting(grasps, "press_in", s.press_in)
    closing_pose[:, :3] += press_in * rotate(closing_pose[:, 3:], hand.palm_normal)
    closing_pose[:, 2:3] -= _setting(grasps, "press_down", s.press_down)
    return _roll(settled_pose, start_pose, start_fingers, approach, closing_pose, wrist, grasp, squeeze, s, p)


def _roll(
    settled_pose: np.ndarray,
    start_pose: np.ndarray,
    start_fingers: np.ndarray,
    approach: Approach,
    closing_pose: np.ndarray,
    wrist: np.ndarray,
    grasp: np.ndarray,
    squeeze: np.ndarray,
    s: ReferenceSettings,
    p: Protocol,
) -> Motion:
    """Follow the planned way with a set point that keeps the wrist's speed limits."""
    path = Path(start_pose, start_fingers, approach, settled_pose)
    set_point = WristSetPoint(start_pose, p)
    arrived = np.full(len(wrist), np.inf)
    to_object = invert(settled_pose)
    substeps = round(p.control_period / SET_POINT_PERIOD)
    after = s.close_time + s.squeeze_time + s.pause
    table: list[tuple[np.ndarray, ...]] = []
    for step in range(round(p.approach_time / p.control_period) + 1):
        time = step * p.control_period
        path.advance(set_point.pose[:, :3], s.lookahead)
        goal, _ = path.at(path.progress + s.lookahead)
        _, fingers = path.at(path.progress + 0.02)
        arrived = np.where((path.length - path.progress < 2e-3) & ~np.isfinite(arrived), time, arrived)
        since = np.where(np.isfinite(arrived), time - arrived, -1.0)[:, None]
        closing = np.clip((since + p.control_period) / s.close_time, 0.0, 1.0)
        squeezing = np.clip((since + p.control_period - s.close_time) / s.squeeze_time, 0.0, 1.0)
        goal = np.where(closing > 0, closing_pose, goal)
        lifting = since[:, 0] >= after - 1e-9
        goal[:, 2] += np.where(lifting, s.lift_margin, 0.0)
        fingers = fingers + closing * (grasp - fingers) + squeezing * squeeze
        table.append(
            (
                compose(to_object, goal),
                fingers,
                compose(to_object, set_point.pose),
                set_point.velocity.copy(),
                lifting,
            )
        )
        if table[-1][-1].all():
            break
        for _ in range(substeps):
            set_point.advance(goal, SET_POINT_PERIOD)
    goals, targets, points, velocities, lift = (
        np.stack(column, axis=1) for column in zip(*table, strict=True)
    )
    last = len(table) - 1
    return Motion(
        goals,
        targets,
        points,
        velocities,
        np.where(np.isfinite(arrived), np.rint(arrived / p.control_period), last).astype(int),
        np.where(lift.any(axis=1), lift.argmax(axis=1), last),
        wrist,
        grasp,
        approach.collision,
    )


def _setting(grasps: RobotGraspSet, name: str, default: float) -> np.ndarray:
    """A number that refinement may have set for each grasp, shape [N, 1]."""
    return np.asarray(grasps.extra.get(name, np.full(len(grasps), default)))[:, None]


def _servo_offsets(
    hand: Hand,
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    settled_pose: np.ndarray,
    wrist: np.ndarray,
    grasp: np.ndarray,
    s: ReferenceSettings,
) -> np.ndarray:
    """Of the joints' servo targets, that make the torques of the squeeze [rad], shape [N, U]."""
    names = grasps.object_name.tolist()
    around = CollisionScene.settled(names, settled_pose, objects)
    models = [objects[name] for name in names]
    torques = squeeze_torques(hand, around, models, wrist, grasp, grasps.link_contacts)
    force = _setting(grasps, "force_scale", 1.0)[:, 0] * (s.force + s.force_per_kg * grasps.object_mass)
    stiffness = np.array([servo.kp for servo in hand.actuators.values()])
    return np.clip(force[:, None] * torques / stiffness, -s.squeeze_limit, s.squeeze_limit)
