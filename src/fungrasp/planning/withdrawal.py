"""Motions between two attempts: withdrawal from the object, and the way around it to the next start pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.geometry.poses import (
    compose,
    quaternion_conjugate,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    relative,
    rotate,
    rotation_vector,
)
from fungrasp.objects import ObjectModel
from fungrasp.task import Action, GraspPlan, Observation

OPENING_STEPS = 10
"""Control steps for opening the hand (1 s)."""
SMALL_GAP = 0.01
"""Height above the table [m] below which an object is released without lowering: the error of the tracked
pose."""
PASSING = 0.05
"""Distance at which the palm passes a waypoint without stopping [m]."""
ARRIVED = 0.002
"""Distance at which the palm's setpoint has arrived [m]."""
TURNED = 0.02
"""Angle at which the palm's setpoint has arrived at the last waypoint [rad]."""
WAY_ROUND = 0.35
"""Smallest distance of the palm from the center of a point-sized object on the way around it [m]: a hand's
length and 15 cm."""
ROUND_STEPS = 12
"""Number of waypoints on the way around the object."""


@dataclass(frozen=True, eq=False, repr=False)
class Waypoints(BatchRecord):
    """Waypoints of W hands, K each."""

    palm: np.ndarray
    """Palm poses, world frame, shape [W, K, 7]."""
    fingers: np.ndarray
    """Targets of the finger servos [rad], shape [W, K, U]."""
    near: np.ndarray
    """Distance of the palm's setpoint at which each waypoint is reached [m], shape [W, K]."""


def way_off(plan: GraspPlan, observation: Observation, gap: np.ndarray) -> Waypoints:
    """Return waypoints that lower a hanging object onto the table, open the hand, and withdraw along the
    reversed approach, shifted to the place of opening.

    Args:
        plan: followed plans, W of them.
        gap: heights of the objects above the table [m], shape [W].
    """
    rows, closing = np.arange(len(plan)), plan.closing_step
    low = observation.palm_setpoint.copy()
    low[:, 2] -= np.where(gap > SMALL_GAP, gap, 0.0)
    last = int(closing.max())
    back = np.maximum(closing[:, None] - np.arange(last + 1), 0)
    path = compose(plan.object_pose[:, None], plan.palm_setpoint_object[rows[:, None], back])
    path[..., :3] += (low[:, :3] - path[:, 0, :3])[:, None]
    # As open as before the fingers closed.
    opened = plan.finger_targets[rows, np.maximum(closing - 1, 0)]
    closed = observation.joint_setpoints
    share = np.arange(1, OPENING_STEPS + 1)[:, None] / OPENING_STEPS
    opening = closed[:, None] + share * (opened - closed)[:, None]
    fingers = plan.finger_targets[rows[:, None], np.maximum(back - 1, 0)]
    stops = np.full((len(plan), 1 + OPENING_STEPS), ARRIVED)
    passed = np.full((len(plan), last + 1), PASSING)
    passed[:, -1] = ARRIVED
    return Waypoints(
        np.concatenate([np.repeat(low[:, None], 1 + OPENING_STEPS, axis=1), path], axis=1),
        np.concatenate([closed[:, None], opening, fingers], axis=1),
        np.concatenate([stops, passed], axis=1),
    )


def way_round(
    observation: Observation,
    object_pose: np.ndarray,
    models: Mapping[str, ObjectModel],
    names: list[str],
    start: np.ndarray,
    start_fingers: np.ndarray,
) -> Waypoints:
    """Return waypoints from the current palm poses to start poses, on circles about the objects.

    Args:
        observation: W rows.
        object_pose: object poses, world frame, shape [W, 7].
        names: object names, length W.
        start: palm poses at the start, world frame, shape [W, 7].
        start_fingers: independent joints at the start [rad], shape [W, U].
    """
    palm, fingers = observation.palm_setpoint, observation.joint_setpoints
    center = np.array([models[name].center_of_mass for name in names])
    middle = compose(object_pose, np.concatenate([center, np.tile([1.0, 0, 0, 0], (len(center), 1))], axis=1))
    reach = np.array(
        [np.linalg.norm(models[n].vertices - models[n].center_of_mass, axis=1).max() for n in names]
    )
    away = np.stack([palm[:, :3] - middle[:, :3], start[:, :3] - middle[:, :3]])
    distance = np.linalg.norm(away, axis=-1)
    direction = away / np.maximum(distance, 1e-9)[..., None]
    turn = _turn_between(direction[0], direction[1])
    twist = rotation_vector(relative(palm, start)[:, 3:])
    poses, closing = [], []
    for share in np.arange(1, ROUND_STEPS + 1) / ROUND_STEPS:
        radius = (1 - share) * distance[0] + share * distance[1]
        if share < 1:
            radius = np.maximum(radius, WAY_ROUND + reach)
        place = middle[:, :3] + radius[:, None] * rotate(
            quaternion_from_rotation_vector(share * turn), direction[0]
        )
        place[:, 2] = np.maximum(place[:, 2], np.minimum(palm[:, 2], start[:, 2]))
        step = np.concatenate([np.zeros_like(twist), quaternion_from_rotation_vector(share * twist)], axis=1)
        poses.append(np.concatenate([place, compose(palm, step)[:, 3:]], axis=1))
        closing.append(fingers + share * (start_fingers - fingers))
    near = np.full((len(palm), ROUND_STEPS), PASSING)
    near[:, -1] = ARRIVED
    return Waypoints(np.stack(poses, axis=1), np.stack(closing, axis=1), near)


def _turn_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return rotation vectors that turn unit vectors a into b, over the top if they are opposite; shape [W,
    3] each."""
    axis = np.cross(a, b)
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(size[:, 0], np.sum(a * b, axis=1))
    over = np.cross(a, np.array([0.0, 0.0, 1.0]))
    over /= np.maximum(np.linalg.norm(over, axis=1, keepdims=True), 1e-9)
    axis = np.where(size > 1e-6, axis / np.maximum(size, 1e-9), over)
    return angle[:, None] * axis


class WaypointPolicy:
    """Follows waypoints as the palm's setpoint reaches them, and stays at the last one."""

    def __init__(self, ways: Waypoints):
        """ways: waypoints of W hands."""
        self._ways, self._at = ways, np.zeros(len(ways), dtype=int)
        self.arrived = np.zeros(len(ways), dtype=bool)
        """Whether the last waypoint has been reached, shape [W] bool."""

    def act(self, observation: Observation) -> Action:
        """See ``Policy.act``."""
        ways, rows = self._ways, np.arange(len(self._at))
        last = ways.palm.shape[1] - 1
        goal, setpoint = ways.palm[rows, self._at], observation.palm_setpoint
        near = np.linalg.norm(goal[:, :3] - setpoint[:, :3], axis=1) < ways.near[rows, self._at]
        apart = rotation_vector(quaternion_multiply(quaternion_conjugate(goal[:, 3:]), setpoint[:, 3:]))
        turned = np.linalg.norm(apart, axis=1) < TURNED
        self.arrived |= (self._at == last) & near & turned
        self._at = np.minimum(self._at + near, last)
        return Action(
            ways.palm[rows, self._at], ways.fingers[rows, self._at], np.zeros(len(rows), dtype=bool)
        )
