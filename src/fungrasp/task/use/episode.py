"""Use tests of W worlds whose lift test has just ended: the wrist plays the motion of each grasp's task."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.geometry.poses import (
    compose,
    inverse_transform_points,
    invert,
    quaternion_conjugate,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
    rotation_vector,
    transform_points,
)
from fungrasp.task.environment import LiftEnvironment
from fungrasp.task.use.finger_hold import FingerHold
from fungrasp.task.use.finger_press import press_offsets
from fungrasp.task.use.functional_contact import functional_contact
from fungrasp.task.use.geometry import far_end, horizontal, turn_axis, turning_frame
from fungrasp.task.use.motion import OPENING_TIME, UseMotion
from fungrasp.task.use.outcome import LARGEST_SHIFT, LARGEST_TURN, UseOutcomes

TABLE_AWAY = -0.2
"""Height of the table top during the motion [m]: a robot would move away from it."""

RAMP_TIME = 0.3
"""Time in which forces on the object and the press of a finger rise [s]."""

LOST = 0.1
"""An object that has moved by more in the palm is lost, and its test is over [m]."""

_DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class _Use:
    """One world's test."""

    world: int
    motion: UseMotion
    palm: np.ndarray
    """Setpoint of the palm where the motion begins, world frame, shape [7]."""
    axis: np.ndarray
    """Axis of the turn or line of the shift, world frame, shape [3]."""
    end: np.ndarray
    """The object's far end, object frame [m], shape [3]."""
    end_height: float
    """Its height when the motion begins, world frame [m]."""
    press: np.ndarray
    """Offsets of the setpoints that press a trigger [rad], shape [U]; zero for fingers that do not."""
    squeeze: np.ndarray
    """Offsets of the setpoints from the joints in the hold [rad], shape [U]."""

    def palm_at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Setpoint of the palm, shape [7], and its linear velocity [m/s], shape [3], world frame."""
        value, rate = self.motion.displacement(min(time, self.motion.duration))
        pose = self.palm.copy()
        if self.motion.shift:
            pose[:3] += value * self.axis
            return pose, rate * self.axis
        turn = quaternion_from_rotation_vector(value * self.axis)
        pose[3:] = quaternion_multiply(turn, pose[3:])
        return pose, np.zeros(3)

    def fingers_at(
        self, time: float, joints: np.ndarray, holding: np.ndarray, kept: np.ndarray, opened: np.ndarray
    ) -> np.ndarray:
        """Setpoints of the fingers [rad], shape [U].

        Args:
            time: since the motion began [s].
            joints: where the joints are, shape [U].
            holding: setpoints of the hold, shape [U].
            kept: those that keep the joints where they are, shape [U].
            opened: those of the open hand, shape [U].
        """
        m = self.motion
        if m.trigger is not None:
            # A finger that closes a gap first presses as hard: its setpoints stay as far ahead of its joints.
            # One that is pushed back keeps its setpoints, as what it holds would otherwise go through it.
            press = min(time / RAMP_TIME, 1.0) * self.press
            still, moving = holding + press, joints + self.squeeze + press
            ahead = np.where(press > 0.0, np.maximum(still, moving), np.minimum(still, moving))
            return np.where(self.press != 0.0, ahead, kept)
        if m.pull and time > m.duration:
            share = min((time - m.duration) / (0.5 * OPENING_TIME), 1.0)
            return holding + share * (opened - holding)
        return kept

    def load_at(
        self, time: float, object_pose: np.ndarray, center: np.ndarray, palm: np.ndarray, weight: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Force at the center of mass [N] and torque [N m] of the world on the object, world frame.

        Args:
            time: since the motion began [s].
            object_pose: world frame, shape [7].
            center: of the object's mass, world frame [m], shape [3].
            palm: pose of the palm, world frame, shape [7].
            weight: of the object [N].
        """
        m, force, torque = self.motion, np.zeros(3), np.zeros(3)
        end = transform_points(object_pose[None], self.end[None, None])[0, 0]
        away = (end - palm[:3]) / np.linalg.norm(end - palm[:3])
        rise = min(time / RAMP_TIME, 1.0)
        if m.press is not None:
            yielded = end[2] - self.end_height
            normal = rise * np.clip(m.press.force - m.press.stiffness * yielded, 0.0, 2 * m.press.force)
            _, rate = m.displacement(time)
            # Friction grows with speed below 2 cm/s, so that it does not jump where the stroke turns.
            force = normal * (-_DOWN - m.press.friction * np.clip(rate / 0.02, -1.0, 1.0) * self.axis)
        if m.torque:
            sign = 1.0 if time < 0.5 * m.duration else -1.0
            since = time if sign > 0 else time - 0.5 * m.duration
            torque = sign * min(since / RAMP_TIME, 1.0) * m.torque * away
        if m.pull:
            force = rise * m.pull * away
            if time > m.duration:
                # Whoever takes the object carries it.
                force = force - weight * _DOWN
        return force, torque + np.cross(end - center, force)


def play_use(
    environment: LiftEnvironment,
    motions: Sequence[UseMotion | None],
    held: np.ndarray,
    held_parts: Sequence[Sequence[frozenset[str]]],
    watch: Callable[[], None] = lambda: None,
) -> UseOutcomes:
    """Let the wrist play the motions of W grasps' tasks after the hold, while the fingers hold on
    (``FingerHold``).

    Args:
        environment: whose lift tests are over.
        motions: of each world; None where the task has none.
        held: worlds that passed the lift test, shape [W] bool; the others are not tested.
        held_parts: of each world and contact link, the parts that the person held there, W x L.
        watch: called after each setpoint, to record (``fungrasp.evaluation.UseRecorder``).
    """
    engine, task, hand = environment.engine, environment.task, environment.scene.hand
    contact, touched = functional_contact(environment, held_parts)
    outcomes = UseOutcomes(
        motion=np.array(
            [m.name if m is not None and h else "" for m, h in zip(motions, held, strict=True)], dtype=str
        ),
        success=np.zeros(len(environment), dtype=bool),
        shift_m=np.full(len(environment), np.nan),
        turn_rad=np.full(len(environment), np.nan),
        trigger_force_n=np.full(len(environment), np.nan),
        functional_contact=np.where(held, contact, np.nan),
        reason=np.full(len(environment), "", dtype=object),
    )
    uses = [_begin(environment, w, m) for w, m in enumerate(motions) if m is not None and held[w]]
    if not uses:
        return _with_texts(outcomes)
    worlds = np.array([use.world for use in uses])
    frames = engine.wrist_frame
    for use in uses:
        if use.motion.turn:
            frames[use.world] = turning_frame(use.axis, use.palm)
    palm_before = engine.palm_pose
    engine.set_parameters(worlds, table_height=np.full(len(worlds), TABLE_AWAY))
    engine.set_state(worlds, wrist_frame=frames[worlds], palm_pose=palm_before[worlds])

    palms, velocity = task.setpoints.wrist.pose.copy(), np.zeros((len(engine), 3))
    fingers = task.setpoints.fingers.copy()
    hold = FingerHold(hand, fingers, hand.independent(engine.joint_positions))
    limits = environment.scene.servo_limits.T
    opened = np.clip(0.0, *limits)
    period, substeps = task.setpoints.period, task.setpoints.substeps
    durations = np.array([use.motion.duration for use in uses])
    ends = np.array([use.motion.whole_duration for use in uses])
    shift, turn = np.zeros(len(uses)), np.zeros(len(uses))
    force, torque = np.zeros((len(engine), 3)), np.zeros((len(engine), 3))
    weight = environment.scene.settings.gravity * environment.privileged().object_mass
    start = _in_palm(environment, worlds)
    first = fingers.copy()
    for step in range(round(ends.max() / period)):
        time = step * period
        active = (time < ends - 1e-9) & (shift < LOST)
        poses, centers, palm = engine.object_pose, engine.center_of_mass, engine.palm_pose
        joints = hand.independent(engine.joint_positions)
        kept = np.clip(hold.keep(joints), *limits)
        for use in (u for u, a in zip(uses, active, strict=True) if a):
            w = use.world
            palms[w], velocity[w] = use.palm_at(time + period)
            fingers[w] = use.fingers_at(time + period, joints[w], first[w], kept[w], opened)
            force[w], torque[w] = use.load_at(time, poses[w], centers[w], palm[w], weight[w])
        engine.push_object(force, torque)
        engine.step(engine.controls(palms, velocity, fingers), substeps, worlds[active])
        watch()
        # What has let go may move; until then the object is to stay.
        holding = active & (time < durations - 1e-9)
        moved, turned = _difference(start, _in_palm(environment, worlds))
        shift = np.where(holding, np.maximum(shift, moved), shift)
        turn = np.where(holding, np.maximum(turn, turned), turn)
    engine.push_object(np.zeros_like(force), np.zeros_like(torque))
    outcomes.shift_m[worlds], outcomes.turn_rad[worlds] = shift, turn
    _judge(environment, uses, outcomes, touched)
    return _with_texts(outcomes)


def _begin(environment: LiftEnvironment, world: int, motion: UseMotion) -> _Use:
    engine, scene = environment.engine, environment.scene
    setpoints = environment.task.setpoints
    object_pose, palm = engine.object_pose[world], engine.palm_pose[world]
    model = scene.models[engine.object_index[world]]
    end = far_end(model, object_pose, palm)
    place = transform_points(object_pose[None], end[None, None])[0, 0]
    axis = np.zeros(3)
    if motion.turn:
        axis = turn_axis(motion.turn, scene.hand, palm, place)
    elif motion.shift:
        facing = rotate(palm[3:], scene.hand.palm_normal)
        axis = np.cross(-_DOWN, horizontal((place - palm[:3]) / np.linalg.norm(place - palm[:3]), facing))
    press = np.zeros(setpoints.fingers.shape[1])
    if motion.trigger is not None and motion.trigger.finger in scene.hand.fingers:
        press = press_offsets(environment, world, motion.trigger)
    return _Use(
        world,
        motion,
        setpoints.wrist.pose[world].copy(),
        axis,
        end,
        float(place[2]),
        press,
        setpoints.fingers[world] - scene.hand.independent(engine.joint_positions[[world]])[0],
    )


def _in_palm(environment: LiftEnvironment, worlds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Center of mass [m], shape [I, 3], and rotation, shape [I, 4], of objects in the palm's frame."""
    engine = environment.engine
    palm, pose = engine.palm_pose[worlds], engine.object_pose[worlds]
    center = inverse_transform_points(palm, engine.center_of_mass[worlds][:, None])[:, 0]
    return center, compose(invert(palm), pose)[:, 3:]


def _difference(
    start: tuple[np.ndarray, np.ndarray], now: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement [m] and turn [rad] between two of ``_in_palm``, shape [I] each."""
    turn = rotation_vector(quaternion_multiply(now[1], quaternion_conjugate(start[1])))
    return np.linalg.norm(now[0] - start[0], axis=1), np.linalg.norm(turn, axis=1)


def _judge(
    environment: LiftEnvironment, uses: Sequence[_Use], outcomes: UseOutcomes, parts: np.ndarray
) -> None:
    """Fill in success and reason. parts: that each link touches, shape [W, L] str."""
    engine, hand = environment.engine, environment.scene.hand
    contacts, forces, diverged = engine.link_contacts, engine.link_forces, engine.diverged
    for use in uses:
        w, trigger = use.world, use.motion.trigger
        reason = ""
        if diverged[w]:
            reason = "the simulation diverged"
        elif outcomes.shift_m[w] > LARGEST_SHIFT:
            reason = "the object slipped in the palm"
        elif outcomes.turn_rad[w] > LARGEST_TURN:
            reason = "the object turned in the palm"
        elif trigger is not None:
            links = [i for i, name in enumerate(hand.link_names) if name.startswith(trigger.finger)]
            on_part = [i for i in links if contacts[w, i] and trigger.part in ("", parts[w, i])]
            outcomes.trigger_force_n[w] = forces[w, on_part].sum() if on_part else 0.0
            if not links:
                reason = f"the hand has no {trigger.finger} finger"
            elif not on_part:
                reason = f"the {trigger.finger} finger does not touch the {trigger.part or 'object'}"
            elif outcomes.trigger_force_n[w] < trigger.force:
                reason = f"the {trigger.finger} finger presses with less than {trigger.force:g} N"
        elif use.motion.pull and contacts[w].any():
            reason = "the hand did not let go"
        if not reason and trigger is None and not outcomes.functional_contact[w] > 0:
            reason = "no finger touches the part that the person held"
        outcomes.success[w], outcomes.reason[w] = not reason, reason


def _with_texts(outcomes: UseOutcomes) -> UseOutcomes:
    return replace(outcomes, reason=outcomes.reason.astype(str))
