"""Loads that a grip must withstand during the use motion of the object."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import (
    compose,
    quaternion_conjugate,
    quaternion_from_rotation_vector,
    rotate,
    transform_points,
)
from fungrasp.geometry.signed_distance import SignedDistanceBank, project_to_surface
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import GRAVITY
from fungrasp.task.use import UseMotion
from fungrasp.task.use.geometry import far_end, horizontal, turn_axis

_UP = np.array([0.0, 0.0, 1.0])


def use_loads(
    motion: UseMotion,
    hand: Hand,
    model: ObjectModel,
    object_pose: np.ndarray,
    palm: np.ndarray,
    joints: np.ndarray,
    mass: float,
) -> np.ndarray:
    """Return forces at the center of mass [N] and torques [N m] on the object during a use motion, object
    frame, shape [K, 6]: weight and inertia in the turning palm, loads at the far end, and the press of a
    finger on a trigger.

    Args:
        object_pose: object pose in the hold, world frame, shape [7].
        palm: pose in the grasp, object frame, shape [7].
        joints: independent joints in the grasp [rad], shape [U].
        mass: object mass [kg].
    """
    held = compose(object_pose, palm)
    end = far_end(model, object_pose, held)
    points = np.stack([end, model.center_of_mass])
    place, center = transform_points(object_pose[None], points[None])[0]
    away = (place - held[:3]) / np.linalg.norm(place - held[:3])
    weight = -GRAVITY * mass * _UP
    loads: list[tuple[np.ndarray, np.ndarray]] = [(weight, np.zeros(3))]
    before = 0.0
    for value, duration, ramp in motion.segments:
        peak = abs(value - before) / (duration - ramp) / ramp
        before = value
        if motion.turn:
            axis = turn_axis(motion.turn, hand, held, place)
            # In the object frame, gravity turns the opposite way; inertia acts in both directions.
            down = rotate(quaternion_from_rotation_vector(-value * axis), weight)
            sideways = mass * peak * np.cross(axis, center - held[:3])
            loads += [(down + sign * sideways, np.zeros(3)) for sign in (-1.0, 1.0)]
    if motion.press is not None:
        across = np.cross(_UP, horizontal(away, rotate(held[3:], hand.palm_normal)))
        for sign in (-1.0, 1.0):
            force = motion.press.force * (_UP + sign * motion.press.friction * across)
            loads.append((weight + force, np.cross(place - center, force)))
    if motion.torque:
        loads += [(weight, sign * motion.torque * away) for sign in (-1.0, 1.0)]
    if motion.pull:
        force = motion.pull * away
        loads.append((weight + force, np.cross(place - center, force)))
    found = rotate(quaternion_conjugate(object_pose[3:]), np.array(loads)).reshape(len(loads), 6)
    if motion.trigger is None or motion.trigger.finger not in hand.fingers:
        return found
    tip = hand.fingers[motion.trigger.finger].tip
    press = motion.trigger.force * _press(hand, model, palm, joints, tip)
    return np.concatenate([found, found[:1] + press])


def _press(hand: Hand, model: ObjectModel, palm: np.ndarray, joints: np.ndarray, tip: str) -> np.ndarray:
    """Return the wrench of a fingertip force of 1 N, along the surface normal at the nearest point: force [N]
    and torque about the center of mass [N m], object frame, shape [6]."""
    kinematics = HandKinematics(hand, 1)
    kinematics.update(palm[None], joints[None])
    bank, only = SignedDistanceBank([model.signed_distance]), np.zeros(1, dtype=int)
    place, outward = project_to_surface(bank, only, kinematics.points(kinematics.body_points((tip,))))
    force = -outward[0, 0]
    return np.concatenate([force, np.cross(place[0, 0] - model.center_of_mass, force)])
