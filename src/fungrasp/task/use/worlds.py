"""Use motions in several worlds: setpoints of wrists and fingers, and loads on the objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fungrasp.geometry.poses import (
    cross,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    relative,
    rotate,
    transform_points,
)
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.task.environment import LiftEnvironment
from fungrasp.task.use.geometry import far_end, horizontal, turn_axis
from fungrasp.task.use.motion import OPENING_TIME, TriggerPress, UseMotion

RAMP_TIME = 0.3
"""Rise time of loads on the object and of the press of a finger [s]."""

SLOW = 0.02
"""Speed below which the friction of a surface grows linearly, to avoid jumps at reversals [m/s]."""

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class UseWorlds:
    """Use tests in I worlds."""

    motions: Sequence[UseMotion]
    """Motion of each world, length I."""
    palm: np.ndarray
    """Palm setpoints at the start of the motions, world frame, shape [I, 7]."""
    axis: np.ndarray
    """Axes of turns or directions of shifts, world frame, shape [I, 3]; zero for other motions."""
    end: np.ndarray
    """The objects' far ends, object frame [m], shape [I, 3]."""
    end_height: np.ndarray
    """Heights of the far ends at the start of the motions, world frame [m], shape [I]."""
    press: np.ndarray
    """Setpoint offsets that press a trigger [rad], shape [I, U]; zero for other fingers."""
    squeeze: np.ndarray
    """Offsets of the setpoints from the joints in the hold [rad], shape [I, U]."""

    @classmethod
    def begin(
        cls, environment: LiftEnvironment, worlds: np.ndarray, motions: Sequence[UseMotion]
    ) -> UseWorlds:
        """Create the use tests of worlds that hold their objects.

        Args:
            worlds: shape [I].
            motions: motion of each world, length I.
        """
        engine, scene, setpoints = environment.engine, environment.scene, environment.task.setpoints
        object_pose, palm = engine.object_pose[worlds], engine.palm_pose[worlds]
        models = [scene.models[i] for i in engine.object_index[worlds]]
        end = np.array([far_end(m, object_pose[i], palm[i]) for i, m in enumerate(models)])
        place = transform_points(object_pose, end[:, None])[:, 0]
        axis = np.zeros((len(worlds), 3))
        press = np.zeros((len(worlds), setpoints.fingers.shape[1]))
        for i, motion in enumerate(motions):
            if motion.turn:
                axis[i] = turn_axis(motion.turn, scene.hand, palm[i], place[i])
            elif motion.shift:
                facing = rotate(palm[i, 3:], scene.hand.palm_normal)
                axis[i] = np.cross(_UP, horizontal(_away(place[i], palm[i]), facing))
            if motion.trigger is not None and motion.trigger.finger in scene.hand.fingers:
                press[i] = press_offsets(environment, int(worlds[i]), motion.trigger)
        return cls(
            motions,
            setpoints.wrist.pose[worlds].copy(),
            axis,
            end,
            place[:, 2],
            press,
            setpoints.fingers[worlds] - scene.hand.independent(engine.joint_positions[worlds]),
        )

    def palms_at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return palm setpoints, shape [I, 7], and their linear velocities [m/s], shape [I, 3], world frame.
        time: since the motions began [s]."""
        value, rate = self._displacement(time)
        shifts = np.array([bool(motion.shift) for motion in self.motions])[:, None]
        pose = self.palm.copy()
        pose[:, :3] += shifts * value * self.axis
        turn = quaternion_from_rotation_vector(~shifts * value * self.axis)
        pose[:, 3:] = quaternion_multiply(turn, pose[:, 3:])
        return pose, shifts * rate * self.axis

    def fingers_at(
        self, time: float, joints: np.ndarray, holding: np.ndarray, kept: np.ndarray, opened: np.ndarray
    ) -> np.ndarray:
        """Return the finger setpoints [rad], shape [I, U].

        Args:
            time: since the motions began [s].
            joints: positions of the joints [rad], shape [I, U].
            holding: setpoints at the start of the motions [rad], shape [I, U].
            kept: setpoints that keep the joints in place [rad], shape [I, U].
            opened: setpoints of the open hand [rad], shape [U].
        """
        # A finger that closes a gap keeps its press: its setpoints stay the same distance ahead of its
        # joints. A finger that is pushed back keeps its setpoints; otherwise it would give way to the object.
        press = min(time / RAMP_TIME, 1.0) * self.press
        still, moving = holding + press, joints + self.squeeze + press
        ahead = np.where(press > 0.0, np.maximum(still, moving), np.minimum(still, moving))
        found = np.where(self.press != 0.0, ahead, kept)
        since = time - np.array([m.duration if m.pull else np.inf for m in self.motions])[:, None]
        share = np.clip(since / (0.5 * OPENING_TIME), 0.0, 1.0)
        return np.where(since > 0, holding + share * (opened - holding), found)

    def loads_at(
        self, time: float, object_pose: np.ndarray, center: np.ndarray, palm: np.ndarray, weight: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return external forces at the centers of mass [N] and torques on the objects [N m], world frame,
        shape [I, 3] each.

        Args:
            time: since the motions began [s].
            object_pose: object poses, world frame, shape [I, 7].
            center: centers of mass, world frame [m], shape [I, 3].
            palm: poses, world frame, shape [I, 7].
            weight: weights of the objects [N], shape [I].
        """
        end = transform_points(object_pose, self.end[:, None])[:, 0]
        away = _away(end, palm)
        rise = min(time / RAMP_TIME, 1.0)
        force, torque = np.zeros_like(end), np.zeros_like(end)
        rate = self._displacement(time)[1]
        for i, m in enumerate(self.motions):
            if m.press is not None:
                yielded = end[i, 2] - self.end_height[i]
                normal = rise * np.clip(m.press.force - m.press.stiffness * yielded, 0.0, 2 * m.press.force)
                slowed = np.clip(rate[i] / SLOW, -1.0, 1.0)
                force[i] = normal * (_UP - m.press.friction * slowed * self.axis[i])
            if m.torque:
                first = time < 0.5 * m.duration
                since = time if first else time - 0.5 * m.duration
                torque[i] = (1 if first else -1) * min(since / RAMP_TIME, 1.0) * m.torque * away[i]
            if m.pull:
                force[i] = rise * m.pull * away[i]
                if time > m.duration:
                    # The person who takes the object carries its weight.
                    force[i] += weight[i] * _UP
        return force, torque + cross(end - center, force)

    def _displacement(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return ``UseMotion.displacement`` of each world, shape [I, 1] each."""
        known = {motion: motion.displacement(min(time, motion.duration)) for motion in set(self.motions)}
        value, rate = np.array([known[motion] for motion in self.motions]).T
        return value[:, None], rate[:, None]


def _away(end: np.ndarray, palm: np.ndarray) -> np.ndarray:
    """Return unit vectors from palms to far ends, shape [..., 3]. end: [m], [..., 3]; palm: poses, [...,
    7]."""
    way = end - palm[..., :3]
    return way / np.linalg.norm(way, axis=-1, keepdims=True)


PRESS_MARGIN = 1.5
"""Factor on the trigger's force for the press of a finger, which touches beside the planned point and loses a
part of its force."""


def press_offsets(environment: LiftEnvironment, world: int, trigger: TriggerPress) -> np.ndarray:
    """Return servo offsets that raise the finger tip's normal force on the object to ``PRESS_MARGIN`` times
    the trigger's force [rad], shape [U]: ``J^T f`` over the servo stiffness. The present force is estimated
    from the servo torques in that direction.

    Args:
        trigger: force and finger.
    """
    engine, hand = environment.engine, environment.scene.hand
    object_pose, palm = engine.object_pose[[world]], engine.palm_pose[[world]]
    joints = hand.independent(engine.joint_positions[[world]])
    kinematics = HandKinematics(hand, 1)
    kinematics.update(relative(object_pose, palm), joints)
    tip = kinematics.body_points((hand.fingers[trigger.finger].tip,))
    place = kinematics.points(tip)
    model = environment.scene.models[engine.object_index[world]]
    outward = SignedDistanceBank([model.signed_distance]).query(np.zeros(1, dtype=int), place)[1][0, 0]
    torques = -(outward / np.linalg.norm(outward)) @ kinematics.jacobian(tip.bodies, place)[0, 0, :, 6:]
    stiffness = np.array([servo.kp for servo in hand.actuators.values()])
    squeeze = environment.task.setpoints.fingers[world] - joints[0]
    pressing = torques @ (stiffness * squeeze) / (torques @ torques)
    missing = PRESS_MARGIN * trigger.force - max(pressing, 0.0)
    return max(missing, 0.0) * torques / stiffness
